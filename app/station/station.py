"""The station: one rig, held from `open` to `close`, its bench and its runs. A plain object; no process, no channel, no window.

Each command is a public method and returns at once; it raises `CommandRefused` where `allowed` has a reason. What lasts is done
by the *engine's thread*, the one that calls `serve` (or, in tests on the virtual clock, `work`), and is reported by events.
`stop` does not pass through that thread, because it may be waiting for a device: it is carried out by the thread that calls it.
"""

import contextlib
import queue
import re
import threading
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import count
from pathlib import Path

from goniotwin.app.campaign.campaign import check_referenced, check_way, operator_for
from goniotwin.app.campaign.journal.summary import SUFFIX
from goniotwin.app.campaign.journal.writing import Journal, JournalError, software_versions
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import (
    DeviceFailed,
    Event,
    EventLogged,
    LightChanged,
    Positions,
    RowCommitted,
    SafetyOrder,
    State,
    close_shutter_order,
    cut_power_order,
    left_order,
    shutter_found_open,
)
from goniotwin.app.campaign.running.question import Answer, PositionGiven, Question, Reply, position_refusal
from goniotwin.app.campaign.running.resume import remaining_work
from goniotwin.app.campaign.running.stop import Stopped, StopRequest
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.errors import UserError, one_line
from goniotwin.app.guardian.record import Record
from goniotwin.app.rig import AXES, OpenRig, RigDescription, open_rig
from goniotwin.app.rig.last_rig import remember_rig
from goniotwin.app.station.bench import Bench, PendingReading
from goniotwin.app.station.board import Board
from goniotwin.app.station.contacts import Contacts
from goniotwin.app.station.messages import (
    ActivityChanged,
    BenchChanged,
    LampRead,
    Message,
    OperatorChanged,
    OrderAcknowledged,
    QuestionAsked,
    QuestionClosed,
    ReferencesChanged,
    RigClosed,
    RigOpened,
    RowSaved,
    RunBegun,
    RunEnded,
    RunRefused,
    Snapshot,
    SpeedChanged,
    StopReceived,
)
from goniotwin.app.station.permissions import STOPPED, allowed
from goniotwin.drivers import Axis, DeviceError, LimitError, NoAnswer
from goniotwin.drivers.errors import FaultText, Unreferenced
from goniotwin.drivers.guard import CLOSE_SHUTTER
from goniotwin.drivers.motion import MotionController
from goniotwin.protocols.clock import GREATEST_SPEED, LEAST_SPEED, Clock, RealClock, ScaledClock, VirtualClock, calendar_stamp

POLL_S = 0.2
"""Real time between two readings of the axis positions at rest."""
ENCODERS_S = 1.0
"""Real time between two comparisons of counters and encoders of axes at rest."""
LAMP_S = 1.0
"""Shortest real time between two reports of the monitor's current."""
DARK_TIMES = 3.0
"""The monitor shows light by more than so many times its current with the shutter closed."""
LIVE_POLL_S = 0.02
"""The same between two polls of live readings."""
LIVE_S = 0.1
"""Shortest real time between two live readings."""
NO_HEARTBEAT_S = float("inf")
"""A virtual rig has the longest heartbeat of its controllers: it counts simulated time, but the host is slow in real time. At
simulation speed 60, a pause of 35 ms would exceed a short heartbeat."""
OPERATOR = "operator"
"""Kind of the event of a journal that a person is the operator of a virtual rig: so again when the run is resumed."""
NOT_BEGUN = (UserError, OSError, ValueError)
"""Errors before a run begins; those of Python are of paths that the system refuses: too long, or with a NUL."""
Task = Callable[[], None]
NO_ACTIVITY = -1


class CommandRefused(UserError):
    """A command that the station does not carry out now; the message is the reason, in one line."""


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


