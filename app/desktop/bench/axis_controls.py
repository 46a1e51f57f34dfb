"""The controls of one axis: its position between its soft limits, jog, go to, home and set position."""

from typing import TYPE_CHECKING

from PySide6.QtCore import QPointF, QRectF, QSize, Qt, Signal, Slot
from PySide6.QtGui import QColor, QPainter, QPaintEvent, QPen, QPolygonF
from PySide6.QtWidgets import QHBoxLayout, QLabel, QPushButton, QSizePolicy, QVBoxLayout, QWidget

from goniotwin.app.desktop.bench.number_field import NumberField
from goniotwin.app.desktop.model.axes import GREEK
from goniotwin.app.desktop.rig.panels import angle_text, place_mark
from goniotwin.app.desktop.theme import Colours

if TYPE_CHECKING:  # the window shows itself before the drivers are loaded
    from goniotwin.drivers import AxisDescription

FARTHEST_DEG = 9999.0
"""Angles that can be entered: beyond any limits, so that a refusal can give the reason."""
ARRIVED_DEG = 0.02
"""A jog starts at the last target if the axis is no farther from it than this: steps then add up without an error."""
WIDEST = "✗ −000.00°"
"""The longest text of a position whose encoder is known to agree."""
BEYOND = 0.05
"""Share of the range that is drawn beyond each soft limit."""


class LimitsBar(QWidget):
    """The range of an axis with its soft limits, its position and the angle that it would go to."""

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self._colours = colours
        self._limits: tuple[float, float] | None = None
        self._position: float | None = None
        self._target: float | None = None
        self._doubtful = False
        self._font = self.font()
        self._font.setPointSizeF(0.85 * self._font.pointSizeF())
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.setFixedHeight(28)
        self.setMinimumWidth(56)
        self.set_limits(None)

    def set_limits(self, limits: tuple[float, float] | None) -> None:
        """Take the soft limits, deg."""
        self._limits = limits
        self._describe()

    def set_angles(self, position: float | None, target: float | None) -> None:
        """Show the position, and the target that differs from it, deg."""
        self._position, self._target = position, target
        self._describe()

    def set_doubtful(self, doubtful: bool) -> None:
        """Show whether the axis is unreferenced: it may be elsewhere."""
        if doubtful != self._doubtful:
            self._doubtful = doubtful
            self.update()

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        self.update()

    def _describe(self) -> None:
        text = (
            "soft limits unknown"
            if self._limits is None
            else f"soft limits {_short(self._limits[0])} to {_short(self._limits[1])}"
        )
        self.setToolTip(text)
        self.setAccessibleName(f"{text}, position {angle_text(self._position)}")
        self.update()

    def sizeHint(self) -> QSize:
        """A comfortable size; Qt calls it."""
        return QSize(150, 28)

    def paintEvent(self, event: QPaintEvent) -> None:
        """Draw the bar; Qt calls it."""
        del event
        if self._limits is None:
            return
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setFont(self._font)
        colours, (low, high) = self._colours, self._limits
        y = 9.0
        left, right = self._x(low), self._x(high)
        painter.setPen(QPen(QColor(colours.line), 5.0))
        painter.drawLine(QPointF(left, y), QPointF(right, y))
        painter.setPen(QPen(QColor(colours.dim), 2.0))
        for x in (left, right):
            painter.drawLine(QPointF(x, y - 6.0), QPointF(x, y + 6.0))
        painter.setPen(QColor(colours.text))
        below = QRectF(0.0, y + 6.0, self.width(), self.height() - y - 6.0)
        painter.drawText(below, Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter, _short(low))
        painter.drawText(below, Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter, _short(high))
        if self._target is not None:
            x = self._x(min(max(self._target, low), high))
            outside = not low <= self._target <= high
            painter.setPen(QPen(QColor(colours.bad if outside else colours.text), 1.4))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawEllipse(QPointF(x, y), 4.5, 4.5)
        if self._position is not None:
            inside = low - ARRIVED_DEG <= self._position <= high + ARRIVED_DEG
            colour = QColor(colours.points if inside and not self._doubtful else colours.bad)
            x = min(max(self._x(self._position), 4.0), self.width() - 4.0)
            painter.setPen(QPen(colour, 1.0))
            painter.setBrush(Qt.BrushStyle.NoBrush if self._doubtful else colour)
            painter.drawPolygon(QPolygonF([QPointF(x, y + 4.0), QPointF(x - 5.0, y - 7.0), QPointF(x + 5.0, y - 7.0)]))
        painter.end()

    def _x(self, angle: float) -> float:
        assert self._limits is not None
        low, high = self._limits
        span = max(high - low, 1e-9)
        return 5.0 + (self.width() - 10.0) * (angle - low + BEYOND * span) / ((1.0 + 2.0 * BEYOND) * span)


