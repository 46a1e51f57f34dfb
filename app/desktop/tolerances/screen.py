"""The tolerances screen: a study file, its computation beside the window, and what it found. Everything on it is simulated."""

import html
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QSize, Qt, Signal, Slot
from PySide6.QtGui import QFontDatabase, QShowEvent
from PySide6.QtWidgets import (
    QBoxLayout,
    QComboBox,
    QHBoxLayout,
    QLabel,
    QPlainTextEdit,
    QProgressBar,
    QTabWidget,
    QTextBrowser,
    QVBoxLayout,
    QWidget,
)

from goniotwin import examples
from goniotwin.app.desktop import model
from goniotwin.app.desktop.dialogs import FileDialog
from goniotwin.app.desktop.events.question import QuestionBox, ask_to_replace
from goniotwin.app.desktop.screen import Screen, WithoutPreferredHeight
from goniotwin.app.desktop.theme import Colours
from goniotwin.app.desktop.tolerances.distribution_view import DistributionView
from goniotwin.app.desktop.tolerances.tables import NumberTable, show_content, show_deviations, show_distributions
from goniotwin.app.errors import UserError

if TYPE_CHECKING:  # the window shows itself before the optics are loaded
    from goniotwin.app.desktop.model.tolerances import Studies, StudyAnswer, StudyContent, StudyOutcome
    from goniotwin.app.station.messages import Snapshot

FOLDER = examples.FOLDER / "tolerances"
WIDE, HIGH = 820, 330
"""Size of a room from which on the study is beside its result, and the curves are below their table."""
LEAST_PARTS = 200, 138
"""Size of a room in which the parts of a low screen still are whole, with their tabs."""
STUDY_WIDTH = 270
PROGRESS_WIDTH = 120
READY = "Ready. A study is computed on the twin, beside the window."
IN_RUN = "a run is in progress, and nothing may disturb it: compute after it"
WAITING = "Waits for the end of the run"
CANCELLED = "Cancelled."


