"""The rig screen: the rig file, the axes and the devices."""

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QHBoxLayout, QVBoxLayout

from goniotwin.app.desktop.rig.panels import AxesPanel, DevicesPanel, RigPanel
from goniotwin.app.desktop.screen import Screen
from goniotwin.app.desktop.theme import Colours


class RigScreen(Screen):
    """Rig file and axes at the left, devices at the right."""

    title = "Rig"
    icon = "connection"

    def __init__(self, colours: Colours) -> None:
        super().__init__(colours)
        self.rig = RigPanel()
        self.axes = AxesPanel()
        self.devices = DevicesPanel(colours)
        left = QVBoxLayout()
        left.addWidget(self.rig)
        left.addWidget(self.axes)
        left.addStretch(1)
        layout = QHBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(12)
        layout.addLayout(left, 1)
        layout.addWidget(self.devices, 1, Qt.AlignmentFlag.AlignTop)

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        super().set_colours(colours)
        self.devices.set_colours(colours)
