"""The instrument from the side and from above: beam, mirrors, sample, arcs and the obstructed zone. It only shows."""

import contextlib
import math
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

from PySide6.QtCore import QPointF, QRectF, QSize, Qt, Signal, Slot
from PySide6.QtGui import QBrush, QColor, QFontMetricsF, QPainter, QPaintEvent, QPen, QPolygonF
from PySide6.QtWidgets import QSizePolicy, QWidget

from goniotwin.app.desktop import model
from goniotwin.app.desktop.model.axes import GREEK
from goniotwin.app.desktop.rig.panels import place_mark
from goniotwin.app.desktop.theme import Colours

if TYPE_CHECKING:  # the window shows itself before numpy and the optics are loaded
    from goniotwin.app.desktop.model.instrument import InstrumentDrawing, InstrumentModel, Obstruction, View
    from goniotwin.arrays import Floats

MARGIN = 6
BESIDE = 1.35
"""Side and top view are beside each other where the widget is at least so many times as wide as high, else below each other."""
LEAST = QSize(240, 140)
PUPIL_SHOWN = 1.16
"""The beam begins at so many times the reach, in the top view."""
ZONE_PIXELS = 4.0
GAP = 18
"""Pixels between the views."""
MOVED_DEG = 0.02
"""A smaller change of a position computes no obstructed zone again."""


