"""The panels of the instrument: rig file, devices and axes. They only show."""

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import Qt, Signal, Slot
from PySide6.QtWidgets import QCheckBox, QGridLayout, QGroupBox, QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from goniotwin.app.campaign.wording import rounded_duration_text
from goniotwin.app.desktop.model.axes import GREEK
from goniotwin.app.desktop.theme import Colours
from goniotwin.protocols.clock import calendar_stamp

if TYPE_CHECKING:  # the window shows itself before the engine is loaded
    from goniotwin.app.station.messages import DeviceStatus, RigOpened

DEVICES = ("axes", "monochromator", "photodiodes", "monitor")
"""The devices that a rig usually has."""
NO_VALUE = "–"
JUST_NOW_S = 3.0


class RigPanel(QGroupBox):
    """The open rig."""

    open = Signal()
    connect_again = Signal()

    def __init__(self) -> None:
        super().__init__("Rig file")
        self.setAccessibleName("Rig file")
        self._name = heading("no rig")
        self._name.setAccessibleName("Rig")
        self._path = path_label()
        self.open_button = QPushButton("&Open rig…")
        self.open_button.setAccessibleName("Open a rig file")
        self.again_button = QPushButton("&Connect again")
        self.again_button.setAccessibleName("Connect the rig's devices again")
        self.open_button.clicked.connect(self.open)
        self.again_button.clicked.connect(self.connect_again)
        self.buttons = (self.open_button, self.again_button)
        self.person = QCheckBox("A person is the op&erator")
        self.person.setToolTip("Questions about mounting and faults, as on a real rig; from the next run on")
        self.person.setAccessibleName("A person is the operator")
        fill(self, [self._name, self._path], self.buttons).addWidget(self.person)
        self.person.hide()

    def set_rig(self, rig: "RigOpened | None", path: Path) -> None:
        """Show the open rig, or that the one of a file is not open. At a real rig a person always is the operator."""
        self.person.setVisible(rig is not None and rig.simulated)
        self._name.setText(rig.name if rig else f"no rig: {path.name}")
        show_path(self._path, path)


class DevicesPanel(QGroupBox):
    """Each device: whether it is connected, what it is, when it last answered, its last error and what to do."""

    shown = Signal(object)
    """The statuses, whenever they are set."""
    reconnect = Signal(str)
    """The name of a device that is to be connected anew."""

    def __init__(self, colours: Colours) -> None:
        super().__init__("Devices")
        self.setAccessibleName("Devices")
        self._colours = colours
        self._statuses: dict[str, DeviceStatus] = {}
        self._addresses: dict[str, str] = {}
        self._errors: dict[str, tuple[str, str]] = {}
        self._refusal = "no rig is open"
        self._rows: dict[str, DeviceRow] = {}
        self._layout = QVBoxLayout(self)
        self._layout.setSpacing(6)
        self._layout.setContentsMargins(8, 4, 8, 6)
        self.set_devices({})

    @property
    def statuses(self) -> "dict[str, DeviceStatus]":
        """The statuses as they were set last."""
        return self._statuses

    def text(self, device: str) -> str:
        """The text of a device."""
        return self._rows[device].summary

    def set_devices(self, devices: "dict[str, DeviceStatus]") -> None:
        """Show the status of each device; without a rig, those that a rig usually has."""
        self._statuses = dict(devices)
        names = list(devices) or list(DEVICES)
        if names != list(self._rows):
            self._make_rows(names)
        self._show()
        self.shown.emit(self._statuses)

    def set_addresses(self, addresses: dict[str, str]) -> None:
        """Take where each device is, by name."""
        self._addresses = addresses
        self._show()

    def set_errors(self, errors: dict[str, tuple[str, str]]) -> None:
        """Take the last error of devices, by name: its time of day and its text."""
        if errors != self._errors:  # they are given with every message, and what is shown takes long to style
            self._errors = dict(errors)
            self._show()

    def set_refusal(self, reason: str) -> None:
        """Disable the buttons, and give the reason; an empty reason enables them."""
        if reason != self._refusal:
            self._refusal = reason
            self._show()

    def _make_rows(self, devices: list[str]) -> None:
        while (item := self._layout.takeAt(0)) is not None:
            if (widget := item.widget()) is not None:
                widget.deleteLater()
        self._rows = {name: DeviceRow(name) for name in devices}
        for row in self._rows.values():
            row.reconnect.connect(self.reconnect)
            self._layout.addWidget(row)

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        self._show()

    @Slot()
    def _show(self) -> None:
        for name, row in self._rows.items():
            row.show_status(
                self._statuses.get(name), self._addresses.get(name, ""), self._errors.get(name), self._refusal, self._colours
            )

    def refresh(self) -> None:
        """Show how long ago each device answered, now."""
        self._show()


