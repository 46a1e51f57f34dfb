"""The panels of the instrument: rig file, devices and axes. They only show."""

from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QCheckBox, QGridLayout, QGroupBox, QHBoxLayout, QLabel, QPushButton, QVBoxLayout, QWidget

from goniotwin.app.desktop.theme import Colours

if TYPE_CHECKING:  # the window shows itself before the engine is loaded
    from goniotwin.app.station.messages import DeviceStatus, RigOpened

GREEK = {"gamma": "γ", "sigma": "σ", "beta": "β", "shift": "Δ"}
"""The letter of each axis, in the order of a pose."""
DEVICES = ("axes", "monochromator", "photodiodes", "monitor")
"""The devices that a rig usually has."""
NO_VALUE = "–"


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
    """Each device: whether it is connected, its identity, or the reason why it does not respond."""

    shown = Signal(object)
    """The statuses, whenever they are set."""

    def __init__(self, colours: Colours) -> None:
        super().__init__("Devices")
        self.setAccessibleName("Devices")
        self._colours = colours
        self._statuses: dict[str, DeviceStatus] = {}
        self._marks: dict[str, QLabel] = {}
        self._texts: dict[str, QLabel] = {}
        self._grid = QGridLayout(self)
        self._grid.setColumnStretch(1, 1)
        self._grid.setVerticalSpacing(2)
        self.set_devices({})

    def text(self, device: str) -> str:
        """The text of a device."""
        return f"{self._marks[device].text()}: {self._texts[device].text()}"

    def set_devices(self, devices: "dict[str, DeviceStatus]") -> None:
        """Show the status of each device; without a rig, those that a rig usually has."""
        self._statuses = dict(devices)
        names = list(devices) or list(DEVICES)
        if names != list(self._marks):
            self._make_rows(names)
        self._show()
        self.shown.emit(self._statuses)

    def _make_rows(self, devices: list[str]) -> None:
        while (item := self._grid.takeAt(0)) is not None:
            if (widget := item.widget()) is not None:
                widget.deleteLater()
        self._marks, self._texts = {}, {}
        for at, device in enumerate(devices):
            mark, text = QLabel(), QLabel()
            text.setWordWrap(True)
            text.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            text.setContentsMargins(0, 0, 0, 4)
            self._grid.addWidget(QLabel(device.capitalize()), 2 * at, 0)
            self._grid.addWidget(mark, 2 * at, 1, Qt.AlignmentFlag.AlignRight)
            self._grid.addWidget(text, 2 * at + 1, 0, 1, 2)
            self._marks[device], self._texts[device] = mark, text

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        self._show()

    def _show(self) -> None:
        for device in self._marks:
            status = self._statuses.get(device)
            mark, text = self._marks[device], self._texts[device]
            if status is None:
                shown, colour = "not connected", self._colours.dim
            elif status.connected:
                shown, colour = "✓ connected", self._colours.good
            else:
                shown, colour = "✗ not responding", self._colours.bad
            mark.setText(shown)
            mark.setStyleSheet(f"color: {colour}; font-weight: bold")
            text.setText(status.text if status else "")
            text.setVisible(status is not None)
            text.setStyleSheet(f"color: {self._colours.text if status and not status.connected else self._colours.dim}")
            mark.setAccessibleName(f"{device} {shown}")
            text.setAccessibleName(f"{device}: {status.text if status else 'not connected'}")


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
