"""The runs of a station: what each is asked for, from any thread, how it is begun and measured, and what it reports."""

import contextlib
import re
import threading
from collections.abc import Callable, Sequence
from itertools import count
from pathlib import Path

from goniotwin.app.campaign.campaign import check_referenced, check_way, operator_for
from goniotwin.app.campaign.journal.summary import SUFFIX
from goniotwin.app.campaign.journal.writing import Journal, software_versions
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import (
    DeviceFailed,
    Event,
    EventLogged,
    RowCommitted,
    SafetyOrder,
    State,
)
from goniotwin.app.campaign.running.question import Ask
from goniotwin.app.campaign.running.resume import remaining_work
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.errors import UserError, one_line
from goniotwin.app.rig import RigDescription
from goniotwin.app.station.board import Board, Publish
from goniotwin.app.station.messages import RowSaved, RunBegun, RunEnded, RunRefused
from goniotwin.app.station.orders import RunRecord, SafetyOrders
from goniotwin.app.station.permissions import STOPPED
from goniotwin.app.station.poller import POLL_S, Poller
from goniotwin.app.station.stops import Stops
from goniotwin.drivers import NoAnswer
from goniotwin.protocols.clock import Clock, ScaledClock

OPERATOR = "operator"
"""Kind of the event of a journal that a person is the operator of a virtual rig: so again when the run is resumed."""
NOT_BEGUN = (UserError, OSError, ValueError)
"""Errors before a run begins; those of Python are of paths that the system refuses: too long, or with a NUL."""


