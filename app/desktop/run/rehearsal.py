"""The rehearsal of the open schedule in the window: begun, cancelled and shown; its verdict is asked for at Start."""

from collections.abc import Callable

from PySide6.QtCore import QObject, Qt, Signal, Slot
from PySide6.QtWidgets import QWidget

from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.rehearsal.report import RehearsalPage
from goniotwin.app.desktop.dialogs import TextBox
from goniotwin.app.desktop.events.question import QuestionBox, ask_to_replace
from goniotwin.app.desktop.model.rehearsal import RehearsalAnswer, RehearsalProgress, Rehearsals
from goniotwin.app.desktop.model.worker import WorkFailed

START_ANYWAY = "Start anyway"


class RehearsalControl(QObject):
    """Rehearses a plan beside the window. `rehearsed` is the verdict on the plan that is open, None without one."""

    progressed = Signal(str)
    """The progress in words; empty where there is no rehearsal any more."""
    reported = Signal(str, bool)
    """A line for the status, and whether it is an error."""
    _answered = Signal(object)
    """What the worker delivers; emitted in a thread."""

    def __init__(self, window: QWidget, *, processes: bool = True) -> None:
        super().__init__(window)
        self._window = window
        self._rehearsals = Rehearsals(self._answered.emit, process=processes)
        self._verdict: RehearsalPage | None = None
        self._plan: Plan | None = None
        self.rehearsing = False
        self.question: QuestionBox | None = None
        self._answered.connect(self._take, Qt.ConnectionType.QueuedConnection)

    @property
    def rehearsed(self) -> RehearsalPage | None:
        """The verdict on the plan that is open."""
        return self._verdict if self._rehearsals.is_of(self._plan) else None

    def set_plan(self, plan: Plan | None, refusal: str) -> None:
        """Take the plan that is open: a rehearsal of another one is cancelled, and so is one that is not allowed now."""
        self._plan = plan
        if self.rehearsing and plan is not None and (refusal or not self._rehearsals.is_of(plan)):
            self.end("The rehearsal is cancelled.")

    @Slot()
    def toggle(self) -> None:
        """Begin to rehearse, or cancel."""
        if self.rehearsing:
            self.end("The rehearsal is cancelled.")
        elif self._plan is not None:
            self.rehearsing, self._verdict = True, None
            self._rehearsals.rehearse(self._plan)
            self.progressed.emit(str(RehearsalProgress(0, 0, 0.0)))

    def before_start(self, start: Callable[[], object]) -> None:
        """Start at once, or after a yes where the rehearsal has shown that the schedule misses something."""
        if self.rehearsing:
            self.end("")
        if (found := self.rehearsed) is None or not found.missed:
            start()
            return
        plan, text = self._plan, "\n\n".join(found.missed)

        def begin() -> None:
            if self._plan is plan:  # else it was edited meanwhile
                start()

        title, effect = f"Start {found.name} as it is?", "The run begins, as planned"
        self.question = ask_to_replace(self._window, title, text, begin, START_ANYWAY, effect)

    def end(self, text: str) -> None:
        """End the worker, and report a text."""
        self._rehearsals.end()
        self.rehearsing = False
        self.progressed.emit("")
        if text:
            self.reported.emit(text, False)

    @Slot(object)
    def _take(self, numbered: tuple[int, RehearsalAnswer]) -> None:
        number, answer = numbered
        if not self.rehearsing or number != self._rehearsals.number:
            return
        match answer:
            case RehearsalProgress():
                self.progressed.emit(str(answer))
            case RehearsalPage():
                self.end("")
                self._verdict = answer
                self.reported.emit(answer.summary, bool(answer.missed))
                TextBox(self._window, f"Rehearsal of {answer.name}", answer.html).show()
            case WorkFailed(reason):
                self.end("")
                self.reported.emit(f"The rehearsal has failed: {reason}", True)
