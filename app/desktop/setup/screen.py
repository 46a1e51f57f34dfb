"""The schedule screen: file and form at the left, its text in the middle, its directions at the right."""

import contextlib
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QSize, Qt, QTimer, Signal, Slot
from PySide6.QtGui import QColor, QFontDatabase, QKeyEvent, QTextCursor
from PySide6.QtWidgets import (
    QComboBox,
    QFrame,
    QGroupBox,
    QHBoxLayout,
    QLabel,
    QPlainTextEdit,
    QPushButton,
    QScrollArea,
    QSplitter,
    QTextEdit,
    QVBoxLayout,
    QWidget,
)

from goniotwin import examples
from goniotwin.app.campaign.wording import rounded_duration_text
from goniotwin.app.desktop import model
from goniotwin.app.desktop.events.question import ask_file, ask_to_replace
from goniotwin.app.desktop.rig.panels import fill, heading, path_label, show_path
from goniotwin.app.desktop.screen import Screen
from goniotwin.app.desktop.setup.form import NewSchedule, ScheduleForm
from goniotwin.app.desktop.theme import Colours
from goniotwin.app.errors import UserError
from goniotwin.app.formats.file import write_file

if TYPE_CHECKING:  # the window shows itself before planner and pyqtgraph are loaded
    from goniotwin.app.campaign.planning.plan import Plan
    from goniotwin.app.desktop.model.draft import Drafted, DraftPlanner, TemplateChoice
    from goniotwin.app.desktop.setup.preview import DirectionsView
    from goniotwin.app.station.messages import RigOpened

UNSAVED = "the schedule has changes that are not saved: save it first (Ctrl+S)"
READ_AGAIN = "the schedule that was saved is being read"
SCROLLED = "Form that scrolls"
NEW_NAME, PARAGRAPH = "new.toml", "\u2029"
EXAMPLES = examples.FOLDER
"""What came with the program is not written to."""
PAUSE_MS = 400
"""Time without a key after which a text is planned."""
SHARES = (38, 31, 31)
"""Of the columns in the width, percent."""
NARROW = 760
"""Width of a room below which the directions are omitted."""


class SchedulePanel(QGroupBox):
    """The schedule, its size, and the folder of data files."""

    open = Signal()
    choose_folder = Signal()
    plan_shown = Signal(object)
    folder_shown = Signal(object)
    """The plan and the folder, whenever they are set."""

    def __init__(self) -> None:
        super().__init__("Schedule file")
        self.setAccessibleName("Schedule file")
        self._name = heading("no schedule")
        self._name.setAccessibleName("Schedule")
        self._path = path_label()
        self._size = QLabel()
        self._size.setWordWrap(True)
        self._folder = path_label()
        self.open_button = QPushButton("&Open schedule…")
        self.open_button.setAccessibleName("Open a schedule file")
        self.folder_button = QPushButton("Save &in…")
        self.folder_button.setAccessibleName("Choose the folder for data files (journals)")
        self.open_button.clicked.connect(self.open)
        self.folder_button.clicked.connect(self.choose_folder)
        self.new_button, self.save_button, self.copy_button = (
            QPushButton(each) for each in ("Ne&w…", "Sav&e", "Save a &copy…")
        )
        for button, name in (
            (self.new_button, "New schedule from a template"),
            (self.save_button, "Save the schedule (Ctrl+S)"),
            (self.copy_button, "Save the schedule as another file"),
        ):
            button.setAccessibleName(name)
            button.setToolTip(name)
        self.buttons = (self.open_button, self.folder_button)
        every = (self.new_button, self.open_button, self.save_button, self.copy_button, self.folder_button)
        fill(self, [self._name, self._path, self._size, self._folder], every)
        self.set_plan(None)

    def set_plan(self, plan: "Plan | None") -> None:
        """Show the schedule of a plan and its size."""
        self._name.setText(plan.schedule.file.name if plan else "no schedule")
        self._path.setVisible(plan is not None)
        self._size.setVisible(plan is not None)
        if plan is not None:
            show_path(self._path, Path(plan.schedule.name))
            self._size.setText(f"{len(plan.rows)} rows, estimated duration {rounded_duration_text(plan.seconds)}")
        self.plan_shown.emit(plan)

    def set_unsaved(self, path: Path | None, *, unsaved: bool) -> None:
        """Show whether the text differs from the file `path`, or has none yet."""
        show_path(self._path, path or Path(NEW_NAME), "● not saved: " if unsaved else "")
        self._size.setHidden(unsaved or path is None)  # it is that of the file
        if path is None and unsaved:
            self._name.setText("new schedule")
            self._path.show()

    def set_folder(self, folder: Path) -> None:
        """Show the folder of data files."""
        show_path(self._folder, folder, "Data files (journals) in ")
        self.folder_shown.emit(folder)