class AxisControls(QWidget):
    """One axis. `command` has a station's command and its arguments; `place_wanted` is that its position is to be set, which a
    person is asked for; `refused` why what was entered is not done.
    """

    command = Signal(str, object)
    refused = Signal(str)
    place_wanted = Signal(str)

    def __init__(self, axis: str, colours: Colours) -> None:
        super().__init__()
        self.axis = axis
        self._unreferenced = ""
        self._colours = colours
        self._settings: AxisDescription | None = None
        self._position: float | None = None
        self._encoder: float | None = None
        self._sent: float | None = None
        self._entered = False
        self._one_line = False
        self._refusal = ""
        self._wanted = 0.0
        self._step = 1.0
        name = QLabel()
        self.position = QLabel()
        font = self.position.font()
        font.setBold(True)
        font.setPointSizeF(1.15 * font.pointSizeF())
        self.position.setFont(font)
        self.position.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        self.bar = LimitsBar(colours)
        self.down, self.up = _button("−", f"Jog {axis} down"), _button("+", f"Jog {axis} up")
        for jog in (self.down, self.up):
            jog.setFixedWidth(30)
        self.target = NumberField(f"Angle for {axis}, degrees", -FARTHEST_DEG, FARTHEST_DEG, 2)
        self.target.setSuffix("°")
        self.target.setMinimumWidth(self.target.fontMetrics().horizontalAdvance("−000.00°") + 34)
        self.go = _button("Go", f"Move {axis} to the angle in the field")
        self.home = _button("Home", f"Home {axis}")
        self.set_button = _button("Set…", f"Set the position of {axis}")
        self.controls = (self.down, self.up, self.target, self.go, self.home, self.set_button)
        name.setBuddy(self.target)
        self._name = name
        self._name.setToolTip(axis)
        self._upper, self._lower = QHBoxLayout(), QHBoxLayout()
        self._upper.setSpacing(8)
        self._lower.setSpacing(4)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(1)
        layout.addLayout(self._upper)
        layout.addLayout(self._lower)
        self.set_one_line(False)
        self.down.clicked.connect(self._jog_down)
        self.up.clicked.connect(self._jog_up)
        self.go.clicked.connect(self._go)
        self.home.clicked.connect(self._home)
        self.set_button.clicked.connect(self._set)
        self.target.lineEdit().returnPressed.connect(self._go_by_key)
        self.target.refused.connect(self.refused)
        self.target.typed.connect(self._note_entry)
        self.target.valueChanged.connect(self._note_entry)
        self.set_position(None)

    def set_one_line(self, one_line: bool) -> None:
        """Lay out all parts in one line, or position and limits above the controls."""
        self._one_line = one_line
        self._show_position()
        self._name.setText(f"<b>{GREEK[self.axis]}</b>" if one_line else f"<b>{GREEK[self.axis]}</b> {self.axis}")
        self._name.setMinimumWidth(0 if one_line else self._name.fontMetrics().horizontalAdvance("γ gamma") + 8)
        self._upper.setSpacing(4 if one_line else 8)
        for part in (self._name, self.position, self.bar):
            self._upper.addWidget(part, 1 if part is self.bar else 0)
        for control in self.controls:
            (self._upper if one_line else self._lower).addWidget(control, 1 if control is self.target else 0)

    def set_settings(self, settings: "AxisDescription | None") -> None:
        """Take the table of the axis in the rig file."""
        self._settings, self._sent, self._entered = settings, None, False
        self.bar.set_limits(None if settings is None else (settings.lower_deg, settings.upper_deg))
        self._show()

    def set_position(self, degrees: float | None) -> None:
        """Show the position."""
        first = self._position is None
        self._position = degrees
        self._show_position()
        here = None if degrees is None else round(degrees, 2) + 0.0
        follows = not self._entered and (first or not self._refusal)  # what a person has entered, and is done now, stays
        if follows and here is not None and here != self.target.value():
            self.target.setValue(here)
            self._entered = False
        self._show()

    def set_unreferenced(self, reason: str, encoder_deg: float | None) -> None:
        """Show that the axis is unreferenced, and why, with its encoder's position; empty if it is referenced."""
        self._unreferenced, self._encoder = reason, encoder_deg
        self._show_position()

    def _show_position(self) -> None:
        text = place_mark(self._position, bool(self._unreferenced), self._encoder)
        self.position.setText(text)
        self.position.setMinimumWidth(self.position.fontMetrics().horizontalAdvance(max(WIDEST, text, key=len)))
        self.bar.setVisible(not self._one_line or len(text) <= len(WIDEST))  # two values take its place
        if self._unreferenced:
            self.position.setToolTip(f"{self.axis} is unreferenced: {self._unreferenced}; home it, or set its position")
        else:
            self.position.setToolTip(f"Position of {self.axis}")
        self.bar.set_doubtful(bool(self._unreferenced))
        self.position.setAccessibleName(f"{self.axis} {'unreferenced, ' if self._unreferenced else ''}position {text}")
        self.position.setStyleSheet(f"color: {self._colours.bad}" if self._unreferenced else "")

    def set_step(self, degrees: float) -> None:
        """Take the step of a jog."""
        self._step = degrees
        for button, sign in ((self.down, "−"), (self.up, "+")):
            button.setToolTip(f"Jog {self.axis} by {sign}{degrees:g}°")

    def set_refusals(self, move: str, home: str, set_position: str) -> None:
        """Disable what is refused now; the reasons are the tool tips."""
        if self._settings is not None and self._settings.homing is None:
            home = home or f"{self.axis} has no homing table in the rig file; set its position instead"
        self._refusal = move
        for button in (self.down, self.up, self.go):
            button.setEnabled(not move)
        self.set_step(self._step)
        if move:
            for button in (self.down, self.up):
                button.setToolTip(move)
        self.go.setToolTip(move or f"Move {self.axis} to the angle in the field (Enter)")
        self.home.setEnabled(not home)
        self.home.setToolTip(home or f"Find the reference of {self.axis}; the axis moves")
        self.set_button.setEnabled(not set_position)
        self.set_button.setToolTip(set_position or f"State where {self.axis} is; nothing moves")

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        self.bar.set_colours(colours)
        self._show_position()

    @property
    def _base(self) -> float | None:
        """Where a jog starts: the last target where the axis is there, else its position."""
        near = self._sent is not None and self._position is not None and abs(self._position - self._sent) <= ARRIVED_DEG
        return self._sent if near else self._position

    @Slot()
    def _show(self) -> None:
        wanted = self._wanted if self._entered else self.target.value()
        there = self._position is not None and abs(wanted - self._position) < ARRIVED_DEG
        self.bar.set_angles(self._position, None if there or self._position is None else wanted)

    @Slot(float)
    def _note_entry(self, angle_deg: float) -> None:
        self._entered, self._wanted = True, angle_deg
        self._show()

    @Slot()
    def _jog_down(self) -> None:
        self._jog(-self._step)

    @Slot()
    def _jog_up(self) -> None:
        self._jog(self._step)

    def _jog(self, step: float) -> None:
        base = self._base
        if base is not None:
            self.target.setValue(angle := round(base + step, 4))
            self._go_to(angle)

    @Slot()
    def _go_by_key(self) -> None:
        if self.go.isEnabled():
            self._go()
        else:
            self.refused.emit(f"{self.axis} is not moved: {self._refusal}")

    @Slot()
    def _go(self) -> None:
        if (angle := self.target.entered()) is not None:
            self._go_to(angle)

    def _go_to(self, angle_deg: float) -> None:
        self._sent, self._entered = angle_deg, False
        self.command.emit("move", {"axis": self.axis, "target_deg": angle_deg})

    @Slot()
    def _home(self) -> None:
        self._sent = None
        self.command.emit("home", {"axis": self.axis})

    @Slot()
    def _set(self) -> None:
        self.place_wanted.emit(self.axis)


def _short(degrees: float) -> str:
    return f"{degrees:g}°".replace("-", "−")


def _button(text: str, name: str) -> QPushButton:
    button = QPushButton(text)
    button.setAccessibleName(name)
    button.setToolTip(name)
    button.setAutoDefault(False)
    button.setFixedWidth(button.fontMetrics().horizontalAdvance(text) + 20)
    return button
