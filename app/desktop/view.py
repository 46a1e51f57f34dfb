"""The contents of the window: all panels and their places, the banner of a simulated rig, the lines of text at the bottom."""

from itertools import pairwise
from pathlib import Path

from PySide6.QtCore import Qt, Slot
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QScrollArea, QSplitter, QVBoxLayout, QWidget

from goniotwin.app.desktop.events.panels import EventLog, OrdersPanel, QuestionBar
from goniotwin.app.desktop.rig.panels import AxesPanel, DevicesPanel
from goniotwin.app.desktop.run.live_plot import ScanPlot
from goniotwin.app.desktop.run.panel import RunPanel
from goniotwin.app.desktop.setup.panels import RigPanel, SchedulePanel
from goniotwin.app.desktop.theme import Colours

LEFT_WIDTH = 330
PLOT_HEIGHT, LOG_HEIGHT = 360, 190
"""Heights of plot and log at the start."""


class MainView(QWidget):
    """The contents of the window. It only shows."""

    def __init__(self, colours: Colours, folder: Path, speed: float) -> None:
        super().__init__()
        self._colours = colours
        self._status_is_error = False
        self._banner = QLabel()
        self._banner.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.orders = OrdersPanel(colours)
        self.question = QuestionBar(colours)
        self.log = EventLog(colours)
        self.rig = RigPanel()
        self.devices = DevicesPanel(colours)
        self.axes = AxesPanel()
        self.schedule = SchedulePanel(folder)
        self.run = RunPanel(speed, colours)
        self.plot = ScanPlot(colours)
        self._status = _text_label("Status")
        self._saved = _text_label("Journal")
        self._plot_error = _text_label("Error of the plot")
        self._lay_out()
        self.set_colours(colours)
        self.set_simulated(False, None)
        self.set_plot_error("")
        self.set_saved("")

    @property
    def status(self) -> str:
        """The status line."""
        return self._status.text()

    @property
    def banner(self) -> str:
        """The banner across the top; empty for a real rig."""
        return "" if self._banner.isHidden() else self._banner.text()

    @property
    def saved(self) -> str:
        """The line with the path of the journal."""
        return self._saved.text()

    @property
    def plot_error(self) -> str:
        """The error of the plot; empty without one."""
        return self._plot_error.text()

    def show_status(self, text: str, *, error: bool = False) -> None:
        """Show the status line."""
        self._status_is_error = error
        self._status.setText(f"✗ {text}" if error else text)
        self._colour_texts()

    def set_simulated(self, simulated: bool, seed: int | None) -> None:
        """Show or hide the banner of a simulated rig."""
        self._banner.setVisible(simulated)
        self._banner.setText(f"SIMULATED  ·  seed {seed}  ·  not a real measurement")
        self._banner.setAccessibleName(self._banner.text())

    def set_saved(self, text: str) -> None:
        """Show the line with the path of the journal."""
        self._saved.setText(text)
        self._saved.setVisible(bool(text))

    @Slot(str)
    def set_plot_error(self, text: str) -> None:
        """Show an error of the plot; hide it if empty."""
        self._plot_error.setText(text)
        self._plot_error.setVisible(bool(text))

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        self._banner.setStyleSheet(
            f"background: {colours.simulated}; color: {colours.on_simulated}; font-weight: bold; padding: 4px"
        )
        self.orders.set_colours(colours)
        self.question.set_colours(colours)
        self.log.set_colours(colours)
        self.devices.set_colours(colours)
        self.run.set_colours(colours)
        self.plot.set_colours(colours)
        self._colour_texts()

    def _colour_texts(self) -> None:
        self._status.setStyleSheet(f"color: {self._colours.bad}; font-weight: bold" if self._status_is_error else "")
        self._plot_error.setStyleSheet(f"color: {self._colours.bad}")
        self._saved.setStyleSheet(f"color: {self._colours.dim}")

    def _lay_out(self) -> None:
        left = QWidget()
        column = QVBoxLayout(left)
        column.setContentsMargins(0, 0, 4, 0)
        for panel in (self.rig, self.schedule, self.axes, self.devices):
            column.addWidget(panel)
        column.addStretch(1)
        scroll = QScrollArea()
        scroll.setWidget(left)
        scroll.setWidgetResizable(True)
        scroll.setFrameShape(QFrame.Shape.NoFrame)
        scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        scroll.setFixedWidth(LEFT_WIDTH)
        scroll.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        right = QVBoxLayout()
        right.setSpacing(6)
        middle = QSplitter(Qt.Orientation.Vertical)
        middle.addWidget(self.plot)
        middle.addWidget(self.log)
        self.plot.setMinimumHeight(220)
        self.log.setMinimumHeight(90)
        middle.setSizes([PLOT_HEIGHT, LOG_HEIGHT])
        middle.setStretchFactor(0, 2)
        middle.setStretchFactor(1, 1)
        middle.setChildrenCollapsible(False)
        right.addWidget(middle, 1)
        for each in (self._plot_error, self.run, self._status, self._saved):
            right.addWidget(each)
        body = QHBoxLayout()
        body.setContentsMargins(10, 6, 10, 8)
        body.setSpacing(10)
        body.addWidget(scroll)
        body.addLayout(right, 1)
        whole = QVBoxLayout(self)
        whole.setContentsMargins(0, 0, 0, 0)
        whole.setSpacing(0)
        whole.addWidget(self._banner)
        whole.addWidget(self.orders)
        whole.addWidget(self.question)
        whole.addLayout(body, 1)
        self.setMinimumSize(880, 560)
        self._order_tabs()

    def _order_tabs(self) -> None:
        """Set the tab order to that of the work: set-up first. Stop is not in it: it has keys of its own."""
        order = [
            self.rig.open_button, self.rig.again_button, self.rig.person,
            self.schedule.open_button, self.schedule.folder_button,
            self.run.start_button, self.run.pause_button, self.run.speeds,
        ]  # fmt: skip
        for first, second in pairwise(order):
            QWidget.setTabOrder(first, second)


def _text_label(name: str) -> QLabel:
    """A label for a line of text that wraps and can be selected; `name` for screen readers."""
    label = QLabel()
    label.setWordWrap(True)
    label.setAccessibleName(name)
    label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    return label
