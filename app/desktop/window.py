"""The main window: passes on what the operator does, asks questions, and closes in order."""

from collections.abc import Callable
from pathlib import Path

from PySide6.QtCore import Slot
from PySide6.QtGui import QCloseEvent
from PySide6.QtWidgets import QFileDialog, QMainWindow, QMessageBox, QWidget

from goniotwin.app.desktop.event_loop import GarbageCollector
from goniotwin.app.desktop.model.rig_thread import RigThread
from goniotwin.app.desktop.presenter import Presenter
from goniotwin.app.desktop.theme import Theme
from goniotwin.app.desktop.view import MainView

Choice = tuple[str, Callable[[], None]]
"""The text of a button, and what it does."""


class MainWindow(QMainWindow):
    """One rig, one schedule, one run at a time. Journals are written to `folder`."""

    def __init__(self, theme: Theme, rig: Path, schedule: Path | None, folder: Path, speed: float = 1.0) -> None:
        super().__init__()
        self.theme = theme
        self.mount_question: Question | None = None
        self.close_question: Question | None = None
        self._folder = folder
        self._closing = False
        self._closed = False
        self.view = MainView(theme.colours, folder, speed)
        self.setCentralWidget(self.view)
        self.resize(1180, 760)
        self.presenter = Presenter(self.view, rig, self)
        self._connect()
        self._collector = GarbageCollector(self)
        self._collector.start()
        self.rig_thread = RigThread(self.presenter.message_received.emit, speed)
        self._open_rig(rig)
        if schedule is not None:
            self.rig_thread.load(schedule)

    def _connect(self) -> None:
        self.theme.changed.connect(self._recolour)
        self.presenter.changed.connect(self._refresh)
        self.presenter.mount_requested.connect(self._ask_to_mount)
        self.presenter.run_ended.connect(self._after_run)
        run, rig, schedule = self.view.run, self.view.rig, self.view.schedule
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
        permissions = self.presenter.permissions
        self.view.run.set_permissions(permissions)
        for button in (*self.view.rig.buttons, *self.view.schedule.buttons):
            button.setEnabled(permissions.open)
        self.setWindowTitle(self.presenter.title)

    @Slot()
    def _recolour(self) -> None:
        self.view.set_colours(self.theme.colours)

    # The run.

    @Slot()
    def _start(self) -> None:
        if self.presenter.plan is not None:
            self.presenter.show_starting()
            self.rig_thread.start(self.presenter.plan, self._folder)

    @Slot()
    def _pause(self) -> None:
        self.rig_thread.pause()

    @Slot()
    def _resume(self) -> None:
        self.rig_thread.resume()

    @Slot()
    def _stop(self) -> None:
        self.rig_thread.stop()
        if not self.presenter.busy:
            self.view.show_status("Stop was sent to all axes.")

    @Slot(float)
    def _set_speed(self, speed: float) -> None:
        self.rig_thread.set_speed(speed)

    @Slot(str)
    def _ask_to_mount(self, text: str) -> None:
        choices = ("It is mounted", self._confirm_mounted), ("Stop the run", self._stop_mounting)
        self.mount_question = Question(self, "mount", text, *choices)

    def _confirm_mounted(self) -> None:
        self.mount_question = None
        self.rig_thread.confirm_mounted()

    def _stop_mounting(self) -> None:
        self.mount_question = None
        self._stop()

    @Slot()
    def _after_run(self) -> None:
        for question in (self.mount_question, self.close_question):
            if question is not None:
                question.dismiss()
        self.mount_question = self.close_question = None
        if self._closing:
            self.close()

    # The files.

    @Slot()
    def _choose_rig(self) -> None:
        folder = self.presenter.rig_path.parent
        name, _ = QFileDialog.getOpenFileName(self, "Open a rig file", str(folder), "Rig files (*.toml)")
        if name:
            self._open_rig(Path(name))

    @Slot()
    def _connect_again(self) -> None:
        self._open_rig(self.presenter.rig_path)

    def _open_rig(self, path: Path) -> None:
        self.presenter.show_opening(path)
        self.rig_thread.open(path)

    @Slot()
    def _choose_schedule(self) -> None:
        plan = self.presenter.plan
        folder = Path(plan.schedule.name).parent if plan else self.presenter.rig_path.parent
        name, _ = QFileDialog.getOpenFileName(self, "Open a schedule file", str(folder), "Schedule files (*.toml)")
        if name:
            self.rig_thread.load(Path(name))

    @Slot()
    def _choose_folder(self) -> None:
        name = QFileDialog.getExistingDirectory(self, "Folder for data files (journals)", str(self._folder))
        if name:
            self._folder = Path(name)
            self.view.schedule.set_folder(self._folder)

    # The end.

    def closeEvent(self, event: QCloseEvent) -> None:
        """Ask during a run; otherwise close the rig and end its thread."""
        if self.presenter.busy and not self._closed:
            event.ignore()
            if self.close_question is not None:
                self.close_question.dismiss()
            text = "A run is in progress. Stop brings all axes to rest; measured rows stay in the journal."
            choices = ("Stop and close", self._stop_and_close), ("Keep running", self._keep_running)
            self.close_question = Question(self, "close", text, *choices)
            return
        self.shut_down()
        event.accept()

    @Slot()
    def stop_and_close(self) -> None:
        """Stop a run in order, then close, without a question. For a signal from the terminal or the system."""
        if not self.presenter.busy:
            self.close()
            return
        if self.close_question is not None:
            self.close_question.dismiss()
        self._stop_and_close()

    def _keep_running(self) -> None:
        self.close_question = None

    def _stop_and_close(self) -> None:
        self.close_question = None
        self._closing = True
        self._stop()

    def shut_down(self) -> None:
        """End the rig's thread; a run is stopped first. Nothing is moved. A second call does nothing."""
        if not self._closed:
            self._closed = True
            self.presenter.close()
            self.rig_thread.close()
            self._collector.stop()


class Question(QMessageBox):
    """A question with two buttons. Closing it is the second one. It does not block: Stop stays within reach."""

    def __init__(self, parent: QWidget, title: str, text: str, yes: Choice, no: Choice) -> None:
        super().__init__(QMessageBox.Icon.Question, f"goniotwin: {title}", text, parent=parent)
        self._yes, self._no = yes[1], no[1]
        self._open = True
        self.yes_button = self.addButton(yes[0], QMessageBox.ButtonRole.AcceptRole)
        self.no_button = self.addButton(no[0], QMessageBox.ButtonRole.RejectRole)
        self.setDefaultButton(self.no_button)
        self.setEscapeButton(self.no_button)
        self.setAccessibleName(text)
        self.setModal(False)
        self.finished.connect(self._finish)
        self.show()

    def dismiss(self) -> None:
        """Close the question without an answer."""
        if self._open:
            self._open = False
            self.close()
            self.deleteLater()

    @Slot()
    def _finish(self) -> None:
        if self._open:
            self._open = False
            (self._yes if self.clickedButton() is self.yes_button else self._no)()
            self.deleteLater()
