"""The main window: passes on what the operator does, asks questions, and closes in order."""

from pathlib import Path

from PySide6.QtCore import Qt, Slot
from PySide6.QtGui import QCloseEvent, QKeyEvent
from PySide6.QtWidgets import QFileDialog, QMainWindow

from goniotwin.app.campaign.running.events import SafetyOrder
from goniotwin.app.campaign.running.question import EFFECTS, Answer
from goniotwin.app.desktop.event_loop import GarbageCollector
from goniotwin.app.desktop.events.question import Choice, QuestionBox
from goniotwin.app.desktop.model.messages import QuestionAsked
from goniotwin.app.desktop.model.rig_thread import RigThread
from goniotwin.app.desktop.presenter import Presenter
from goniotwin.app.desktop.theme import Theme
from goniotwin.app.desktop.view import MainView

KEEP_RUNNING, STOP_AND_CLOSE = "Keep running", "Stop and close"
KEEP_OPEN, ACKNOWLEDGE = "Keep open", "Acknowledge"


class MainWindow(QMainWindow):
    """One rig, one schedule, one run at a time. Journals are written to `folder`."""

    def __init__(self, theme: Theme, rig: Path, schedule: Path | None, folder: Path, speed: float = 1.0) -> None:
        super().__init__()
        self.theme = theme
        self.question: QuestionBox | None = None
        self.close_question: QuestionBox | None = None
        self._asked = 0
        self._folder = folder
        self._closing = False
        self._unattended = False
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
        self.presenter.question_asked.connect(self._ask)
        self.presenter.run_ended.connect(self._after_run)
        run, rig, schedule = self.view.run, self.view.rig, self.view.schedule
        run.start.connect(self._start)
        run.pause.connect(self._pause)
        run.resume.connect(self._resume)
        run.stop.connect(self._stop)
        run.speed_chosen.connect(self._set_speed)
        self.view.orders.acknowledged.connect(self._acknowledge)
        self.view.question.show_question.connect(self._show_question)
        rig.open.connect(self._choose_rig)
        rig.connect_again.connect(self._connect_again)
        rig.person.toggled.connect(self._set_person)
        schedule.open.connect(self._choose_schedule)
        schedule.choose_folder.connect(self._choose_folder)

    @Slot()
    def _refresh(self) -> None:
        permissions = self.presenter.permissions
        self.view.run.set_permissions(permissions)
        for button in (*self.view.rig.buttons, self.view.rig.person, *self.view.schedule.buttons):
            button.setEnabled(permissions.open)
        self.setWindowTitle(self.presenter.title)

    @Slot()
    def _recolour(self) -> None:
        self.view.set_colours(self.theme.colours)

    # The run.

    @Slot()
    def _start(self) -> None:
        if self.presenter.plan is not None:
            self._keep_open()
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

    @Slot(bool)
    def _set_person(self, person: bool) -> None:
        self.rig_thread.set_person(person)

    @Slot(object)
    def _acknowledge(self, order: SafetyOrder) -> None:
        self.presenter.acknowledge(order)
        self.rig_thread.acknowledge(order)
        if self._closing and not self.presenter.busy:
            self.close()

    @Slot()
    def _after_run(self) -> None:
        self._dismiss_question()
        self._dismiss_close_question()
        if self._closing:
            self.close()

    # The questions.

    @Slot(object)
    def _ask(self, asked: QuestionAsked) -> None:
        self._dismiss_question()
        question, self._asked = asked.question, asked.number
        choices = [Choice(each, EFFECTS[each], each is Answer.STOP, each is question.default) for each in question.answers]
        self.question = self._question_box(question.title, question.text, choices)
        self.question.chosen.connect(self._answer)
        self.view.question.set_question(question.title)

    @Slot(str)
    def _answer(self, label: str) -> None:
        answer = Answer(label)
        if answer is Answer.WAIT:
            assert self.question is not None
            self.question.hide()
            return
        self._dismiss_question()
        if answer is Answer.STOP:
            self._stop()
        else:
            self.rig_thread.answer(self._asked, answer)

    @Slot()
    def _show_question(self) -> None:
        if self.question is not None:
            self.question.appear()

    def _question_box(self, title: str, text: str, choices: list[Choice]) -> QuestionBox:
        box = QuestionBox(self, title, text, choices)
        box.escape_released.connect(self.view.run.release_hold)
        return box

    def _dismiss_question(self) -> None:
        if self.question is not None:
            self.question.dismiss()
        self.question = None
        self.view.question.set_question("")

    def _dismiss_close_question(self) -> None:
        if self.close_question is not None:
            self.close_question.dismiss()
        self.close_question = None

    def keyReleaseEvent(self, event: QKeyEvent) -> None:
        """Esc is held no longer; Qt calls it."""
        if event.key() == Qt.Key.Key_Escape and not event.isAutoRepeat():
            self.view.run.release_hold()
        super().keyReleaseEvent(event)

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
        """Ask during a run, and wait for the acknowledgement of every safety order; then close the rig and end its thread."""
        orders = [] if self._unattended or self._closed else self.view.orders.orders
        self._dismiss_close_question()
        if orders and not self.presenter.busy:
            event.ignore()
            self._closing = True
            self._ask_acknowledgement(orders[0])
            return
        if self.presenter.busy and not self._closed:
            event.ignore()
            choices = [
                Choice(KEEP_RUNNING, "The window stays open.", default=True),
                Choice(STOP_AND_CLOSE, f"{EFFECTS[Answer.STOP]} Then the window closes.", stops=True),
            ]
            self.close_question = self._question_box("Close the window?", "A run is in progress.", choices)
            self.close_question.chosen.connect(self._answer_close)
            return
        self.shut_down()
        event.accept()

    def _ask_acknowledgement(self, order: SafetyOrder) -> None:
        choices = [
            Choice(KEEP_OPEN, "The window stays open, with the order at its top.", default=True),
            Choice(ACKNOWLEDGE, "It is done, or seen to. The journal records it. Then the window closes.", stops=True),
        ]
        text = f"The window closes when this order is acknowledged: {order.reason}"
        self.close_question = self._question_box(order.order, text, choices)
        self.close_question.chosen.connect(self._answer_close)

    def _keep_open(self) -> None:
        """Give up closing the window."""
        self._closing = False
        self._dismiss_close_question()

    @Slot()
    def stop_and_close(self) -> None:
        """Stop a run in order, then close, without a question: after a signal, perhaps without a person at the window."""
        self._unattended = True
        self._stop_and_close()

    def _stop_and_close(self) -> None:
        if not self.presenter.busy:
            self.close()
            return
        self._dismiss_close_question()
        self._closing = True
        self._stop()

    @Slot(str)
    def _answer_close(self, label: str) -> None:
        self._dismiss_close_question()
        if label == STOP_AND_CLOSE:
            self._stop_and_close()
        elif label == ACKNOWLEDGE:
            self.view.orders.acknowledge(self.view.orders.orders[0])
        else:
            self._closing = False

    def shut_down(self) -> None:
        """End the rig's thread; a run is stopped first. Nothing is moved. A second call does nothing."""
        if not self._closed:
            self._closed = True
            self.presenter.close()
            self.rig_thread.close()
            self._collector.stop()
