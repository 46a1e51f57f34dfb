"""The results screen: a campaign or a file, the choice of a light, its hemisphere beside a cut, and the value at the cursor."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QSize, Qt, Signal, Slot
from PySide6.QtGui import QStandardItemModel
from PySide6.QtWidgets import QComboBox, QHBoxLayout, QLabel, QSplitter, QStackedWidget, QVBoxLayout

from goniotwin.app.desktop import model
from goniotwin.app.desktop.dialogs import FileDialog, TextBox
from goniotwin.app.desktop.screen import Screen, WithoutPreferredHeight
from goniotwin.app.desktop.theme import Colours

if TYPE_CHECKING:  # numpy, the reduction and pyqtgraph are loaded after the window has been shown
    from goniotwin.app.data.results import Light, Picture, Shown, View
    from goniotwin.app.desktop.model.results import Checked, Opened, ResultsReader
    from goniotwin.app.desktop.results.lobe import LobeView
    from goniotwin.app.desktop.results.panels import ResultMap, ResultPlot

NOTHING = "Choose a campaign on the screen Campaigns, or open a file."
FIELDS = {
    "sample": "Sample",
    "colour": "Wavelength or channel",
    "side": "Lit side",
    "direction": "Reflected or transmitted",
    "sigma_deg": "Incidence sigma",
    "psi_deg": "Azimuth of the light psi",
}
"""The fields of a light that can be chosen, with their names."""
PICTURES: "dict[Picture, str]" = {
    "plane": "Plane of incidence",
    "cursor": "Plane through the cursor",
    "polar": "Polar diagram",
    "spectrum": "Spectrum at the cursor",
    "lobe": "Lobe in space",
}
AT_THE_CURSOR = ("cursor", "spectrum")
"""Pictures that follow the cursor."""
COMPARISONS = ("Compare with …", "Theory of the virtual sample", "Prediction of the twin", "Another file …")
SYMBOLS = {"sigma_deg": "σ", "psi_deg": "ψ"}
AT_CURSOR = ("Value at the cursor", "Direction at the cursor", "Largest components of the uncertainty")
NARROW, LOW = 640, 300
"""Size of a room below which the choices have two lines and the map is omitted, and of a value only its first line is shown."""
LEAST_PLOT = 130, 110


class ResultsScreen(Screen):
    """The file and the choices at the top, the hemisphere beside the cut, the value at the cursor below."""

    title = "Results"
    icon = "chart-bell-curve"

    export_wanted = Signal(object)
    report_wanted = Signal(object)
    """The journal to export, or to write the report of."""
    _answered = Signal(object)
    """What the worker delivers; emitted in a thread."""

    def __init__(self, colours: Colours) -> None:
        super().__init__(colours)
        self.lights: tuple[Light, ...] = ()
        self.wanted: View | None = None
        self.checked: Checked | None = None
        self.shown: Shown | None = None
        self.index = 0
        self._reader: ResultsReader | None = None
        self._asked = False
        self.pictures: tuple[ResultMap, ResultPlot, LobeView] | None = None
        """Of the first values on."""
        self._path: Path | None = None
        self._folder = Path.home()
        self._is_error, self._low, self._narrow, self._about, self._is_journal = False, False, False, "", False
        self.open_button = self._button("Open f&ile…", "Open a journal or a file of values", self._choose_file)
        self.again_button = self._button("Rea&d again", "Read the file again, as a campaign grows", self._again)
        self._mark = QLabel("SIMULATED")
        self._mark.setAccessibleName("SIMULATED: the values of this file are not measured")
        self.heading = QLabel()
        self.heading.setWordWrap(True)
        self.heading.setTextFormat(Qt.TextFormat.PlainText)
        self.heading.setAccessibleName("The file that is shown")
        head, self._light_row = QHBoxLayout(), QHBoxLayout()
        self._head = head
        self.check_button = self._button("Chec&ks", "The verdicts on the campaign, with what to do", self._show_checks)
        self.export_button = self._button(
            "E&xport…", "Export this campaign to a file", lambda: self.export_wanted.emit(self._path)
        )
        self.report_button = self._button(
            "Rep&ort…", "Write the report of this campaign", lambda: self.report_wanted.emit(self._path)
        )
        buttons = (self.open_button, self.again_button, self.check_button, self.export_button, self.report_button)
        for part in buttons:
            head.addWidget(part)
        self.picture, self.comparison = QComboBox(), QComboBox()
        self.picture.addItems(list(PICTURES.values()))
        self.comparison.addItems(COMPARISONS)
        for choice, name, chosen in (
            (self.picture, "What is shown beside the hemisphere", self._choose_picture),
            (self.comparison, "What the values are compared with", self._choose_comparison),
        ):
            choice.setAccessibleName(name)
            choice.setToolTip(name)
            choice.activated.connect(chosen)
            choice.setMinimumContentsLength(12)
            choice.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
        self.choices = {field: QComboBox() for field in FIELDS}
        self.only = QLabel()
        self.only.setAccessibleName("What all values have in common")
        self._light_row.addWidget(self.only)
        for field, name in FIELDS.items():
            self.choices[field].activated.connect(lambda at, field=field: self._choose(field, at))
            self.choices[field].setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToContents)
            self.choices[field].setAccessibleName(name)
            self.choices[field].setToolTip(name)
            self._light_row.addWidget(self.choices[field])
        for each in (self.picture, self.comparison):
            self._light_row.addWidget(each)
        self.plots = QSplitter(Qt.Orientation.Horizontal)
        self.plots.setChildrenCollapsible(False)
        self.plots.setAccessibleName("Hemisphere and cut of the results")
        self.texts = tuple(QLabel() for _ in AT_CURSOR)
        whole = WithoutPreferredHeight()
        layout = QVBoxLayout(whole)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(4)
        layout.addLayout(head)
        layout.addLayout(self._light_row)
        layout.addWidget(self.plots, 1)
        layout.addStretch(0)
        for label, name in zip(self.texts, AT_CURSOR, strict=True):
            label.setWordWrap(True)
            label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            label.setAccessibleName(name)
            layout.addWidget(label)
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        outer.addWidget(whole)
        self._answered.connect(self._take, Qt.ConnectionType.QueuedConnection)
        self.set_colours(colours)
        self._clear(NOTHING)
        self.fit(QSize(NARROW, LOW))

    def complete(self) -> None:
        """Make what opens files."""
        self._reader = model.ResultsReader(self._answered.emit)
        self.open_button.setEnabled(True)

    def _make_pictures(self) -> "tuple[ResultMap, ResultPlot, LobeView]":
        """Make the pictures of the first values."""
        # These load pyqtgraph, which the window's first picture does without.
        from goniotwin.app.desktop.results.lobe import LobeView
        from goniotwin.app.desktop.results.panels import ResultMap, ResultPlot

        disc, plot, lobe = ResultMap(self._colours), ResultPlot(self._colours), LobeView(self._colours)
        beside = QStackedWidget()
        for each in (plot, lobe):
            beside.addWidget(each)
        for at, part in enumerate((disc, beside)):
            part.setMinimumSize(*LEAST_PLOT)
            self.plots.addWidget(part)
            self.plots.setStretchFactor(at, 2 + at)
        for before, after in pairwise((self.comparison, disc.keys.view, plot.keys.view, lobe)):
            self.setTabOrder(before, after)
        disc.keys.pressed.connect(lambda right, up: self._move(lambda shown: shown.towards(self.index, right, up)))
        disc.keys.clicked.connect(lambda x, y: self._move(lambda shown: shown.nearest(x, y)))
        plot.keys.pressed.connect(lambda right, _up: self._move(lambda shown: shown.along_plane(self.index, right), along=True))
        plot.keys.clicked.connect(lambda x, _y: self._move(lambda shown: shown.in_plane_at(self.index, x), along=True))
        disc.setHidden(self._narrow)
        return disc, plot, lobe

    def begin(self) -> None:
        """Start what opens files, as a person looks for one."""
        if self._reader is not None:
            self._reader.begin()

    def set_folder(self, folder: Path) -> None:
        """Take the folder in which a file is looked for first."""
        self._folder = folder

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        super().set_colours(colours)
        self._mark.setStyleSheet(
            f"background: {colours.simulated}; color: {colours.on_simulated}; font-weight: bold; padding: 1px 6px"
        )
        self.heading.setStyleSheet(f"color: {colours.bad}" if self._is_error else "")
        self.texts[0].setStyleSheet("font-weight: bold")
        for part in self.pictures or ():
            part.set_colours(colours)

    def fit(self, room: QSize) -> None:
        """Take less room for the choices, the map and the value where there is little."""
        self._low, self._narrow = room.height() < LOW, room.width() < NARROW
        (self._light_row if self._narrow else self._head).addWidget(self._mark)
        self._head.removeWidget(self.heading)
        self._head.addWidget(self.heading, 1)
        self.only.setHidden(self._narrow)
        if self.pictures is not None:
            self.pictures[0].setHidden(self._narrow)
        self._show_texts()

    def shut_down(self) -> None:
        """End the worker."""
        if self._reader is not None:
            self._reader.close()

    # The file.

    def open_file(self, path: Path) -> None:
        """Open a journal or a file; return at once."""
        if self._reader is not None:
            self._clear(f"Reading {path.name} …")
            if path != self._path:
                self.wanted = None
                self.picture.setCurrentIndex(0)
                self.comparison.setCurrentIndex(0)
            self._path, self.checked, self._is_journal = path, None, False
            self.again_button.setEnabled(True)
            self._reader.open(path)

    def _choose_file(self) -> None:
        first = self._folder if self._path is None else self._path.parent
        FileDialog(self, "Open a journal or a file of values", first, "All files (*)", self.open_file)

    def _again(self) -> None:
        if self._path is not None:
            self.open_file(self._path)

    def _clear(self, text: str, *, error: bool = False, choices: bool = True) -> None:
        """Show a text in place of values; without `choices` these stay."""
        self.shown, self._is_error = None, error
        self.heading.setText(f"✗ {text}" if error else text)
        self.heading.setToolTip("")
        if choices:
            self.lights = ()
            self._mark.hide()
            self._show_choices()
        self.open_button.setEnabled(self._reader is not None)
        self.again_button.setEnabled(self._path is not None)
        self.plots.hide()
        self._show_buttons()
        self._show_texts()
        self.set_colours(self._colours)

    def _show_about(self, more: str = "") -> None:
        """Show what the file is, and what its checks are."""
        checks = "" if self.checked is None else self.checked.summary
        self.heading.setText("; ".join(filter(None, (self._about, checks, more))))

    def _show_buttons(self) -> None:
        """Allow what is possible with the file that is open."""
        for each in (self.check_button, self.export_button, self.report_button):
            each.setEnabled(self._is_journal)
        for choice in (self.picture, self.comparison):
            choice.setVisible(bool(self.lights))
        self.check_button.setToolTip("" if self.checked is None else self.checked.summary)

    def _show_checks(self) -> None:
        """Show the verdicts, or ask for them."""
        if self.checked is not None:
            TextBox(self.window(), "Checks of the campaign", self.checked.html).show()
        elif self._reader is not None:
            self.check_button.setEnabled(False)
            self.check_button.setToolTip("The checks are being computed …")
            self._asked = True
            self._reader.check()

    @Slot(object)
    def _take(self, delivered: object) -> None:
        answer = None if self._reader is None else self._reader.take(delivered)
        if isinstance(answer, model.Opened):
            self._show_opened(answer)
        elif isinstance(answer, model.Answered) and answer.shown.view == self.wanted:
            self._show_values(answer.shown)
        elif isinstance(answer, model.Checked):
            self.checked = answer
            self._show_about()
            self._show_buttons()
            if self._asked:
                self._asked = False
                self._show_checks()
        elif isinstance(answer, model.ResultsFailed):
            self._clear(answer.reason, error=True, choices=not self.lights)

    # The view.

    def _show_opened(self, opened: "Opened") -> None:
        self.lights = opened.lights
        self._is_journal = opened.journal and opened.whole
        self._about = f"{opened.name}: {opened.about}"
        self._show_about()
        self.heading.setToolTip("\n".join(opened.notes))
        self._mark.setVisible(opened.simulated)
        entries = self.comparison.model()
        assert isinstance(entries, QStandardItemModel)
        for at in (1, 2):
            entries.item(at).setEnabled(self._is_journal and opened.simulated)
        self._show_buttons()
        of, before = self.lights, self.wanted
        if before is None:
            self._show(model.View(model.first_light(of)))
        else:
            self._show(before._replace(light=model.nearest_light(of, before.light, "sample", before.light.sample)))
        if opened.check and self._reader is not None:
            self._reader.check()

    def _choose(self, field: str, at: int) -> None:
        if self.wanted is not None:
            light = model.nearest_light(self.lights, self.wanted.light, field, self._values(field)[at])
            self._show(self.wanted._replace(light=light))

    def _choose_picture(self, at: int) -> None:
        if self.wanted is not None:
            self._show(self.wanted._replace(picture=list(PICTURES)[at]))

    def _choose_comparison(self, at: int) -> None:
        if self.wanted is None:
            return
        if at < len(COMPARISONS) - 1:
            self._show_about("comparing …" if at else "")
            self._show(self.wanted._replace(other=(None, model.THEORY, model.PREDICTION)[at]))
            return

        def chosen(path: Path) -> None:
            if self.wanted is not None:
                self._show(self.wanted._replace(other=path))

        def cancelled() -> None:
            others = (None, model.THEORY, model.PREDICTION)
            shown = None if self.wanted is None else self.wanted.other
            self.comparison.setCurrentIndex(others.index(shown) if shown in others else len(others))

        FileDialog(self, "Compare with a journal or a file of values", self._folder, "All files (*)", chosen).rejected.connect(
            cancelled
        )

    def _show(self, view: "View") -> None:
        """Ask for a view, with the cursor where it is."""
        self.wanted = view if self.shown is None else view._replace(cursor=self.shown.place(self.index))
        self._show_choices()
        if self._reader is not None:
            self._reader.show(self.wanted)

    def _values(self, field: str) -> list[str | float]:
        """What there is to choose of a field."""
        return list(dict.fromkeys(getattr(each, field) for each in self.lights))

    def _show_choices(self) -> None:
        single: list[str] = []
        for field in FIELDS:
            values, choice = self._values(field), self.choices[field]
            texts = [_choice_text(field, each) for each in values]
            if [choice.itemText(at) for at in range(choice.count())] != texts:
                choice.clear()
                choice.addItems(texts)
            if self.wanted is not None and values:
                choice.setCurrentIndex(values.index(getattr(self.wanted.light, field)))
            choice.setVisible(len(texts) > 1)
            single += texts if len(texts) == 1 else []
        self.only.setText(", ".join(single))

    # The values.

    def _show_values(self, shown: "Shown") -> None:
        self.pictures = self.pictures or self._make_pictures()
        before, self.shown = self.shown, shown
        if self._is_error:
            self._is_error = False
            self.set_colours(self._colours)
        self._show_about()
        for each in self.pictures:
            each.show_values(shown)
        beside = self.plots.widget(1)
        assert isinstance(beside, QStackedWidget)
        beside.setCurrentIndex(int(shown.view.picture == "lobe"))
        self.plots.show()
        self.index = (
            shown.highest if before is None or not _alike(before.view.light, shown.view.light) else self._kept(before, shown)
        )
        for each in self.pictures[:2]:
            each.set_cursor(shown, self.index)
        self._show_texts()

    def _kept(self, before: "Shown", shown: "Shown") -> int:
        """The index of the value at the cursor in what is shown now."""
        return shown.nearest(*before.place(self.index))

    def _move(self, to: "Callable[[Shown], int]", *, along: bool = False) -> None:
        """Move the cursor to another value; a picture that follows it is made anew, but for a move along its own plane."""
        if self.shown is None:
            return
        self.index = to(self.shown)
        for each in (self.pictures or ())[:2]:
            each.set_cursor(self.shown, self.index)
        self._show_texts()
        if self.wanted is not None and self.wanted.picture in AT_THE_CURSOR and not along:
            self._show(self.wanted)

    def _show_texts(self) -> None:
        self.heading.setHidden(self._narrow and self.shown is not None)  # where there is room for an error or for values
        texts = ("",) * len(self.texts) if self.shown is None else model.value_texts(self.shown, self.index)
        for at, (label, text) in enumerate(zip(self.texts, texts, strict=True)):
            label.setText(text)
            label.setToolTip("\n".join(texts))
            label.setVisible(bool(text) and (at == 0 or not self._low))


def _alike(one: "Light", other: "Light") -> bool:
    """Whether two lights have the same directions: they differ by sample and wavelength at most."""
    return one._replace(sample=other.sample, colour=other.colour) == other


def _choice_text(field: str, value: str | float) -> str:
    return f"{SYMBOLS[field]} {value:g}°" if field in SYMBOLS else str(value)
