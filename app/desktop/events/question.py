"""A question to the operator, in a window of its own that blocks nothing: Stop stays within reach."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from PySide6.QtCore import Qt, Signal, Slot
from PySide6.QtWidgets import QApplication, QDialog, QGridLayout, QLabel, QLineEdit, QPushButton, QVBoxLayout, QWidget

from goniotwin.app.desktop.dialogs import TITLE_BAR, FileDialog

WIDTH, WIDEST = 540, 760
"""Width of a question, and of one whose texts a small screen has not the height for."""


@dataclass(frozen=True)
class Choice:
    """An answer: the text of its button and what follows. One that `stops` a run is given with the mouse alone.

    `default` is that of a key pressed by accident, and of closing the question.
    """

    label: str
    effect: str
    stops: bool = False
    default: bool = False


class QuestionBox(QDialog):
    """A question with its answers. Closing it is no answer: it can be shown again.

    `entry` is what an answer needs besides; it is shown below the text.
    """

    chosen = Signal(str)

    def __init__(self, parent: QWidget, title: str, text: str, choices: Sequence[Choice], entry: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle(f"goniotwin: {title}")
        self.setAccessibleName(f"{title}. {text}")
        self.setModal(False)
        self.setMinimumWidth(WIDTH)
        self._heading = QLabel(title)
        font = self._heading.font()
        font.setBold(True)
        font.setPointSizeF(1.3 * font.pointSizeF())
        self._heading.setFont(font)
        self._text = QLabel(text)
        self._text.setTextInteractionFlags(Qt.TextInteractionFlag.TextBrowserInteraction)
        self._text.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self._text.setAccessibleName(text)
        self._note, self._problem = QLabel(), QLabel()
        self._refusal = ""
        self._stopping = {choice.label for choice in choices if choice.stops}
        for label in (self._heading, self._text, self._note, self._problem):
            label.setTextFormat(Qt.TextFormat.PlainText)
            label.setWordWrap(True)
        self.buttons = {choice.label: self._button(choice) for choice in choices}
        grid = QGridLayout()
        grid.setColumnStretch(1, 1)
        grid.setHorizontalSpacing(14)
        for at, choice in enumerate(choices):
            effect = QLabel(choice.effect)
            effect.setWordWrap(True)
            grid.addWidget(self.buttons[choice.label], at, 0)
            grid.addWidget(effect, at, 1)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(16, 14, 16, 14)
        layout.setSpacing(10)
        layout.addWidget(self._heading)
        layout.addWidget(self._text)
        layout.addWidget(self._note)
        if entry is not None:
            layout.addWidget(entry)
        layout.addWidget(self._problem)
        layout.addSpacing(4)
        layout.addLayout(grid)
        self.set_note("")
        self.set_problem("")
        default = next((choice.label for choice in choices if choice.default), None)
        if default is None:
            self._text.setFocus()
        else:
            self.buttons[default].setDefault(True)
            self.buttons[default].setFocus()
        self.appear()

    @property
    def text(self) -> str:
        """Title and text."""
        return f"{self._heading.text()}: {self._text.text()}"

    def appear(self) -> None:
        """Show the question, and draw the attention to it; the keys stay with another dialog in which a person is."""
        active = QApplication.activeWindow()
        self.show()
        self._fit()
        self.raise_()
        (active if isinstance(active, QDialog) and active.isVisible() else self).activateWindow()
        QApplication.alert(self)
        QApplication.beep()

    def set_note(self, text: str) -> None:
        """Show a line below the text; hide it if empty."""
        self._show_line(self._note, text)

    @property
    def problem(self) -> str:
        """Why the last answer was not taken; empty if nothing is wrong."""
        return self._problem.text()

    def set_problem(self, reason: str) -> None:
        """Show why an answer is not taken; hide the line if empty."""
        self._show_line(self._problem, f"✗ {reason}" if reason else "")

    def _show_line(self, line: QLabel, text: str) -> None:
        if text != line.text() or line.isHidden() == bool(text):
            line.setText(text)
            line.setVisible(bool(text))
            self._fit()

    def _fit(self) -> None:
        """Make room for all lines: a layout gives a window no more height when texts that wrap come later."""
        layout = self.layout()
        if layout is not None and self.isVisible():
            self._heading.show()
            layout.activate()
            room = self.screen().availableGeometry()
            most, width = room.height() - TITLE_BAR, self.width()
            if layout.totalHeightForWidth(width) > most:
                width = min(WIDEST, room.width())
            if layout.totalHeightForWidth(width) > most:
                self._heading.hide()  # the title bar has it
                layout.activate()
            self.resize(width, min(max(layout.totalHeightForWidth(width), layout.totalMinimumSize().height()), most))

    def set_refusal(self, reason: str) -> None:
        """Disable the answers, for this reason, but for those that stop; enabled again, the question draws the attention."""
        if reason == self._refusal:
            return
        before, self._refusal = self._refusal, reason
        for label, button in self.buttons.items():
            if label not in self._stopping:
                button.setEnabled(not reason)
                button.setToolTip(reason)
        if before:
            self.appear()

    def dismiss(self) -> None:
        """Remove the question."""
        self.hide()
        self.deleteLater()

    def _button(self, choice: Choice) -> QPushButton:
        button = QPushButton(choice.label)
        button.setAutoDefault(False)
        button.setMinimumWidth(120)
        button.setAccessibleName(f"{choice.label}. {choice.effect}")
        if choice.stops:
            button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        button.clicked.connect(self._choose)
        return button

    @Slot()
    def _choose(self) -> None:
        button = self.sender()
        assert isinstance(button, QPushButton)
        self.chosen.emit(button.text().replace("&", ""))


REPLACE, CANCEL = "Replace", "Cancel"


def ask_to_replace(
    parent: QWidget,
    title: str,
    text: str,
    replace: Callable[[], object],
    verb: str = REPLACE,
    effect: str = "The former content is lost",
) -> QuestionBox:
    """Ask before something is lost, and call `replace` after a yes, whose label is `verb`. Blocks nothing."""
    choices = [Choice(verb, effect), Choice(CANCEL, "Nothing changes", default=True)]
    box = QuestionBox(parent, title, text, choices)

    def answered(label: str) -> None:
        box.dismiss()
        if label == verb:
            replace()

    box.chosen.connect(answered)
    return box


def ask_file(parent: QWidget, title: str, first: Path, kinds: str, chosen: Callable[..., object], *labels: str) -> None:
    """Ask for a file to write, and before one is replaced. Blocks nothing. `chosen` gets it, and a text for each label."""
    fields = {label: QLineEdit() for label in labels}

    def asked(out: Path) -> None:
        texts = [each.text().strip() for each in fields.values()]
        if out.exists():
            ask_to_replace(parent, f"Replace {out.name}?", f"There is a file {out}.", lambda: chosen(out, *texts))
        else:
            chosen(out, *texts)

    dialog = FileDialog(parent, title, first, kinds, asked, save=True)
    for label, field in fields.items():
        dialog.add_field(label, field)