class TolerancesScreen(Screen):
    """The study at the left, its result at the right; all of it in tabs where the room is small."""

    title = "Tolerances"
    icon = "tune-variant"

    answered = Signal(object)
    """The number of a study and an answer of its worker; emitted in a thread."""

    def __init__(self, colours: Colours) -> None:
        super().__init__(colours)
        self.outcome: StudyOutcome | None = None
        self.content: StudyContent | None = None
        self.question: QuestionBox | None = None
        self._studies: Studies | None = None
        self._station: Snapshot | None = None
        self._computing = False
        self._complete = False
        self._refused = False
        self._is_error = False
        self._folder = Path.home()
        self._outcomes: dict[Path, tuple[StudyContent, StudyOutcome]] = {}
        self.choice = QComboBox()
        self.choice.setAccessibleName("Study")
        self.choice.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.choice.setMinimumContentsLength(9)
        for path in sorted(FOLDER.glob("*.toml")):
            self._add_choice(path, path.name)
        self.open_button = self._button("&Open…", "Open a study file", self._choose_file)
        self.compute_button = self._button("&Compute", "Compute the study", self.compute)
        self.cancel_button = self._button("Ca&ncel", "Cancel the computation", self.cancel)
        self.save_button = self._button("Save &in…", "Save figure, tables, text and JSON in a folder", self._choose_folder)
        self._mark = QLabel("SIMULATED")
        self._mark.setAccessibleName("SIMULATED: tolerances are computed on the twin")
        self.status = QLabel()
        self.status.setWordWrap(True)
        self.status.setTextFormat(Qt.TextFormat.PlainText)
        self.progress = QProgressBar()
        self.progress.setRange(0, 1000)
        self.progress.setFixedSize(PROGRESS_WIDTH, self.progress.fontMetrics().height() + 4)  # the line keeps its height
        self.progress.setAccessibleName("Progress of the study")
        self.study_text = QTextBrowser()
        self.study_text.setAccessibleName("What the study has")
        self.study_text.setTabChangesFocus(True)
        self.study_text.setMinimumSize(160, 76)
        self.deviations = NumberTable("Deviations of the study", colours)
        self.summary = QLabel()
        self.summary.setWordWrap(True)
        self.summary.setTextFormat(Qt.TextFormat.PlainText)
        self.summary.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.distributions = NumberTable("Sets of combinations", colours)
        self.curves = DistributionView(colours)
        self.report = QPlainTextEdit()
        self.report.setReadOnly(True)
        self.report.setAccessibleName("Result as text")
        self.report.setFont(QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont))
        self.report.setLineWrapMode(QPlainTextEdit.LineWrapMode.NoWrap)
        self.report.setTabChangesFocus(True)
        self.report.setMinimumHeight(76)
        self.report.setPlaceholderText("Tables, assumptions and explanations of a computed study are shown here.")
        self._lay_out()
        self.choice.currentIndexChanged.connect(self._show_chosen)
        self.distributions.itemSelectionChanged.connect(self._show_curves)
        self.answered.connect(self._take_answer, Qt.ConnectionType.QueuedConnection)
        self.set_colours(colours)
        self._show_nothing()

    def _lay_out(self) -> None:
        label = QLabel("Stud&y")
        label.setBuddy(self.choice)
        head = QHBoxLayout()
        head.setSpacing(6)
        head.addWidget(label)
        head.addWidget(self.choice, 1)
        for button in (self.open_button, self.compute_button, self.cancel_button, self.save_button):
            head.addWidget(button)
        head.addStretch(1)
        line = QHBoxLayout()
        line.setSpacing(8)
        line.addWidget(self._mark)
        line.addWidget(self.status, 1)
        line.addWidget(self.progress)
        self._together = QWidget()
        together = QVBoxLayout(self._together)
        together.setContentsMargins(6, 4, 6, 4)
        together.setSpacing(4)
        self._table_and_curves = QBoxLayout(QBoxLayout.Direction.TopToBottom)
        self._table_and_curves.addWidget(self.distributions, 2)
        self._table_and_curves.addWidget(self.curves, 3)
        together.addWidget(self.summary)
        together.addLayout(self._table_and_curves, 1)
        self.parts = QTabWidget()
        for tabs in (self.parts, self.parts.tabBar()):  # Tab stops at the latter
            tabs.setAccessibleName("Parts of the tolerances screen")
        for part, title in ((self.deviations, "Deviations"), (self._together, "All together"), (self.report, "Text")):
            self.parts.addTab(part, title)
        # A page that is hidden does not pass on that it needs less height by now.
        self.parts.setMinimumSize(*LEAST_PARTS)
        self._columns = QHBoxLayout()
        self._columns.setSpacing(10)
        self._columns.addWidget(self.study_text)
        self._columns.addWidget(self.parts, 1)
        whole = WithoutPreferredHeight()
        layout = QVBoxLayout(whole)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(4)
        layout.addLayout(head)
        layout.addLayout(line)
        layout.addLayout(self._columns, 1)
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        outer.addWidget(whole)
        self._wide: bool | None = None
        self.fit(QSize(WIDE, HIGH))

    def fit(self, room: QSize) -> None:
        """Show the study in a tab where the room is narrow, and the curves beside their table where it is low."""
        low = room.height() < HIGH
        direction = QBoxLayout.Direction.LeftToRight if low else QBoxLayout.Direction.TopToBottom
        self._table_and_curves.setDirection(direction)
        self._table_and_curves.setStretch(1, 2 if low else 3)
        self.summary.setVisible(bool(self.summary.text()) and not low)
        self._low = low
        wide = room.width() >= WIDE
        if wide == self._wide:
            return
        self._wide = wide
        if wide:
            self.study_text.setFixedWidth(STUDY_WIDTH)
            self._columns.insertWidget(0, self.study_text)
            self.study_text.show()
        else:
            self.study_text.setMinimumWidth(160)
            self.study_text.setMaximumWidth((1 << 24) - 1)
            shown = self.parts.currentIndex()
            self.parts.insertTab(0, self.study_text, "Study")
            self.parts.setCurrentIndex(shown + 1)

    def complete(self) -> None:
        """Read the chosen study when the screen is shown: what reads it is loaded by then."""
        self._complete = True
        if self.isVisible():
            self._show_chosen()

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        super().set_colours(colours)
        self._mark.setStyleSheet(
            f"background: {colours.simulated}; color: {colours.on_simulated}; font-weight: bold; padding: 1px 6px"
        )
        for part in (self.deviations, self.distributions, self.curves):
            part.set_colours(colours)
        self._colour_status()

    def shut_down(self) -> None:
        """End a computation."""
        if self._studies is not None:
            self._studies.end()

    def showEvent(self, event: QShowEvent) -> None:
        """Read the chosen study at first; Qt calls it."""
        super().showEvent(event)
        if self._complete and self.content is None and not self._refused:
            self._show_chosen()

    # What the station reports.

    @property
    def in_run(self) -> bool:
        """Whether a run is in progress."""
        return self._station is not None and (self._station.busy or self._station.starting)

    @Slot(object)
    def show_message(self, message: object) -> None:
        """Have a study wait while a run is in progress."""
        before = self.in_run
        match message:
            case model.Positions():  # a run has many a second
                return
            case model.Attached(_name, snapshot):
                self._station = snapshot
            case model.NotAttached() | model.StationLost():
                self._station = None
            case _ if isinstance(message, model.Message):
                self._station = model.advance(self._station or model.Snapshot(), message)
        if self.in_run != before:
            if self._studies is not None:
                self._studies.wait(self.in_run)
            self._enable()
            if not self._computing and self.content is not None:
                self._show_status(self._idle_text())

    # The study.

    @property
    def path(self) -> Path | None:
        """The chosen study file."""
        path = self.choice.currentData()
        return None if path is None else Path(path)

    def open_study(self, path: Path) -> None:
        """Choose a study file; it is read again if it is chosen already."""
        paths = [Path(self.choice.itemData(at)) for at in range(self.choice.count())]
        at = paths.index(path) if path in paths else self._add_choice(path, f"{path.name}  {path.parent}")
        if at == self.choice.currentIndex():
            self._show_chosen()
        else:
            self.choice.setCurrentIndex(at)

    def _add_choice(self, path: Path, text: str) -> int:
        self.choice.addItem(text, str(path))
        at = self.choice.count() - 1
        self.choice.setItemData(at, str(path), Qt.ItemDataRole.ToolTipRole)
        return at

    def _choose_file(self) -> None:
        first = self.path.parent if self.path is not None else FOLDER
        FileDialog(self, "Open a study file", first, "Study files (*.toml)", self.open_study)

    @Slot()
    def _show_chosen(self) -> None:
        """Show the chosen study, with its result if it has been computed since the file was written."""
        path = self.path
        self._show_nothing()
        if path is None or not self._complete:
            return
        try:
            content = model.read_content(path)
        except UserError as error:
            self._refused = True
            self._show_status(str(error), error=True)
            return
        self.content = content
        topics = "".join(f"<p><b>{html.escape(topic)}</b><br>{html.escape(text)}</p>" for topic, text in content.topics)
        self.study_text.setHtml(f"<p><b>{html.escape(content.name)}</b></p>{topics}")
        show_content(self.deviations, content)
        computed = self._outcomes.get(path)
        if computed is not None and computed[0] == content:
            self._show_outcome(computed[1])
        self._show_status(self._idle_text())
        self._enable()

    def _show_nothing(self) -> None:
        self.content, self.outcome, self._refused = None, None, False
        self.study_text.setHtml("")
        show_content(self.deviations, None)
        show_distributions(self.distributions, None)
        self.curves.set_outcome(None)
        self.report.setPlainText("")
        self._show_summary("")
        self._show_status("")
        self._enable()

    def _show_outcome(self, outcome: "StudyOutcome") -> None:
        self.outcome = outcome
        show_deviations(self.deviations, outcome)
        show_distributions(self.distributions, outcome)
        self.curves.set_outcome(outcome)
        self.report.setPlainText(outcome.text)
        self._show_summary(outcome.summary)

    def _show_summary(self, text: str) -> None:
        self.summary.setText(text)
        self.summary.setAccessibleName(f"Summary: {text}" if text else "Summary")
        self.summary.setVisible(bool(text) and not self._low)

    @Slot()
    def _show_curves(self) -> None:
        if self.outcome is not None and self.distributions.chosen >= 0:
            self.curves.set_outcome(self.outcome, self.distributions.chosen)

    # The computation.

    def compute(self) -> None:
        """Begin to compute the chosen study."""
        path = self.path
        if path is None or self._computing or self.in_run:
            return
        self._outcomes.pop(path, None)
        self._show_chosen()  # the file may be another by now
        if self.content is None:
            return
        if self._studies is None:
            self._studies = model.Studies(self.answered.emit)
        self._computing = True
        self.progress.setValue(0)
        self._studies.compute(path)
        self._show_status("Loading the optics …")
        self._enable()
        self.cancel_button.setFocus()

    def cancel(self) -> None:
        """Give the computation up; nothing is kept of it."""
        if self._computing:
            self._end(CANCELLED)

    @Slot(object)
    def _take_answer(self, numbered: "tuple[int, StudyAnswer]") -> None:
        number, answer = numbered
        if not self._computing or self._studies is None or number != self._studies.number:
            return
        match answer:
            case model.StudyProgress(share, step, waiting):
                self.progress.setValue(round(1000 * share))
                self._show_status(f"{WAITING}: {step}" if waiting else f"{step[:1].upper()}{step[1:]} …")
            case model.StudyOutcome():
                content = self.content
                assert content is not None  # no other study can be chosen meanwhile
                self._outcomes[content.path] = content, answer
                self._show_outcome(answer)
                self.parts.setCurrentWidget(self._together)
                self._end("")
            case model.WorkFailed(reason):
                self._end(reason, error=True)

    def _end(self, text: str, *, error: bool = False) -> None:
        assert self._studies is not None
        self._studies.end()
        self._computing = False
        had_focus = self.cancel_button.hasFocus()
        self._enable()
        self._show_status(text or self._idle_text(), error=error)
        if had_focus:
            (self.save_button if self.outcome is not None else self.compute_button).setFocus()

    def _enable(self) -> None:
        idle = not self._computing
        self.choice.setEnabled(idle)
        self.open_button.setEnabled(idle and self._complete)
        self.compute_button.setEnabled(idle and self.content is not None and not self.in_run)
        self.compute_button.setToolTip(f"Disabled: {IN_RUN}" if self.in_run else "Compute all stages of the study")
        self.cancel_button.setEnabled(self._computing)
        self.save_button.setEnabled(idle and self.outcome is not None)
        self.progress.setVisible(self._computing)

    def _idle_text(self) -> str:
        if self.in_run:
            return f"{IN_RUN[:1].upper()}{IN_RUN[1:]}."
        return f"Computed: {self.outcome.name}." if self.outcome is not None else READY

    def _show_status(self, text: str, *, error: bool = False) -> None:
        self._is_error = error
        self.status.setText(f"✗ {text}" if error else text)
        self.status.setAccessibleName(f"Tolerances: {text}")
        self._colour_status()

    def _colour_status(self) -> None:
        self.status.setStyleSheet(f"color: {self._colours.bad if self._is_error else self._colours.text}")

    # The files.

    @Slot(object)
    def set_folder(self, folder: Path) -> None:
        """Take the folder that is offered for the files of a study."""
        self._folder = folder

    def _choose_folder(self) -> None:
        first = next((each for each in (self._folder, *self._folder.absolute().parents) if each.is_dir()), Path.home())
        FileDialog(self, "Folder for the figure, the tables, the text and the JSON of the study", first, "", self.save_in)

    def save_in(self, folder: Path) -> None:
        """Write the files of the result into a folder, after a question where there are such files."""
        outcome = self.outcome
        if outcome is None:
            return
        self._folder = folder
        there = [name for name in outcome.files if (folder / name).exists()]
        if not there:
            self._write(outcome, folder)
            return
        title, text = "Replace the files of an earlier study?", f"{folder} has {', '.join(there)}."
        self.question = ask_to_replace(self, title, text, lambda: self._write(outcome, folder))

    def _write(self, outcome: "StudyOutcome", folder: Path) -> None:
        try:
            model.write_outcome(outcome, folder)
        except UserError as error:
            self._show_status(str(error), error=True)
        else:
            self._show_status(f"Written into {folder.name}: {', '.join(outcome.files)}")
            self.status.setToolTip(str(folder))