class Runs:
    """One run after the other: `engine` is the present one's, `record` the last one's. What lasts is in the engine's thread.

    A command for a run may come before its engine exists, and is then carried out when it does. `publish` takes the events,
    and `held` gives the poller of the rig that is open.
    """

    def __init__(
        self, board: Board, publish: Publish, stops: Stops, orders: SafetyOrders, held: Callable[[], Poller | None]
    ) -> None:
        self.engine: Engine | None = None
        self.record: RunRecord | None = None
        self._board = board
        self._publish = publish
        self._stops = stops
        self._orders = orders
        self._held = held
        self._pause_requested, self._finish_requested = threading.Event(), threading.Event()
        self._mounted: str | None = None

    # ---- commands: from any thread ----

    def pause(self) -> None:
        """Pause the run before its next row; one that is about to begin, before its first row."""
        self._pause_requested.set()  # before the engine is looked up: `begin` checks it after it has one
        if self.engine is not None:
            self.engine.pause()

    def resume(self) -> None:
        """Resume the run that is paused."""
        self._pause_requested.clear()
        if self.engine is not None:
            self.engine.resume()

    def finish_cut(self) -> None:
        """End the run in good order after the last row of the cut in progress."""
        self._finish_requested.set()
        if self.engine is not None:
            self.engine.finish_cut()

    def forget_requests(self) -> None:
        """Forget what an earlier run was asked for, its stop too."""
        for each in (self._stops.requested, self._pause_requested, self._finish_requested):
            each.clear()

    # ---- in the engine's thread ----

    def start(self, schedule: Path, folder: Path, rig: RigDescription, ask: Ask, *, person: bool) -> None:
        """Measure a schedule into a new journal in `folder`; RunRefused has the reason where it cannot begin."""
        opened = self._open_poller().bench.opened
        try:
            plan = make_plan(read_schedule(schedule), rig)
            check_referenced(opened, plan.rig.name)
            check_way(opened, plan.rows)
            self._check_stop()
            try:
                folder.mkdir(parents=True, exist_ok=True)
                journal = Journal.create(next_journal(folder, plan.schedule.file.name), plan, software_versions())
            except (UserError, OSError) as error:
                raise UserError(f"the journal cannot be created: {error}") from None
        except NOT_BEGUN as error:
            self._publish(RunRefused(one_line(str(error))))
            return
        self._measure(plan, journal, plan.rows, ask, person=person)

    def continue_journal(self, path: Path, rig: RigDescription, ask: Ask, *, person: bool | None) -> None:
        """Continue the campaign of a journal; RunRefused has the reason where it cannot. None: the operator that it had."""
        opened = self._open_poller().bench.opened
        try:
            with contextlib.closing(Journal.open(path)) as unlocked:
                remaining_work(unlocked, rig)  # raises the error before the journal is changed
            self._check_stop()
            journal = Journal.reopen(path)
            try:
                remaining = remaining_work(journal, rig)  # again, now that no other program can change it
                check_referenced(opened, remaining.plan.rig.name, homing=True)
                check_way(opened, remaining.work)
            except BaseException:
                journal.close()
                raise
        except NOT_BEGUN as error:
            self._publish(RunRefused(one_line(str(error))))
            return
        if isinstance(opened.rig.clock, ScaledClock):
            opened.rig.clock.advance_to(remaining.start_s)
        if person is None:
            person = bool(journal.event_texts(OPERATOR))
        self._measure(remaining.plan, journal, remaining.work, ask, person=person)

    def _check_stop(self) -> None:
        if self._stops.requested.is_set():
            raise UserError(STOPPED)

    def _open_poller(self) -> Poller:
        poller = self._held()
        assert poller is not None
        return poller

    def _measure(self, plan: Plan, journal: Journal, work: Sequence[Row], ask: Ask, *, person: bool) -> None:
        poller = self._open_poller()
        bench, opened, clock = poller.bench, poller.bench.opened, poller.bench.opened.rig.clock
        poller.end_live()
        self._mounted = None
        record = RunRecord(journal, clock)
        reason, opened.guard.journal = "", str(journal.path.resolve())
        with contextlib.closing(record):
            operator = operator_for(opened, plan.rig.file, ask, person=person, samples=plan.schedule.file.samples)
            engine = Engine(opened.rig, plan, journal, operator, [self.listen], positions_every_s(clock), work=work)
            if person and plan.rig.simulated and not journal.event_texts(OPERATOR):
                journal.event(clock.now(), OPERATOR, "a person is the operator of this simulated rig")
            self.begin(engine, plan, journal, work, record, person=person)
            try:
                state = engine.run()
            except Exception as error:  # noqa: BLE001  (last resort of the thread: reported, and nothing moves on)
                reason = f"the run was aborted: {type(error).__name__}: {error}"
                engine.stop()
                state = State.FAILED
            self.wait_for_stops()
        opened.guard.journal = ""
        for device in engine.disconnected:
            lost = NoAnswer(device, "reconnect it during the run", "not responding", "connect it again")
            poller.contacts.note_lost(device, lost)
        bench.look()
        bench.take_over(None if engine.disconnected else engine.gain, self._mounted)
        self.end(state, reason, journal.place.kept_at, journal.place.note)

    def begin(
        self, engine: Engine, plan: Plan, journal: Journal, work: Sequence[Row], record: RunRecord, *, person: bool = False
    ) -> None:
        """Report a run that begins: its commands go to `engine` from now on."""
        self.record = record
        self.engine = engine
        planned = len(plan.rows)
        done = planned - sum(row.number < planned for row in work)
        left = sum(row.seconds for row in work)
        self._publish(RunBegun(journal.path, plan.schedule.file.name, done, planned, left, person))
        for text in journal.open_orders():
            order, _, reason = text.partition(": ")
            self._orders.give(SafetyOrder(order, reason), record)
        if self._pause_requested.is_set():  # each requested before the engine existed
            engine.pause()
        if self._finish_requested.is_set():
            engine.finish_cut()
        if self._stops.requested.is_set():
            engine.stop()

    def wait_for_stops(self) -> None:
        """The engine has ended: wait for the stops in progress, because one that is not confirmed is an order of this run."""
        self.engine = None
        self._stops.wait()

    def end(self, state: State, reason: str, journal: Path, note: str = "") -> None:
        """Report the end of a run, whose journal is closed."""
        self.engine = None
        if note:
            self._publish(EventLogged("journal", note, "journal"))
        if (poller := self._held()) is not None:
            self._publish(poller.bench.settings)
            poller.report_references()
        self._publish(RunEnded(state, reason or self._board.snapshot.reason, journal))

    def listen(self, event: Event) -> None:
        """Take an event of the engine."""
        match event:
            case RowCommitted(row, data, done, total, seconds_left):
                poller = self._open_poller()
                if row.kind == "mount":
                    self._mounted = row.sample
                if data.readings:
                    poller.note_lamp(data.readings[-1].monitor_a, shutter_open=row.kind != "dark")
                if data.readings and row.kind in ("measure", "drift"):  # it needs all devices
                    poller.contacts.note_answers()
                    poller.contacts.report_answers_now_and_then()
                self._publish(RowSaved(row, data.flags, done, total, seconds_left))
            case SafetyOrder():
                self._orders.give(event, self.record)
            case DeviceFailed(error):
                self._open_poller().contacts.note_fault(error, recovered=True)
            case _:
                self._publish(event)


def positions_every_s(clock: Clock) -> float:
    """Time of a rig's clock between two reports of the positions: about 20 a second at a high simulation speed."""
    speed = clock.speed if isinstance(clock, ScaledClock) else 1.0
    return max(POLL_S, 0.25 * POLL_S * speed)


def next_journal(folder: Path, name: str) -> Path:
    """The path of the next journal in a folder: `NAME-001.journal`, or the number after the highest one there.

    The number of a removed journal is not used again while a later one is there.
    """
    stem = re.sub(r"[^\w.-]+", "-", name).strip("-.") or "campaign"
    pattern = re.compile(rf"{re.escape(stem)}-(\d+){re.escape(SUFFIX)}")
    numbers = [int(match[1]) for each in folder.glob(f"*{SUFFIX}") if (match := pattern.fullmatch(each.name))]
    paths = (folder / f"{stem}-{number:03d}{SUFFIX}" for number in count(max(numbers, default=0) + 1))
    return next(path for path in paths if not path.exists())
