"""The window's connection to the station that has the rig. No Qt.

What the operator does goes to the station as a command, and is answered by its events. The window's own process makes plans
and reads the journal, in threads: it finds the values of a row there when the station reports the row. Stop is sent by the
thread that calls it, before anything else.
"""

import contextlib
import logging
import queue
import threading
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, wait
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from goniotwin.app.campaign.journal.samples import known_samples, samples_of
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.running.events import SafetyOrder, left_order
from goniotwin.app.campaign.running.question import Answer
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.desktop.model.messages import (
    Attached,
    CommandRefused,
    Message,
    NotAttached,
    PlanRefused,
    RigRead,
    SamplesRead,
    StationLost,
    StopReport,
)
from goniotwin.app.desktop.model.planner import NO_RIG, Planner, description_of
from goniotwin.app.desktop.model.run_reader import RunReader
from goniotwin.app.errors import UserError
from goniotwin.app.rig.left import acknowledge_left, left_unsafe
from goniotwin.app.station.client import ANSWER_S as COMMAND_S
from goniotwin.app.station.client import NoStation, Refused, StationClient
from goniotwin.app.station.connection_file import attach, connection_folder
from goniotwin.app.station.hosting import station_of
from goniotwin.app.station.message_text import message_text
from goniotwin.app.station.messages import Message as StationMessage
from goniotwin.app.station.messages import QuestionAsked, RigOpened, RunEnded, RunRefused, Snapshot
from goniotwin.app.station.orders import end_shutter_orders
from goniotwin.app.station.permissions import STOPPED
from goniotwin.app.station.starting import start_station
from goniotwin.protocols.clock import RealClock, calendar_s

Send = Callable[[Message], None]
OnEvent = Callable[[StationMessage], None]
OnEnd = Callable[[], None]
LOG = logging.getLogger(__name__)
NOT_OPENED = "stopped before the rig was open; connect again"
LOST_S = 0.5
"""Real time without any reply after which a stop counts as lost."""
ANSWER_S = 2.0
"""Longest time that a window which is closed waits for answers."""
END_S = 30.0
"""Longest time in which a station gives its rig back."""


class Stations(Protocol):
    """How a window finds or starts the station of a rig file."""

    look_s: float
    """Time between two looks for a station of the rig, while there is none."""

    def attach(self, rig: Path, name: str, on_event: OnEvent, on_end: OnEnd) -> StationClient | None:
        """Attach to a station that has the rig; None where there is none. Raises TimeoutError where it is silent."""

    def start(
        self, rig: Path, speed: float, name: str, on_event: OnEvent, on_end: OnEnd, given_up: Callable[[], bool]
    ) -> StationClient:
        """Start a station and attach to it. Raises UserError, also where it is `given_up` meanwhile."""

    def changed(self) -> bool:
        """Whether there may be other stations than at the last call that returned True. Costs nothing."""


class StationProcesses:
    """Stations in processes of their own, found by their connection files."""

    look_s = 2.0

    def __init__(self) -> None:
        self._seen: int | None = None

    def attach(self, rig: Path, name: str, on_event: OnEvent, on_end: OnEnd) -> StationClient | None:
        """Attach to a station that has the rig; None where there is none. Raises UserError."""
        path = station_of(rig)
        return None if path is None else attach(path, name, on_event, on_end)

    def start(
        self, rig: Path, speed: float, name: str, on_event: OnEvent, on_end: OnEnd, given_up: Callable[[], bool]
    ) -> StationClient:
        """Start a station and attach to it. Raises UserError, also where it is `given_up` meanwhile."""
        return start_station(rig, speed, name, on_event, on_end, given_up)

    def changed(self) -> bool:
        """Whether the connection files may be others than at the last call that returned True: one look at their folder."""
        try:
            now = connection_folder().stat().st_mtime_ns
        except OSError:  # there is none yet
            return False
        if now == self._seen:
            return False
        # A file that comes within the same tick of the file system's clock would not be seen.
        settled = calendar_s() - 1e-9 * now > self.look_s
        self._seen = now if settled else None
        return True


class Session:
    """One client of one station; `leaving` when its end is expected. `stops` is how many it has had when the client came."""

    def __init__(self, take: Callable[["Session", StationMessage], None], lost: Callable[["Session"], None]) -> None:
        self._take, self._lost = take, lost
        self.client: StationClient | None = None
        self.stops = 0
        self.leaving = False
        self.ended = threading.Event()

    def on_event(self, message: StationMessage) -> None:
        """Take an event of the station, and log it."""
        if text := message_text(message):
            LOG.info("station: %s", text)
        self._take(self, message)

    def on_end(self) -> None:
        """The connection has ended."""
        LOG.info("the connection to the station has ended%s", "" if self.leaving else " unexpectedly")
        self.ended.set()
        self._lost(self)


