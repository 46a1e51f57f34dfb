"""The thread that owns the rig: it opens it, watches the axes, and runs the engine. It knows no Qt.

Everything that may take long (a port that does not answer, a long plan) happens here, so the window never waits.
Stop does not come through here, since this thread may be waiting for a device: it has a thread of its own.

Where the next journal goes: a name that no file has, without a date in it.
"""

import queue
import re
import threading
from collections.abc import Callable
from itertools import count
from pathlib import Path

from goniotwin.app.campaign.campaign import operator_for
from goniotwin.app.campaign.journal.writing import Journal, software_versions
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import Event, Positions, State, StateChanged
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.desktop.model.messages import (
    DeviceLost,
    DeviceStatus,
    Message,
    MountWanted,
    PlanMade,
    PlanRefused,
    RigClosed,
    RigOpened,
    RunBegan,
    RunEnded,
    RunRefused,
    StopFailed,
)
from goniotwin.app.desktop.model.scaled_clock import PacedClock
from goniotwin.app.errors import UserError
from goniotwin.app.rig import OpenRig, RigDescription, open_rig, read_rig
from goniotwin.drivers import DeviceError

SUFFIX = ".journal"


def next_journal(folder: Path, name: str) -> Path:
    """`NAME-001.journal` in a folder, or the first number that is free after the highest one there.

    Numbers are not used again after a journal has been taken away, as long as a later one is there.
    """
    stem = re.sub(r"[^\w.-]+", "-", name).strip("-.") or "campaign"
    pattern = re.compile(rf"{re.escape(stem)}-(\d+){re.escape(SUFFIX)}")
    taken = [int(found[1]) for each in folder.glob(f"*{SUFFIX}") if (found := pattern.fullmatch(each.name))]
    paths = (folder / f"{stem}-{number:03d}{SUFFIX}" for number in count(max(taken, default=0) + 1))
    return next(path for path in paths if not path.exists())


Tell = Callable[[Message], None]
Ask = Callable[[str], None]
WATCH_S = 0.2
"""Between two looks at the axes while nothing runs, in a person's time."""
TWIN = "twin://"
LONGEST_HEARTBEAT_S = 65.0
"""The module's silence counter has 16 bits of ms. Of a virtual rig it counts the rig's time, while the host that it minds
is slow in ours: at 60 times a drawing of 35 ms would look like a dead host."""
NO_RIG = "there is no rig to plan for"


