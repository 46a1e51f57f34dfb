"""The run screen: the hemisphere, the cut with prediction and residual, and the latest events below them."""

from typing import TYPE_CHECKING, Literal

from PySide6.QtCore import Qt, Signal, Slot
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QComboBox, QHBoxLayout, QLabel, QSlider, QSplitter, QVBoxLayout, QWidget

from goniotwin.app.desktop.events.panels import EventModel, EventTable
from goniotwin.app.desktop.screen import Screen
from goniotwin.app.desktop.theme import Colours

if TYPE_CHECKING:  # pyqtgraph is loaded after the window has been shown
    from goniotwin.app.desktop.run.hemisphere import HemisphereMap
    from goniotwin.app.desktop.run.live_plot import ScanPlot

PLOT_HEIGHT, EVENTS_HEIGHT = 400, 130
"""Heights of plot and events at the start."""
LEAST_PLOT, LEAST_EVENTS = 140, 60
LOW = 280
"""Height in logical pixels below which the events give their room to the plot."""
NARROW = 560
"""Width below which the hemisphere gives its room to the plot."""
MAP_WIDTH, LEAST_MAP = 320, 170
PLANE_STEP_DEG = 5
SCALE_NAMES: tuple[Literal["log", "linear", "symlog"], ...] = ("log", "linear", "symlog")
SCAN_IN_PROGRESS = "scan in progress"


class RunScreen(Screen):
    """Hemisphere and cut, made when the window has been shown; and the latest events."""

    title = "Run"
    icon = "play-circle-outline"

    plane_chosen = Signal(object)
    """Azimuth about the specular direction of the plane to show, deg; None is the scan in progress."""

    def __init__(self, colours: Colours) -> None:
        super().__init__(colours)
        self._plot: ScanPlot | None = None
        self._map: HemisphereMap | None = None
        self._events: EventTable | None = None
        self._error = QLabel()
        self._error.setWordWrap(True)
        self._error.setAccessibleName("Error of the plot")
        self.plane = QSlider(Qt.Orientation.Horizontal)
        self.plane.setAccessibleName("Plane through the specular direction")
        self.plane.setToolTip("Left end: the scan in progress; then planes through the specular direction, in steps of 5°")
        self.plane.setRange(0, 180 // PLANE_STEP_DEG)
        self.plane.setPageStep(6)
        self.plane.setMinimumWidth(80)
        self.plane.setMaximumWidth(300)
        self._plane_text = QLabel(SCAN_IN_PROGRESS)
        self._plane_text.setAccessibleName("Plane that is shown")
        self._plane_label = QLabel("Pla&ne")
        self._plane_label.setBuddy(self.plane)
        self.scale = QComboBox()
        self.scale.addItems(SCALE_NAMES)
        self.scale.setAccessibleName("Scale of the values")
        self.scale.setToolTip("Scale of the values")
        self._scale_label = QLabel("Scal&e")
        self._scale_label.setBuddy(self.scale)
        self._place = QWidget()
        self._place.setMinimumHeight(LEAST_PLOT)
        controls = QHBoxLayout()
        for each in (self._plane_label, self.plane, self._plane_text):
            controls.addWidget(each)
        controls.setStretch(1, 1)
        controls.addStretch(1)
        controls.addWidget(self._scale_label)
        controls.addWidget(self.scale)
        place = QVBoxLayout(self._place)
        place.setContentsMargins(0, 0, 0, 0)
        place.setSpacing(3)
        place.addLayout(controls)
        self.plots = QSplitter(Qt.Orientation.Horizontal)
        self.plots.setChildrenCollapsible(False)
        self.plots.setAccessibleName("Hemisphere and cut")
        place.addWidget(self.plots, 1)
        place.addWidget(self._error)
        self.splitter = QSplitter(Qt.Orientation.Vertical)
        self.splitter.setAccessibleName("Plot and events")
        self.splitter.addWidget(self._place)
        self.splitter.setChildrenCollapsible(False)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.splitter)
        self.plane.valueChanged.connect(self._choose_plane)
        self.scale.currentTextChanged.connect(self._choose_scale)
        self.show_error("")

    def set_events(self, model: EventModel) -> None:
        """Show the events of a log below the plot."""
        self._events = EventTable(model, "Latest events")
        self._events.setMinimumHeight(LEAST_EVENTS)
        self.splitter.addWidget(self._events)
        self.splitter.setStretchFactor(0, 3)
        self.splitter.setStretchFactor(1, 1)
        self.splitter.setSizes([PLOT_HEIGHT, EVENTS_HEIGHT])

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Leave the room to the plot where there is little; Qt calls it."""
        super().resizeEvent(event)
        if self._events is not None:
            self._events.setVisible(self.height() >= LOW)
        if self._map is not None:
            self._map.setVisible(self.width() >= NARROW)
        self._plane_text.setVisible(self.width() >= NARROW)

    def complete(self) -> None:
        """Make the plots."""
        # These load pyqtgraph, which the window's first picture does without.
        from goniotwin.app.desktop.run.hemisphere import HemisphereMap
        from goniotwin.app.desktop.run.live_plot import ScanPlot

        self._map = HemisphereMap(self._colours)
        self._map.setMinimumWidth(LEAST_MAP)
        self._plot = ScanPlot(self._colours)
        self.plots.addWidget(self._map)
        self.plots.addWidget(self._plot)
        self.plots.setStretchFactor(0, 2)
        self.plots.setStretchFactor(1, 3)
        self.plots.setSizes([MAP_WIDTH, 2 * MAP_WIDTH])
        self._map.setVisible(self.width() >= NARROW)

    @property
    def plot(self) -> "ScanPlot":
        """The plot; not before `complete`."""
        assert self._plot is not None
        return self._plot

    @property
    def hemisphere(self) -> "HemisphereMap":
        """The hemisphere; not before `complete`."""
        assert self._map is not None
        return self._map

    @property
    def error(self) -> str:
        """The error of the plot; empty without one."""
        return self._error.text()

    def show_error(self, text: str) -> None:
        """Show an error of the plot; hide it if empty."""
        self._error.setText(text)
        self._error.setVisible(bool(text))

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        super().set_colours(colours)
        self._error.setStyleSheet(f"color: {colours.bad}")
        for each in (self._plot, self._map):
            if each is not None:
                each.set_colours(colours)

    @Slot(int)
    def _choose_plane(self, step: int) -> None:
        phi_deg = None if step == 0 else float((step - 1) * PLANE_STEP_DEG)
        self._plane_text.setText(SCAN_IN_PROGRESS if phi_deg is None else f"through specular, φ {phi_deg:g}°")
        self.plane_chosen.emit(phi_deg)

    @Slot(str)
    def _choose_scale(self, name: str) -> None:
        if self._plot is not None:
            self._plot.set_scale(next(each for each in SCALE_NAMES if each == name))