class InstrumentView(QWidget):
    """Side view and top view at the positions of the axes. What is blocked is computed in a thread of its own, and follows."""

    computed = Signal(object)
    blocked_shown = Signal(object)
    """The photodiodes to which the mirror unit blocks the light, whenever they are known anew."""

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self._colours = colours
        self._model: InstrumentModel | None = None
        self._drawing: InstrumentDrawing | None = None
        self._blocked: Obstruction | None = None
        self._positions: dict[str, float] = {}
        self._unreferenced: dict[str, float | None] = {}
        self._asked: dict[str, float] | None = None
        self._computing = False
        self._active = False
        self._levels: dict[int, float] = {}
        self._saturated: frozenset[int] = frozenset()
        self._shutter_open: bool | None = None
        self._worker: ThreadPoolExecutor | None = None
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.setMinimumSize(LEAST)
        self.computed.connect(self._show_blocked)
        self._describe()

    @property
    def blocked(self) -> frozenset[int]:
        """The photodiodes to which the mirror unit blocks the light, by number."""
        return self._blocked.photodiodes if self._blocked is not None else frozenset()

    def set_model(self, model: "InstrumentModel | None") -> None:
        """Show the instrument of a rig; nothing without one."""
        self._model, self._drawing, self._blocked, self._asked = model, None, None, None
        self.set_positions({})

    def set_positions(self, positions: Mapping[str, float]) -> None:
        """Show the instrument at these positions, deg; an axis without one is drawn at 0."""
        self._positions = dict(positions)
        self._drawing = self._model.drawing(positions) if self._model is not None and positions else None
        self._compute()
        self._describe()
        self.update()

    def set_unreferenced(self, encoders: Mapping[str, float | None]) -> None:
        """Mark unreferenced axes, with the positions by their encoders, deg; None is unknown."""
        if dict(encoders) != self._unreferenced:
            self._unreferenced = dict(encoders)
            self._describe()
            self.update()

    @property
    def doubt(self) -> str:
        """Which axes may be elsewhere than they are drawn, in one line; empty if none."""
        marks = [
            f"{GREEK[axis]} {place_mark(self._positions.get(axis), True, encoder)}"
            for axis, encoder in self._unreferenced.items()
            if axis in self._positions
        ]
        return f"{', '.join(marks)}: unreferenced (counter | encoder)" if marks else ""

    def set_active(self, active: bool) -> None:
        """Compute what is blocked from now on, or compute nothing while the screen is hidden."""
        self._active = active
        self._compute()

    def set_shutter(self, is_open: bool | None) -> None:
        """Show whether light comes through; None is unknown."""
        self._shutter_open = is_open
        self._describe()
        self.update()

    def set_levels(self, levels: Mapping[int, float], saturated: frozenset[int]) -> None:
        """Show signals, 0 (none) to 1 (full scale), by the number of the photodiode."""
        self._levels, self._saturated = dict(levels), saturated
        self.update()

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        self.update()

    def shut_down(self) -> None:
        """End the thread."""
        if self._worker is not None:
            self._worker.shutdown(wait=True, cancel_futures=True)
            self._worker = None

    # What is blocked.

    def _compute(self) -> None:
        model, positions = self._model, self._positions
        if model is None or self._drawing is None or self._computing or not self._active:
            return
        asked = self._asked
        if asked is not None and all(abs(positions[each] - asked.get(each, math.inf)) < MOVED_DEG for each in positions):
            return
        self._asked, self._computing = positions, True
        if self._worker is None:
            self._worker = ThreadPoolExecutor(1, thread_name_prefix="obstructed zone")

        def work() -> None:
            try:
                found: object = (model, model.obstruction(positions))
            except Exception as error:  # noqa: BLE001  (of the optics: the drawing has no obstructed zone then)
                found = error
            with contextlib.suppress(RuntimeError):  # the window is gone
                self.computed.emit(found)

        self._worker.submit(work)

    @Slot(object)
    def _show_blocked(self, found: object) -> None:
        self._computing = False
        if isinstance(found, tuple) and found[0] is self._model:
            self._blocked = found[1]
            self.blocked_shown.emit(self.blocked)
        self._describe()
        self.update()
        self._compute()

    # Text.

    @property
    def summary(self) -> str:
        """The drawing as text."""
        return self.accessibleDescription()

    def _describe(self) -> None:
        self.setAccessibleName("Instrument, side and top view")
        self.setAccessibleDescription(self._text())

    def _text(self) -> str:
        if self._drawing is None:
            return "No positions: the axes are not connected." if self._model is not None else "No rig is open."
        blocked = len(self.blocked)
        parts = [self.doubt or model.pose_text(self._positions)]
        if self._shutter_open is not None:
            parts.append("shutter open" if self._shutter_open else "shutter closed")
        if blocked:
            parts.append(f"{blocked} photodiode{'s' if blocked > 1 else ''} blocked by the mirror unit")
        if self._drawing.too_high:
            parts.append("the arc must not cross the incoming beam at this shift")
        return "; ".join(parts)

    # Drawing.

    def sizeHint(self) -> QSize:
        """A comfortable size; Qt calls it."""
        return QSize(520, 260)

    def paintEvent(self, event: QPaintEvent) -> None:
        """Draw both views; Qt calls it."""
        del event
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.fillRect(self.rect(), QColor(self._colours.base))
        whole = QRectF(self.rect()).adjusted(MARGIN, MARGIN, -MARGIN, -MARGIN)
        doubt = self.doubt
        if self._drawing is None:
            painter.setPen(QColor(self._colours.dim))
            painter.drawText(whole, Qt.AlignmentFlag.AlignCenter | Qt.TextFlag.TextWordWrap, self._text())
            painter.end()
            return
        if doubt:
            line = QFontMetricsF(painter.font()).height() + 2.0
            self._draw_doubt(painter, doubt, QRectF(whole.left(), whole.bottom() - line, whole.width(), line))
            whole.setBottom(whole.bottom() - line)
        if whole.width() >= BESIDE * whole.height():
            half = 0.5 * (whole.width() - GAP)
            first = QRectF(whole.left(), whole.top(), half, whole.height())
            second = QRectF(whole.left() + half + GAP, whole.top(), half, whole.height())
            between = QPointF(whole.center().x(), whole.top()), QPointF(whole.center().x(), whole.bottom())
        else:
            half = 0.5 * (whole.height() - GAP)
            first = QRectF(whole.left(), whole.top(), whole.width(), half)
            second = QRectF(whole.left(), whole.top() + half + GAP, whole.width(), half)
            between = QPointF(whole.left(), whole.center().y()), QPointF(whole.right(), whole.center().y())
        painter.setPen(QColor(self._colours.line))
        painter.drawLine(*between)
        ViewPainter(painter, first, "side", self._drawing, self._colours, self._shutter_open).draw(self)
        ViewPainter(painter, second, "top", self._drawing, self._colours, self._shutter_open).draw(self)
        painter.end()

    def _draw_doubt(self, painter: QPainter, doubt: str, line: QRectF) -> None:
        """Frame the drawing, and state below it which axes may be elsewhere."""
        painter.setBrush(Qt.BrushStyle.NoBrush)
        painter.setPen(QPen(QColor(self._colours.bad), 2.0, Qt.PenStyle.DashLine))
        painter.drawRect(QRectF(self.rect()).adjusted(1.0, 1.0, -1.0, -1.0))
        painter.drawText(line, Qt.AlignmentFlag.AlignCenter, doubt)

    def level(self, channel: int) -> float | None:
        """The signal of a photodiode, 0 to 1; None if none was read."""
        return self._levels.get(channel)

    def is_saturated(self, channel: int) -> bool:
        """Whether a photodiode is saturated."""
        return channel in self._saturated

    @property
    def cells(self) -> "Floats | None":
        """The cells of the obstructed zone, mm."""
        return self._blocked.cells if self._blocked is not None else None


