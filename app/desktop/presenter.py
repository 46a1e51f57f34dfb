"""What the window knows: hears what the rig's thread tells, and has it shown."""

from pathlib import Path

from PySide6.QtCore import QObject, Qt, Signal, Slot

from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.running.events import Positions, RowCommitted, RowStarted, State, StateChanged
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
from goniotwin.app.desktop.model.permissions import BUSY, Allowed, allowed
from goniotwin.app.desktop.run.live_plot import LivePlot
from goniotwin.app.desktop.view import Parts

SAID = {
    State.RUNNING: "The run goes on.",
    State.PAUSING: "Pausing after this row.",
    State.PAUSED: "Paused with the shutter closed. Resume goes on with the next row.",
    State.RECOVERING: "A device has failed; it is dealt with as the schedule says.",
    State.STOPPING: "Stopping.",
}


class Session(QObject):
    """The rig, the plan and the run as far as they have been told.

    `told` is the only thing that crosses threads, and `_heed` its only slot: one that is no `@Slot` would be called in the
    rig's thread, and crash. Who else wants to listen takes `heard`, which comes in the window's thread afterwards.
    """

    told = Signal(object)
    heard = Signal(object)
    changed = Signal()
    mount_wanted = Signal(str)
    ended = Signal()

    def __init__(self, parts: Parts, rig_path: Path, parent: QObject) -> None:
        super().__init__(parent)
        self.state = State.IDLE
        self.rig: RigOpened | None = None
        self.rig_path = rig_path
        self.plan: Plan | None = None
        self.journal: Path | None = None
        self._parts = parts
        self._no_plan = ""
        self._opening = True
        self._progress = (0, 0)
        self._stop_trouble = ""
        self._live = LivePlot(parts.plot, self)
        self._live.failed.connect(parts.set_plot_trouble)
        self.told.connect(self._heed, Qt.ConnectionType.QueuedConnection)

    @property
    def busy(self) -> bool:
        """Whether a run goes on."""
        return self.state in BUSY

    @property
    def allowed(self) -> Allowed:
        """What may be done now."""
        return allowed(self.rig, self.plan, self._no_plan, self.state, self._opening)

    @property
    def title(self) -> str:
        """What goes on in a line: for the window's frame, which is seen when the window is not."""
        done, of = self._progress
        doing = f"{self.state} {100 * done // max(of, 1)} %" if self.busy else str(self.state)
        name = self.rig.description.file.name if self.rig else "no rig"
        return " – ".join(part for part in (self._mark, name, doing, "goniotwin") if part)

    def opening(self, path: Path) -> None:
        """A rig has been asked for."""
        self._opening, self.rig_path = True, path
        self._parts.say(f"Connecting the devices of {path} …")
        self.changed.emit()

    def starting(self) -> None:
        """A run has been asked for; known at once, so that a second click finds Start disabled."""
        self.state = State.RUNNING
        self._stop_trouble = ""
        self._parts.set_plot_trouble("")
        self.changed.emit()

    def close(self) -> None:
        """Nothing that is told from now on is shown."""
        self._live.end()
        self.told.disconnect(self._heed)

    @property
    def _mark(self) -> str:
        if self.rig is None or not self.rig.description.simulated:
            return ""
        return f"SIMULATED (seed {self.rig.description.seed})"

    @Slot(object)
    def _heed(self, message: Message) -> None:
        match message:
            case Positions(degrees):
                self._parts.axes.set_positions(degrees)
            case RowStarted() | RowCommitted():
                self._heed_row(message)
            case StateChanged(state, _reason):
                self.state = state
                self._parts.say(SAID.get(state, self._parts.status))
            case RunBegan(plan, journal):
                self.journal = journal
                self._live.begin(plan, self._mark)
                self._show_progress(0, len(plan.rows), plan.seconds)
                self._parts.set_saved(f"Saved row by row in {journal}")
            case RunEnded():
                self._end(message)
            case RunRefused(reason):
                self.state = State.IDLE
                self._parts.say(f"Not started: {reason}", bad=True)
                self.ended.emit()
            case MountWanted(text):
                self.mount_wanted.emit(text)
            case PlanMade() | PlanRefused():
                self._heed_plan(message)
            case StopFailed(reasons):
                self._stop_trouble = "STOP DID NOT REACH EVERY AXIS: use the main switch. " + " ".join(reasons)
                self._parts.say(self._stop_trouble, bad=True)
            case RigOpened() | RigClosed() | DeviceLost():
                self._heed_rig(message)
        if not isinstance(message, Positions):
            self.changed.emit()
        self.heard.emit(message)

    def _heed_plan(self, message: PlanMade | PlanRefused) -> None:
        if isinstance(message, PlanMade):
            self.plan, self._no_plan = message.plan, ""
            self._show_progress(0, len(message.plan.rows), message.plan.seconds)
            if self.rig is not None and not self.rig.silent:
                self._parts.say("Ready to start.")
        else:
            self.plan, self._no_plan = None, message.reason
            self._show_progress(0, 0, None)
            if self.rig is not None:
                self._parts.say(message.reason, bad=True)
        self._parts.schedule.set_plan(self.plan)

    def _heed_rig(self, message: RigOpened | RigClosed | DeviceLost) -> None:
        match message:
            case RigOpened(description, devices, paced):
                self._opening, self.rig = False, message
                self.plan = None  # it was made for the rig before; the one for this rig is on its way
                self._parts.set_simulated(description.simulated, description.seed)
                self._parts.devices.set_devices(devices)
                self._parts.axes.set_positions({})
                self._parts.run.set_paced(paced)
                self._live.begin(None, self._mark)
                if message.silent:
                    silent = " and ".join(message.silent)
                    self._parts.say(f"No answer from {silent}: see Devices for the reason, then connect again.", bad=True)
                else:
                    self._parts.say("All devices answer.")
            case RigClosed(reason):
                ended = self.busy
                self._opening, self.rig, self.state = False, None, State.IDLE
                self._parts.set_simulated(False, None)
                self._parts.devices.set_devices({})
                self._parts.axes.set_positions({})
                self._live.begin(None, "")
                self._parts.say(reason, bad=True)
                if ended:
                    self.ended.emit()
            case DeviceLost(device, reason) if self.rig is not None:
                devices = {**self.rig.devices, device: DeviceStatus(False, reason)}
                self.rig = RigOpened(self.rig.description, devices, self.rig.paced)
                self._parts.devices.set_devices(devices)
                self._parts.axes.set_positions({})
                self._parts.say(reason, bad=True)
        self._parts.rig.set_rig(self.rig, self.rig_path)

    def _heed_row(self, event: RowStarted | RowCommitted) -> None:
        if isinstance(event, RowStarted):
            self._parts.axes.set_targets(event.row.pose)
            if self.state is State.RUNNING:
                self._parts.say(f"Measuring row {event.row.number + 1}: {event.row.identity}")
        else:
            self._show_progress(event.done, event.total, event.seconds_left)
        self._live.heed(event)

    def _show_progress(self, done: int, of: int, left_s: float | None) -> None:
        self._progress = (done, of)
        self._parts.run.set_progress(done, of, left_s)

    def _end(self, end: RunEnded) -> None:
        self.state = end.state
        self._parts.axes.set_targets(None)
        done, of = self._progress
        if self._stop_trouble:
            self._parts.say(self._stop_trouble, bad=True)
        elif end.state is State.DONE:
            self._parts.say(f"Done: {of} rows.")
        elif end.state is State.IDLE:
            why = "" if end.reason in ("", "stopped") else f": {end.reason}"
            self._parts.say(f"Stopped after {done} of {of} rows{why}. They are kept; Start begins a new journal.")
        else:
            self._parts.say(f"Failed after {done} of {of} rows, which are kept: {end.reason}", bad=True)
        self._parts.set_saved(f"Saved in {end.journal}")
        self.ended.emit()
