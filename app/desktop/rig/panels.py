"""The panels of the instrument: rig file, devices and axes. They only show."""

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import Qt, Signal, Slot
from PySide6.QtWidgets import QCheckBox, QGridLayout, QGroupBox, QLabel, QPushButton, QVBoxLayout, QWidget

from goniotwin.app.campaign.wording import rounded_duration_text
from goniotwin.app.desktop.model.axes import GREEK
from goniotwin.app.desktop.theme import Colours
from goniotwin.protocols.clock import calendar_stamp

if TYPE_CHECKING:  # the window shows itself before the engine is loaded
    from goniotwin.app.station.messages import DeviceStatus, RigOpened

DEVICES = ("axes", "monochromator", "photodiodes", "monitor")
"""The devices that a rig usually has."""
NO_VALUE = "–"
Unreferenced = dict[str, float | None]
"""The encoders of unreferenced axes, deg, by axis; None is unknown."""
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
            row.show_status(self._statuses.get(name), self._addresses.get(name, ""), self._refusal, self._colours)

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

    def show_status(self, status: "DeviceStatus | None", address: str, refusal: str, colours: Colours) -> None:
        """Show a status; without one that the device is not connected."""
        name = self._device.capitalize()
        at = f"at {address}" if address else ""
        mark, state = contact_text(status)
        mark = f"{name} {mark} {state}"
        answered = answered_text(status.answered, calendar_stamp()) if status is not None else ""
        serious = status is not None and not status.connected
        colour = colours.dim if status is None else colours.bad if serious else colours.good
        if status is None or not status.error:
            wrong = ""
        else:
            wrong = status.error if serious else f"last error at {local_time(status.failed)}: {status.error}"
        identity = status.identity if status is not None and status.connected else at
        what = ", ".join(filter(None, (identity, answered.replace("answered", "last answered") if serious else answered)))
        self._mark.setText(mark)
        self._mark.setStyleSheet(f"color: {colour}; font-weight: bold")
        self._mark.setToolTip(at)
        self._what.setText(what)
        self._what.setVisible(bool(what))
        self._what.setStyleSheet(f"color: {colours.dim}")
        self._what.setToolTip(at)
        self._error.setText(wrong)
        self._error.setToolTip("" if status is None else status.detail)
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


def contact_text(status: "DeviceStatus | None") -> tuple[str, str]:
    """The state of a device now, wherever it is shown: its mark, and in words; None is a device that is not open."""
    if status is None:
        return NO_VALUE, "not connected"
    if status.connected:
        return "✓", "connected"
    if str(status.contact) == "silent" and status.answered:
        return "✗", f"silent since {rounded_duration_text(seconds_since(status.answered, calendar_stamp()))}"
    return "✗", str(status.contact)


def seconds_since(stamp: str, now: str) -> float:
    """The time between two calendar stamps (ISO 8601), s."""
    return (datetime.fromisoformat(now) - datetime.fromisoformat(stamp)).total_seconds()


def local_time(stamp: str) -> str:
    """The time of day of a calendar's stamp, in this computer's time zone."""
    return datetime.fromisoformat(stamp).astimezone().strftime("%H:%M:%S")


def answered_text(stamp: str, now: str) -> str:
    """How long ago a device answered, from calendar stamps (ISO 8601) of its answer and of now; empty without an answer."""
    if not stamp:
        return ""
    seconds = seconds_since(stamp, now)
    return "answered just now" if seconds < JUST_NOW_S else f"answered {rounded_duration_text(seconds)} ago"


class AxesPanel(QGroupBox):
    """The position and the target of each axis."""

    positions_shown = Signal(object, object)
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

    def set_positions(self, degrees: dict[str, float], unreferenced: Unreferenced | None = None) -> None:
        """Show the positions, deg; without a value an axis has a dash. `unreferenced` axes have a mark, and their encoder's."""
        marked = unreferenced or {}
        for axis, label in self._positions.items():
            label.setText(place_mark(degrees.get(axis), axis in marked, marked.get(axis)))
            label.setAccessibleName(f"{axis} position {label.text()}")
        self.positions_shown.emit(degrees, marked)

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
    """Lay out labels, and buttons in rows of three below them."""
    layout = QVBoxLayout(box)
    layout.setSpacing(6)
    for label in labels:
        layout.addWidget(label)
    grid = QGridLayout()
    for number, button in enumerate(buttons):
        grid.addWidget(button, *divmod(number, 3))
    layout.addLayout(grid)
    return layout


def place_mark(counter_deg: float | None, unreferenced: bool, encoder_deg: float | None) -> str:
    """The position of an axis by its counter; of an unreferenced one with a mark, and by its encoder, if that is another."""
    if counter_deg is None or not unreferenced:
        return angle_text(counter_deg)
    counter, encoder = angle_text(counter_deg), angle_text(encoder_deg)
    return f"✗ {counter}" if encoder_deg is None or encoder == counter else f"✗ {counter} | {encoder}"


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
