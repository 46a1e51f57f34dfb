"""The last reading: signals of the photodiodes as bars over the arc, and the trend of the monitor. They only show."""

import math
from typing import TYPE_CHECKING

from PySide6.QtCore import QPointF, QRectF, QSize, Qt, Slot
from PySide6.QtGui import QBrush, QColor, QFontMetricsF, QPainter, QPaintEvent, QPen, QPolygonF
from PySide6.QtWidgets import QSizePolicy, QWidget

from goniotwin.app.desktop import model
from goniotwin.app.desktop.theme import Colours

if TYPE_CHECKING:  # as in the instrument view
    from goniotwin.app.campaign.readout import WarmUpTrace
    from goniotwin.app.desktop.model.readings import Bar, Bars

ANGLES_DEG = (0, 30, 60, 90)
FULL_TURN_SHOWN_DEG = 92.0
BAR_DEG = 3.4
MARK = 4.0
ROOM_OF_ANGLE = 28.0
"""Pixels of 30 deg from which on each of the angles has room for its text."""
LEAST_RANGE = 0.002
"""Least range of the monitor's relative change that is drawn."""
NO_READING = "No reading yet."


class SignalBars(QWidget):
    """Photocurrents over the polar angles of the photodiodes, logarithmic: upper arc at the left, lower at the right."""

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self._colours = colours
        self._bars: Bars | None = None
        self._blocked: frozenset[int] = frozenset()
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.setMinimumSize(170, 96)
        self.setAccessibleName("Signals of the photodiodes")
        self.set_bars(None)

    @property
    def summary(self) -> str:
        """The bars as text."""
        return self.accessibleDescription()

    def set_bars(self, bars: "Bars | None") -> None:
        """Show a reading, or that there is none."""
        self._bars = bars
        self.setAccessibleDescription(bars.text if bars is not None else NO_READING)
        self.update()

    @Slot(object)
    def set_blocked(self, blocked: frozenset[int]) -> None:
        """Mark the photodiodes to which the mirror unit blocks the light."""
        self._blocked = blocked
        self.update()

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        self.update()

    def sizeHint(self) -> QSize:
        """A comfortable size; Qt calls it."""
        return QSize(520, 170)

    def paintEvent(self, event: QPaintEvent) -> None:
        """Draw the bars; Qt calls it."""
        del event
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.fillRect(self.rect(), QColor(self._colours.base))
        if self._bars is None:
            painter.setPen(QColor(self._colours.dim))
            painter.drawText(QRectF(self.rect()), Qt.AlignmentFlag.AlignCenter, NO_READING)
        else:
            self._draw(painter, self._bars)
        painter.end()

    def _draw(self, painter: QPainter, bars: "Bars") -> None:
        metrics = QFontMetricsF(painter.font())
        line = metrics.height()
        left = metrics.horizontalAdvance("100 nA") + 12.0
        whole = QRectF(self.rect()).adjusted(left, line + 10.0, -8.0, -line - 6.0)
        arcs = [arc for arc in ("upper", "lower") if any(bar.arc == arc for bar in bars.bars)]
        gap = 14.0
        width = (whole.width() - gap * (len(arcs) - 1)) / len(arcs)
        self._draw_scale(painter, bars, whole, line)
        for at, arc in enumerate(arcs):
            place = QRectF(whole.left() + at * (width + gap), whole.top(), width, whole.height())
            painter.setPen(QColor(self._colours.text))
            painter.drawText(QRectF(place.left(), 2.0, width, line), Qt.AlignmentFlag.AlignCenter, f"{arc} arc")
            self._draw_angles(painter, place, line)
            for bar in bars.bars:
                if bar.arc == arc:
                    self._draw_bar(painter, place, bar, bars.level(bar))

    def _draw_scale(self, painter: QPainter, bars: "Bars", place: QRectF, line: float) -> None:
        low, high = math.log10(bars.least_a), math.log10(bars.full_scale_a)
        decades = range(math.ceil(low), math.floor(high) + 1)
        every = 1 + int(line * len(decades) / max(place.height(), 1.0))
        for decade in decades:
            y = place.bottom() - place.height() * (decade - low) / (high - low)
            painter.setPen(QPen(QColor(self._colours.line), 1.0))
            painter.drawLine(QPointF(place.left() - 3.0, y), QPointF(place.right(), y))
            if (decade - decades[0]) % every == 0:
                painter.setPen(QColor(self._colours.text))
                text = QRectF(0.0, y - 0.5 * line, place.left() - 7.0, line)
                right = Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
                painter.drawText(text, right, model.current_text(10.0**decade))
        painter.setPen(QPen(QColor(self._colours.bad), 1.2, Qt.PenStyle.DashLine))
        painter.drawLine(place.topLeft(), place.topRight())
        painter.setPen(QPen(QColor(self._colours.dim), 1.0))
        painter.drawLine(place.bottomLeft(), place.bottomRight())

    def _draw_angles(self, painter: QPainter, place: QRectF, line: float) -> None:
        painter.setPen(QColor(self._colours.text))
        room = self._x(place, 30.0) - self._x(place, 0.0) > ROOM_OF_ANGLE
        for angle in ANGLES_DEG if room else (0, 60):
            x = self._x(place, angle)
            painter.drawLine(QPointF(x, place.bottom()), QPointF(x, place.bottom() + 3.0))
            text = QRectF(x - 20.0, place.bottom() + 4.0, 40.0, line)
            if text.right() > self.width():
                text.moveRight(self.width() - 1.0)
            painter.drawText(text, Qt.AlignmentFlag.AlignHCenter | Qt.AlignmentFlag.AlignTop, f"{angle}°")

    def _draw_bar(self, painter: QPainter, place: QRectF, bar: "Bar", level: float) -> None:
        colours = self._colours
        x = self._x(place, bar.polar_deg)
        half = max(0.5 * BAR_DEG * place.width() / (FULL_TURN_SHOWN_DEG + 4.0), 1.5)
        top = place.bottom() - min(max(level, 0.0), 1.0) * place.height()
        if bar.state == "dark":
            painter.setPen(QPen(QColor(colours.dim), 1.2))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawPolygon(_triangle(x, place.bottom() - 1.0))
        else:
            saturated = bar.state == "saturated"
            blocked = bar.channel in self._blocked
            colour = QColor(colours.bad if saturated else colours.blocked if blocked else colours.points)
            painter.setPen(QPen(colour, 1.0))
            painter.setBrush(QBrush(colour, Qt.BrushStyle.BDiagPattern) if saturated else QBrush(colour))
            painter.drawRect(QRectF(x - half, top, 2.0 * half, place.bottom() - top))
            if saturated:
                painter.setBrush(colour)
                painter.drawPolygon(
                    QPolygonF([QPointF(x - MARK, top - 1.0), QPointF(x + MARK, top - 1.0), QPointF(x, top - 7.0)])
                )
        if bar.channel in self._blocked:
            painter.setPen(QPen(QColor(colours.text), 1.4))
            middle = QPointF(x, place.bottom() - 14.0)
            painter.drawLine(middle + QPointF(-MARK, -MARK), middle + QPointF(MARK, MARK))
            painter.drawLine(middle + QPointF(-MARK, MARK), middle + QPointF(MARK, -MARK))

    def _x(self, place: QRectF, angle_deg: float) -> float:
        return place.left() + place.width() * (angle_deg + 4.0) / (FULL_TURN_SHOWN_DEG + 4.0)


