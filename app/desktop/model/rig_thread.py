"""The thread that owns the rig: it opens the rig, polls the axes, and runs the engine. No Qt.

Everything that may take long (a port that does not respond, a long plan) happens in this thread, so the window never waits.
Stop does not pass through it, because it may be waiting for a device: Stop has a thread of its own.
"""

import contextlib
import queue
import re
import threading
from collections.abc import Callable
from itertools import count
from pathlib import Path

from goniotwin.app.campaign.campaign import operator_for
from goniotwin.app.campaign.journal.summary import SUFFIX
from goniotwin.app.campaign.journal.writing import Journal, JournalError, software_versions
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.reduction.reduction import journal_findings
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import (
    Event,
    EventLogged,
    Positions,
    SafetyOrder,
    State,
    StateChanged,
    cut_power_order,
)
from goniotwin.app.campaign.running.question import Answer, Question
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.desktop.model.messages import (
    DeviceFault,
    DeviceStatus,
    Message,
    PlanMade,
    PlanRefused,
    QuestionAsked,
    RigClosed,
    RigOpened,
    RunEnded,
    RunRefused,
    RunStarted,
)
from goniotwin.app.errors import UserError
from goniotwin.app.rig import OpenRig, RigDescription, open_rig, read_rig
from goniotwin.app.rig.last_rig import remember_rig
from goniotwin.drivers import DeviceError
from goniotwin.protocols.clock import Clock, ScaledClock

Send = Callable[[Message], None]
NO_RIG = "no rig is open"
POLL_S = 0.2
"""Real time between two readings of the axis positions."""
NO_HEARTBEAT_S = float("inf")
"""A virtual rig has the longest heartbeat of its controllers: it counts simulated time, but the host is slow in real time. At
simulation speed 60, a repaint of 35 ms would exceed a short heartbeat."""


class RunRecord:
    """The journal of a run, for events from any thread, also after the run has closed it."""

    def __init__(self, journal: Journal, clock: Clock) -> None:
        self._journal = journal
        self._clock = clock
        self._open = True
        self._lock = threading.Lock()

    def event(self, kind: str, text: str) -> None:
        """Write an event. Raises JournalError, UserError."""
        t = self._clock.now()
        with self._lock:
            if self._open:
                self._journal.event(t, kind, text)
            else:
                with Journal.reopen(self._journal.path) as journal:
                    journal.event(t, kind, text)

    def close(self) -> None:
        """Close the journal."""
        with self._lock:
            self._open = False
            self._journal.close()