class DeviceRow(QWidget):
    """One device of the list."""

    reconnect = Signal(str)

    def __init__(self, device: str) -> None:
        super().__init__()
        self._device = device
        self._mark, self._what, self._error = QLabel(), QLabel(), QLabel()
        self._button = QPushButton("Connect")
        self._button.setAutoDefault(False)
        self._button.setFixedWidth(self._button.fontMetrics().horizontalAdvance("Reconnect") + 20)
        self._button.clicked.connect(self._ask)
        for label in (self._what, self._error):
            label.setWordWrap(True)
            label.setTextFormat(Qt.TextFormat.PlainText)
            label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        grid = QGridLayout(self)
        grid.setContentsMargins(0, 0, 0, 0)
        grid.setHorizontalSpacing(10)
        grid.setVerticalSpacing(1)
        grid.setColumnStretch(0, 1)
        grid.addWidget(self._mark, 0, 0)
        grid.addWidget(self._what, 1, 0)
        grid.addWidget(self._button, 0, 1, 2, 1)
        grid.addWidget(self._error, 2, 0, 1, 2)

    @property
    def summary(self) -> str:
        """The row as text."""
        parts = [self._mark.text(), self._what.text(), self._error.text()]
        return ": ".join(part for part in parts if part)

    def show_status(
        self, status: "DeviceStatus | None", address: str, error: tuple[str, str] | None, refusal: str, colours: Colours
    ) -> None:
        """Show a status; without one that the device is not connected."""
        name = self._device.capitalize()
        at = f"at {address}" if address else ""
        answered = answered_text(getattr(status, "answered", ""), calendar_stamp()) if status is not None else ""
        if status is None:
            mark, colour, what, wrong = f"{name} not connected", colours.dim, at, ""
        elif status.connected:
            mark, colour, what = f"{name} ✓ connected", colours.good, ", ".join(filter(None, (status.text, answered)))
            wrong = "" if error is None else f"last error at {error[0]}: {error[1]}"
        else:
            mark, colour, wrong = f"{name} ✗ not responding", colours.bad, status.text
            what = ", ".join(filter(None, (at, answered.replace("answered", "last answered"))))
        self._mark.setText(mark)
        self._mark.setStyleSheet(f"color: {colour}; font-weight: bold")
        self._mark.setToolTip(at)
        self._what.setText(what)
        self._what.setVisible(bool(what))
        self._what.setStyleSheet(f"color: {colours.dim}")
        self._what.setToolTip(at)
        serious = status is not None and not status.connected
        self._error.setText(wrong)
        self._error.setVisible(bool(wrong))
        self._error.setStyleSheet(f"color: {colours.bad if serious else colours.dim}")
        self._button.setText("Reconnect" if status is not None else "Connect")
        self._button.setAccessibleName(f"Reconnect {self._device}" if status is not None else f"Connect {self._device}")
        self._button.setEnabled(not refusal)
        self._button.setToolTip(refusal or f"Open the wire of {self._device} again and write its settings; nothing moves")
        for label, text in ((self._mark, mark), (self._what, what), (self._error, wrong)):
            label.setAccessibleName(f"{self._device}: {text}")

    @Slot()
    def _ask(self) -> None:
        self.reconnect.emit(self._device)


