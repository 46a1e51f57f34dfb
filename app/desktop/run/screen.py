"""The run screen: the plot of the scan in progress, and the latest events below it."""

from typing import TYPE_CHECKING

from PySide6.QtCore import Qt
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QLabel, QSplitter, QVBoxLayout, QWidget

from goniotwin.app.desktop.events.panels import EventModel, EventTable
from goniotwin.app.desktop.screen import Screen
from goniotwin.app.desktop.theme import Colours

if TYPE_CHECKING:  # pyqtgraph is loaded after the window has been shown
    from goniotwin.app.desktop.run.live_plot import ScanPlot

PLOT_HEIGHT, EVENTS_HEIGHT = 400, 130
"""Heights of plot and events at the start."""
LEAST_PLOT, LEAST_EVENTS = 140, 60
LOW = 280
"""Height in logical pixels below which the events give their room to the plot."""


class RunScreen(Screen):
    """The plot, made when the window has been shown; and the latest events."""

    title = "Run"
    icon = "play-circle-outline"

    def __init__(self, colours: Colours) -> None:
        super().__init__(colours)
        self._plot: ScanPlot | None = None
        self._events: EventTable | None = None
        self._error = QLabel()
        self._error.setWordWrap(True)
        self._error.setAccessibleName("Error of the plot")
        self._place = QWidget()
        self._place.setMinimumHeight(LEAST_PLOT)
        place = QVBoxLayout(self._place)
        place.setContentsMargins(0, 0, 0, 0)
        place.addWidget(self._error)
        self.splitter = QSplitter(Qt.Orientation.Vertical)
        self.splitter.setAccessibleName("Plot and events")
        self.splitter.addWidget(self._place)
        self.splitter.setChildrenCollapsible(False)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self.splitter)
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

    def complete(self) -> None:
        """Make the plot."""
        from goniotwin.app.desktop.run.live_plot import ScanPlot

        self._plot = ScanPlot(self._colours)
        layout = self._place.layout()
        assert isinstance(layout, QVBoxLayout)
        layout.insertWidget(0, self._plot, 1)

    @property
    def plot(self) -> "ScanPlot":
        """The plot; not before `complete`."""
        assert self._plot is not None
        return self._plot

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
        if self._plot is not None:
            self._plot.set_colours(colours)
