"""The window: hears what the rig's thread tells, shows it, and passes on what the person wants. It decides nothing else."""

from pathlib import Path

from PySide6.QtCore import QObject, Qt, QTimer, Signal, Slot
from PySide6.QtGui import QCloseEvent
from PySide6.QtWidgets import QFileDialog, QMainWindow

from app.campaign.events import Positions, RowCommitted, RowStarted, State, StateChanged
from app.campaign.plan import Plan
from app.desktop.allowed import BUSY, allowed
from app.desktop.cut import LiveCut
from app.desktop.layout import Parts
from app.desktop.messages import (
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
from app.desktop.questions import Question, ask_to_close, ask_to_mount
from app.desktop.rigthread import RigThread
from app.desktop.theme import Theme

REDRAW_MS = 100
SAID = {
    State.RUNNING: "The run goes on.",
    State.PAUSING: "Pausing after this row.",
    State.PAUSED: "Paused with the shutter closed. Resume goes on with the next row.",
    State.STOPPING: "Stopping.",
}


class Bridge(QObject):
    """From the rig's thread to the window's: a signal is the only thing that crosses."""

    told = Signal(object)


class MainWindow(QMainWindow):
    """One rig, one schedule, one run at a time; journals go into `folder`."""

    def __init__(self, theme: Theme, rig: Path, schedule: Path | None, folder: Path, speed: float = 1.0) -> None:
        super().__init__()
        self.theme = theme
        self.state = State.IDLE
        self.journal: Path | None = None
        self._rig_path = rig
        self._folder = folder
        self._rig: RigOpened | None = None
        self.plan: Plan | None = None
        self._no_plan = ""
        self._opening = True
        self._closing = False
        self._closed = False
        self._live: LiveCut | None = None
        self._progress = (0, 0)
        self._stop_trouble = ""
        self.mounting: Question | None = None
        self.leaving: Question | None = None
        self.parts = Parts(theme.colours, folder, speed)
        self.setCentralWidget(self.parts)
        self.resize(1180, 760)
        self._redraw = QTimer(self, interval=REDRAW_MS, singleShot=True)
        self._redraw.timeout.connect(self._draw)
        self._listen_to_controls()
        theme.changed.connect(self._recolour)
        self.bridge = Bridge()
        self.bridge.told.connect(self._heed, Qt.ConnectionType.QueuedConnection)
        self.rig_thread = RigThread(self.bridge.told.emit, speed)
        self._open_rig(rig)
        if schedule is not None:
            self.rig_thread.load(schedule)

    # What the rig's thread tells.

    @Slot(object)
    def _heed(self, message: Message) -> None:
        if self._closed:
            return
        match message:
            case Positions(degrees):
                self.parts.axes.set_positions(degrees)
                return
            case RowStarted() | RowCommitted():
                self._heed_row(message)
            case StateChanged(state, _reason):
                self.state = state
                self._say(SAID.get(state, ""))
            case RunBegan(plan, journal):
                self._begin(plan, journal)
            case RunEnded():
                self._end(message)
            case RunRefused(reason):
                self.state = State.IDLE
                self._say(f"Not started: {reason}", bad=True)
            case MountWanted(text):
                self.mounting = ask_to_mount(self, text, self._mounted, self._not_mounted)
            case PlanMade(plan):
                self.plan, self._no_plan = plan, ""
                self._progress = (0, len(plan.rows))
                self.parts.schedule.set_plan(plan)
                self.parts.run.set_progress(0, len(plan.rows), plan.seconds)
                if self._rig is not None and not self._rig.silent:
                    self._say("Ready to start.")
            case PlanRefused(reason):
                self.plan, self._no_plan = None, reason
                self.parts.schedule.set_plan(None)
                self.parts.run.set_progress(0, 0, None)
                if self._rig is not None:
                    self._say(reason, bad=True)
            case _:
                self._heed_rig(message)
        self._show_allowed()

    def _heed_rig(self, message: Message) -> None:
        match message:
            case RigOpened(description, devices, paced):
                self._opening, self._rig = False, message
                self.parts.set_simulated(description.simulated, description.seed)
                self.parts.devices.set_devices(devices)
                self.parts.run.set_paced(paced)
                self._live = None
                self.parts.plot.clear(self._mark())
                if message.silent:
                    silent = " and ".join(message.silent)
                    self._say(f"No answer from {silent}: see Devices for the reason, then connect again.", bad=True)
                else:
                    self._say("All devices answer.")
            case RigClosed(reason):
                self._opening, self._rig = False, None
                self.parts.set_simulated(False, None)
                self.parts.devices.set_devices({})
                self.parts.axes.set_positions({})
                self._say(reason, bad=bool(reason))
            case DeviceLost(device, reason) if self._rig is not None:
                devices = {**self._rig.devices, device: DeviceStatus(False, reason)}
                self._rig = RigOpened(self._rig.description, devices, self._rig.paced)
                self.parts.devices.set_devices(devices)
                self.parts.axes.set_positions({})
                self._say(reason, bad=True)
            case StopFailed(reasons):
                self._stop_trouble = "STOP DID NOT REACH EVERY AXIS: use the main switch. " + " ".join(reasons)
                self._say(self._stop_trouble, bad=True)
        self.parts.rig.set_rig(self._rig, self._rig_path)

    def _begin(self, plan: Plan, journal: Path) -> None:
        self.journal = journal
        self._live = LiveCut(plan)
        self._progress = (0, len(plan.rows))
        self.parts.plot.clear(self._mark())
        self.parts.run.set_progress(0, len(plan.rows), plan.seconds)
        self.parts.set_saved(f"Saved row by row in {journal}")

    def _heed_row(self, event: RowStarted | RowCommitted) -> None:
        if isinstance(event, RowStarted):
            self.parts.axes.set_targets(event.row.pose)
            if self.state is State.RUNNING:
                self._say(f"Measuring row {event.row.number + 1}: {event.row.identity}")
        else:
            self._progress = (event.done, event.of)
            self.parts.run.set_progress(event.done, event.of, event.seconds_left)
        if self._live is None:
            return
        try:
            self._live.heed(event)
        except Exception as error:  # noqa: BLE001  (what is shown may fail in any way; what is measured goes on)
            self._plot_failed(error)
        if not self._redraw.isActive():
            self._redraw.start()

    @Slot()
    def _draw(self) -> None:
        cut = None
        try:
            if self._live is not None:
                cut = self._live.cut()
            if cut is not None:
                self.parts.plot.show_cut(cut)
        except Exception as error:  # noqa: BLE001  (as above)
            self._plot_failed(error)

    def _plot_failed(self, error: Exception) -> None:
        """It is not tried again in this run: what failed once would fail at every row."""
        self._live = None
        self.parts.set_plot_trouble(f"The plot failed ({type(error).__name__}: {error}); the run is not affected.")

    def _end(self, end: RunEnded) -> None:
        self.state = end.state
        self.parts.axes.set_targets(None)
        for question in (self.mounting, self.leaving):
            if question is not None:
                question.dismiss()
        self.mounting = self.leaving = None
        done, of = self._progress
        if end.state is State.DONE:
            self._say(f"Done: {of} rows.")
        elif end.state is State.IDLE:
            self._say(f"Stopped after {done} of {of} rows. They are kept; Start begins a new journal.")
        else:
            self._say(f"Failed after {done} of {of} rows, which are kept: {end.reason}", bad=True)
        if self._stop_trouble:
            self._say(self._stop_trouble, bad=True)
        self.parts.set_saved(f"Saved in {end.journal}")
        if self._closing:
            self.close()

    # What the person wants.

    def _listen_to_controls(self) -> None:
        run, rig, schedule = self.parts.run, self.parts.rig, self.parts.schedule
        run.start.connect(self._start)
        run.pause.connect(self._pause)
        run.resume.connect(self._resume)
        run.stop.connect(self._stop)
        run.speed_chosen.connect(self._set_speed)
        rig.open.connect(self._choose_rig)
        rig.connect_again.connect(self._connect_again)
        schedule.open.connect(self._choose_schedule)
        schedule.choose_folder.connect(self._choose_folder)

    @Slot()
    def _start(self) -> None:
        if self.plan is not None:
            self.state = State.RUNNING  # at once, so that a second click finds Start disabled
            self._stop_trouble = ""
            self.parts.set_plot_trouble("")
            self.rig_thread.start(self.plan, self._folder)
            self._show_allowed()

    @Slot()
    def _pause(self) -> None:
        self.rig_thread.pause()

    @Slot()
    def _resume(self) -> None:
        self.rig_thread.resume()

    @Slot()
    def _stop(self) -> None:
        self.rig_thread.stop()
        if self.state not in BUSY:
            self._say("The axes were told to stop.")

    def _mounted(self) -> None:
        self.mounting = None
        self.rig_thread.mounted()

    def _not_mounted(self) -> None:
        self.mounting = None
        self._stop()

    @Slot(float)
    def _set_speed(self, speed: float) -> None:
        self.rig_thread.set_speed(speed)

    @Slot()
    def _choose_rig(self) -> None:
        name, _ = QFileDialog.getOpenFileName(self, "Open a rig", str(self._rig_path.parent), "Rigs (*.toml)")
        if name:
            self._open_rig(Path(name))

    @Slot()
    def _connect_again(self) -> None:
        self._open_rig(self._rig_path)

    def _open_rig(self, path: Path) -> None:
        self._opening, self._rig_path = True, path
        self._say(f"Connecting the devices of {path} …")
        self.rig_thread.open(path)
        self._show_allowed()

    @Slot()
    def _choose_schedule(self) -> None:
        folder = Path(self.plan.schedule.name).parent if self.plan else self._rig_path.parent
        name, _ = QFileDialog.getOpenFileName(self, "Open a schedule", str(folder), "Schedules (*.toml)")
        if name:
            self.rig_thread.load(Path(name))

    @Slot()
    def _choose_folder(self) -> None:
        name = QFileDialog.getExistingDirectory(self, "Folder for journals", str(self._folder))
        if name:
            self._folder = Path(name)
            self.parts.schedule.set_folder(self._folder)

    # How it looks, and how it ends.

    def _say(self, text: str, *, bad: bool = False) -> None:
        if text:
            self.parts.say(text, bad=bad)

    def _mark(self) -> str:
        if self._rig is None or not self._rig.description.simulated:
            return ""
        return f"SIMULATED (seed {self._rig.description.seed})"

    def _show_allowed(self) -> None:
        can = allowed(self._rig, self.plan, self._no_plan, self.state, self._opening)
        self.parts.run.set_allowed(can)
        for button in (self.parts.rig.open_button, self.parts.rig.again_button, self.parts.schedule.open_button,
                       self.parts.schedule.folder_button):  # fmt: skip
            button.setEnabled(can.open)
        done, of = self._progress
        doing = f"{self.state} {100 * done // max(of, 1)} %" if self.state in BUSY else str(self.state)
        name = self._rig.description.file.name if self._rig else "no rig"
        self.setWindowTitle(" – ".join(part for part in (self._mark(), name, doing, "goniotwin") if part))

    @Slot()
    def _recolour(self) -> None:
        self.parts.set_colours(self.theme.colours)

    def closeEvent(self, event: QCloseEvent) -> None:
        """Asks while a run goes on; otherwise gives the rig back and ends its thread."""
        if self.state in BUSY and not self._closed:
            event.ignore()
            if self.leaving is not None:
                self.leaving.dismiss()
            self.leaving = ask_to_close(self, self._stop_and_close, self._keep_running)
            return
        self.shut_down()
        event.accept()

    def _keep_running(self) -> None:
        self.leaving = None

    def _stop_and_close(self) -> None:
        self.leaving = None
        self._closing = True
        self._stop()

    def shut_down(self) -> None:
        """Ends the rig's thread, stopping a run where there is one. Nothing is moved. May be called twice."""
        if not self._closed:
            self._closed = True
            self._redraw.stop()
            self.rig_thread.close()
