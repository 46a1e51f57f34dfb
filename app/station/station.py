"""The station: one rig, held from `open` to `close`, its bench and its runs. A plain object; no process, no channel, no window.

Each command is a public method and returns at once; it raises `CommandRefused` where `allowed` has a reason. What lasts is done
by the *engine's thread*, the one that calls `serve` (or, in tests on the virtual clock, `work`), and is reported by events.
`stop` does not pass through that thread, because it may be waiting for a device: it is carried out by the thread that calls it.
"""

import queue
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from goniotwin.app.campaign.running.events import (
    EventLogged,
    LightChanged,
    close_shutter_order,
    cut_power_order,
)
from goniotwin.app.campaign.running.question import Answer, Question, Reply, position_refusal
from goniotwin.app.campaign.running.stop import Stopped, StopRequest
from goniotwin.app.errors import UserError, one_line
from goniotwin.app.rig import OpenRig, RigDescription, open_rig
from goniotwin.app.station.bench import Bench
from goniotwin.app.station.board import Board
from goniotwin.app.station.connector import Connector
from goniotwin.app.station.messages import (
    ActivityChanged,
    BenchChanged,
    Message,
    OperatorChanged,
    RigClosed,
    Snapshot,
    SpeedChanged,
    StopReceived,
)
from goniotwin.app.station.orders import SafetyOrders, end_shutter_orders
from goniotwin.app.station.permissions import CommandRefused, allowed
from goniotwin.app.station.poller import POLL_S, Poller
from goniotwin.app.station.questions import LOOK_S, Questions
from goniotwin.app.station.runs import Runs
from goniotwin.app.station.stops import Stops
from goniotwin.drivers import DeviceError, LimitError
from goniotwin.drivers.errors import FaultText
from goniotwin.drivers.guard import CLOSE_SHUTTER
from goniotwin.protocols.clock import GREATEST_SPEED, LEAST_SPEED, Clock, RealClock, ScaledClock, VirtualClock

NO_HEARTBEAT_S = float("inf")
"""A virtual rig has the longest heartbeat of its controllers: it counts simulated time, but the host is slow in real time. At
simulation speed 60, a pause of 35 ms would exceed a short heartbeat."""
Task = Callable[[], None]
NO_ACTIVITY = -1