class RigThread:
    """One rig and what is done with it. `tell` is called from this thread and from Stop's; it must only pass on."""

    def __init__(self, tell: Tell, speed: float = 1.0) -> None:
        self._tell = tell
        self._speed = speed
        self._tasks: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._clock = PacedClock()
        self._opened: OpenRig | None = None
        self._description: RigDescription | None = None
        self._schedule: Path | None = None
        self._engine: Engine | None = None
        self._reason = ""
        self._axes_answer = False
        self._stops: list[threading.Thread] = []
        self._halted = threading.Event()
        self._mounted = threading.Event()
        self._thread = threading.Thread(target=self._work, name="rig")
        self._thread.start()

    # What the window asks for; each returns at once.

    def open(self, rig: Path) -> None:
        """Opens the rig of a file in the place of the one that is open."""
        self._tasks.put(lambda: self._open(rig))

    def load(self, schedule: Path) -> None:
        """Reads a schedule and makes the plan for the rig."""
        self._tasks.put(lambda: self._load(schedule))

    def start(self, plan: Plan, folder: Path) -> None:
        """Runs a plan on the open rig, into a new journal in `folder`, which is made if need be."""
        self._halted.clear()
        self._tasks.put(lambda: self._run(plan, folder))

    def pause(self) -> None:
        """The run waits before its next row."""
        engine = self._engine
        if engine is not None:
            engine.pause()

    def resume(self) -> None:
        """The run goes on."""
        engine = self._engine
        if engine is not None:
            engine.resume()

    def stop(self) -> None:
        """All axes come to rest and the run ends. An axis whose wire is silent delays nobody but itself."""
        thread = threading.Thread(target=self._stop, name="stop")
        self._stops = [each for each in self._stops if each.is_alive()] + [thread]
        thread.start()

    def mounted(self) -> None:
        """What was to be mounted is in the sample unit."""
        self._mounted.set()

    def set_speed(self, speed: float) -> None:
        """How fast a virtual rig's time passes; a real rig's passes as it does."""
        self._speed = speed
        if self._description is not None and _all_virtual(self._description):
            self._clock.set_speed(speed)

    def close(self) -> None:
        """Stops a run if there is one, gives the rig back, ends the threads. Nothing is moved. Blocks until then."""
        self._halted.set()  # a run that has been asked for and not begun does not begin
        if self._engine is not None:
            self.stop()
        self._tasks.put(None)
        self._thread.join()
        for each in self._stops:
            each.join()

    # What happens in the thread.

    def _work(self) -> None:
        while True:
            try:
                # The one wait here that is not the rig's clock's: it is for a person, at a person's pace.
                task = self._tasks.get(timeout=WATCH_S)
            except queue.Empty:
                self._watch()
                continue
            if task is None:
                break
            try:
                task()
            except Exception as error:  # noqa: BLE001  (whatever a library throws: it is told, and the window lives on)
                self._give_back()
                self._refuse(f"the rig was given back after a fault: {type(error).__name__}: {error}")
        self._give_back()

    def _watch(self) -> None:
        """Where the axes are, while nobody moves them; the first failure ends it until the rig is opened again."""
        if self._opened is None or not self._axes_answer:
            return
        try:
            degrees = {name: axis.position_deg() for name, axis in self._opened.rig.axes.items()}
        except DeviceError as error:
            self._axes_answer = False
            self._tell(DeviceLost("axes", str(error)))
        else:
            self._tell(Positions(degrees))

    def _open(self, path: Path) -> None:
        self._give_back()
        try:
            description = read_rig(path)
            self._clock = PacedClock(self._speed if _all_virtual(description) else 1.0)
            opened = open_rig(description, self._clock)
        except UserError as error:
            self._refuse(str(error))
            return
        self._opened, self._description = opened, description
        if _all_virtual(description):
            opened.rig.axes_module.heartbeat_s = LONGEST_HEARTBEAT_S
        outcome = opened.rig.connect()
        self._axes_answer = outcome["axes"] is None
        devices = {
            device: DeviceStatus(True, opened.rig.identities[device]) if error is None else DeviceStatus(False, str(error))
            for device, error in outcome.items()
        }
        self._tell(RigOpened(description, devices, _all_virtual(description)))
        if self._schedule is not None:
            self._load(self._schedule)

    def _refuse(self, reason: str) -> None:
        self._tell(RigClosed(reason))
        self._tell(PlanRefused(NO_RIG))

    def _load(self, path: Path) -> None:
        self._schedule = path
        if self._description is None:
            self._tell(PlanRefused(NO_RIG))
            return
        try:
            self._tell(PlanMade(make_plan(read_schedule(path), self._description)))
        except UserError as error:
            self._tell(PlanRefused(str(error)))

    def _run(self, plan: Plan, folder: Path) -> None:
        if self._opened is None or plan.rig is not self._description:
            self._tell(RunRefused("the plan is for another rig than the one that is open"))
            return
        if self._halted.is_set():
            self._tell(RunRefused("it was stopped before it began"))
            return
        try:
            folder.mkdir(parents=True, exist_ok=True)
            path = next_journal(folder, plan.schedule.file.name)
            journal = Journal.create(path, plan, software_versions())
        except (UserError, OSError) as error:
            self._tell(RunRefused(f"the journal cannot be made: {error}"))
            return
        with journal:
            # So often that the numbers move for a person, whatever the pace of the rig's time.
            every_s = max(WATCH_S, 0.25 * WATCH_S * self._clock.speed)
            operator = operator_for(self._opened, plan.rig.file, self._ask)
            self._reason = ""
            engine = Engine(self._opened.rig, plan, journal, operator, [self._heed], every_s)
            self._engine = engine
            self._tell(RunBegan(plan, path))
            if self._halted.is_set():  # Stop came while there was no engine yet to be told
                engine.stop()
            state = self._carried_out(engine)
            self._engine = None
        self._tell(RunEnded(state, self._reason, path))

    def _carried_out(self, engine: Engine) -> State:
        """Runs it; what the engine does not know as a fault (a full disk, a mistake of ours) still stops the axes."""
        try:
            return engine.run()
        except Exception as error:  # noqa: BLE001  (the thread's last line of defence: it is told, and nothing moves on)
            self._reason = f"the run broke off: {type(error).__name__}: {error}"
            self._report(engine.stop())
            return State.FAILED

    def _heed(self, event: Event) -> None:
        if isinstance(event, StateChanged) and event.reason:
            self._reason = event.reason
        self._tell(event)

    def _ask(self, text: str) -> None:
        """Waits for the person at the rig, or for Stop."""
        self._mounted.clear()
        if not self._halted.is_set():
            self._tell(MountWanted(text))
            self._mounted.wait()

    def _stop(self) -> None:
        self._halted.set()  # before it is asked whether there is an engine: whoever makes one looks here afterwards
        engine, opened = self._engine, self._opened
        if engine is not None:
            self._report(engine.stop())
        elif opened is not None:
            self._report(opened.rig.stop())
        self._mounted.set()

    def _report(self, failures: list[DeviceError]) -> None:
        if failures:
            self._tell(StopFailed(tuple(str(each) for each in failures)))

    def _give_back(self) -> None:
        opened, self._opened, self._description = self._opened, None, None
        self._axes_answer = False
        if opened is not None:
            opened.close()


def _all_virtual(description: RigDescription) -> bool:
    return all(address.startswith(TWIN) for address in description.file.addresses)