class RigThread:
    """One rig and its runs. `send` is called from this thread and from that of Stop; it must return at once."""

    def __init__(self, send: Send, speed: float = 1.0) -> None:
        self._send = send
        self._speed = speed
        self._tasks: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._clock = ScaledClock()
        self._opened: OpenRig | None = None
        self._description: RigDescription | None = None
        self._schedule: Path | None = None
        self._engine: Engine | None = None
        self._reason = ""
        self._axes_connected = False
        self._short: list[threading.Thread] = []
        self._starting = threading.Lock()
        self._stop_requested = threading.Event()
        self._person = False
        self._asked = 0
        self._answers: queue.SimpleQueue[tuple[int, Answer] | None] = queue.SimpleQueue()
        self._record: RunRecord | None = None
        self._ordered: dict[SafetyOrder, RunRecord | None] = {}
        self._thread = threading.Thread(target=self._work, name="rig")
        self._thread.start()

    # Requests of the window. Each returns at once.

    def open(self, rig: Path) -> None:
        """Open the rig of a file; the rig that is open is closed first."""
        self._tasks.put(lambda: self._open(rig))

    def load(self, schedule: Path) -> None:
        """Read a schedule and make the plan for the rig."""
        self._tasks.put(lambda: self._load(schedule))

    def start(self, plan: Plan, folder: Path) -> None:
        """Run a plan on the open rig, into a new journal in `folder`, which is created if it does not exist."""
        self._stop_requested.clear()
        self._tasks.put(lambda: self._run(plan, folder))

    def pause(self) -> None:
        """Pause the run before its next row."""
        engine = self._engine
        if engine is not None:
            engine.pause()

    def resume(self) -> None:
        """Resume the run."""
        engine = self._engine
        if engine is not None:
            engine.resume()

    def stop(self) -> None:
        """Bring all axes to rest and end the run. An axis that does not respond delays no other."""
        self._start_short("stop", self._stop)

    def answer(self, number: int, answer: Answer) -> None:
        """Answer a question by its number; ignored if it is not open any more."""
        self._answers.put((number, answer))

    def acknowledge(self, order: SafetyOrder) -> None:
        """Record in the journal of its run that a safety order has been acknowledged."""
        self._start_short("acknowledge", lambda: self._acknowledge(order))

    def set_person(self, person: bool) -> None:
        """Set whether a person is the operator of a virtual rig, from the next run on."""
        self._person = person

    def set_speed(self, speed: float) -> None:
        """Set the simulation speed of a virtual rig; ignored for a real one."""
        self._speed = speed
        if self._description is not None and self._description.file.in_process:
            self._clock.set_speed(speed)

    def close(self) -> None:
        """Stop a run, close the rig and end the threads; return when they have ended. Nothing is moved."""
        self._stop_requested.set()  # a run that is requested but not started does not start
        if self._engine is not None:
            self.stop()
        self._tasks.put(None)
        self._thread.join()
        self._wait_for_short()

    @property
    def open_orders(self) -> list[SafetyOrder]:
        """The safety orders that are not acknowledged; complete after `close`."""
        return list(self._ordered)

    def _start_short(self, name: str, work: Callable[[], None]) -> None:
        """Start a thread for what may wait for a device or a disk."""
        thread = threading.Thread(target=work, name=name)
        with self._starting:
            self._short = [each for each in self._short if each.is_alive()] + [thread]
            thread.start()

    def _wait_for_short(self) -> None:
        """Wait for the threads that were started so far."""
        with self._starting:
            started = list(self._short)
        for each in started:
            each.join()

    # In the thread.

    def _work(self) -> None:
        while True:
            try:
                # Real time: this wait is for the operator, not for the rig.
                task = self._tasks.get(timeout=POLL_S)
            except queue.Empty:
                self._poll_axes()
                continue
            if task is None:
                break
            try:
                task()
            except Exception as error:  # noqa: BLE001  (of any library: reported, and the window stays open)
                self._close_rig()
                self._report_no_rig(f"the rig was closed after a fault: {type(error).__name__}: {error}")
        self._close_rig()

    def _poll_axes(self) -> None:
        """Send the positions of the axes while no run is on. After a failure no more are read until the rig is opened again."""
        if self._opened is None or not self._axes_connected:
            return
        try:
            degrees = {name: axis.position_deg() for name, axis in self._opened.rig.axes.items()}
        except DeviceError as error:
            self._axes_connected = False
            self._send(DeviceFault(self._opened.rig.device(error.device).name, str(error)))
        else:
            self._send(Positions(degrees))

    def _open(self, path: Path) -> None:
        self._close_rig()
        try:
            description = read_rig(path)
            self._clock = ScaledClock(self._speed if description.file.in_process else 1.0)
            opened = open_rig(description, self._clock)
        except UserError as error:
            self._report_no_rig(str(error))
            return
        self._opened, self._description = opened, description
        if description.file.in_process:
            for controller in opened.rig.controllers:
                controller.set_heartbeat(NO_HEARTBEAT_S)
        outcome = opened.rig.connect()
        if not any(outcome.values()):
            remember_rig(description.file)
        self._axes_connected = all(outcome[each.name] is None for each in opened.rig.controllers)
        devices = {
            device: DeviceStatus(True, opened.rig.identities[device]) if error is None else DeviceStatus(False, str(error))
            for device, error in outcome.items()
        }
        self._send(RigOpened(description, devices, description.file.in_process))
        if self._schedule is not None:
            self._load(self._schedule)

    def _report_no_rig(self, reason: str) -> None:
        self._send(RigClosed(reason))
        self._send(PlanRefused(NO_RIG))

    def _load(self, path: Path) -> None:
        self._schedule = path
        if self._description is None:
            self._send(PlanRefused(NO_RIG))
            return
        try:
            self._send(PlanMade(make_plan(read_schedule(path), self._description)))
        except UserError as error:
            self._send(PlanRefused(str(error)))

    def _run(self, plan: Plan, folder: Path) -> None:
        if self._opened is None or plan.rig is not self._description:
            self._send(RunRefused("the plan is for another rig; open the schedule again"))
            return
        if self._stop_requested.is_set():
            self._send(RunRefused("stopped before the start"))
            return
        try:
            folder.mkdir(parents=True, exist_ok=True)
            path = next_journal(folder, plan.schedule.file.name)
            journal = Journal.create(path, plan, software_versions())
        except (UserError, OSError) as error:
            self._send(RunRefused(f"the journal cannot be created: {error}"))
            return
        self._record = RunRecord(journal, self._opened.rig.clock)
        with contextlib.closing(self._record):
            # Often enough for the operator to see the positions change, at any simulation speed.
            every_s = max(POLL_S, 0.25 * POLL_S * self._clock.speed)
            operator = operator_for(self._opened, plan.rig.file, self._ask, person=self._person)
            self._reason = ""
            engine = Engine(self._opened.rig, plan, journal, operator, [self._forward], every_s)
            self._engine = engine
            self._send(RunStarted(plan, path))
            if self._stop_requested.is_set():  # requested before the engine existed
                engine.stop()
            state = self._run_engine(engine)
            self._engine = None
            self._wait_for_short()  # a stop that is not confirmed is an order of this run
        if journal.note:
            self._send(EventLogged("journal", journal.note, "journal"))
        for device in engine.disconnected:
            self._axes_connected &= all(each.name != device for each in self._opened.rig.controllers)
            self._send(DeviceFault(device, f"{device}: could not be reconnected during the run; connect again"))
        self._send(RunEnded(state, self._reason, journal.kept_at))
        self._report_findings(journal.kept_at)

    def _report_findings(self, journal: Path) -> None:
        """Send what the data of a run show of the instrument, if they are enough for a reduction."""
        with contextlib.suppress(UserError):
            for finding in journal_findings(journal):
                self._send(EventLogged("finding", finding, journal.name, "see goniotwin verify"))

    def _run_engine(self, engine: Engine) -> State:
        """Run the engine. An exception that is not a fault of a device (a full disk, a program error) stops the axes too."""
        try:
            return engine.run()
        except Exception as error:  # noqa: BLE001  (last resort of the thread: reported, and nothing moves on)
            self._reason = f"the run was aborted: {type(error).__name__}: {error}"
            engine.stop()
            return State.FAILED

    def _forward(self, event: Event) -> None:
        if isinstance(event, StateChanged) and event.reason:
            self._reason = event.reason
        if isinstance(event, SafetyOrder):
            self._ordered[event] = self._record
        self._send(event)

    def _ask(self, question: Question) -> Answer:
        """Wait for the operator's answer, or for Stop."""
        self._asked += 1
        if not self._stop_requested.is_set():
            self._send(QuestionAsked(self._asked, question))
        while not self._stop_requested.is_set():
            match self._answers.get():
                case (self._asked, Answer() as answer):
                    return answer
        return Answer.STOP

    def _stop(self) -> None:
        self._stop_requested.set()  # before the engine is looked up: `_run` checks it after it has created one
        engine, opened = self._engine, self._opened
        if engine is not None:
            engine.stop()
        elif opened is not None:
            failures = opened.rig.stop()
            for each in failures:
                self._send(EventLogged("fault", str(each), each.device))
            if (order := cut_power_order(opened.rig, failures)) is not None:
                self._ordered[order] = None
                self._send(order)
        self._answers.put(None)  # wakes a run that waits for an answer

    def _acknowledge(self, order: SafetyOrder) -> None:
        record = self._ordered.pop(order, None)  # None: no run was on when it was given
        if record is not None:
            try:
                record.event("acknowledged", order.text)
            except (JournalError, UserError) as error:
                self._send(EventLogged("fault", f"the acknowledgement is not in the journal: {error}", "journal"))

    def _close_rig(self) -> None:
        opened, self._opened, self._description = self._opened, None, None
        self._axes_connected = False
        if opened is not None:
            opened.close()


def next_journal(folder: Path, name: str) -> Path:
    """The path of the next journal in a folder: `NAME-001.journal`, or the number after the highest one there.

    The number of a removed journal is not used again while a later one is there.
    """
    stem = re.sub(r"[^\w.-]+", "-", name).strip("-.") or "campaign"
    pattern = re.compile(rf"{re.escape(stem)}-(\d+){re.escape(SUFFIX)}")
    numbers = [int(match[1]) for each in folder.glob(f"*{SUFFIX}") if (match := pattern.fullmatch(each.name))]
    paths = (folder / f"{stem}-{number:03d}{SUFFIX}" for number in count(max(numbers, default=0) + 1))
    return next(path for path in paths if not path.exists())