def _triangle(x: float, tip: float, *, down: bool = True) -> QPolygonF:
    """A triangle with its tip at a height, pointing down or up."""
    base = tip - 6.0 if down else tip + 6.0
    return QPolygonF([QPointF(x - MARK, base), QPointF(x + MARK, base), QPointF(x, tip)])


class MonitorTrend(QWidget):
    """The monitor's relative change over the last ten minutes of the rig's clock."""

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self._colours = colours
        self._trace: WarmUpTrace | None = None
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Preferred)
        self.setMinimumSize(170, 64)
        self.setAccessibleName("Trend of the monitor")
        self.set_trace(None)

    @property
    def summary(self) -> str:
        """The trend as text."""
        return self.accessibleDescription()

    def set_trace(self, trace: "WarmUpTrace | None") -> None:
        """Show readings of the monitor."""
        self._trace = trace
        if trace is None:
            self.setAccessibleDescription(NO_READING)
        else:
            self.setAccessibleDescription(model.trend_text(trace))
        self.update()

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        self.update()

    def sizeHint(self) -> QSize:
        """A comfortable size; Qt calls it."""
        return QSize(520, 84)

    def paintEvent(self, event: QPaintEvent) -> None:
        """Draw the trend; Qt calls it."""
        del event
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        colours = self._colours
        painter.fillRect(self.rect(), QColor(colours.base))
        metrics = QFontMetricsF(painter.font())
        line = metrics.height()
        heading = QRectF(8.0, 2.0, self.width() - 16.0, line)
        painter.setPen(QColor(colours.text))
        text = metrics.elidedText(f"Monitor: {self.summary}", Qt.TextElideMode.ElideRight, heading.width())
        painter.drawText(heading, Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter, text)
        if self._trace is not None and len(self._trace.times_s) > 1:
            left = metrics.horizontalAdvance("−0.00 %") + 12.0
            self._draw(painter, self._trace, QRectF(self.rect()).adjusted(left, line + 8.0, -10.0, -line - 5.0), line)
        painter.end()

    def _draw(self, painter: QPainter, trace: "WarmUpTrace", place: QRectF, line: float) -> None:
        colours = self._colours
        last, mean = trace.times_s[-1], sum(trace.currents_a) / len(trace.currents_a)
        span = max(last - trace.times_s[0], 60.0)
        changes = [current / mean - 1.0 if mean else 0.0 for current in trace.currents_a]
        reach = max(LEAST_RANGE, 1.15 * max(abs(each) for each in changes))
        decimals = 2 if reach < 0.1 else 0

        def y_of(change: float) -> float:
            return place.center().y() - 0.5 * place.height() * change / reach

        for change in (-reach, 0.0, reach):
            painter.setPen(QPen(QColor(colours.line), 1.0))
            painter.drawLine(QPointF(place.left(), y_of(change)), QPointF(place.right(), y_of(change)))
            if change or place.height() > 3.0 * line:
                painter.setPen(QColor(colours.text))
                label = QRectF(0.0, y_of(change) - 0.5 * line, place.left() - 6.0, line)
                text = f"{100.0 * change:+.{decimals}f} %".replace("-", "−") if change else "mean"
                painter.drawText(label, Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter, text)
        painter.setPen(QPen(QColor(colours.points), 1.6))
        painter.drawPolyline(
            QPolygonF(
                [
                    QPointF(place.right() - place.width() * (last - t) / span, y_of(change))
                    for t, change in zip(trace.times_s, changes, strict=True)
                ]
            )
        )
        painter.setPen(QColor(colours.text))
        below = QRectF(place.left(), place.bottom() + 3.0, place.width(), line)
        painter.drawText(below, Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignTop, f"{span / 60.0:.0f} min ago")
        painter.drawText(below, Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignTop, "now")
