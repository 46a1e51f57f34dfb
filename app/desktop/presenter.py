"""The presenter: receives the messages of the rig's thread, keeps the state of rig, plan and run, and shows it in the view."""

from pathlib import Path

from PySide6.QtCore import QObject, Qt, Signal, Slot

from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.running.events import (
    EventLogged,
    Positions,
    RowCommitted,
    RowStarted,
    SafetyOrder,
    State,
    StateChanged,
)
from goniotwin.app.desktop.events.panels import LogEntry
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
from goniotwin.app.desktop.model.permissions import BUSY, Permissions, permissions
from goniotwin.app.desktop.run.live_plot import LivePlot
from goniotwin.app.desktop.view import MainView

STATUS = {
    State.RUNNING: "Running.",
    State.PAUSING: "Pausing after this row.",
    State.PAUSED: "Paused, with the shutter closed. Resume continues with the next row.",
    State.RECOVERING: "Device fault: reconnecting.",
    State.STOPPING: "Stopping.",
}
END = {State.DONE: "done", State.IDLE: "stopped", State.FAILED: "failed"}
SERIOUS = ("fault", "stop", "encoder", "sleep", "finding")
"""Kinds of the journal's events that a person should look at."""


class Presenter(QObject):
    """The state of rig, plan and run, as the messages so far give it.

    `message_received` is the only signal that crosses threads, and `_handle` its only slot: a function that is not a `@Slot`
    would be called in the rig's thread, and crash. Other listeners connect to `message_shown`, which is emitted afterwards in
    the window's thread.
    """

    message_received = Signal(object)
    message_shown = Signal(object)
    changed = Signal()
    question_asked = Signal(object)
    run_ended = Signal()

    def __init__(self, view: MainView, rig_path: Path, parent: QObject) -> None:
        super().__init__(parent)
        self.state = State.IDLE
        self.rig: RigOpened | None = None
        self.rig_path = rig_path
        self.plan: Plan | None = None
        self.journal: Path | None = None
        self._view = view
        self._no_plan = ""
        self._opening = True
        self._progress = (0, 0)
        self._live_plot = LivePlot(view.plot, self)
        self._live_plot.failed.connect(view.set_plot_error)
        self.message_received.connect(self._handle, Qt.ConnectionType.QueuedConnection)

    @property
    def busy(self) -> bool:
        """Whether a run is in progress."""
        return self.state in BUSY

    @property
    def permissions(self) -> Permissions:
        """Which controls are enabled now."""
        return permissions(self.rig, self.plan, self._no_plan, self.state, self._opening)

    @property
    def title(self) -> str:
        """The window's title: rig and progress, which are visible in a task bar too."""
        done, of = self._progress
        progress = f"{self.state} {100 * done // max(of, 1)} %" if self.busy else str(self.state)
        name = self.rig.description.file.name if self.rig else "no rig"
        order = "SAFETY ORDER" if self._view.orders.orders else ""
        return " – ".join(part for part in (order, self._mark, name, progress, "goniotwin") if part)

    def show_opening(self, path: Path) -> None:
        """Show that a rig is being opened."""
        self._opening, self.rig_path = True, path
        self._view.show_status(f"Connecting the devices of {path} …")
        self.changed.emit()

    def show_starting(self) -> None:
        """Show that a run is being started; at once, so that Start is disabled for a second click."""
        self.state = State.RUNNING
        self._view.set_plot_error("")
        self.changed.emit()

    def acknowledge(self, order: SafetyOrder) -> None:
        """Show that a safety order has been acknowledged."""
        self._log(f"Acknowledged: {order.order}")
        self.changed.emit()

    def close(self) -> None:
        """Show no further messages."""
        self._live_plot.stop()
        self.message_received.disconnect(self._handle)

    @property
    def _mark(self) -> str:
        if self.rig is None or not self.rig.description.simulated:
            return ""
        return f"SIMULATED (seed {self.rig.description.seed})"

    @Slot(object)
    def _handle(self, message: Message) -> None:
        match message:
            case Positions(degrees):
                self._view.axes.set_positions(degrees)
            case RowStarted() | RowCommitted():
                self._show_row(message)
            case StateChanged(state, _reason):
                self._log_state(state)
                self.state = state
                self._view.show_status(STATUS.get(state, self._view.status))
            case EventLogged(kind, what, where, consequence):
                self._log(what, where, consequence, serious=kind in SERIOUS)
            case SafetyOrder(order, reason):
                if message not in self._view.orders.orders:
                    where = self.rig.description.file.name if self.rig is not None else ""
                    self._view.orders.add(message)
                    self._log(f"Safety order: {order}: {reason}", where, "stays until it is acknowledged", serious=True)
            case RunStarted(plan, journal):
                self.journal = journal
                self._live_plot.start(plan, self._mark)
                self._show_progress(0, len(plan.rows), plan.seconds)
                self._view.set_saved(f"Saved row by row in {journal}")
                self._log("Run started", journal.name, f"{len(plan.rows)} rows")
            case RunEnded():
                self._show_end(message)
            case RunRefused(reason):
                self.state = State.IDLE
                self._view.show_status(f"Not started: {reason}", error=True)
                self._log(f"Not started: {reason}", serious=True)
                self.run_ended.emit()
            case QuestionAsked(_number, question):
                self._view.show_status(f"Waiting for the operator: {question.title}.")
                self._log(f"Question to the operator: {question.title}", "", "the run waits")
                self.question_asked.emit(message)
            case PlanMade() | PlanRefused():
                self._show_plan(message)
            case RigOpened() | RigClosed() | DeviceFault():
                self._show_rig(message)
        if not isinstance(message, Positions):
            self.changed.emit()
        self.message_shown.emit(message)

    def _log(self, what: str, where: str = "", consequence: str = "", *, serious: bool = False) -> None:
        self._view.log.add(LogEntry(what, where, consequence, serious))

    def _log_state(self, state: State) -> None:
        if state is State.PAUSED:
            self._log("Paused", "", "the shutter is closed")
        elif state is State.STOPPING:
            self._log("Stop", "", "all axes come to rest")
        elif self.state is State.PAUSED:
            self._log("Resumed")

    def _show_plan(self, message: PlanMade | PlanRefused) -> None:
        if isinstance(message, PlanMade):
            self.plan, self._no_plan = message.plan, ""
            self._show_progress(0, len(message.plan.rows), message.plan.seconds)
            if self.rig is not None and not self.rig.not_responding:
                self._view.show_status("Ready to start.")
        else:
            self.plan, self._no_plan = None, message.reason
            self._show_progress(0, 0, None)
            if self.rig is not None:
                self._view.show_status(message.reason, error=True)
                self._log(message.reason, "schedule", "there is no plan to start", serious=True)
        self._view.schedule.set_plan(self.plan)

    def _show_rig(self, message: RigOpened | RigClosed | DeviceFault) -> None:
        match message:
            case RigOpened(description, devices, virtual):
                self._opening, self.rig = False, message
                self.plan = None  # made for the previous rig; the plan for this one follows
                self._view.set_simulated(description.simulated, description.seed)
                self._view.devices.set_devices(devices)
                self._view.axes.set_positions({})
                self._view.run.set_virtual(virtual)
                self._live_plot.start(None, self._mark)
                if message.not_responding:
                    names = " and ".join(message.not_responding)
                    text = f"Not responding: {names}. See the screen Rig for the reason, then connect again."
                    self._view.show_status(text, error=True)
                    for device in message.not_responding:
                        self._log(devices[device].text, device, "no run can start", serious=True)
                else:
                    self._view.show_status("All devices are connected.")
                    self._log("All devices are connected", description.file.name)
            case RigClosed(reason):
                was_busy = self.busy
                self._opening, self.rig, self.state = False, None, State.IDLE
                self._view.set_simulated(False, None)
                self._view.devices.set_devices({})
                self._view.axes.set_positions({})
                self._live_plot.start(None, "")
                self._view.show_status(reason, error=True)
                if reason:
                    self._log(reason, self.rig_path.name, "no rig is open", serious=True)
                if was_busy:
                    self.run_ended.emit()
            case DeviceFault(device, reason) if self.rig is not None:
                devices = {**self.rig.devices, device: DeviceStatus(False, reason)}
                self.rig = RigOpened(self.rig.description, devices, self.rig.virtual)
                self._view.devices.set_devices(devices)
                self._view.axes.set_positions({})
                self._view.show_status(reason, error=True)
                self._log(reason, device, "no run can start before it is connected again", serious=True)
        self._view.rig.set_rig(self.rig, self.rig_path)

    def _show_row(self, event: RowStarted | RowCommitted) -> None:
        if isinstance(event, RowStarted):
            self._view.axes.set_targets(event.row.pose)
            if self.state is State.RUNNING:
                self._view.show_status(f"Measuring row {event.row.number + 1}: {event.row.identity}")
        else:
            self._show_progress(event.done, event.total, event.seconds_left)
            if event.data.flags:
                self._log(f"Row flagged: {', '.join(event.data.flags)}", event.row.identity)
        self._live_plot.add_row(event)

    def _show_progress(self, done: int, of: int, left_s: float | None) -> None:
        self._progress = (done, of)
        self._view.run.set_progress(done, of, left_s)

    def _show_end(self, end: RunEnded) -> None:
        self.state = end.state
        self._live_plot.finish()
        self._view.axes.set_targets(None)
        done, of = self._progress
        self._show_progress(done, of, None)
        failed = end.state is State.FAILED
        self._log(
            f"Run ended: {END[end.state]} after {done} of {of} rows",
            end.journal.name,
            "measured rows are saved",
            serious=failed,
        )
        if end.state is State.DONE:
            self._view.show_status(f"Done: {of} rows.")
        elif end.state is State.IDLE:
            why = "" if end.reason in ("", "stopped") else f": {end.reason}"
            self._view.show_status(f"Stopped after {done} of {of} rows{why}. They are saved; Start creates a new journal.")
        else:
            self._view.show_status(f"Failed after {done} of {of} rows, which are saved: {end.reason}", error=True)
        self._view.set_saved(f"Saved in {end.journal}")
        self.run_ended.emit()
