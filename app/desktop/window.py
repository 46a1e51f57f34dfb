"""The window: passes on what the person wants, asks where it has to, and ends cleanly."""

from pathlib import Path

from PySide6.QtCore import Slot
from PySide6.QtGui import QCloseEvent
from PySide6.QtWidgets import QFileDialog, QMainWindow

from goniotwin.app.desktop.collector import GuiCollector
from goniotwin.app.desktop.model.rig_thread import RigThread
from goniotwin.app.desktop.presenter import Session
from goniotwin.app.desktop.questions import Question, ask_to_close, ask_to_mount
from goniotwin.app.desktop.theme import Theme
from goniotwin.app.desktop.view import Parts


class MainWindow(QMainWindow):
    """One rig, one schedule, one run at a time; journals go into `folder`."""

    def __init__(self, theme: Theme, rig: Path, schedule: Path | None, folder: Path, speed: float = 1.0) -> None:
        super().__init__()
        self.theme = theme
        self.mounting: Question | None = None
        self.leaving: Question | None = None
        self._folder = folder
        self._leaves = False
        self._closed = False
        self.parts = Parts(theme.colours, folder, speed)
        self.setCentralWidget(self.parts)
        self.resize(1180, 760)
        self.session = Session(self.parts, rig, self)
        self._connect()
        self._collector = GuiCollector(self)
        self._collector.begin()
        self.rig_thread = RigThread(self.session.told.emit, speed)
        self._open_rig(rig)
        if schedule is not None:
            self.rig_thread.load(schedule)

    def _connect(self) -> None:
        self.theme.changed.connect(self._recolour)
        self.session.changed.connect(self._refresh)
        self.session.mount_wanted.connect(self._ask_to_mount)
        self.session.ended.connect(self._after_run)
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
    def _refresh(self) -> None:
        can = self.session.allowed
        self.parts.run.set_allowed(can)
        for button in (*self.parts.rig.buttons, *self.parts.schedule.buttons):
            button.setEnabled(can.open)
        self.setWindowTitle(self.session.title)

    @Slot()
    def _recolour(self) -> None:
        self.parts.set_colours(self.theme.colours)

    # The run.

    @Slot()
    def _start(self) -> None:
        if self.session.plan is not None:
            self.session.starting()
            self.rig_thread.start(self.session.plan, self._folder)

    @Slot()
    def _pause(self) -> None:
        self.rig_thread.pause()

    @Slot()
    def _resume(self) -> None:
        self.rig_thread.resume()

    @Slot()
    def _stop(self) -> None:
        self.rig_thread.stop()
        if not self.session.busy:
            self.parts.say("The axes were told to stop.")

    @Slot(float)
    def _set_speed(self, speed: float) -> None:
        self.rig_thread.set_speed(speed)

    @Slot(str)
    def _ask_to_mount(self, text: str) -> None:
        self.mounting = ask_to_mount(self, text, self._mounted, self._not_mounted)

    def _mounted(self) -> None:
        self.mounting = None
        self.rig_thread.mounted()

    def _not_mounted(self) -> None:
        self.mounting = None
        self._stop()

    @Slot()
    def _after_run(self) -> None:
        for question in (self.mounting, self.leaving):
            if question is not None:
                question.dismiss()
        self.mounting = self.leaving = None
        if self._leaves:
            self.close()

    # The files.

    @Slot()
    def _choose_rig(self) -> None:
        folder = self.session.rig_path.parent
        name, _ = QFileDialog.getOpenFileName(self, "Open a rig", str(folder), "Rigs (*.toml)")
        if name:
            self._open_rig(Path(name))

    @Slot()
    def _connect_again(self) -> None:
        self._open_rig(self.session.rig_path)

    def _open_rig(self, path: Path) -> None:
        self.session.opening(path)
        self.rig_thread.open(path)

    @Slot()
    def _choose_schedule(self) -> None:
        plan = self.session.plan
        folder = Path(plan.schedule.name).parent if plan else self.session.rig_path.parent
        name, _ = QFileDialog.getOpenFileName(self, "Open a schedule", str(folder), "Schedules (*.toml)")
        if name:
            self.rig_thread.load(Path(name))

    @Slot()
    def _choose_folder(self) -> None:
        name = QFileDialog.getExistingDirectory(self, "Folder for journals", str(self._folder))
        if name:
            self._folder = Path(name)
            self.parts.schedule.set_folder(self._folder)

    # The end.

    def closeEvent(self, event: QCloseEvent) -> None:
        """Asks while a run goes on; otherwise gives the rig back and ends its thread."""
        if self.session.busy and not self._closed:
            event.ignore()
            if self.leaving is not None:
                self.leaving.dismiss()
            self.leaving = ask_to_close(self, self._stop_and_close, self._keep_running)
            return
        self.shut_down()
        event.accept()

    @Slot()
    def stop_and_close(self) -> None:
        """Stops a run in good order, then closes. Asks nothing: for a request to end from terminal or system."""
        if not self.session.busy:
            self.close()
            return
        if self.leaving is not None:
            self.leaving.dismiss()
        self._stop_and_close()

    def _keep_running(self) -> None:
        self.leaving = None

    def _stop_and_close(self) -> None:
        self.leaving = None
        self._leaves = True
        self._stop()

    def shut_down(self) -> None:
        """Ends the rig's thread, stopping a run where there is one. Nothing is moved. May be called twice."""
        if not self._closed:
            self._closed = True
            self.session.close()
            self.rig_thread.close()
            self._collector.end()
