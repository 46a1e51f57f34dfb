"""The question whether the window closes: during a run, which may go on, and for each safety order that is not acknowledged."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from PySide6.QtCore import QObject, Signal, Slot
from PySide6.QtWidgets import QWidget

from goniotwin.app.campaign.running.question import EFFECTS, Answer
from goniotwin.app.desktop.events.question import Choice, QuestionBox
from goniotwin.app.desktop.menu import QUIT_KEY
from goniotwin.app.desktop.run.panel import STOP_KEY

if TYPE_CHECKING:
    from goniotwin.app.campaign.running.events import SafetyOrder

CLOSE_WINDOW, STOP_AND_CLOSE = "Close the window", "Stop and close"
KEEP_OPEN, ACKNOWLEDGE = "Keep open", "Acknowledge"


class CloseQuestion(QObject):
    """What a person has decided about the end of the window. `box` is the question that is open, None without one."""

    close_wanted = Signal()
    stop_wanted = Signal()
    """Stop the run; the window closes when it has ended."""
    acknowledge_wanted = Signal(object)

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self.box: QuestionBox | None = None
        self._parent = parent
        self._closing = False
        self._unattended = False
        self._order: SafetyOrder | None = None

    @property
    def unattended(self) -> bool:
        """Whether the window closes without a question."""
        return self._unattended

    def allows(self, orders: "Sequence[SafetyOrder]", *, busy: bool) -> bool:
        """Whether the window may close now; else there is a question. Asked again beside that of a run, the run goes on."""
        asked = self.box is not None and self.box.isVisible()
        self.dismiss()
        if self._unattended:
            return True
        if orders and not busy:
            self._closing = True
            self._ask_acknowledgement(orders[0])
            return False
        if busy and not asked:
            self._ask_about_run()
            return False
        return True

    def proceed(self) -> None:
        """What the window was to wait for has ended: close, if that is still wanted."""
        self.dismiss()
        if self._closing:
            self.close_wanted.emit()

    @Slot()
    def keep_open(self) -> None:
        """Give up closing the window."""
        self._closing = False
        self.dismiss()

    def close_unattended(self) -> None:
        """Close without a question."""
        self._unattended = True
        self.close_wanted.emit()

    def dismiss(self) -> None:
        """Take the question away."""
        if self.box is not None:
            self.box.dismiss()
        self.box = None

    def _ask_about_run(self) -> None:
        choices = [
            Choice(CLOSE_WINDOW, "The run goes on. The next window shows it again.", default=True),
            Choice(STOP_AND_CLOSE, f"{EFFECTS[Answer.STOP]} Then the window closes.", stops=True),
            Choice(KEEP_OPEN, "The window stays open."),
        ]
        text = f"A run is in progress. {QUIT_KEY} again keeps measuring and closes; {STOP_KEY} first stops the run."
        self._ask("Close the window?", text, choices)

    def _ask_acknowledgement(self, order: "SafetyOrder") -> None:
        choices = [
            Choice(KEEP_OPEN, "The window stays open, with the order at its top.", default=True),
            Choice(ACKNOWLEDGE, "It is done, or somebody is doing it. The window then closes.", stops=True),
        ]
        self._order = order
        self._ask(order.order, f"The window closes when this order is acknowledged: {order.reason}", choices)

    def _ask(self, title: str, text: str, choices: list[Choice]) -> None:
        self.box = QuestionBox(self._parent, title, text, choices)
        self.box.chosen.connect(self._answer)
        self.box.rejected.connect(self.keep_open)

    @Slot(str)
    def _answer(self, label: str) -> None:
        self.dismiss()
        if label == STOP_AND_CLOSE:
            self._closing = True
            self.stop_wanted.emit()
        elif label == CLOSE_WINDOW:
            self.close_unattended()
        elif label == ACKNOWLEDGE:
            self.acknowledge_wanted.emit(self._order)
        else:
            self._closing = False