def answered_text(stamp: str, now: str) -> str:
    """How long ago a device answered, from calendar stamps (ISO 8601) of its answer and of now; empty without an answer."""
    if not stamp:
        return ""
    seconds = (datetime.fromisoformat(now) - datetime.fromisoformat(stamp)).total_seconds()
    return "answered just now" if seconds < JUST_NOW_S else f"answered {rounded_duration_text(seconds)} ago"


class AxesPanel(QGroupBox):
    """The position and the target of each axis."""

    positions_shown = Signal(object)
    targets_shown = Signal(object)
    """What was set last, whenever it is set."""

    def __init__(self) -> None:
        super().__init__("Axes")
        self.setAccessibleName("Axes")
        self._positions: dict[str, QLabel] = {}
        self._targets: dict[str, QLabel] = {}
        grid = QGridLayout(self)
        grid.setColumnStretch(0, 1)
        grid.setHorizontalSpacing(18)
        grid.addWidget(_right("position"), 0, 1)
        grid.addWidget(_right("target"), 0, 2)
        for at, axis in enumerate(GREEK, start=1):
            position, target = _right(NO_VALUE), _right(NO_VALUE)
            font = position.font()
            font.setPointSizeF(1.25 * font.pointSizeF())
            font.setBold(True)
            position.setFont(font)
            # Wide enough for the widest value, so that the layout does not change with the numbers.
            position.setMinimumWidth(position.fontMetrics().horizontalAdvance("−000.00°"))
            grid.addWidget(QLabel(f"{GREEK[axis]}  {axis}"), at, 0)
            grid.addWidget(position, at, 1)
            grid.addWidget(target, at, 2)
            self._positions[axis], self._targets[axis] = position, target
        self.set_positions({})

    def position(self, axis: str) -> str:
        """The text of an axis position."""
        return self._positions[axis].text()

    def set_positions(self, degrees: dict[str, float]) -> None:
        """Show the positions, deg; without a value an axis has a dash."""
        for axis, label in self._positions.items():
            label.setText(angle_text(degrees.get(axis)))
            label.setAccessibleName(f"{axis} position {label.text()}")
        self.positions_shown.emit(degrees)

    def set_targets(self, pose: tuple[float, ...] | None) -> None:
        """Show the targets of a pose, deg; None while no axis is sent anywhere."""
        for axis, value in zip(GREEK, pose or (None,) * len(GREEK), strict=True):
            label = self._targets[axis]
            label.setText(angle_text(value))
            label.setAccessibleName(f"{axis} target {label.text()}")
        self.targets_shown.emit(pose)


def heading(text: str, parent: QWidget | None = None) -> QLabel:
    """A label in bold that wraps."""
    label = QLabel(text, parent)
    label.setWordWrap(True)
    font = label.font()
    font.setBold(True)
    label.setFont(font)
    return label


def path_label() -> QLabel:
    """A label for a path, that wraps."""
    label = QLabel()
    label.setWordWrap(True)
    label.setTextFormat(Qt.TextFormat.PlainText)
    label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    return label


def show_path(label: QLabel, path: Path, before: str = "") -> None:
    """Show a path, with a text before it."""
    # A path has no spaces to wrap at; an invisible one after each separator allows a line break.
    text = str(path).replace("/", "/\u200b").replace("\\", "\\\u200b")
    label.setText(f"{before}{text}")
    label.setToolTip(str(path))
    label.setAccessibleName(f"{before}{path}")


def fill(box: QGroupBox, labels: list[QLabel], buttons: tuple[QPushButton, ...]) -> QVBoxLayout:
    """Lay out labels, and buttons in a row below them."""
    layout = QVBoxLayout(box)
    layout.setSpacing(6)
    for label in labels:
        layout.addWidget(label)
    row = QHBoxLayout()
    for button in buttons:
        row.addWidget(button)
    layout.addLayout(row)
    return layout


def angle_text(degrees: float | None) -> str:
    """An angle in degrees with two digits after the point; a dash without one."""
    if degrees is None:
        return NO_VALUE
    # Noise about zero would otherwise show -0.00.
    return f"{round(degrees, 2) + 0.0:.2f}°".replace("-", "−")


def _right(text: str) -> QLabel:
    label = QLabel(text)
    label.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
    return label
