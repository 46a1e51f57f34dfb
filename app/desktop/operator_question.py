"""The question of a run that is open: asked in a box of its own, answered once, and shown again until it is closed."""

from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, Signal, Slot
from PySide6.QtWidgets import QWidget

from goniotwin.app.campaign.running.question import EFFECTS, Answer
from goniotwin.app.desktop import model
from goniotwin.app.desktop.bench.position_entry import NO_ANGLE, PositionEntry
from goniotwin.app.desktop.events.panels import QuestionBar
from goniotwin.app.desktop.events.question import Choice, QuestionBox
from goniotwin.app.desktop.rig.panels import contact_text

if TYPE_CHECKING:
    from goniotwin.app.desktop.bench.sample_entry import SampleEntry
    from goniotwin.app.station.messages import QuestionAsked, Snapshot


class OperatorQuestion(QObject):
    """The question to the operator; `box` is None without one. `bar` shows that there is one, and shows its box again."""

    answered = Signal(int, object, object, object)
    """Number of the question, answer, angle in degrees of `Set position` or None, and what `Mounted` states of the sample."""
    stop_wanted = Signal()

    def __init__(self, parent: QWidget, bar: QuestionBar) -> None:
        super().__init__(parent)
        self.box: QuestionBox | None = None
        self._parent = parent
        self._bar = bar
        self._asked: QuestionAsked | None = None
        self._entry: PositionEntry | None = None
        self._sample: SampleEntry | None = None
        bar.show_question.connect(self.show)

    def ask(self, asked: "QuestionAsked", now: "Snapshot") -> None:
        """Ask a question, in place of the one before."""
        self.dismiss()
        question, self._asked = asked.question, asked
        choices = [Choice(each, EFFECTS[each], each is Answer.STOP, each is question.default) for each in question.answers]
        self._entry = PositionEntry(question.axis.name) if question.axis is not None else None
        self._sample = self._sample_entry() if question.sample else None
        self.box = QuestionBox(self._parent, question.title, question.text, choices, self._entry or self._sample)
        if Answer.MOUNTED in self.box.buttons:
            self.box.buttons[Answer.MOUNTED].setText(f"&{Answer.MOUNTED}")
        self.box.chosen.connect(self._answer)
        self.show_facts(now)
        self._bar.set_question(question.title)

    @Slot()
    def dismiss(self) -> None:
        """The question is closed."""
        if self.box is not None:
            self.box.dismiss()
        self.box = self._asked = None
        self._bar.set_question("")

    @Slot()
    def show(self) -> None:
        """Show the box again, if a question is open."""
        if self.box is not None:
            self.box.appear()

    @Slot(str)
    def show_refusal(self, reason: str) -> None:
        """Show why the station has refused the answer, and ask again."""
        if self.box is not None:
            self.box.set_problem(reason)
            self.box.appear()

    def set_watching(self, reason: str) -> None:
        """Set why this window cannot answer; empty if it can."""
        if self.box is not None:
            self.box.set_refusal(reason)

    @Slot(object)
    def show_message(self, message: object) -> None:
        """Show what is known of the sample, when it has been read."""
        asked = self._asked
        if isinstance(message, model.SamplesRead) and asked is not None and asked.number == message.number and self._sample:
            self._sample.set_known(message.own, message.known)

    def show_facts(self, now: "Snapshot") -> None:
        """Show, with the question, what is known now of the device and the axis that it is about."""
        if now.question is None or self.box is None:
            return
        question = now.question.question
        if self._entry is not None and question.axis is not None:
            self._entry.show_place(*now.place(question.axis.name))
        status = now.rig.devices.get(question.device) if now.rig is not None else None
        self.box.set_note(f"{question.device.capitalize()}: {' '.join(contact_text(status))}" if status is not None else "")

    @Slot(str)
    def _answer(self, label: str) -> None:
        answer = Answer(label)
        assert self.box is not None
        assert self._asked is not None
        angle = self._entry.angle_deg if self._entry is not None and answer is Answer.SET_POSITION else None
        if answer is Answer.SET_POSITION and angle is None:
            self.box.set_problem(NO_ANGLE)
            return
        self.box.hide()  # it is dismissed when it is closed, and shown again after a refusal
        if answer is Answer.STOP:
            self.stop_wanted.emit()
        elif answer is not Answer.WAIT:
            sample = self._sample.given() if self._sample is not None and answer is Answer.MOUNTED else {}
            self.answered.emit(self._asked.number, answer, angle, sample)

    def _sample_entry(self) -> "SampleEntry":
        # Loads the schedule's tables, which the window has by then.
        from goniotwin.app.desktop.bench.sample_entry import SampleEntry

        return SampleEntry()
