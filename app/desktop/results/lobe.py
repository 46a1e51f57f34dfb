"""The lobe in space: the triangles of a map, as far from the middle as its values are high, painted from back to front."""

from collections.abc import Callable

import numpy as np
from PySide6.QtCore import QPointF, Qt
from PySide6.QtGui import QColor, QKeyEvent, QMouseEvent, QPainter, QPaintEvent, QPen, QPolygonF
from PySide6.QtWidgets import QWidget

from goniotwin.app.data.results import Shown
from goniotwin.app.desktop.theme import Colours
from goniotwin.app.figures.description import Bar
from goniotwin.app.figures.hemisphere import LEVELS, RINGS_DEG, colour_table
from goniotwin.app.figures.style import DISC, MARKS
from goniotwin.app.figures.surface import Surface
from goniotwin.arrays import Floats

STEPS_DEG = {
    Qt.Key.Key_Left: (-10.0, 0.0),
    Qt.Key.Key_Right: (10.0, 0.0),
    Qt.Key.Key_Up: (0.0, 10.0),
    Qt.Key.Key_Down: (0.0, -10.0),
}
A_PIXEL_DEG = 0.5
FIRST_TURN_DEG, FIRST_HEIGHT_DEG = -25.0, 30.0
LIGHTEST = 0.75
"""Colour of a triangle that is seen along its surface, over that of one seen along its normal."""


class LobeView(QWidget):
    """The lobe of a light, turned by the arrow keys or by the mouse. Its shape has the values' scale."""

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self._colours = colours
        self._shown: Shown | None = None
        self._turn, self._height = FIRST_TURN_DEG, FIRST_HEIGHT_DEG
        self._held = QPointF()
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self.setAccessibleName("Lobe in space")

    def show_values(self, shown: Shown) -> None:
        """Show the lobe of a light."""
        self._shown = shown
        text = "The values as distances from the middle; turn it by the arrow keys" if shown.surface is not None else ""
        self.setAccessibleDescription(text or "The directions span no area: there is no lobe")
        self.setToolTip(self.accessibleDescription())
        self.update()

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        self.update()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        """Turn the lobe; Qt calls it."""
        if (step := STEPS_DEG.get(Qt.Key(event.key()))) is None:
            super().keyPressEvent(event)
        else:
            self._rotate(*step)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        """Hold the lobe; Qt calls it."""
        self._held = event.position()

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        """Turn the lobe; Qt calls it."""
        moved, self._held = event.position() - self._held, event.position()
        self._rotate(A_PIXEL_DEG * moved.x(), A_PIXEL_DEG * moved.y())

    def _rotate(self, turn: float, height: float) -> None:
        self._turn, self._height = self._turn + turn, min(max(self._height + height, 0.0), 90.0)
        self.update()

    def _seen(self, points: Floats) -> Floats:
        """Points (..., 3) as they are seen: right, up and towards the eye."""
        turn, height = np.radians((self._turn, self._height))
        x, y, z = points[..., 0], points[..., 1], points[..., 2]
        right, away = x * np.cos(turn) - y * np.sin(turn), x * np.sin(turn) + y * np.cos(turn)
        return np.stack(
            [right, z * np.cos(height) + away * np.sin(height), z * np.sin(height) - away * np.cos(height)], axis=-1
        )

    def paintEvent(self, event: QPaintEvent) -> None:
        """Paint the lobe; Qt calls it."""
        del event
        painter = QPainter(self)
        painter.fillRect(self.rect(), QColor(DISC.base))
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if self._shown is None or self._shown.surface is None:
            painter.setPen(QColor(DISC.text))
            painter.drawText(self.rect(), Qt.AlignmentFlag.AlignCenter | Qt.TextFlag.TextWordWrap, self.accessibleDescription())
            painter.end()
            return
        unit = 0.46 * min(self.width(), 1.4 * self.height())
        middle = QPointF(0.5 * self.width(), 0.68 * self.height())

        def placed(points: Floats) -> QPolygonF:
            return QPolygonF([QPointF(middle.x() + unit * x, middle.y() - unit * y) for x, y in points[:, :2].tolist()])

        around = np.radians(np.linspace(0.0, 360.0, 73))
        painter.setPen(QPen(QColor(DISC.line), 1.0))
        for ring in RINGS_DEG:
            radius = ring / RINGS_DEG[-1]
            circle = np.stack([radius * np.cos(around), radius * np.sin(around), np.zeros(around.size)], axis=1)
            painter.drawPolyline(placed(self._seen(circle)))
        self._paint_lobe(painter, self._shown.surface, self._shown.map.bar, placed)
        sigma = np.radians(self._shown.view.light.sigma_deg)
        for side, line, of in ((-1.0, Qt.PenStyle.SolidLine, MARKS["light"]), (1.0, Qt.PenStyle.DashLine, MARKS["specular"])):
            ray = np.array([[0.0, 0.0, 0.0], [side * np.sin(sigma), 0.0, np.cos(sigma)]])
            painter.setPen(QPen(QColor(of.colour), 2.0, line))
            painter.drawPolyline(placed(self._seen(ray)))
        if self.hasFocus():
            painter.setPen(QPen(QColor(self._colours.accent), 2.0))
            painter.drawRect(self.rect().adjusted(1, 1, -2, -2))
        painter.end()

    def _paint_lobe(self, painter: QPainter, of: Surface, bar: Bar, placed: Callable[[Floats], QPolygonF]) -> None:
        """Paint the triangles, the nearest one last; their colours are those of the map."""
        polar, azimuth = np.radians(np.hypot(of.x, of.y)), np.arctan2(of.y, of.x)
        unit = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1)
        shares = bar.scale.share(of.values, bar.limits)
        corners = self._seen(unit * shares[:, None])[of.triangles]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
        light = LIGHTEST + (1.0 - LIGHTEST) * np.abs(normal[:, 2]) / length
        level = (shares[of.triangles].mean(axis=1) * (LEVELS - 1)).astype(np.int64)
        colours = (colour_table(bar.colours)[level] * light[:, None]).astype(np.int64).tolist()
        for k in np.argsort(corners[:, :, 2].mean(axis=1)).tolist():
            colour = QColor(*colours[k])
            painter.setPen(QPen(colour, 0.5))
            painter.setBrush(colour)
            painter.drawPolygon(placed(corners[k]))