class Station:
    """One rig and what is done with it.

    `board` has its state and takes listeners. `disconnected` is set when the rig is to be given back: no command begins then.
    `clock` is that of the rig; without it a virtual rig has one at `speed`, which the command of that name changes, and any
    other rig real time; the attribute is the one in use. `wall` is real time, in which idle devices are polled; `look_s` that
    between two looks at them while a question waits.
    """

    def __init__(
        self, speed: float = 1.0, clock: Clock | None = None, wall: Clock | None = None, look_s: float = LOOK_S
    ) -> None:
        self.board = Board(Snapshot(speed=speed))
        self.disconnected = threading.Event()
        self._given_clock = clock
        self.clock: Clock = clock or ScaledClock()
        self._wall = wall or RealClock()
        self._tasks: queue.SimpleQueue[tuple[Task, int] | None] = queue.SimpleQueue()
        self._begun = 0
        """Number of the activity that was begun last."""
        self._description: RigDescription | None = None
        self._poller: Poller | None = None
        self._connector: Connector | None = None
        self._end_reason = ""
        self.stops = Stops()
        self.orders = SafetyOrders(self.board)
        self.runs = Runs(self.board, self._publish, self.stops, self.orders, lambda: self._poller)
        self._questions = Questions(self.board, self.stops.requested, look_s)

    @property
    def snapshot(self) -> Snapshot:
        """The state now."""
        return self.board.snapshot

    @property
    def now_s(self) -> float:
        """The time of the rig's clock, s."""
        return self.clock.now()

    @property
    def busy(self) -> bool:
        """Whether a run is in progress or about to begin, or anything moves on the bench."""
        now = self.snapshot
        return now.busy or now.starting or bool(now.activity)

    @property
    def opened(self) -> OpenRig | None:
        """The rig that is open; None without one."""
        poller = self._poller  # the engine's thread may close it now
        return None if poller is None else poller.bench.opened

    # ---- commands: from any thread; each returns at once ----

    def stop(self) -> list[str]:
        """Bring all axes to rest, and end the run or what the bench does; return what was not confirmed.

        Carried out by the calling thread, at once. An axis that does not respond delays no other.
        """
        with self.stops.carrying_out():  # before the engine is looked up: `Runs.begin` checks it after it has created one
            try:
                engine, poller = self.runs.engine, self._poller
                if engine is not None:
                    return [str(each) for each in engine.stop()]
                if poller is None:
                    return []
                rig = poller.bench.opened.rig
                failures = poller.bench.request.stop()
                for each in failures:
                    fault = rig.in_words(each)
                    self._publish(EventLogged("fault", fault.headline, each.device, detail=fault.detail))
                if (order := cut_power_order(rig, failures)) is not None:
                    self.orders.give(order)
                return [str(each) for each in failures]
            finally:
                self._questions.wake()  # a run that waits for an answer
                self._publish(StopReceived())  # before another command is accepted: its client knows this stop

    def pause(self) -> None:
        """Pause the run before its next row, with the shutter closed; one that is about to begin, before its first row."""
        self._check("pause")
        self.runs.pause()

    def resume(self) -> None:
        """Resume the run that is paused."""
        self._check("resume")
        self.runs.resume()

    def finish_cut(self) -> None:
        """End the run in good order after the last row of the cut in progress."""
        self._check("finish_cut")
        self.runs.finish_cut()

    def answer(
        self, question: int, choice: Answer, angle_deg: float | None = None, sample: dict[str, Any] | None = None
    ) -> None:
        """Answer the open question by its number; the first answer counts. `Stop` stops, `Wait` changes nothing.

        `Set position` needs the angle at which the axis is, within its soft limits. `Mounted` may have the keys and values of
        the record of the `sample`, as in `[metadata.samples.NAME]`; `picture` is then the path of a file.
        """
        self._check("answer")
        self._questions.answer(question, choice, angle_deg, sample)
        if choice is Answer.STOP:
            self.stop()

    def acknowledge(self, order: str) -> None:
        """Acknowledge a safety order, by its text, and record that in the journal of its run."""
        self._check("acknowledge")
        acknowledged = self.orders.acknowledge(order)
        opened = self.opened
        if opened is not None and acknowledged.order == CLOSE_SHUTTER:
            if (left := opened.guard.left) is not None:
                end_shutter_orders(left)
            opened.guard.settle()

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
        self._begin("connect", f"connecting {what}", lambda: self._devices.connect(device))

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
            with self.stops.none_in_progress():
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
        if not isinstance(self.clock, ScaledClock):
            raise CommandRefused("the virtual clock has no speed")
        self.clock.set_speed(factor)
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
        self.clock = self.clock_for(description)
        self.adopt(open_rig(description, self.clock, transcript), description)

    def clock_for(self, description: RigDescription, start_s: float = 0.0) -> Clock:
        """The clock on which a rig is opened."""
        if self._given_clock is None:
            self.clock = ScaledClock(self.snapshot.speed if description.file.in_process else description.file.speed)
            self.clock.advance_to(start_s)
        return self.clock

    def release(self) -> None:
        """Hold the rig no longer: what has opened it closes it."""
        self._poller = self._connector = None

    def adopt(self, opened: OpenRig, description: RigDescription) -> None:
        """Hold a rig that is open on this station's clock."""
        self._description = description
        self._poller = Poller(Bench(opened, self.tick), self.board, self._publish, self._wall)
        self._connector = Connector(self._poller, description, self.board, self._publish, self.orders)
        if description.file.in_process and not isinstance(self.clock, VirtualClock):
            for controller in opened.rig.controllers:
                controller.set_heartbeat(NO_HEARTBEAT_S)

    def connect_all(self) -> None:
        """Connect all devices of the rig that is open; nothing moves. The event has the status of each."""
        self._devices.report(self._rig().rig.connect())

    def report_connected(self) -> None:
        """Report that all devices of a rig are connected, for a run that is about to begin."""
        self._devices.report({each.name: None for each in self._rig().rig.devices}, closing=True)
        self._publish(ActivityChanged("starting the run", starts=True))

    def serve(self) -> None:
        """Do what the commands ask for, until `end`; then stop what is in progress and close the rig."""
        while True:
            try:
                # Real time: this wait is for the operator, not for the rig.
                task = self._tasks.get(timeout=POLL_S if self._poller is None else self._poller.interval_s)
            except queue.Empty:
                self.tick()
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
        self.stops.requested.set()  # a run that is requested but not started does not start
        if self.busy:
            self.stop()
        self._tasks.put(None)

    def close_rig(self, reason: str = "", *, fault: bool = False) -> None:
        """Close the shutter if the bench has opened it, and give the rig back. No axis moves."""
        poller, self._poller, self._connector, self._description = self._poller, None, None, None
        self.runs.wait_for_stops()  # one that finds a closed port would order to cut the motors' power
        if poller is not None:
            opened = poller.bench.opened
            try:
                poller.bench.close_shutter()
            except DeviceError as error:
                self.orders.give(close_shutter_order(opened.rig, error))
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
            opened = self.opened
            text = FaultText(str(fault)) if opened is None else opened.rig.in_words(fault)
            error, detail = ("stopped", "") if self.stops.requested.is_set() else (text.headline, text.detail)
            if self._poller is not None:
                self._poller.contacts.note_fault(fault)
        except UserError as refusal:
            error = str(refusal)
        except Exception as fault:  # noqa: BLE001  (of any library: reported, and the station goes on without the rig)
            self.close_rig(f"the rig was closed after a fault: {type(fault).__name__}: {fault}", fault=True)
            return
        if (poller := self._poller) is not None:
            if activity == self._begun and self.snapshot.activity:
                poller.poll_axes()  # a client that has waited for the end of the task has the positions then
            if poller.bench.settings != self.snapshot.bench:
                self._publish(poller.bench.settings)
            poller.report_references()
        with self.board.deciding() as now:
            if activity == self._begun and (now.activity or error):
                self._publish(ActivityChanged("", error, detail=detail))

    def tick(self) -> None:
        """What is done between tasks, and between the polls of one on the bench: positions, live readings, last answers."""
        if self._poller is not None and self.runs.engine is None:
            self._poller.poll(self._connect_lost)

    def _connect_lost(self) -> None:
        """Connect an idle device again that was lost; nothing moves. One attempt at a time, with pauses in between."""
        if self.busy or self.stops.in_progress or self.disconnected.is_set() or not self._tasks.empty():
            return
        self._devices.connect_lost()

    # ---- the bench, in the engine's thread ----

    @property
    def _held(self) -> Poller:
        """The poller of the open rig."""
        assert self._poller is not None
        return self._poller

    @property
    def _devices(self) -> Connector:
        """The connector of the open rig."""
        assert self._connector is not None
        return self._connector

    def _on_bench(self) -> Bench:
        return self._held.bench

    def _set_live(self, on: bool) -> None:
        if not self.snapshot.busy:  # a run may have begun meanwhile
            self._held.set_live(on)

    def _read(self, readings: int, dark: bool) -> None:
        reading = self._on_bench().read(readings, dark=dark)
        self._held.report_reading(reading, shutter_open=False if dark else self._on_bench().settings.shutter_open)

    # ---- a run ----

    def _start(self, schedule: Path, folder: Path, person: bool) -> None:
        assert self._description is not None
        self.runs.start(schedule, folder, self._description, self.ask, person=person)

    def _resume(self, journal: Path, person: bool | None) -> None:
        assert self._description is not None
        self.runs.continue_journal(journal, self._description, self.ask, person=person)

    def wake(self) -> None:
        """Let `ask` look at its `given_up`."""
        self._questions.wake()

    def ask(self, question: Question, given_up: Callable[[], str] = lambda: "") -> Reply:
        """Wait for the operator's answer, or for a stop. Raises UserError with the reason where `given_up` has one.

        Meanwhile counter and encoder of an axis that is asked about are reported: a person may turn it.
        """

        def look() -> None:
            if self._poller is not None and question.axis is not None:
                self._poller.report_place(question.axis.name)
            elif self._poller is not None:
                self._poller.ask_devices_of_run()

        return self._questions.ask(question, look, given_up)

    def report_place(self, axis: str) -> None:
        """Report counter and encoder of an axis at rest, as far as it responds."""
        if self._poller is not None:
            self._poller.report_place(axis)

    # ---- inside ----

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
            with self.stops.none_in_progress():
                self.runs.forget_requests()
                bench.request = StopRequest(opened.rig)
            self._begun += 1
            self._publish(ActivityChanged(one_line(activity), starts=run))

        def unless_stopped() -> None:
            bench.request.check()
            task()

        self.do(task if run else unless_stopped)

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
        opened = self.opened
        if opened is None:
            raise CommandRefused("no rig is open")
        return opened

    def _publish(self, message: Message) -> None:
        self.board.publish(message)
        if isinstance(message, BenchChanged | LightChanged) and message.shutter_open is False:
            self.orders.withdraw_shutter()
