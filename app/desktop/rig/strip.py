"""The strip above every screen: which devices are connected, and where the axes are."""

from typing import TYPE_CHECKING

from PySide6.QtCore import Slot
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel

from goniotwin.app.desktop.model.axes import GREEK
from goniotwin.app.desktop.rig.panels import DEVICES, NO_VALUE, angle_text
from goniotwin.app.desktop.theme import Colours

if TYPE_CHECKING:  # as in the panels
    from goniotwin.app.station.messages import DeviceStatus

NARROW, WIDE = 800, 1000
"""Widths of the strip in logical pixels from which on each device has room, and the targets too."""


class RigStrip(QFrame):
    """A mark for each device, and position and target of each axis. Always in sight."""

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self._colours = colours
        self._statuses: dict[str, DeviceStatus] = {}
        self._degrees: dict[str, float] = {}
        self._pose: tuple[float, ...] | None = None
        self._devices = QLabel()
        self._devices.setMinimumWidth(1)  # its text follows the width of the window, not the other way round
        self._axes = {axis: QLabel() for axis in GREEK}
        layout = QHBoxLayout(self)
        layout.setContentsMargins(12, 3, 12, 3)
        layout.setSpacing(14)
        layout.addWidget(self._devices)
        layout.addStretch(1)
        for label in self._axes.values():
            layout.addWidget(label)
        self.set_colours(colours)

    @Slot(object)
    def set_devices(self, devices: "dict[str, DeviceStatus]") -> None:
        """Show which devices are connected."""
        self._statuses = dict(devices)
        marks, states = [], []
        for device in devices or DEVICES:
            status = devices.get(device)
            if status is None:
                mark, colour, state = NO_VALUE, self._colours.dim, "not connected"
            elif status.connected:
                mark, colour, state = "✓", self._colours.good, "connected"
            else:
                mark, colour, state = "✗", self._colours.bad, "not responding"
            marks.append(f"<span style='color:{colour}'><b>{mark}</b></span>&nbsp;{device.capitalize()}")
            states.append(f"{device} {state}")
        failed = [mark for mark in marks if "✗" in mark]
        if self.width() < NARROW and len(failed) != 1:  # one mark stands for all
            mark = (failed or marks)[0].rpartition("&nbsp;")[0]
            marks = [f"{mark}&nbsp;{len(failed) or len(marks)} devices"]
        elif self.width() < NARROW:
            marks = failed
        self._devices.setText("&nbsp;&nbsp;&nbsp;".join(marks))
        self._devices.setAccessibleName(f"Devices: {', '.join(states)}")

    @Slot(object)
    def set_positions(self, degrees: dict[str, float]) -> None:
        """Show the positions, deg."""
        self._degrees = degrees
        self._show()

    @Slot(object)
    def set_targets(self, pose: tuple[float, ...] | None) -> None:
        """Show the targets of a pose, deg; None while no axis is sent anywhere."""
        self._pose = pose
        self._show()

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        self.setStyleSheet(f"RigStrip {{ border: none; border-bottom: 1px solid {colours.line} }}")
        self.set_devices(self._statuses)
        self._show()

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Leave out what has no room; Qt calls it."""
        super().resizeEvent(event)
        self.set_devices(self._statuses)
        self._show()

    def _show(self) -> None:
        wide = self.width() >= WIDE
        for at, (axis, label) in enumerate(self._axes.items()):
            position = angle_text(self._degrees.get(axis))
            target = angle_text(self._pose[at]) if self._pose is not None else NO_VALUE
            moving = target not in (NO_VALUE, position)
            arrow = f" → {target}" if wide and moving else ""
            label.setText(f"{GREEK[axis]} {position}{arrow}")
            label.setMinimumWidth(label.fontMetrics().horizontalAdvance(f"{GREEK[axis]} −000.00°"))
            label.setToolTip(f"{axis}: position {position}, target {target}")
            label.setAccessibleName(f"{axis} position {position}, target {target}")
