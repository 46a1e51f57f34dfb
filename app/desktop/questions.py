"""What the window asks a person. No question blocks: Stop stays within reach while one is open."""

from collections.abc import Callable

from PySide6.QtCore import Slot
from PySide6.QtWidgets import QMessageBox, QWidget

Choice = tuple[str, Callable[[], None]]


class Question(QMessageBox):
    """A question with two answers, each of which does something; closing it is the second."""

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
        self.finished.connect(self._answered)
        self.show()

    def dismiss(self) -> None:
        """It needs no answer any more."""
        if self._open:
            self._open = False
            self.close()
            self.deleteLater()

    @Slot()
    def _answered(self) -> None:
        if self._open:
            self._open = False
            (self._yes if self.clickedButton() is self.yes_button else self._no)()
            self.deleteLater()


def ask_to_mount(parent: QWidget, text: str, mounted: Callable[[], None], stop: Callable[[], None]) -> Question:
    """Shows what is to be mounted, and waits for the person to have done it."""
    return Question(parent, "mount", text, ("It is mounted", mounted), ("Stop the run", stop))


def ask_to_close(parent: QWidget, stop: Callable[[], None], keep: Callable[[], None]) -> Question:
    """Asks whether the run that is going on is to be stopped."""
    text = "A run is going on. Stopping brings the axes to rest where they are; what is measured stays in the journal."
    return Question(parent, "close", text, ("Stop and close", stop), ("Keep running", keep))