@dataclass(frozen=True)
class Asked:
    """When something was asked for: after how many stops of this window, and of the station that it had then."""

    presses: int
    session: Session | None
    stops: int


class Connection:
    """The station of the window's rig. `send` is called from several threads; it must return at once."""

    def __init__(self, send: Send, speed: float = 1.0, stations: Stations | None = None, name: str = "window") -> None:
        self._send = send
        self._speed = speed
        self._stations = stations or StationProcesses()
        self._name = name
        self._session: Session | None = None
        self._last = Snapshot(speed=speed)
        self._rig_path: Path | None = None
        self._person = False
        self._closing = False
        self._presses = 0
        self._stopping = threading.Lock()
        self._openings = 0
        self._starts: deque[Asked] = deque()
        self._pending: list[Future[dict[str, Any]]] = []
        self._wall = RealClock()
        self._tasks: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._planner = Planner(send)
        self._reader = RunReader(send, lambda: self._planner.plan)
        # A daemon: a station that hangs keeps no window open.
        self._thread = threading.Thread(target=self._work, name="connection", daemon=True)
        self._tasks.put(self._show_left)
        self._thread.start()

    # ---- what the window asks for; each returns at once ----

    @property
    def snapshot(self) -> Snapshot:
        """The station as it is known; the last one known if there is none any more."""
        client = self._client
        if client is not None:
            self._last = client.snapshot
        return self._last

    @property
    def open_orders(self) -> list[SafetyOrder]:
        """The safety orders that are not acknowledged."""
        return list(self.snapshot.orders)

    def open(self, rig: Path) -> None:
        """Attach to the station of a rig, or start one. The rig that is open, this one too, is given back before.

        Not after a stop; and not after another opening was asked for.
        """
        self._openings += 1
        opening, presses = self._openings, self._presses
        self._tasks.put(lambda: self._open(rig, presses, opening))

    def load(self, schedule: Path) -> None:
        """Read a schedule and make the plan for the rig."""
        self._tasks.put(lambda: self._load(schedule))

    def start(self, plan: Plan, folder: Path) -> None:
        """Measure a plan into a new journal in `folder`, which is created if it does not exist."""
        self._starts.append(self._asked_now())
        self._tasks.put(lambda: self._start(plan, folder))

    def resume_journal(self, journal: Path) -> None:
        """Continue the campaign of a journal; a station is started first if there is none."""
        self._starts.append(self._asked_now())
        self._tasks.put(lambda: self._resume_journal(journal))

    def stop(self) -> None:
        """Bring all axes to rest and end what is in progress, or has been asked for. Reported by StopReport."""
        with self._stopping:  # the line of a start is written before that of the stop, or not at all
            self._presses += 1
        client = self._client
        if client is None:
            self._send(StopReport(confirmed=False, lost=True))
            return
        received = threading.Event()
        future = client.send("stop", received=received.set)
        future.add_done_callback(self._report_stop)
        self._wall.at(self._wall.now() + LOST_S, lambda: self._check_stop(received, future))

    def pause(self) -> None:
        """Pause the run before its next row; one that has been asked for, before its first row."""
        self._after_start("pause")

    def resume(self) -> None:
        """Resume the run."""
        self.command("resume")

    def finish_cut(self) -> None:
        """End the run after the cut in progress."""
        self._after_start("finish_cut")

    def answer(
        self, number: int, answer: Answer, angle_deg: float | None = None, sample: Mapping[str, Any] | None = None
    ) -> None:
        """Answer a question by its number; `Set position` with the angle, `Mounted` with what is stated of the sample."""
        given = {"angle_deg": angle_deg, "sample": sample or None}
        given = {key: value for key, value in given.items() if value is not None}
        self.command("answer", question=number, choice=answer, **given)

    def acknowledge(self, order: SafetyOrder) -> None:
        """Acknowledge a safety order; the journal of its run records it. One that no station has is of a program that died."""
        if order in self.snapshot.orders:
            self.command("acknowledge", order=order.text)
        else:
            self._tasks.put(partial(self._acknowledge_left, order.text))

    def operate(self) -> None:
        """Operate the rig from here; the other clients watch from then on."""
        self.command("operate")

    def set_person(self, person: bool) -> None:
        """Set whether a person is the operator of a virtual rig, from the next run on."""
        self._person = person

    def set_speed(self, speed: float) -> None:
        """Set the simulation speed of a virtual rig; ignored for a real one."""
        self._speed = speed
        rig = self.snapshot.rig
        if rig is not None and rig.virtual:
            self.command("speed", factor=speed)

    def command(self, command: str, **arguments: Any) -> None:
        """Send any command of a station (`station.permissions.COMMANDS`); a refusal is reported by CommandRefused."""
        client = self._client
        if client is None:
            self._send(CommandRefused(command, NO_RIG))
            return
        future = client.send(command, **arguments)
        self._pending = [each for each in self._pending if not each.done()] + [future]
        future.add_done_callback(lambda future: self._report_refusal(command, future))

    def close(self) -> None:
        """Leave the station, which goes on, and end the threads; return when they have ended, or what they wait for hangs."""
        self._closing = True
        self._planner.close()
        self._reader.close()
        wait(self._pending, ANSWER_S)  # an acknowledgement is in the journal before the window is closed
        self._tasks.put(None)
        self._thread.join(ANSWER_S)
        session = self._session
        if session is not None and session.client is not None:
            self._last = session.client.snapshot
            session.leaving = True
            self._session = None
            session.client.close()
        self._reader.join(ANSWER_S)

    # ---- the thread of the connection ----

    @property
    def _client(self) -> StationClient | None:
        session = self._session
        return session.client if session is not None else None

    def _after_start(self, command: str) -> None:
        """Send a command, after that for a run which is still to be sent."""
        if self._starts:
            self._tasks.put(lambda: self.command(command))
        else:
            self.command(command)

    def _send_start(self, command: str, **arguments: Any) -> None:
        """Send the command for a run, unless there was a stop since it was asked for. Raises UserError, TimeoutError."""
        session, asked = self._session, self._starts[0]
        with self._stopping:
            if self._presses != asked.presses:
                raise UserError(STOPPED)
            if session is None or session.client is None:
                raise UserError(NO_RIG)
            stops = asked.stops if session is asked.session else session.stops
            answer = session.client.send(command, stops=stops, **arguments)
        answer.result(COMMAND_S)

    def _asked_now(self) -> Asked:
        session = self._session
        return Asked(self._presses, session, session.client.snapshot.stops if session and session.client else 0)

    def _show_left(self) -> None:
        """Show the orders for what programs that died have left; a station of the rig takes them away again."""
        for each in left_unsafe():
            self._send(left_order(each))

    def _acknowledge_left(self, text: str) -> None:
        for each in acknowledge_left(text):
            end_shutter_orders(each)

    def _work(self) -> None:
        while True:
            try:
                task = self._tasks.get(timeout=self._stations.look_s)
            except queue.Empty:
                task = self._look
            if task is None:
                return
            try:
                task()
            except (UserError, TimeoutError) as error:
                self._send(NotAttached(str(error)))
            except Exception as error:  # of any library: reported, and the window stays open
                LOG.exception("unexpected error")
                self._send(NotAttached(f"unexpected error: {type(error).__name__}: {error}"))

    def _open(self, rig: Path, presses: int, opening: int) -> None:
        def given_up() -> bool:
            return self._closing or self._presses != presses or self._openings != opening

        if self._closing or self._openings != opening:
            return
        if self._presses != presses:
            self._send(NotAttached(NOT_OPENED))
            return
        self._leave()
        self._rig_path = rig
        session = Session(self._take, self._lose)
        try:
            client = self._stations.attach(rig, self._name, session.on_event, session.on_end)
            found = client is not None
            if client is None:
                client = self._stations.start(rig, self._speed, self._name, session.on_event, session.on_end, given_up)
        except (UserError, TimeoutError) as error:
            if self._openings != opening:
                return
            if self._presses != presses:
                self._send(NotAttached(NOT_OPENED))
                return
            silent = isinstance(error, TimeoutError)
            self._send(NotAttached(f"{rig}: its station is not responding; wait, or end its process" if silent else str(error)))
            self._send(PlanRefused(NO_RIG))
            return
        self._begin_session(session, client, found)
        if found and self._presses != presses:  # meant for what that station does
            client.send("stop")

    def _look(self) -> None:
        """Attach to a station of the rig that another program has started meanwhile. Nothing is opened."""
        if self._client is not None or self._rig_path is None or not self._stations.changed():
            return
        session = Session(self._take, self._lose)
        with contextlib.suppress(TimeoutError):
            client = self._stations.attach(self._rig_path, self._name, session.on_event, session.on_end)
            if client is not None:
                self._begin_session(session, client, found=True)

    def _begin_session(self, session: Session, client: StationClient, found: bool) -> None:
        if self._closing:
            client.close()
            return
        session.client, session.stops = client, client.snapshot.stops
        LOG.info("attached to the station of %s as %s", self._rig_path, client.name)
        self._session = session
        self._send(Attached(client.name, client.snapshot, found, client.dropped, client.attached_s))
        self._show(client.snapshot)
        client.start()

    def _leave(self) -> None:
        """Give the open rig back, and wait for the end of its station; or leave it to the other client that operates it."""
        session, self._session = self._session, None
        self._planner.give_up()
        if session is None or session.client is None:
            return
        session.leaving = True
        with contextlib.suppress(NoStation, Refused, TimeoutError):
            session.client.do("disconnect")
            session.ended.wait(END_S)
        session.client.close()

    def _show(self, snapshot: Snapshot) -> None:
        """Report the state of a station as the events that have led to it."""
        if snapshot.rig is not None:
            self._tasks.put(self._read_rig)
        if snapshot.journal is not None:
            self._reader.attach(snapshot)
        if snapshot.question is not None:
            self._tasks.put(partial(self._read_samples, snapshot.question))

    def _take(self, session: Session, message: StationMessage) -> None:
        """Take an event of the station, in the thread that reads it."""
        if session is not self._session:
            return
        self._reader.take(message)
        if isinstance(message, RunEnded):  # the reader sends it, after the values of its rows
            return
        self._send(message)
        if isinstance(message, RigOpened):  # after it: a window forgets the plan for the rig before
            self._tasks.put(self._read_rig)
        if isinstance(message, QuestionAsked):
            self._tasks.put(partial(self._read_samples, message))

    def _lose(self, session: Session) -> None:
        if session is self._session and not session.leaving:
            self._last = session.client.snapshot if session.client is not None else self._last
            self._session = None
            self._planner.give_up()
            self._send(StationLost(self._last))

    def _read_rig(self) -> None:
        """Read the tables of the station's rig, and make the plan for it."""
        rig = self.snapshot.rig
        try:
            self._send(RigRead(None if rig is None else description_of(rig).file))
        except (UserError, OSError):
            self._send(RigRead(None))  # the plan is refused with the reason
        self._make_plan()

    def _read_samples(self, asked: QuestionAsked) -> None:
        """Read what is known of the sample that a question is about."""
        sample, journal = asked.question.sample, self.snapshot.journal
        if sample and journal is not None:
            own = next((each for each in samples_of(journal) if each.name == sample), None)
            self._send(SamplesRead(asked.number, own, tuple(known_samples(journal.parent))))

    def _load(self, schedule: Path) -> None:
        self._planner.schedule = schedule
        self._make_plan()

    def _make_plan(self) -> None:
        self._planner.make(self.snapshot.rig if self._client is not None else None)

    def _start(self, plan: Plan, folder: Path) -> None:
        path = Path(plan.schedule.name).absolute()
        try:
            if read_schedule(path).text != plan.schedule.text:
                raise UserError(f"{path}: has changed since it was read; open it again")
            self._send_start("start", schedule=str(path), folder=str(folder.absolute()), person=self._person)
        except (UserError, TimeoutError) as error:
            self._send(RunRefused(str(error)))
        finally:
            self._starts.popleft()

    def _resume_journal(self, journal: Path) -> None:
        """Continue a campaign, with the operator of its journal."""
        try:
            if self._client is None and self._rig_path is not None:
                self._open(self._rig_path, self._starts[0].presses, self._openings)
            if (client := self._client) is not None:
                self._wait_for_rig(client)
            self._send_start("continue", journal=str(journal.absolute()))
        except (UserError, TimeoutError) as error:
            self._send(RunRefused(str(error)))
        finally:
            self._starts.popleft()

    def _wait_for_rig(self, client: StationClient) -> None:
        """Wait until a station that has just been started has connected its devices."""
        until = self._wall.now() + END_S
        presses = self._starts[0].presses
        while client.snapshot.rig is None and not client.snapshot.closed and not client.ended and self._wall.now() < until:
            if self._presses != presses:
                return
            self._wall.sleep_until(self._wall.now() + 0.05)

    # ---- answers ----

    def _report_refusal(self, command: str, future: "Future[dict[str, Any]]") -> None:
        error = future.exception()
        if error is not None and not self._closing:
            self._send(CommandRefused(command, str(error)))

    def _report_stop(self, future: "Future[dict[str, Any]]") -> None:
        if self._closing:
            return
        if future.exception() is not None:
            self._send(StopReport(confirmed=False, lost=True))
        else:
            failures = tuple(future.result().get("failures", ()))
            self._send(StopReport(confirmed=not failures, failures=failures))

    def _check_stop(self, received: threading.Event, future: "Future[dict[str, Any]]") -> None:
        if not received.is_set() and not future.done() and not self._closing:
            self._send(StopReport(confirmed=False, lost=True))