class ScheduleText(QPlainTextEdit):
    """The text of a schedule. A letter with Alt is that of a control, also of one that is disabled, and no part of the text.

    Brackets are: some keyboards of macOS have them at Alt.
    """

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Leave letters with Alt alone; Qt calls it."""
        if event.modifiers() == Qt.KeyboardModifier.AltModifier and event.text().isascii() and event.text().isalpha():
            event.ignore()
        else:
            super().keyPressEvent(event)


class SetupScreen(Screen):
    """A schedule as form and text: what is typed in one is in the other. What is saved is what a run measures."""

    title = "Schedule"
    icon = "calendar-clock"

    saved = Signal(object)
    """The file that was saved, to be opened."""
    unsaved_changed = Signal(str)
    """Why the schedule cannot be started as it is, or empty."""
    reported = Signal(str, bool)
    """A line for the status, and whether it is an error."""
    _delivered = Signal(object)

    def __init__(self, colours: Colours) -> None:
        super().__init__(colours)
        self.schedule = SchedulePanel()
        self.form = ScheduleForm(colours)
        self.drafted: Drafted | None = None
        self._planner: DraftPlanner | None = None
        self._preview: DirectionsView | None = None
        self._new: NewSchedule | None = None
        self._rig: RigOpened | None = None
        self._samples: tuple[str, ...] = ()
        self._path: Path | None = None
        self._saved, self._planned, self._line_end = "", "", "\n"
        self._text = ScheduleText()
        self._text.setAccessibleName("Text of the schedule file")
        self._text.setFont(QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont))
        self._text.setTabChangesFocus(True)
        self._text.setPlaceholderText("Open a schedule, or write a new one from a template.")
        self._error, self._facts = QLabel(), QLabel()
        for label, name in ((self._error, "Error in the schedule"), (self._facts, "What the schedule takes")):
            label.setWordWrap(True)
            label.setTextFormat(Qt.TextFormat.PlainText)
            label.setAccessibleName(name)
        self.incidence = QComboBox()
        self.incidence.setAccessibleName("Incidence of the directions that are shown")
        self.incidence.activated.connect(lambda _at: self._show_map())
        left, middle, self._right = QWidget(), QWidget(), QWidget()
        columns_of: list[tuple[QWidget, tuple[QWidget, ...]]] = [
            (left, (self.schedule, self.form)),
            (middle, (self._text, self._error, self._facts)),
            (self._right, (self.incidence,)),
        ]
        for column, parts in columns_of:
            layout = QVBoxLayout(column)
            layout.setContentsMargins(0, 0, 6, 0)
            for part in parts:
                layout.addWidget(part, 1 if part is self._text else 0)
            if column is left:
                layout.addStretch(1)
        scroll = self._scroll = QScrollArea()
        scroll.setAccessibleName(SCROLLED)
        scroll.setWidget(left)
        scroll.setWidgetResizable(True)
        scroll.setFrameShape(QFrame.Shape.NoFrame)
        scroll.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        columns = self._columns = QSplitter(Qt.Orientation.Horizontal)
        columns.setChildrenCollapsible(False)
        for each in (scroll, middle, self._right):
            columns.addWidget(each)
        outer = QHBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        outer.addWidget(columns)
        self._pause = QTimer(self, singleShot=True, interval=PAUSE_MS)
        self._pause.timeout.connect(self._plan)
        self._text.textChanged.connect(self._take_text)
        self.form.edited.connect(self._replace_text)
        self.form.refused.connect(self._show_refusal)
        self.schedule.plan_shown.connect(self._show_plan)
        self.schedule.new_button.clicked.connect(lambda: self._ask_template())
        self.schedule.save_button.clicked.connect(lambda: self.save())
        self.schedule.copy_button.clicked.connect(lambda: self._ask_copy())
        self._delivered.connect(self._show_draft, Qt.ConnectionType.QueuedConnection)
        self.set_colours(colours)
        self._show_plan(None)

    def complete(self) -> None:
        """Make form, planner and picture."""
        from goniotwin.app.desktop.model.draft import DraftPlanner
        from goniotwin.app.desktop.setup.preview import DirectionsView

        self._planner = DraftPlanner(self._delivered.emit)
        self._preview = DirectionsView(self._colours)
        layout = self._right.layout()
        assert isinstance(layout, QVBoxLayout)
        layout.insertWidget(1, self._preview, 1)
        self.form.complete()
        stops = (self.schedule.folder_button, *self.form.fields.values(), self._text, self.incidence)
        for before, after in pairwise(stops):
            self.setTabOrder(before, after)

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        super().set_colours(colours)
        self._error.setStyleSheet(f"color: {colours.bad}")
        if self._preview is not None:
            self._preview.set_colours(colours)

    def fit(self, room: QSize) -> None:
        """Leave out the directions where there is little room."""
        self._right.setVisible(room.width() >= NARROW)
        left = self._scroll.widget()
        assert left is not None
        self._scroll.setMinimumWidth(left.minimumSizeHint().width() + self._scroll.verticalScrollBar().sizeHint().width())
        self._columns.setSizes([room.width() * share // 100 for share in SHARES])

    def shut_down(self) -> None:
        """End the planner."""
        if self._planner is not None:
            self._planner.close()

    @Slot(object)
    def show_message(self, message: object) -> None:
        """Take the samples of a virtual rig, which a new schedule offers."""
        if isinstance(message, model.RigRead):
            twin = None if message.rig is None else message.rig.twin
            self._samples = () if twin is None else tuple(twin.samples)

    def set_rig(self, rig: "RigOpened | None") -> None:
        """Take the rig for which texts are planned."""
        if rig is not self._rig:
            self._rig = rig
            self._pause.start()

    # The text.

    @property
    def text(self) -> str:
        """The text of the schedule, with one kind of line end; plain text would lose blanks that do not break."""
        return self._text.document().toRawText().replace(PARAGRAPH, "\n")

    @property
    def unsaved(self) -> bool:
        """Whether the text differs from the file's."""
        return self.text != self._saved

    @property
    def error(self) -> str:
        """What is wrong with the text, or with what was typed into the form."""
        return self._error.text()

    @Slot(object)
    def _show_plan(self, plan: "Plan | None") -> None:
        """Show the schedule that was opened, unless changes of the one that is shown would be lost."""
        if plan is None or (self.unsaved and plan.schedule.text != self.text):
            return
        self._path, self._line_end = Path(plan.schedule.name), "\n"
        with contextlib.suppress(OSError):  # a text has one kind of line end, whatever its file has
            self._line_end = "\r\n" if b"\r\n" in self._path.read_bytes() else "\n"
        if self.text != plan.schedule.text:
            self.form.discard()
            self._text.setPlainText(plan.schedule.text)
        self._saved = self._planned = self.text
        self._take_text()

    @Slot()
    def _take_text(self) -> None:
        name = NEW_NAME if self._path is None else str(self._path)
        self.form.set_text(self.text, name)
        self.schedule.save_button.setEnabled(self.unsaved)
        self.schedule.set_unsaved(self._path, unsaved=self.unsaved)
        self.schedule.copy_button.setEnabled(bool(self.text))
        self._report_unsaved()
        self._pause.start()

    def _report_unsaved(self) -> None:
        """Report why the schedule cannot be started as it is."""
        unsaved = UNSAVED if self.unsaved else READ_AGAIN if self.text != self._planned else ""
        self.unsaved_changed.emit(self.form.refusal or unsaved)

    @Slot(str)
    def _show_refusal(self, reason: str) -> None:
        self._show_error(reason, None)
        self._report_unsaved()
        if not reason:
            self._pause.start()

    @Slot(str)
    def _replace_text(self, text: str) -> None:
        """Take a text with an edited value: one step to undo."""
        cursor = QTextCursor(self._text.document())
        cursor.beginEditBlock()
        cursor.select(QTextCursor.SelectionType.Document)
        cursor.insertText(text)
        cursor.endEditBlock()

    # Its plan.

    @Slot()
    def _plan(self) -> None:
        if self._planner is not None and self.text:
            self._planner.plan(self.text, self._path or Path(NEW_NAME), self._rig)

    @Slot(object)
    def _show_draft(self, drafted: "Drafted") -> None:
        if drafted.of_template and drafted.error:
            if self._new is not None:
                self._new.show_error(drafted.error)
            return
        if drafted.of_template:
            if self._new is not None:
                self._new.accept()
            self._path, self._saved = None, ""
            self.form.discard()
            self._text.setPlainText(drafted.text)
            self.reported.emit("; ".join(["A new schedule. Save it to measure it", *drafted.notes]), False)
            return
        if drafted.text != self.text:
            return  # another key was pressed meanwhile; its text is planned next
        before_maps = () if self.drafted is None else self.drafted.maps
        self._show_error(self.form.refusal or drafted.error, drafted.line)
        if drafted.error:
            self.drafted = replace(drafted, maps=before_maps)
            return  # the directions stay those of the last plan
        self.drafted = drafted
        self._facts.setText("\n".join(["; ".join(drafted.facts), *(f"⚠ {each}" for each in drafted.warnings)]))
        before = self.incidence.currentText()
        self.incidence.clear()
        self.incidence.addItems([model.map_title(each) for each in drafted.maps])
        self.incidence.setCurrentIndex(max(0, self.incidence.findText(before)))
        self.incidence.setVisible(len(drafted.maps) > 1)
        self._show_map()

    def _show_map(self) -> None:
        if self._preview is not None:
            maps = () if self.drafted is None else self.drafted.maps
            self._preview.show_map(maps[self.incidence.currentIndex()] if maps else None)

    def _show_error(self, reason: str, line: int | None) -> None:
        self._error.setText(reason and f"✗ {reason}")
        self._error.setVisible(bool(reason))
        marks = []
        if line is not None:
            mark = QTextEdit.ExtraSelection()
            mark.cursor = QTextCursor(self._text.document().findBlockByNumber(line - 1))
            mark.format.setBackground(QColor(self._colours.simulated))
            mark.format.setForeground(QColor(self._colours.on_simulated))
            marks = [mark]
        self._text.setExtraSelections(marks)

    # The file.

    def _ask_template(self) -> None:
        def chosen(choice: "TemplateChoice") -> None:
            if self._planner is not None:
                self._planner.make(choice, Path(NEW_NAME), self._rig)

        measured = self.form.sample

        def ask() -> None:
            self._new = NewSchedule(self.window(), self._samples, measured, chosen)
            self._new.show()

        self.leave(ask)

    def leave(self, then: Callable[[], object]) -> None:
        """Do what takes the text away: at once, or after a question where it is not saved. Blocks nothing."""
        if not self.unsaved:
            then()
            return

        def discard() -> None:
            self.form.discard()
            self._text.setPlainText(self._saved)
            then()

        title, text = "Discard the changes of the schedule?", "They are not saved. Cancel, then Ctrl+S saves them."
        ask_to_replace(self.window(), title, text, discard, "Discard", "The changes are lost")

    def _ask_copy(self) -> None:
        name = NEW_NAME if self._path is None else f"{self._path.stem}-copy.toml"
        inside = self._path is None or self._path.is_relative_to(EXAMPLES)
        first = (Path.cwd() if inside or self._path is None else self._path.parent) / name
        ask_file(self.window(), "Save the schedule as", first, "Schedule files (*.toml)", self.save)

    def begin_copy(self, text: str) -> None:
        """Take a text as that of a new schedule, for the next sample."""

        def copy() -> None:
            self._path, self._saved = None, ""
            self._text.setPlainText(text)
            self._take_text()
            self.form.fields["samples"].setFocus()
            self.reported.emit("A copy of the schedule. Enter the next sample, then save it.", False)

        self.leave(copy)

    def save(self, path: Path | None = None) -> None:
        """Write the text to its file, or to another one, which is then opened. Without a file one is asked for."""
        path = path or self._path
        if self.form.refusal:
            self.reported.emit(f"Not saved: {self.form.refusal}", True)
            return
        if path is None or path.is_relative_to(EXAMPLES):
            self._ask_copy()
            return
        text = self.text
        try:
            write_file(path, text.replace("\n", self._line_end).encode())
        except (UserError, OSError) as error:
            self.reported.emit(str(error), True)
            return
        self._path, self._saved = path, text
        self._take_text()
        self.saved.emit(path)