class Station:
    """One rig and what is done with it.

    `board` has its state and takes listeners. `disconnected` is set when the rig is to be given back: no command begins then.
    `clock` is that of the rig; without it a virtual rig has one at `speed`, which the command of that name changes, and any
    other rig real time. `wall` is real time, in which idle devices are polled.
    """

    def __init__(self, speed: float = 1.0, clock: Clock | None = None, wall: Clock | None = None) -> None:
        self.board = Board(Snapshot(speed=speed))
        self.disconnected = threading.Event()
        self._given_clock = clock
        self._clock: Clock = clock or ScaledClock()
        self._wall = wall or RealClock()
        self._tasks: queue.SimpleQueue[tuple[Task, int] | None] = queue.SimpleQueue()
        self._begun = 0
        """Number of the activity that was begun last."""
        self._opened: OpenRig | None = None
        self._description: RigDescription | None = None
        self._bench: Bench | None = None
        self._contacts: Contacts | None = None
        self._engine: Engine | None = None
        self._live: PendingReading | None = None
        self._live_due = 0.0
        self._settled = False
        self._end_reason = ""
        self._mounted: str | None = None
        self._stop_requested, self._pause_requested, self._finish_requested = (threading.Event() for _ in range(3))
        self._stops = 0
        self._no_stops = threading.Condition()
        self._asked = 0
        self._answered = 0
        self._answers: queue.SimpleQueue[tuple[int, Reply] | None] = queue.SimpleQueue()
        self._record: RunRecord | None = None
        self._ordered: dict[SafetyOrder, RunRecord | None] = {}
        self._monitor_dark_a = 0.0
        self._resting: dict[str, tuple[float, float]] = {}
        """Of axes: the counter, and the rig's time since which it is so."""
        self._encoders: dict[str, float] = {}
        self._due: defaultdict[str, float] = defaultdict(float)

    @property
    def snapshot(self) -> Snapshot:
        """The state now."""
        return self.board.snapshot

    @property
    def now_s(self) -> float:
        """The time of the rig's clock, s."""
        return self._clock.now()

    @property
    def busy(self) -> bool:
        """Whether a run is in progress or about to begin, or anything moves on the bench."""
        now = self.snapshot
        return now.busy or now.starting or bool(now.activity)

    @property
    def open_orders(self) -> list[SafetyOrder]:
        """The safety orders that are not acknowledged."""
        return list(self._ordered)

    # ---- commands: from any thread; each returns at once ----

    def stop(self) -> list[str]:
        """Bring all axes to rest, and end the run or what the bench does; return what was not confirmed.

        Carried out by the calling thread, at once. An axis that does not respond delays no other.
        """
        with self._no_stops:  # nothing is accepted from here to the end; `wait_for_stops` waits for it
            self._stops += 1
            self._stop_requested.set()  # before the engine is looked up: `run_begun` checks it after it has created one
        try:
            engine, bench, opened = self._engine, self._bench, self._opened
            if engine is not None:
                return [str(each) for each in engine.stop()]
            if bench is None or opened is None:
                return []
            failures = bench.request.stop()
            for each in failures:
                fault = opened.rig.in_words(each)
                self._publish(EventLogged("fault", fault.headline, each.device, detail=fault.detail))
            if (order := cut_power_order(opened.rig, failures)) is not None:
                self._give_order(order, None)
            return [str(each) for each in failures]
        finally:
            self._answers.put(None)  # wakes a run that waits for an answer
            try:
                self._publish(StopReceived())  # before another command is accepted: its client knows this stop
            finally:
                with self._no_stops:
                    self._stops -= 1
                    self._no_stops.notify_all()

    def pause(self) -> None:
        """Pause the run before its next row, with the shutter closed; one that is about to begin, before its first row."""
        self._check("pause")
        self._pause_requested.set()  # before the engine is looked up: `run_begun` checks it after it has one
        if self._engine is not None:
            self._engine.pause()

    def resume(self) -> None:
        """Resume the run that is paused."""
        self._check("resume")
        self._pause_requested.clear()
        if self._engine is not None:
            self._engine.resume()

    def finish_cut(self) -> None:
        """End the run in good order after the last row of the cut in progress."""
        self._check("finish_cut")
        self._finish_requested.set()
        if self._engine is not None:
            self._engine.finish_cut()

    def answer(self, question: int, choice: Answer, angle_deg: float | None = None) -> None:
        """Answer the open question by its number; the first answer counts. `Stop` stops, `Wait` changes nothing.

        `Set position` needs the angle at which the axis is, within its soft limits.
        """
        self._check("answer")
        with self.board.deciding() as now:
            asked = now.question
            if asked is None or asked.number != question or self._answered == question:
                raise CommandRefused(f"question {question} is answered already")
            if choice not in asked.question.answers:
                raise CommandRefused(f"{choice}: is no answer to this question; give {' or '.join(asked.question.answers)}")
            reply: Reply = choice
            if choice is Answer.SET_POSITION and (axis := asked.question.axis) is not None:
                if angle_deg is None:
                    raise CommandRefused(f"{choice}: give the angle at which {axis.name} is, in degrees")
                if refusal := axis.refusal(angle_deg):
                    raise CommandRefused(refusal)
                reply = PositionGiven(angle_deg)
            if choice in (Answer.WAIT, Answer.STOP):
                question = 0
            else:
                self._answered = question
        if choice is Answer.STOP:
            self.stop()
        elif question:
            self._answers.put((question, reply))

    def acknowledge(self, order: str) -> None:
        """Acknowledge a safety order, by its text, and record that in the journal of its run."""
        self._check("acknowledge")
        with self.board.deciding() as now:
            found = next((each for each in now.orders if each.text == order), None)
            if found is None:
                raise CommandRefused(f"no such safety order is open: {order}")
            record = self._ordered.pop(found, None)
            self._publish(OrderAcknowledged(found))
        self._record_acknowledged(record, found)
        if self._opened is not None and found.order == CLOSE_SHUTTER:
            self._opened.guard.settle()

    def start(self, schedule: Path, folder: Path, person: bool = False) -> None:
        """Measure a schedule into a new journal in `folder`, which is created if it does not exist.

        With `person`, the operator of a virtual rig is a person as well.
        """
        self._begin("start", f"starting {schedule.name}", lambda: self._start(schedule, folder, person), run=True)

    def resume_journal(self, journal: Path, person: bool | None = None) -> None:
        """Continue the campaign of a journal: the command `continue`. Without `person` its operator is as it was."""
        self._begin("continue", f"resuming {journal.name}", lambda: self._resume(journal, person), run=True)

    def connect(self, device: str = "") -> None:
        """Connect one device anew, or all that do not respond."""
        rig = self.snapshot.rig
        if device and rig is not None and device not in rig.devices:
            raise CommandRefused(f"{device}: is no device of this rig; give {', '.join(rig.devices)}")
        what = device or "the devices"
        self._begin("connect", f"connecting {what}", lambda: self._connect(device))

    def move(self, axis: str, target_deg: float) -> None:
        """Move an axis to an angle. Refused outside the soft limits, before anything is sent."""
        opened = self._axis("move", axis)
        try:
            opened.rig.axes[axis].check_limits(target_deg)
        except LimitError as error:
            raise CommandRefused(str(error)) from None
        self._begin("move", f"moving {axis} to {target_deg:g} deg", lambda: self._on_bench().move(axis, target_deg))

    def home(self, axis: str) -> None:
        """Home an axis; it moves."""
        opened = self._axis("home", axis)
        if opened.rig.axes[axis].settings.homing is None:
            raise CommandRefused(f"{axis}: has no [axes.{axis}.homing] table; set its position instead")
        self._begin("home", f"homing {axis}", lambda: self._on_bench().home(axis))

    def set_position(self, axis: str, angle_deg: float) -> None:
        """Set the current position of an axis; nothing moves."""
        opened = self._axis("set_position", axis)
        limits = opened.rig.axes[axis].settings
        if refusal := position_refusal(axis, limits.lower_deg, limits.upper_deg, angle_deg):
            raise CommandRefused(refusal)
        self._begin("set_position", f"setting the position of {axis}", lambda: opened.rig.axes[axis].set_position(angle_deg))

    def wavelength(self, nm: float) -> None:
        """Set the wavelength."""
        self._begin("wavelength", f"setting {nm:g} nm", lambda: self._on_bench().set_wavelength(nm))

    def shutter(self, opened: bool) -> None:
        """Open or close the shutter."""
        doing = "opening" if opened else "closing"
        self._begin("shutter", f"{doing} the shutter", lambda: self._on_bench().set_shutter(opened=opened))

    def gain(self, v_per_a: float) -> None:
        """Set the gain of all amplifiers, one of the rig's list."""
        self._check("gain")
        gains = self._rig().rig.photodiodes.settings.gains_v_per_a
        if v_per_a not in gains:
            raise CommandRefused(f"{v_per_a:g} V/A: is no gain of this rig; give {' or '.join(f'{each:g}' for each in gains)}")
        index = gains.index(v_per_a)
        self._begin("gain", f"setting {v_per_a:g} V/A", lambda: self._on_bench().set_gain(index))

    def read(self, readings: int = 1, dark: bool = False) -> None:
        """Read all photodiodes once, the mean of `readings`; `dark` with the shutter closed. The event has the values."""
        if not 1 <= readings <= 1000:
            raise CommandRefused(f"{readings} readings are not possible; give 1 to 1000")
        what = "taking a dark reading" if dark else "reading"
        self._begin("read", what, lambda: self._read(readings, dark))

    def live(self, on: bool) -> None:
        """Take live readings until they are switched off; they rest while anything else is read or set."""
        with self.board.deciding():
            self._check("live")
            opened, bench = self._rig(), self._on_bench()
            with self._no_stops:
                self._refuse_while_stopping()
                if not self.snapshot.activity:  # else its request holds for both
                    bench.request = StopRequest(opened.rig)
            self._tasks.put((lambda: self._set_live(on), NO_ACTIVITY))

    def mount(self, sample: str) -> None:
        """Mount a sample in a virtual rig."""
        self._begin("mount", f"mounting {sample}", lambda: self._on_bench().mount(sample))

    def speed(self, factor: float) -> None:
        """Set the simulation speed of a virtual rig."""
        self._check("speed")
        if not LEAST_SPEED <= factor <= GREATEST_SPEED:
            possible = f"{LEAST_SPEED:g} to {GREATEST_SPEED:g}"
            raise CommandRefused(f"a simulation speed of {factor:g} is not possible; give {possible}")
        if not isinstance(self._clock, ScaledClock):
            raise CommandRefused("the virtual clock has no speed")
        self._clock.set_speed(factor)
        self._publish(SpeedChanged(factor))

    def disconnect(self) -> None:
        """Stop the bench, close the shutter and give the rig back: the end of the station. Refused during a run."""
        with self.board.deciding() as now:
            self._check("disconnect")
            self._end_reason = f"given back by {now.operator}" if now.operator else ""
            self.disconnected.set()

    def operate(self, client: str) -> None:
        """Note the client that operates; empty if the place is free. The server decides which commands it takes."""
        self._publish(OperatorChanged(client))

    # ---- the engine's thread ----

    def open(self, description: RigDescription, transcript: Path | None = None) -> None:
        """Open the rig of a file and take its lock; nothing is connected yet. Raises UserError."""
        self._clock = self.clock_for(description)
        self.adopt(open_rig(description, self._clock, transcript), description)

    def clock_for(self, description: RigDescription, start_s: float = 0.0) -> Clock:
        """The clock on which a rig is opened."""
        if self._given_clock is None:
            self._clock = ScaledClock(self.snapshot.speed if description.file.in_process else description.file.speed)
            self._clock.advance_to(start_s)
        return self._clock

    def release(self) -> None:
        """Hold the rig no longer: what has opened it closes it."""
        self._opened = self._bench = self._contacts = self._live = None

    def adopt(self, opened: OpenRig, description: RigDescription) -> None:
        """Hold a rig that is open on this station's clock."""
        self._opened, self._description = opened, description
        self._bench, self._contacts = Bench(opened, self._tick), Contacts(opened.rig, self.board, self._wall)
        if description.file.in_process and not isinstance(self._clock, VirtualClock):
            for controller in opened.rig.controllers:
                controller.set_heartbeat(NO_HEARTBEAT_S)

    def connect_all(self) -> None:
        """Connect all devices of the rig that is open; nothing moves. The event has the status of each."""
        opened = self._rig()
        self._report_devices(opened.rig.connect())

    def report_connected(self) -> None:
        """Report that all devices of a rig are connected, for a run that is about to begin."""
        self._report_devices({each.name: None for each in self._rig().rig.devices}, closing=True)
        self._publish(ActivityChanged("starting the run", starts=True))

    def _report_devices(self, outcome: dict[str, DeviceError | None], *, closing: bool = False) -> None:
        """Report the devices of a rig with the errors, or None, of their connections; `closing` as in `_look`."""
        opened, description = self._rig(), self._description
        assert description is not None
        if not any(outcome.values()):
            remember_rig(description.file)
        devices = self._device_contacts.first_statuses(outcome)
        controllers = {axis: each.name for each in opened.rig.controllers for axis in each.axes}
        self._publish(
            RigOpened(
                description.file.name,
                Path(description.name),
                description.digest,
                description.simulated,
                description.seed,
                description.file.in_process,
                devices,
                controllers,
            )
        )
        self._look(closing=closing)

    def serve(self) -> None:
        """Do what the commands ask for, until `end`; then stop what is in progress and close the rig."""
        while True:
            try:
                # Real time: this wait is for the operator, not for the rig.
                task = self._tasks.get(timeout=LIVE_POLL_S if self._live is not None else POLL_S)
            except queue.Empty:
                self._tick()
                continue
            if task is None:
                break
            self._do(*task)
        self.close_rig(self._end_reason)

    def work(self) -> None:
        """Do what the commands so far ask for; return when nothing is left."""
        while not self._tasks.empty():
            if (task := self._tasks.get()) is not None:
                self._do(*task)

    def do(self, task: Task) -> None:
        """Have the engine's thread do something; the activity begun last, if there is one, ends with it."""
        self._tasks.put((task, self._begun))

    def end(self, reason: str = "") -> None:
        """Stop what is in progress, and let `serve` return. From any thread. `reason` is one line for the clients."""
        with self.board.deciding():
            self._end_reason = reason or self._end_reason
            self.disconnected.set()  # no command begins after this, and would take the stop for one before it
        self._stop_requested.set()  # a run that is requested but not started does not start
        if self.busy:
            self.stop()
        self._tasks.put(None)

    def close_rig(self, reason: str = "", *, fault: bool = False) -> None:
        """Close the shutter if the bench has opened it, and give the rig back. No axis moves."""
        opened, bench = self._opened, self._bench
        self._opened = self._description = self._bench = self._contacts = self._live = None
        self.wait_for_stops()  # one that finds a closed port would order to cut the motors' power
        if opened is not None and bench is not None:
            try:
                bench.close_shutter()
            except DeviceError as error:
                self._give_order(close_shutter_order(opened.rig, error), None)
            opened.close()
            self._publish(RigClosed(reason, fault))

    def _do(self, task: Task, activity: int) -> None:
        """Do a task of the bench or of a run. Its activity, by its number, ends with it, whatever happens, and no later one."""
        error = detail = ""
        try:
            task()
        except Stopped:
            error = "stopped"
        except DeviceError as fault:
            opened = self._opened
            text = FaultText(str(fault)) if opened is None else opened.rig.in_words(fault)
            error, detail = ("stopped", "") if self._stop_requested.is_set() else (text.headline, text.detail)
            if self._contacts is not None:
                self._contacts.note_fault(fault)
        except UserError as refusal:
            error = str(refusal)
        except Exception as fault:  # noqa: BLE001  (of any library: reported, and the station goes on without the rig)
            self.close_rig(f"the rig was closed after a fault: {type(fault).__name__}: {fault}", fault=True)
            return
        if activity == self._begun and self.snapshot.activity:
            self._report_positions()
        if self._bench is not None and self._bench.settings != self.snapshot.bench:
            self._publish(self._bench.settings)
        self._report_references()
        with self.board.deciding() as now:
            if activity == self._begun and (now.activity or error):
                self._publish(ActivityChanged("", error, detail=detail))

    def _tick(self) -> None:
        """What is done between tasks, and between the polls of one on the bench: positions, live readings, last answers."""
        now = self._wall.now()
        contacts = self._contacts
        if self._opened is None or contacts is None or self._engine is not None:
            return
        for name, every_s, action in (
            ("positions", POLL_S, self._poll_axes),
            ("live", LIVE_POLL_S, self._poll_live),
            ("ask", POLL_S, self._ask_devices),
            ("answered", POLL_S, contacts.report_answers_now_and_then),
            ("connect", POLL_S, self._connect_lost),
        ):
            if now >= self._due[name]:
                self._due[name] = now + every_s
                try:
                    action()
                except DeviceError as error:
                    contacts.note_fault(error)

    def _report_references(self) -> None:
        """Report which axes are unreferenced, if that has changed. Nothing is asked of them."""
        opened = self._opened
        if opened is None or self.snapshot.rig is None:
            return
        unreferenced = {name: axis.unreferenced_reason for name, axis in opened.rig.axes.items() if axis.unreferenced_reason}
        if unreferenced != self.snapshot.unreferenced:
            self._publish(ReferencesChanged(unreferenced))

    def _report_positions(self) -> None:
        """Report the positions at the end of a task: a client that has waited for it has them then."""
        if self._opened is not None:
            self._poll_axes()

    def _poll_axes(self) -> None:
        """Report the positions of the axes whose controllers respond, and their encoders where they are at rest."""
        opened = self._rig()
        if self.snapshot.rig is None:
            return
        self._report_references()
        compares = self._wall.now() >= self._due["encoders"] and not self.snapshot.activity
        if compares:
            self._due["encoders"] = self._wall.now() + ENCODERS_S
        degrees: dict[str, float] = {}

        def read(axes: Mapping[str, Axis]) -> None:
            for name, axis in axes.items():
                degrees[name] = self._read_axis(axis, compares=compares)

        for controller in opened.rig.controllers:
            self._device_contacts.ask(controller.name, partial(read, controller.axes))
        if degrees:
            encoders = {name: angle for name, angle in self._encoders.items() if name in degrees}
            self._publish(Positions({name: degrees[name] for name in AXES if name in degrees}, encoders))
            self._report_references()

    def _read_axis(self, axis: Axis, *, compares: bool) -> float:
        """Read the counter of an axis, and, if `compares` and it is at rest, its encoder. Raises DeviceError.

        An encoder that contradicts makes the axis unreferenced, as it does after a row.
        """
        counter, now = axis.position_deg(), self._clock.now()
        before, since = self._resting.get(axis.name, (counter, now))
        if counter != before:
            since = now
            self._encoders.pop(axis.name, None)
        self._resting[axis.name] = counter, since
        if compares and axis.settings.encoder and now - since > axis.settings.settling_s:
            try:
                counter, encoder = axis.read_back()
            except Unreferenced:
                encoder = axis.encoder_deg()
            if encoder is not None:
                self._encoders[axis.name] = encoder
        return counter

    def _poll_live(self) -> None:
        bench = self._bench
        if bench is None or not bench.settings.live or self.snapshot.activity:
            self._live, self._settled = None, False
            return
        now = self._wall.now()
        try:
            if self._live is None:
                self._live_due = now + LIVE_S
                self._live = bench.start_live(settled=self._settled)
            while self._live.due <= self._clock.now() and self._wall.now() < now + LIVE_POLL_S:
                if self._live.poll():
                    reading, self._live, self._settled = self._live.result, None, True
                    self._due["live"] = self._live_due
                    self._device_contacts.note_answers("photodiodes", "monitor")
                    self._publish(reading)
                    self._note_lamp(reading.monitor_a, shutter_open=bench.settings.shutter_open)
                    return
        except (DeviceError, Stopped) as error:
            self._live = None
            bench.set_live(False)
            self._publish(bench.settings)
            if isinstance(error, DeviceError):
                raise

    def _ask_devices(self) -> None:
        """Ask devices that nothing uses, so that it is known when they last answered."""
        if self.snapshot.activity or self.snapshot.rig is None:
            return
        rig = self._rig().rig
        reads = () if self._on_bench().settings.live else (rig.photodiodes, rig.monitor)
        for device in (rig.monochromator, *reads):
            self._device_contacts.ask_now_and_then(device.name, device.check)

    def _connect_lost(self) -> None:
        """Connect an idle device again that was lost; nothing moves. One attempt at a time, with pauses in between."""
        if self.busy or self._stops or self.disconnected.is_set() or not self._tasks.empty():
            return
        self._look_after_connection(self._device_contacts.connect_lost())

    def _look_after_connection(self, device: str) -> None:
        """Ask for the settings of the bench again where a device of them was connected: light and gain may be others."""
        rig = self.snapshot.rig
        if device and rig is not None and device not in rig.controllers.values():
            self._look()

    # ---- the bench, in the engine's thread ----

    def _on_bench(self) -> Bench:
        assert self._bench is not None
        return self._bench

    @property
    def _device_contacts(self) -> Contacts:
        assert self._contacts is not None
        return self._contacts

    def _look(self, *, closing: bool = False) -> None:
        """Ask for the settings of the bench; `closing` closes a shutter that is open, also one that was opened by hand."""
        if self._bench is not None:
            left = self._rig().guard.left
            self._bench.look()
            self._see_to_shutter(self._bench, left, closing=closing)
            self._publish(self._bench.settings)
            self._report_references()

    def _see_to_shutter(self, bench: Bench, left: Record | None, *, closing: bool) -> None:
        """Close the shutter that a program which died has left open; order a person to, where that fails.

        A shutter that is open for another reason is left as it is, with an order, unless `closing`.
        """
        is_open, guard = bench.settings.shutter_open, self._rig().guard
        if left is not None and left.done:
            self._publish(EventLogged("guardian", left.outcome, left.device))
            guard.settle()
            left = None
        if left is None and (bench.opened_shutter or not is_open):
            return
        if left is None and not closing:
            self._give_order(shutter_found_open(), None)
            return
        found = left_order(left) if left is not None else shutter_found_open()
        try:
            if is_open is not False:
                bench.close_left_open()
        except DeviceError as error:
            self._device_contacts.note_fault(error)
            self._give_order(found, None)
        else:
            how = "found closed" if is_open is False else "closed now"
            self._publish(EventLogged("guardian", f"Shutter {how}: {found.reason}", self._rig().rig.monochromator.name))
            guard.settle()
            self._withdraw(found)

    def _set_live(self, on: bool) -> None:
        bench = self._on_bench()
        if not self.snapshot.busy:  # a run may have begun meanwhile
            bench.set_live(on and not bench.request.requested)
            self._due["live"] = 0.0

    def _read(self, readings: int, dark: bool) -> None:
        reading = self._on_bench().read(readings, dark=dark)
        self._device_contacts.note_answers("photodiodes", "monitor")
        self._publish(reading)
        self._note_lamp(reading.monitor_a, shutter_open=False if dark else self._on_bench().settings.shutter_open)

    def _note_lamp(self, current_a: float | None, *, shutter_open: bool | None) -> None:
        """Report the monitor's current where the shutter is open; remember it where it is closed."""
        if current_a is None:
            return
        if shutter_open is False:
            self._monitor_dark_a = abs(current_a)
        elif shutter_open and self._wall.now() >= self._due["lamp"]:
            self._due["lamp"] = self._wall.now() + LAMP_S
            self._publish(LampRead(current_a, current_a > DARK_TIMES * self._monitor_dark_a, calendar_stamp()))

    def _connect(self, device: str) -> None:
        rig = self.snapshot.rig
        for name in [device] if device else (rig.not_responding if rig is not None else []):
            if self._device_contacts.connect(name) is None:
                self._look_after_connection(name)

    # ---- a run, in the engine's thread ----

    def _start(self, schedule: Path, folder: Path, person: bool) -> None:
        assert self._description is not None
        try:
            plan = make_plan(read_schedule(schedule), self._description)
            check_referenced(self._rig(), plan.rig.name)
            check_way(self._rig(), plan.rows)
            self._check_stop()
            try:
                folder.mkdir(parents=True, exist_ok=True)
                journal = Journal.create(next_journal(folder, plan.schedule.file.name), plan, software_versions())
            except (UserError, OSError) as error:
                raise UserError(f"the journal cannot be created: {error}") from None
        except NOT_BEGUN as error:
            self._publish(RunRefused(one_line(str(error))))
            return
        self._measure(plan, journal, plan.rows, person)

    def _check_stop(self) -> None:
        if self._stop_requested.is_set():
            raise UserError(STOPPED)

    def _resume(self, path: Path, person: bool | None) -> None:
        try:
            with contextlib.closing(Journal.open(path)) as unlocked:
                remaining_work(unlocked, self._description)  # raises the error before the journal is changed
            self._check_stop()
            journal = Journal.reopen(path)
            try:
                remaining = remaining_work(journal, self._description)  # again, now that no other program can change it
                check_referenced(self._rig(), remaining.plan.rig.name, homing=True)
                check_way(self._rig(), remaining.work)
            except BaseException:
                journal.close()
                raise
        except NOT_BEGUN as error:
            self._publish(RunRefused(one_line(str(error))))
            return
        if isinstance(self._clock, ScaledClock):
            self._clock.advance_to(remaining.start_s)
        if person is None:
            person = bool(journal.event_texts(OPERATOR))
        self._measure(remaining.plan, journal, remaining.work, person)

    def _measure(self, plan: Plan, journal: Journal, work: Sequence[Row], person: bool) -> None:
        opened, bench = self._rig(), self._on_bench()
        bench.set_live(False)
        self._live = self._mounted = None
        record = RunRecord(journal, self._clock)
        reason, opened.guard.journal = "", str(journal.path.resolve())
        with contextlib.closing(record):
            operator = operator_for(opened, plan.rig.file, self.ask, person=person)
            engine = Engine(opened.rig, plan, journal, operator, [self.listen], self.positions_every_s, work=work)
            if person and plan.rig.simulated and not journal.event_texts(OPERATOR):
                journal.event(self._clock.now(), OPERATOR, "a person is the operator of this simulated rig")
            self.run_begun(engine, plan, journal, work, record, person=person)
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
            self._device_contacts.note_lost(device, lost)
        bench.look()
        bench.take_over(None if engine.disconnected else engine.gain, self._mounted)
        self.run_ended(state, reason, journal.kept_at, journal.note)

    @property
    def positions_every_s(self) -> float:
        """Time of the rig's clock between two reports of the positions: about 20 a second at a high simulation speed."""
        speed = self._clock.speed if isinstance(self._clock, ScaledClock) else 1.0
        return max(POLL_S, 0.25 * POLL_S * speed)

    def run_begun(
        self,
        engine: Engine,
        plan: Plan,
        journal: Journal,
        work: Sequence[Row],
        record: RunRecord | None = None,
        *,
        person: bool = False,
    ) -> None:
        """Report a run of this rig that begins: its commands go to `engine` from now on."""
        self._record = record or RunRecord(journal, self._clock)
        self._engine = engine
        planned = len(plan.rows)
        done = planned - sum(row.number < planned for row in work)
        left = sum(row.seconds for row in work)
        self._publish(RunBegun(journal.path, plan.schedule.file.name, done, planned, left, person))
        for text in journal.open_orders():
            order, _, reason = text.partition(": ")
            self._give_order(SafetyOrder(order, reason), self._record)
        if self._pause_requested.is_set():  # each requested before the engine existed
            engine.pause()
        if self._finish_requested.is_set():
            engine.finish_cut()
        if self._stop_requested.is_set():
            engine.stop()

    def wait_for_stops(self) -> None:
        """The engine has ended: wait for the stops in progress, because one that is not confirmed is an order of this run."""
        self._engine = None
        with self._no_stops:
            self._no_stops.wait_for(lambda: not self._stops)

    def run_ended(self, state: State, reason: str, journal: Path, note: str = "") -> None:
        """Report the end of a run, whose journal is closed."""
        self._engine = None
        if note:
            self._publish(EventLogged("journal", note, "journal"))
        if self._bench is not None:
            self._publish(self._bench.settings)
            self._report_references()
        self._publish(RunEnded(state, reason or self.snapshot.reason, journal))

    def listen(self, event: Event) -> None:
        """Take an event of the engine."""
        match event:
            case RowCommitted(row, data, done, total, seconds_left):
                if row.kind == "mount":
                    self._mounted = row.sample
                if data.readings:
                    self._note_lamp(data.readings[-1].monitor_a, shutter_open=row.kind != "dark")
                if data.readings and row.kind in ("measure", "drift"):  # it needs all devices
                    self._device_contacts.note_answers()
                    self._device_contacts.report_answers_now_and_then()
                self._publish(RowSaved(row, data.flags, done, total, seconds_left))
            case SafetyOrder():
                self._give_order(event, self._record)
            case DeviceFailed(error):
                self._device_contacts.note_fault(error, recovered=True)
            case _:
                self._publish(event)

    def wake(self) -> None:
        """Let `ask` look at its `given_up`."""
        self._answers.put(None)

    def ask(self, question: Question, given_up: Callable[[], str] = lambda: "") -> Reply:
        """Wait for the operator's answer, or for a stop. Raises UserError with the reason where `given_up` has one.

        Meanwhile counter and encoder of an axis that is asked about are reported: a person may turn it.
        """
        self._asked += 1
        number: int = self._asked
        given: Answer | None = None
        if self._stop_requested.is_set():
            return Answer.STOP
        if question.axis is not None:
            self.report_place(question.axis.name)
        self._publish(QuestionAsked(number, question))
        try:
            while not self._stop_requested.is_set():
                if self._answers.empty() and (reason := given_up()):
                    raise UserError(reason)
                try:
                    answer = self._answers.get(timeout=ENCODERS_S)
                except queue.Empty:
                    if question.axis is not None:
                        self.report_place(question.axis.name)
                    else:
                        self._ask_while_question_waits()
                    continue
                if answer is not None and answer[0] == number:
                    given = answer[1] if isinstance(answer[1], Answer) else Answer.SET_POSITION
                    return answer[1]
            return Answer.STOP
        finally:
            self._publish(QuestionClosed(number, given))

    # ---- inside ----

    def _ask_while_question_waits(self) -> None:
        """Ask the devices whether they respond. What one has lost is the run's to restore, so nothing is restored here."""
        if self._opened is not None:
            rig, contacts = self._opened.rig, self._device_contacts
            for controller in rig.controllers:
                contacts.ask(controller.name, partial(_read_positions, controller), recovered=True)
            light, photodiodes, monitor = rig.monochromator, rig.photodiodes, rig.monitor
            for name, question in ((light.name, light.ask), (photodiodes.name, photodiodes.check), (monitor.name, monitor.ask)):
                contacts.ask_now_and_then(name, question, recovered=True)
            contacts.report_answers_now_and_then()

    def report_place(self, axis: str) -> None:
        """Report counter and encoder of an axis at rest, as far as it responds."""
        if self._opened is None:
            return
        asked = self._opened.rig.axes[axis]
        try:
            counter, encoder = asked.position_deg(), asked.encoder_deg()
        except DeviceError as error:
            self._device_contacts.note_fault(error, recovered=True)
            return
        self._device_contacts.note_answers(self._opened.rig.controller(axis).name)
        self._device_contacts.report_answers_now_and_then()
        others = {name: angle for name, angle in self.snapshot.encoders.items() if name != axis}
        self._publish(Positions({axis: counter}, others if encoder is None else {**others, axis: encoder}))
        self._report_references()

    def _check(self, command: str) -> None:
        if reason := allowed(self.snapshot)[command]:
            raise CommandRefused(reason)

    def _begin(self, command: str, activity: str, task: Task, *, run: bool = False) -> None:
        """Accept a command that lasts, if it is allowed now: from here on the station is busy with it."""
        with self.board.deciding():
            self._check(command)
            if self.disconnected.is_set():
                raise CommandRefused("the rig is being given back")
            opened, bench = self._rig(), self._on_bench()
            with self._no_stops:
                self._refuse_while_stopping()
                for each in (self._stop_requested, self._pause_requested, self._finish_requested):
                    each.clear()
                bench.request = StopRequest(opened.rig)
            self._begun += 1
            self._publish(ActivityChanged(one_line(activity), starts=run))

        def unless_stopped() -> None:
            bench.request.check()
            task()

        self.do(task if run else unless_stopped)

    def _refuse_while_stopping(self) -> None:
        if self._stops:
            raise CommandRefused("the axes are being stopped; wait until they are at rest")

    def _axis(self, command: str, axis: str) -> OpenRig:
        """The open rig, where a command for an axis is allowed. Raises CommandRefused."""
        self._check(command)
        opened = self._rig()
        if axis not in opened.rig.axes:
            raise CommandRefused(f"{axis}: is no axis; the axes are {', '.join(opened.rig.axes)}")
        rig = self.snapshot.rig
        if rig is not None and axis in rig.silent_axes:
            raise CommandRefused(f"not responding: {rig.controllers[axis]}")
        return opened

    def _rig(self) -> OpenRig:
        opened = self._opened
        if opened is None:
            raise CommandRefused("no rig is open")
        return opened

    def _give_order(self, order: SafetyOrder, record: RunRecord | None) -> None:
        self._ordered[order] = record
        self._publish(order)

    def _withdraw(self, order: SafetyOrder) -> None:
        """An order has no object any more. Windows that show one of a program that died take it away too."""
        record = self._ordered.pop(order, None)
        self._publish(OrderAcknowledged(order))
        self._record_acknowledged(record, order)

    def _record_acknowledged(self, record: RunRecord | None, order: SafetyOrder) -> None:
        if record is not None:  # None: no run was on when it was given
            try:
                record.event("acknowledged", order.text)
            except (JournalError, UserError) as error:
                self._publish(EventLogged("fault", f"the acknowledgement is not in the journal: {error}", "journal"))

    def _publish(self, message: Message) -> None:
        self.board.publish(message)
        if isinstance(message, BenchChanged | LightChanged) and message.shutter_open is False:
            for each in [order for order in self.open_orders if order.order == CLOSE_SHUTTER]:
                self._withdraw(each)


def _read_positions(controller: MotionController) -> None:
    for axis in controller.axes.values():
        axis.position_deg()


def next_journal(folder: Path, name: str) -> Path:
    """The path of the next journal in a folder: `NAME-001.journal`, or the number after the highest one there.

    The number of a removed journal is not used again while a later one is there.
    """
    stem = re.sub(r"[^\w.-]+", "-", name).strip("-.") or "campaign"
    pattern = re.compile(rf"{re.escape(stem)}-(\d+){re.escape(SUFFIX)}")
    numbers = [int(match[1]) for each in folder.glob(f"*{SUFFIX}") if (match := pattern.fullmatch(each.name))]
    paths = (folder / f"{stem}-{number:03d}{SUFFIX}" for number in count(max(numbers, default=0) + 1))
    return next(path for path in paths if not path.exists())
