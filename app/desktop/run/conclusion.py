"""The summary at the end of a run: computed beside the window, and shown with what may come next."""

from functools import partial
from pathlib import Path

from PySide6.QtCore import QObject, Qt, Signal, Slot
from PySide6.QtWidgets import QWidget

from goniotwin.app.campaign.rehearsal.conclusion import Conclusion, conclude
from goniotwin.app.desktop.events.question import Choice, QuestionBox
from goniotwin.app.desktop.model.worker import OneAtATime, WorkFailed, serve_once

RESULTS, REPORT, NEXT, CLOSE = "Results", "Report…", "Next sample…", "Close"
CHOICES = (
    Choice(RESULTS, "Show the values"),
    Choice(REPORT, "Write the report"),
    Choice(NEXT, "Go on with a copy of the schedule"),
    Choice(CLOSE, "The campaign stays on the screen Campaigns", default=True),
)
MOST_LINES = 6
"""Lines of a summary; the checks and the report have all."""


class ConclusionControl(QObject):
    """Concludes the journal of a run that has ended. `box` is the summary that is shown; it blocks nothing."""

    results_wanted = Signal(object)
    report_wanted = Signal(object)
    """The journal to show, or to write the report of."""
    next_wanted = Signal(str)
    """The operator goes on with another sample: the text of the schedule."""
    reported = Signal(str, bool)
    """A line for the status, and whether it is an error."""
    _answered = Signal(object)
    """What the worker delivers; emitted in a thread."""

    def __init__(self, window: QWidget, *, processes: bool = True) -> None:
        super().__init__(window)
        self._window = window
        self._conclusions = OneAtATime[Conclusion | WorkFailed](
            "conclusion", partial(serve_once, conclude), self._answered.emit, process=processes
        )
        self.box: QuestionBox | None = None
        self._answered.connect(self._take, Qt.ConnectionType.QueuedConnection)

    def begin(self, journal: Path) -> None:
        """Conclude a journal; return at once."""
        self.end()
        self._conclusions.begin(journal)

    def end(self) -> None:
        """Show no summary any more, and end the worker."""
        self._conclusions.end()
        if self.box is not None:
            self.box.dismiss()
            self.box = None

    @Slot(object)
    def _take(self, numbered: tuple[int, Conclusion | WorkFailed]) -> None:
        number, found = numbered
        if number != self._conclusions.number:  # a run that has begun since is not disturbed
            return
        self.end()
        if isinstance(found, WorkFailed):
            self.reported.emit(f"The campaign is done. It has no summary: {found.reason}", True)
            return
        lines = found.lines[:MOST_LINES]
        more = "\n\nMore: see Checks on the screen Results." if len(found.lines) > MOST_LINES else ""
        journal, text = found.journal, "\n\n".join(lines) + more
        self.box = QuestionBox(self._window, f"{journal.stem} is done", text, CHOICES)

        def chosen(label: str) -> None:
            self.end()
            if label == RESULTS:
                self.results_wanted.emit(journal)
            elif label == REPORT:
                self.report_wanted.emit(journal)
            elif label == NEXT:
                self.next_wanted.emit(found.schedule)

        self.box.chosen.connect(chosen)
