"""The results screen: a campaign or a file, the choice of a light, its hemisphere and its cut, and the value at the cursor."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QSize, Qt, Signal, Slot
from PySide6.QtWidgets import QComboBox, QGridLayout, QHBoxLayout, QLabel, QSplitter, QVBoxLayout

from goniotwin.app.desktop import model
from goniotwin.app.desktop.dialogs import FileDialog
from goniotwin.app.desktop.screen import Screen, WithoutPreferredHeight
from goniotwin.app.desktop.theme import Colours

if TYPE_CHECKING:  # numpy, the reduction and pyqtgraph are loaded after the window has been shown
    from goniotwin.app.desktop.model.results import Light, Opened, ResultsReader, Shown
    from goniotwin.app.desktop.results.panels import ResultCut, ResultMap

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
SYMBOLS = {"sigma_deg": "σ", "psi_deg": "ψ"}
AT_CURSOR = ("Value at the cursor", "Direction at the cursor", "Largest components of the uncertainty")
NARROW, LOW = 640, 300
"""Size of a room below which the choices have two lines and the map is omitted, and of a value only its first line is shown."""
LEAST_PLOT = 130, 110


class ResultsScreen(Screen):
    """The file and the choices at the top, the hemisphere beside the cut, the value at the cursor below."""

    title = "Results"
    icon = "chart-bell-curve"

    _answered = Signal(object)
    """What the worker delivers; emitted in a thread."""

    def __init__(self, colours: Colours) -> None:
        super().__init__(colours)
        self.lights: tuple[Light, ...] = ()
        self.light: Light | None = None
        self.shown: Shown | None = None
        self.index = 0
        self._reader: ResultsReader | None = None
        self.pictures: tuple[ResultMap, ResultCut] | None = None
        """Of the first values on."""
        self._path: Path | None = None
        self._folder = Path.home()
        self._is_error, self._low, self._narrow, self._about = False, False, False, ""
        self.open_button = self._button("Open f&ile…", "Open a journal or a file of values", self._choose_file)
        self.again_button = self._button("Rea&d again", "Read the file again, as a campaign grows", self._again)
        self._mark = QLabel("SIMULATED")
        self._mark.setAccessibleName("SIMULATED: the values of this file are not measured")
        self.heading = QLabel()
        self.heading.setWordWrap(True)
        self.heading.setTextFormat(Qt.TextFormat.PlainText)
        self.heading.setAccessibleName("The file that is shown")
        head = QHBoxLayout()
        for part in (self.open_button, self.again_button, self._mark, self.heading):
            head.addWidget(part, 1 if part is self.heading else 0)
        self.choices = {field: QComboBox() for field in FIELDS}
        self.only = {field: QLabel() for field in FIELDS}
        self._grid = QGridLayout()
        for field, name in FIELDS.items():
            self.choices[field].activated.connect(lambda at, field=field: self._choose(field, at))
            self.choices[field].setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToContents)
            for each in (self.choices[field], self.only[field]):
                each.setAccessibleName(name)
                each.setToolTip(name)
        self.plots = QSplitter(Qt.Orientation.Horizontal)
        self.plots.setChildrenCollapsible(False)
        self.plots.setAccessibleName("Hemisphere and cut of the results")
        self.texts = tuple(QLabel() for _ in AT_CURSOR)
        whole = WithoutPreferredHeight()
        layout = QVBoxLayout(whole)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(4)
        layout.addLayout(head)
        layout.addLayout(self._grid)
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

    def _make_pictures(self) -> "tuple[ResultMap, ResultCut]":
        """Make the pictures of the first values."""
        # These load pyqtgraph, which the window's first picture does without.
        from goniotwin.app.desktop.results.panels import ResultCut, ResultMap

        disc, cut = ResultMap(self._colours), ResultCut(self._colours)
        for at, each in enumerate((disc, cut)):
            each.setMinimumSize(*LEAST_PLOT)
            self.plots.addWidget(each)
            self.plots.setStretchFactor(at, 2 + at)
        for before, after in pairwise((self.choices["psi_deg"], disc.keys.view, cut.keys.view)):
            self.setTabOrder(before, after)
        disc.keys.pressed.connect(lambda right, up: self._move(lambda shown: shown.towards(self.index, right, up)))
        disc.keys.clicked.connect(lambda x, y: self._move(lambda shown: shown.nearest(x, y)))
        cut.keys.pressed.connect(lambda right, _up: self._move(lambda shown: shown.along_plane(self.index, right)))
        cut.keys.clicked.connect(lambda x, _y: self._move(lambda shown: shown.in_plane_at(self.index, x)))
        disc.setHidden(self._narrow)
        return disc, cut

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
        for at, field in enumerate(FIELDS):
            row, column = divmod(at, 3 if room.width() < NARROW else len(FIELDS))
            for each in (self.choices[field], self.only[field]):
                self._grid.addWidget(each, row, column)
        self._grid.setColumnStretch(len(FIELDS), 1)
        self._low, self._narrow = room.height() < LOW, room.width() < NARROW
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
                self.light = None
            self._path = path
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
        self._show_texts()
        self.set_colours(self._colours)

    @Slot(object)
    def _take(self, delivered: object) -> None:
        answer = None if self._reader is None else self._reader.take(delivered)
        if isinstance(answer, model.Opened):
            self._show_opened(answer)
        elif isinstance(answer, model.Shown) and answer.light == self.light:
            self._show_values(answer)
        elif isinstance(answer, model.ResultsFailed):
            self._clear(answer.reason, error=True, choices=not self.lights)

    # The light.

    def _show_opened(self, opened: "Opened") -> None:
        self.lights = opened.lights
        self._about = f"{opened.name}: {opened.about}"
        self.heading.setText(self._about)
        self.heading.setToolTip("\n".join(opened.notes))
        self._mark.setVisible(opened.simulated)
        of, before = self.lights, self.light
        self._show_light(model.first_light(of) if before is None else model.nearest_light(of, before, "sample", before.sample))

    def _choose(self, field: str, at: int) -> None:
        if self.light is not None:
            self._show_light(model.nearest_light(self.lights, self.light, field, self._values(field)[at]))

    def _show_light(self, light: "Light") -> None:
        self.light = light
        self._show_choices()
        if self._reader is not None:
            self._reader.show(light)

    def _values(self, field: str) -> list[str | float]:
        """What there is to choose of a field."""
        return list(dict.fromkeys(getattr(each, field) for each in self.lights))

    def _show_choices(self) -> None:
        for field in FIELDS:
            values, choice, only = self._values(field), self.choices[field], self.only[field]
            texts = [_choice_text(field, each) for each in values]
            if [choice.itemText(at) for at in range(choice.count())] != texts:
                choice.clear()
                choice.addItems(texts)
            if self.light is not None and values:
                choice.setCurrentIndex(values.index(getattr(self.light, field)))
            only.setText(texts[0] if len(texts) == 1 else "")
            only.setVisible(len(texts) == 1)
            choice.setVisible(len(texts) > 1)

    # The values.

    def _show_values(self, shown: "Shown") -> None:
        self.pictures = self.pictures or self._make_pictures()
        before, self.shown = self.shown, shown
        if self._is_error:
            self._is_error = False
            self.heading.setText(self._about)
            self.set_colours(self._colours)
        for each in self.pictures:
            each.show_values(shown)
        self.plots.show()
        same = before is not None and before.light._replace(sample=shown.light.sample, colour=shown.light.colour) == shown.light
        self.index = shown.highest if before is None or not same else shown.nearest(*before.place(self.index))
        self._move(lambda _: self.index)

    def _move(self, to: "Callable[[Shown], int]") -> None:
        """Move the cursor to another value."""
        if self.shown is not None:
            self.index = to(self.shown)
            for each in self.pictures or ():
                each.set_cursor(self.shown, self.index)
            self._show_texts()

    def _show_texts(self) -> None:
        texts = ("",) * len(self.texts) if self.shown is None else model.value_texts(self.shown, self.index)
        for at, (label, text) in enumerate(zip(self.texts, texts, strict=True)):
            label.setText(text)
            label.setToolTip("\n".join(texts))
            label.setVisible(bool(text) and (at == 0 or not self._low))


def _choice_text(field: str, value: str | float) -> str:
    return f"{SYMBOLS[field]} {value:g}°" if field in SYMBOLS else str(value)
