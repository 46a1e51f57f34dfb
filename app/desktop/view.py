"""What is where in the window."""

from itertools import pairwise
from pathlib import Path

from PySide6.QtCore import Qt, Slot
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QScrollArea, QVBoxLayout, QWidget

from goniotwin.app.desktop.rig.panels import AxesPanel, DevicesPanel
from goniotwin.app.desktop.run.panel import RunPanel
from goniotwin.app.desktop.run.scan_plot import CutPlot
from goniotwin.app.desktop.setup.panels import RigPanel, SchedulePanel
from goniotwin.app.desktop.theme import Colours

LEFT_WIDTH = 330


class Parts(QWidget):
    """All that is in the window; it only shows."""

    def __init__(self, colours: Colours, folder: Path, speed: float) -> None:
        super().__init__()
        self._colours = colours
        self._bad = False
        self._banner = QLabel()
        self._banner.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.rig = RigPanel()
        self.devices = DevicesPanel(colours)
        self.axes = AxesPanel()
        self.schedule = SchedulePanel(folder)
        self.run = RunPanel(speed, colours)
        self.plot = CutPlot(colours)
        self._status = _wrapped("What is going on")
        self._saved = _wrapped("Where it is saved")
        self._trouble = _wrapped("What is wrong with the plot")
        self._lay_out()
        self.set_colours(colours)
        self.set_simulated(False, None)
        self.set_plot_trouble("")
        self.set_saved("")

    @property
    def status(self) -> str:
        """What is said at the bottom."""
        return self._status.text()

    @property
    def banner(self) -> str:
        """What is said across the top; empty for a real rig."""
        return "" if self._banner.isHidden() else self._banner.text()

    @property
    def saved(self) -> str:
        """What is said about the journal."""
        return self._saved.text()

    @property
    def trouble(self) -> str:
        """What is wrong with the plot; empty where nothing is."""
        return self._trouble.text()

    def say(self, text: str, *, bad: bool = False) -> None:
        """Tells the person what is going on."""
        self._bad = bad
        self._status.setText(f"✗ {text}" if bad else text)
        self._colour_texts()

    def set_simulated(self, simulated: bool, seed: int | None) -> None:
        """Across the whole window, for as long as a simulated rig is open."""
        self._banner.setVisible(simulated)
        self._banner.setText(f"SIMULATED  ·  seed {seed}  ·  nothing here is real")
        self._banner.setAccessibleName(self._banner.text())

    def set_saved(self, text: str) -> None:
        """Where the measured rows are."""
        self._saved.setText(text)
        self._saved.setVisible(bool(text))

    @Slot(str)
    def set_plot_trouble(self, text: str) -> None:
        """What is wrong with the plot; empty where nothing is."""
        self._trouble.setText(text)
        self._trouble.setVisible(bool(text))

    def set_colours(self, colours: Colours) -> None:
        """Follows the scheme."""
        self._colours = colours
        self._banner.setStyleSheet(
            f"background: {colours.simulated}; color: {colours.on_simulated}; font-weight: bold; padding: 4px"
        )
        self.devices.set_colours(colours)
        self.run.set_colours(colours)
        self.plot.set_colours(colours)
        self._colour_texts()

    def _colour_texts(self) -> None:
        self._status.setStyleSheet(f"color: {self._colours.bad}; font-weight: bold" if self._bad else "")
        self._trouble.setStyleSheet(f"color: {self._colours.bad}")
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
        right.addWidget(self.plot, 1)
        for each in (self._trouble, self.run, self._status, self._saved):
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
        whole.addLayout(body, 1)
        self.setMinimumSize(880, 560)
        self._order_tabs()

    def _order_tabs(self) -> None:
        """What is set up first comes first; Stop is reached by its own keys from anywhere."""
        order = [
            self.rig.open_button, self.rig.again_button, self.schedule.open_button, self.schedule.folder_button,
            self.run.start_button, self.run.pause_button, self.run.speeds, self.run.stop_button,
        ]  # fmt: skip
        for first, second in pairwise(order):
            QWidget.setTabOrder(first, second)


def _wrapped(name: str) -> QLabel:
    label = QLabel()
    label.setWordWrap(True)
    label.setAccessibleName(name)
    label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    return label
