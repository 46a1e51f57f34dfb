"""The panels that only show: devices, axes, rig, schedule."""

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QGridLayout, QGroupBox, QLabel, QWidget

from goniotwin.app.desktop.model.messages import DEVICES, DeviceStatus
from goniotwin.app.desktop.theme import Colours
from goniotwin.app.rig import AXES

GREEK = {"gamma": "γ", "sigma": "σ", "beta": "β", "shift": "Δ"}
NOTHING = "–"


class DevicesPanel(QGroupBox):
    """Each device: whether it answers, and who it is or why not."""

    def __init__(self, colours: Colours) -> None:
        super().__init__("Devices")
        self.setAccessibleName("Devices")
        self._colours = colours
        self._known: dict[str, DeviceStatus] = {}
        self._marks: dict[str, QLabel] = {}
        self._texts: dict[str, QLabel] = {}
        grid = QGridLayout(self)
        grid.setColumnStretch(1, 1)
        grid.setVerticalSpacing(2)
        for at, device in enumerate(DEVICES):
            mark, text = QLabel(), QLabel()
            text.setWordWrap(True)
            text.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
            text.setContentsMargins(0, 0, 0, 4)
            grid.addWidget(QLabel(device.capitalize()), 2 * at, 0)
            grid.addWidget(mark, 2 * at, 1, Qt.AlignmentFlag.AlignRight)
            grid.addWidget(text, 2 * at + 1, 0, 1, 2)
            self._marks[device], self._texts[device] = mark, text
        self._show()

    def text(self, device: str) -> str:
        """What is shown of a device."""
        return f"{self._marks[device].text()}: {self._texts[device].text()}"

    def set_devices(self, devices: dict[str, DeviceStatus]) -> None:
        """What is known of them now."""
        self._known = dict(devices)
        self._show()

    def set_colours(self, colours: Colours) -> None:
        """Follows the scheme."""
        self._colours = colours
        self._show()

    def _show(self) -> None:
        for device in DEVICES:
            status = self._known.get(device)
            mark, text = self._marks[device], self._texts[device]
            if status is None:
                said, colour = "not connected", self._colours.dim
            elif status.answers:
                said, colour = "✓ answers", self._colours.good
            else:
                said, colour = "✗ does not answer", self._colours.bad
            mark.setText(said)
            mark.setStyleSheet(f"color: {colour}; font-weight: bold")
            text.setText(status.text if status else "")
            text.setVisible(status is not None)
            text.setStyleSheet(f"color: {self._colours.text if status and not status.answers else self._colours.dim}")
            mark.setAccessibleName(f"{device} {said}")
            text.setAccessibleName(f"{device}: {status.text if status else 'nothing known'}")


class AxesPanel(QGroupBox):
    """Where each axis is, and where it is sent."""

    def __init__(self) -> None:
        super().__init__("Axes")
        self.setAccessibleName("Axes")
        self._places: dict[str, QLabel] = {}
        self._targets: dict[str, QLabel] = {}
        grid = QGridLayout(self)
        grid.setColumnStretch(0, 1)
        grid.setHorizontalSpacing(18)
        grid.addWidget(_right("position"), 0, 1)
        grid.addWidget(_right("target"), 0, 2)
        for at, axis in enumerate(AXES, start=1):
            place, target = _right(NOTHING), _right(NOTHING)
            font = place.font()
            font.setPointSizeF(1.25 * font.pointSizeF())
            font.setBold(True)
            place.setFont(font)
            # Wide enough for the widest value, so that nothing jumps while the numbers run.
            place.setMinimumWidth(place.fontMetrics().horizontalAdvance("−000.00°"))
            grid.addWidget(QLabel(f"{GREEK[axis]}  {axis}"), at, 0)
            grid.addWidget(place, at, 1)
            grid.addWidget(target, at, 2)
            self._places[axis], self._targets[axis] = place, target
        self.set_positions({})

    def position(self, axis: str) -> str:
        """What is shown of an axis."""
        return self._places[axis].text()

    def set_positions(self, degrees: dict[str, float]) -> None:
        """Where they are; those not named are unknown."""
        for axis, label in self._places.items():
            label.setText(_angle(degrees.get(axis)))
            label.setAccessibleName(f"{axis} position {label.text()}")

    def set_targets(self, pose: tuple[float, ...] | None) -> None:
        """Where they are sent; None where nobody sends them."""
        for axis, value in zip(AXES, pose or (None,) * len(AXES), strict=True):
            label = self._targets[axis]
            label.setText(_angle(value))
            label.setAccessibleName(f"{axis} target {label.text()}")


def heading(text: str, parent: QWidget | None = None) -> QLabel:
    """A name in bold that wraps."""
    label = QLabel(text, parent)
    label.setWordWrap(True)
    font = label.font()
    font.setBold(True)
    label.setFont(font)
    return label


def _angle(degrees: float | None) -> str:
    if degrees is None:
        return NOTHING
    # A counter that stands at nothing rounds to -0.00 half of the time.
    return f"{round(degrees, 2) + 0.0:.2f}°".replace("-", "−")


def _right(text: str) -> QLabel:
    label = QLabel(text)
    label.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
    return label
