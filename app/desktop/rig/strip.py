"""The strip above every screen: which devices are connected, the light, and where the axes are."""

from typing import TYPE_CHECKING

from PySide6.QtCore import QTimer, Slot
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel

from goniotwin.app.campaign.wording import rounded_duration_text
from goniotwin.app.desktop.model.axes import GREEK
from goniotwin.app.desktop.rig.panels import (
    DEVICES,
    NO_VALUE,
    Unreferenced,
    angle_text,
    contact_text,
    place_mark,
    seconds_since,
)
from goniotwin.app.desktop.theme import Colours
from goniotwin.protocols.clock import calendar_stamp

if TYPE_CHECKING:  # as in the panels
    from goniotwin.app.station.messages import BenchChanged, DeviceStatus, LampRead

SMALL, NARROW, ROOMY, WIDE = 680, 800, 1000, 1200
"""Widths of the strip in logical pixels from which on the wavelength has room, the lamp, each device, and the targets too."""
OLD_S = 10.0
"""A reading of the lamp that is older has its age."""


class RigStrip(QFrame):
    """A mark for each device, shutter, wavelength and lamp, and position and target of each axis. Always in sight."""

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self._colours = colours
        self._statuses: dict[str, DeviceStatus] = {}
        self._degrees: dict[str, float] = {}
        self._unreferenced: Unreferenced = {}
        self._pose: tuple[float, ...] | None = None
        self._devices = QLabel()
        self._devices.setMinimumWidth(1)  # its text follows the width of the window, not the other way round
        self._light = QLabel()
        self._light.setMinimumWidth(1)
        self._bench: BenchChanged | None = None
        self._lamp: LampRead | None = None
        self._axes = {axis: QLabel() for axis in GREEK}
        layout = QHBoxLayout(self)
        layout.setContentsMargins(12, 3, 12, 3)
        layout.setSpacing(14)
        layout.addWidget(self._devices)
        layout.addWidget(self._light)
        layout.addStretch(1)
        for label in self._axes.values():
            layout.addWidget(label)
        self._every_second = QTimer(self, interval=1000)
        self._every_second.timeout.connect(self._show_what_ages)
        self._every_second.start()
        self.set_colours(colours)

    @Slot(object)
    def set_devices(self, devices: "dict[str, DeviceStatus]") -> None:
        """Show the state of each device."""
        self._statuses = dict(devices)
        self._show_devices()

    @Slot(object, object)
    def set_light(self, bench: "BenchChanged | None", lamp: "LampRead | None") -> None:
        """Show shutter, wavelength and lamp as far as they are known; without a rig nothing is."""
        self._bench, self._lamp = bench, lamp
        self._show_light()

    @Slot()
    def _show_what_ages(self) -> None:
        if self.isVisible():
            self._show_devices()
            self._show_light()

    def _show_light(self) -> None:
        bench = self._bench
        if bench is None:
            self._light.setText("")
            self._light.setAccessibleName("Light: no rig is open")
            return
        shutter = {True: "open", False: "closed", None: "unknown"}[bench.shutter_open]
        wavelength = "wavelength unknown" if bench.wavelength_nm is None else f"{bench.wavelength_nm:g} nm"
        lamp = lamp_text(self._lamp, calendar_stamp())
        self._light.setAccessibleName(f"Light: shutter {shutter}, {wavelength}, lamp {lamp}")
        self._light.setToolTip(f"Shutter {shutter}\n{wavelength}\nLamp, by the monitor: {lamp}")
        colour = {True: self._colours.beam, False: self._colours.text, None: self._colours.bad}[bench.shutter_open]
        parts = [f"<span style='color:{colour}'>Shutter&nbsp;<b>{shutter}</b></span>"]
        if self.width() >= SMALL:
            parts.append("–&nbsp;nm" if bench.wavelength_nm is None else wavelength.replace(" ", "&nbsp;"))
        if self.width() >= NARROW:
            parts.append(f"lamp&nbsp;{lamp.replace(' ', '&nbsp;')}")
        self._light.setText("&nbsp;&nbsp;".join(parts))

    def _show_devices(self) -> None:
        colours = {NO_VALUE: self._colours.dim, "✓": self._colours.good, "✗": self._colours.bad}
        marks, states = [], []
        for device in self._statuses or DEVICES:
            mark, state = contact_text(self._statuses.get(device))
            colour = colours[mark]
            marks.append(f"<span style='color:{colour}'><b>{mark}</b></span>&nbsp;{device.capitalize()}")
            states.append(f"{device} {state}")
        failed = [mark for mark in marks if "✗" in mark]
        if self.width() < ROOMY and len(failed) != 1:  # one mark stands for all
            mark = (failed or marks)[0].rpartition("&nbsp;")[0]
            marks = [f"{mark}&nbsp;{len(failed) or len(marks)} devices"]
        elif self.width() < ROOMY:
            marks = failed
        self._devices.setText("&nbsp;&nbsp;&nbsp;".join(marks))
        self._devices.setToolTip("\n".join(states))
        self._devices.setAccessibleName(f"Devices: {', '.join(states)}")

    @Slot(object, object)
    def set_positions(self, degrees: dict[str, float], unreferenced: Unreferenced) -> None:
        """Show the positions, deg, and the encoders of unreferenced axes."""
        self._degrees, self._unreferenced = degrees, unreferenced
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
        self._show_devices()
        self._show_light()
        self._show()

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Leave out what has no room; Qt calls it."""
        super().resizeEvent(event)
        self._show_devices()
        self._show_light()
        self._show()

    def _show(self) -> None:
        wide = self.width() >= WIDE
        for at, (axis, label) in enumerate(self._axes.items()):
            here = self._degrees.get(axis)
            position = place_mark(here, axis in self._unreferenced, self._unreferenced.get(axis))
            target = angle_text(self._pose[at]) if self._pose is not None else NO_VALUE
            moving = target not in (NO_VALUE, angle_text(here))
            arrow = f" → {target}" if wide and moving else ""
            label.setText(f"{GREEK[axis]} {position}{arrow}")
            label.setStyleSheet(f"color: {self._colours.bad}" if position.startswith("✗") else "")
            widest = max(f"{GREEK[axis]} −000.00°", f"{GREEK[axis]} {position}", key=len)
            label.setMinimumWidth(label.fontMetrics().horizontalAdvance(widest))
            counters = "position" if axis not in self._unreferenced else "unreferenced, by its counter | its encoder"
            label.setToolTip(f"{axis}: {counters} {position}, target {target}")
            label.setAccessibleName(f"{axis} position {position}, target {target}")


def lamp_text(lamp: "LampRead | None", now: str) -> str:
    """The lamp by the monitor's last reading with the shutter open: its current, or none; with its age where that is old."""
    if lamp is None:
        return "unknown"
    found = current_text(lamp.current_a) if lamp.light else "no light"
    age = seconds_since(lamp.read, now)
    return found if age < OLD_S else f"{found} {rounded_duration_text(age)} ago"


def current_text(current_a: float) -> str:
    """A current with three digits and its unit, such as `412 nA`."""
    for unit, size in (("mA", 1e-3), ("µA", 1e-6), ("nA", 1e-9)):
        if abs(current_a) >= 0.9995 * size:
            return f"{current_a / size:.3g} {unit}".replace("-", "−")
    return f"{current_a / 1e-12:.3g} pA".replace("-", "−")