class ViewPainter:
    """Draws one view into a rectangle."""

    def __init__(
        self,
        painter: QPainter,
        place: QRectF,
        view: "View",
        drawing: "InstrumentDrawing",
        colours: Colours,
        shutter_open: bool | None,
    ) -> None:
        self._painter = painter
        self._view: View = view
        self._drawing = drawing
        self._colours = colours
        self._shutter_open = shutter_open
        self._place = place
        metrics = QFontMetricsF(painter.font())
        self._line = metrics.height()
        inside = place.adjusted(0.0, self._line + 2.0, 0.0, -2.0)
        reach = 1.05 * drawing.reach_mm
        low, high = (-PUPIL_SHOWN * drawing.reach_mm, reach) if view == "top" else (self._lowest(reach), reach)
        self._scale = min(inside.width() / (2.0 * reach), inside.height() / (high - low))
        middle = 0.5 * (low + high)
        self._origin = QPointF(inside.center().x(), inside.center().y() + self._scale * middle)
        self._bottom = low

    def _lowest(self, reach: float) -> float:
        has_lower = any(arc.arc == "lower" for arc in self._drawing.arcs)
        return -reach if has_lower or self._drawing.pose[1] > 90.0 else -0.15 * reach

    def draw(self, of: InstrumentView) -> None:
        """Draw the view."""
        painter, colours = self._painter, self._colours
        painter.save()
        title = "Side view" if self._view == "side" else "Top view"
        painter.setPen(QColor(colours.text))
        painter.drawText(self._place, Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignTop, title)
        self._draw_frame()
        if of.cells is not None:
            self._draw_zone(of.cells)
        if self._view == "top":
            self._draw_clearance()
        self._draw_sample()
        self._draw_beam()
        arcs = sorted(self._drawing.arcs, key=lambda each: each.arc != "lower")  # from above the upper one hides the lower
        for arc in arcs:
            self._draw_arc(arc.line, arc.arc == "lower")
        for arc in arcs:
            for channel, point in zip(arc.channels, arc.photodiodes, strict=True):
                self._draw_photodiode(of, channel, point, arc.arc == "lower")
        self._draw_mirrors()
        self._draw_angles()
        painter.restore()

    def _points(self, points: "Floats") -> list[QPointF]:
        x0, y0, scale = self._origin.x(), self._origin.y(), self._scale
        return [QPointF(x0 + scale * x, y0 - scale * y) for x, y in model.project(points, self._view).tolist()]

    def _at(self, angle_deg: float, radius_mm: float) -> QPointF:
        """A point at an angle from the upward direction, clockwise (side view), or from the right, counter-clockwise (top)."""
        angle = math.radians(angle_deg)
        x, y = (math.sin(angle), math.cos(angle)) if self._view == "side" else (math.cos(angle), math.sin(angle))
        return QPointF(self._origin.x() + self._scale * radius_mm * x, self._origin.y() - self._scale * radius_mm * y)

    def _draw_frame(self) -> None:
        """The normal in the side view, and the way that the arcs' photodiodes sweep."""
        painter, reach = self._painter, self._drawing.reach_mm
        pen = QPen(QColor(self._colours.line), 1.0)
        painter.setPen(pen)
        painter.setBrush(Qt.BrushStyle.NoBrush)
        radius = self._scale * reach
        rim = QRectF(self._origin.x() - radius, self._origin.y() - radius, 2.0 * radius, 2.0 * radius)
        if self._view == "top":
            painter.drawEllipse(rim)
            pen.setStyle(Qt.PenStyle.DotLine)
            painter.setPen(pen)
            painter.drawLine(self._at(0.0, reach), self._at(180.0, reach))
        else:
            both = self._lowest(1.0) < -0.5
            painter.drawArc(rim, 0, (360 if both else 180) * 16)
            pen.setStyle(Qt.PenStyle.DotLine)
            painter.setPen(pen)
            painter.drawLine(self._at(0.0, reach), self._at(180.0, reach if both else 0.0))
            painter.drawLine(self._at(-90.0, reach), self._at(90.0, reach))

    def _draw_zone(self, cells: "Floats") -> None:
        shade = mixed(self._colours.base, self._colours.blocked, 0.55)
        pen = QPen(shade, ZONE_PIXELS)  # the zone has a width where it is seen from its edge, too
        pen.setJoinStyle(Qt.PenJoinStyle.RoundJoin)
        self._painter.setPen(pen)
        self._painter.setBrush(shade)
        flat = self._points(cells.reshape(-1, 3))
        for first in range(0, len(flat), 4):
            self._painter.drawPolygon(QPolygonF(flat[first : first + 4]))

    def _draw_clearance(self) -> None:
        colour = QColor(self._colours.bad if self._drawing.too_high else self._colours.blocked)
        self._painter.setPen(QPen(colour, 1.0, Qt.PenStyle.DashLine))
        self._painter.setBrush(QBrush(colour, Qt.BrushStyle.BDiagPattern) if self._drawing.too_high else QBrush())
        self._painter.drawPolygon(QPolygonF(self._points(self._drawing.clearance)))

    def _draw_sample(self) -> None:
        painter, colours = self._painter, self._colours
        corners = self._points(self._drawing.sample)
        painter.setPen(QPen(QColor(colours.text), 1.2))
        painter.setBrush(QColor(colours.button))
        if self._view == "top":
            painter.drawPolygon(QPolygonF(corners))
            painter.drawLine(*self._points(self._drawing.mark))
        else:
            left, right = min(each.x() for each in corners), max(each.x() for each in corners)
            painter.setPen(QPen(QColor(colours.text), 3.0))
            painter.drawLine(QPointF(left, self._origin.y()), QPointF(right, self._origin.y()))

    def _draw_beam(self) -> None:
        painter, colours = self._painter, self._colours
        dark = self._shutter_open is False
        pen = QPen(QColor(colours.dim if dark else colours.beam), 2.2)
        pen.setStyle(Qt.PenStyle.DashLine if dark else Qt.PenStyle.SolidLine)
        pen.setJoinStyle(Qt.PenJoinStyle.RoundJoin)
        painter.setPen(pen)
        painter.setBrush(Qt.BrushStyle.NoBrush)
        way = self._points(self._drawing.beam)
        if self._view == "top":
            limit = self._origin.y() - self._scale * self._bottom
            way[0].setY(min(way[0].y(), limit))
        painter.drawPolyline(QPolygonF(way))
        if not dark:
            specular = QPen(QColor(colours.beam), 1.2, Qt.PenStyle.DotLine)
            painter.setPen(specular)
            painter.drawLine(*self._points(self._drawing.specular))

    def _draw_arc(self, line: "Floats", lower: bool) -> None:
        pen = QPen(QColor(self._colours.dim), 1.0 if lower else 2.0)
        self._painter.setPen(pen)
        self._painter.setBrush(Qt.BrushStyle.NoBrush)
        self._painter.drawPolyline(QPolygonF(self._points(line)))

    def _draw_photodiode(self, of: InstrumentView, channel: int, point: "Floats", lower: bool) -> None:
        painter, colours = self._painter, self._colours
        (at,) = self._points(point[None, :])
        radius = min(max(self._scale * 7.0, 2.2), 5.0) * (0.8 if lower else 1.0)
        if channel in of.blocked:
            painter.setPen(QPen(QColor(colours.text), 1.3))
            painter.drawLine(at + QPointF(-radius, -radius), at + QPointF(radius, radius))
            painter.drawLine(at + QPointF(-radius, radius), at + QPointF(radius, -radius))
            return
        level = of.level(channel)
        saturated = of.is_saturated(channel)
        painter.setPen(QPen(QColor(colours.bad if saturated else colours.points), 1.8 if saturated else 1.0))
        fill = mixed(colours.base, colours.points, 0.0 if level is None else level)
        painter.setBrush(QColor(colours.bad) if saturated else fill)
        if saturated:
            painter.drawRect(QRectF(at.x() - radius, at.y() - radius, 2.0 * radius, 2.0 * radius))
        else:
            painter.drawEllipse(at, radius, radius)

    def _draw_mirrors(self) -> None:
        painter, colours = self._painter, self._colours
        painter.setPen(QPen(QColor(colours.text), 2.0))
        fill = QColor(colours.text)
        fill.setAlpha(70)
        painter.setBrush(fill)
        # The first mirror stands before the sample, as seen from the side.
        for mirror in self._drawing.mirrors[1 if self._view == "side" else 0 :]:
            painter.drawPolygon(QPolygonF(self._points(mirror)))

    def _draw_angles(self) -> None:
        """The axes' angles where they turn: sigma and the arc's shift in the side view, beta and gamma in the top view."""
        gamma, sigma, beta, shift = self._drawing.pose
        reach = self._drawing.reach_mm
        if self._view == "side":
            self._draw_turn(90.0, -sigma, 0.36 * reach)
            self._write(
                self._at(0.5 * sigma, 0.47 * reach) if sigma > 25.0 else self._at(-13.0, 0.5 * reach), f"σ {sigma:.2f}°"
            )
            self._corner(f"Δ {shift:.2f}°")
        else:
            self._draw_turn(0.0, beta, 0.5 * reach)
            at = self._at(0.5 * beta, 0.62 * reach) if beta > 25.0 else self._at(-14.0, 0.68 * reach)
            self._write(at, f"β {beta:.2f}°")
            self._corner(f"γ {gamma:.2f}°")
            self._label_light()

    def _draw_turn(self, start_deg: float, span_deg: float, radius_mm: float) -> None:
        """A part of a circle, from an angle counter-clockwise from the right."""
        radius = self._scale * radius_mm
        place = QRectF(self._origin.x() - radius, self._origin.y() - radius, 2.0 * radius, 2.0 * radius)
        self._painter.setPen(QPen(QColor(self._colours.text), 1.0))
        self._painter.setBrush(Qt.BrushStyle.NoBrush)
        self._painter.drawArc(place, round(16.0 * start_deg), round(16.0 * span_deg))

    def _label_light(self) -> None:
        text = "shutter closed" if self._shutter_open is False else "light"
        at = self._points(self._drawing.beam[:1])[0]
        limit = self._origin.y() - self._scale * self._bottom
        width = QFontMetricsF(self._painter.font()).horizontalAdvance(text) + 4.0
        self._write(QPointF(at.x() + 8.0 + 0.5 * width, limit - 0.5 * self._line), text)

    def _corner(self, text: str) -> None:
        """A text at the upper right."""
        self._painter.setPen(QColor(self._colours.text))
        self._painter.drawText(self._place, Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignTop, plain(text))

    def _write(self, at: QPointF, text: str) -> None:
        """A text around a point, on the colour of the ground."""
        text = plain(text)
        metrics = QFontMetricsF(self._painter.font())
        width = metrics.horizontalAdvance(text) + 4.0
        place = QRectF(at.x() - 0.5 * width, at.y() - 0.5 * self._line, width, self._line)
        place.moveLeft(min(max(place.left(), self._place.left()), self._place.right() - width))
        ground = QColor(self._colours.base)
        ground.setAlpha(200)
        self._painter.fillRect(place, ground)
        self._painter.setPen(QColor(self._colours.text))
        self._painter.drawText(place, Qt.AlignmentFlag.AlignCenter, text)


def mixed(first: str, second: str, share: float) -> QColor:
    """A colour between two."""
    one, other = QColor(first), QColor(second)
    share = min(max(share, 0.0), 1.0)
    ends = ((one.red(), other.red()), (one.green(), other.green()), (one.blue(), other.blue()))
    return QColor(*(round(a + share * (b - a)) for a, b in ends))


def plain(text: str) -> str:
    """A text with the sign of minus, and without that of a zero."""
    return text.replace(" -0.00°", " 0.00°").replace("-", "−")
