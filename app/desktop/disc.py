"""The disc of a hemisphere, seen along the normal as in every figure: an image of values, rings, marks, and the colour bar.

A value is stamped into the image once; only the image is painted, so that the time does not grow with the values.
"""

from collections.abc import Iterator

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtGui import QColor, QFontMetricsF, QImage, QPainter, QPaintEvent, QResizeEvent
from PySide6.QtWidgets import QGraphicsEllipseItem, QLabel, QVBoxLayout, QWidget

from goniotwin.app.desktop.figures import PanelItems
from goniotwin.app.desktop.theme import Colours
from goniotwin.app.figures.description import Bar, ColourMap
from goniotwin.app.figures.hemisphere import EDGE_DEG, HORIZON_DEG, LEVELS, PIXELS, RINGS_DEG, colour_table
from goniotwin.app.figures.style import DISC
from goniotwin.arrays import Floats, Ints

EMPTY, PLANNED, LEAST_LEVEL = 0, 1, 2
"""Levels of a pixel: nothing, a planned direction, and the first of LEVELS for values."""
FILL = 0.5
"""Radius of a point over the side of its share of the hemisphere."""
MOST_RADIUS, LEAST_RADIUS = 9.0, 1.0
LOW = 270
"""Height in logical pixels below which the text is omitted."""
STRIP, TICK = 9, 3
"""Height of the strip of colours, and of a tick."""


class ColourBar(QWidget):
    """The bar of the map: the colours from low to high, ticks, and the label with its unit."""

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self._colours = colours
        self.bar: Bar | None = None
        self.setMinimumWidth(40)
        self.setFixedHeight(STRIP + TICK + 2 * self.fontMetrics().height() + 2)
        self.setAccessibleName("Colours of the values")

    def set_bar(self, bar: Bar | None) -> None:
        """Show a bar, or none."""
        if bar != self.bar:
            self.bar = bar
            self.setAccessibleDescription("" if bar is None else f"{bar.label}: {bar.limits[0]:.2g} to {bar.limits[1]:.2g}")
            self.update()

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        self.update()

    def paintEvent(self, event: QPaintEvent) -> None:
        """Paint the strip with its words; Qt calls it."""
        del event
        bar = self.bar
        if bar is None:
            return
        painter, metrics = QPainter(self), QFontMetricsF(self.font())
        strip = np.ascontiguousarray(colour_table(bar.colours)[None, :, :])
        image = QImage(strip.data, LEVELS, 1, 3 * LEVELS, QImage.Format.Format_RGB888)
        margin = 12.0
        room = self.width() - 2.0 * margin
        painter.drawImage(QRectF(margin, 0.0, room, STRIP), image)
        painter.setPen(QColor(self._colours.text))
        taken = 0.0
        for value, share in zip(bar.ticks, bar.scale.share(np.array(bar.ticks), bar.limits).tolist(), strict=True):
            x, text = margin + share * room, f"{value:g}"
            wide = metrics.horizontalAdvance(text)
            painter.drawLine(QPointF(x, STRIP), QPointF(x, STRIP + TICK))
            left = min(max(x - 0.5 * wide, 0.0), self.width() - wide)
            if left >= taken:
                painter.drawText(QPointF(left, STRIP + TICK + metrics.ascent()), text)
                taken = left + wide + 6.0
        below = QRectF(0.0, STRIP + TICK + metrics.height(), self.width(), metrics.height())
        label = metrics.elidedText(bar.label, Qt.TextElideMode.ElideRight, self.width())
        painter.drawText(below, Qt.AlignmentFlag.AlignHCenter, label)
        painter.end()


class DiscView(QWidget):
    """A disc with its colour bar and its content as text. A subclass sets the colours when it is made."""

    def __init__(self, colours: Colours, name: str) -> None:
        super().__init__()
        self._colours = colours
        self._radius = LEAST_RADIUS
        self._mirrored = False
        self._values = np.full((PIXELS, PIXELS), np.nan, dtype=np.float32)
        self._levels = np.zeros((PIXELS, PIXELS), dtype=np.uint8)
        self._mark = ""
        self._view = pg.PlotWidget()
        self._view.setAccessibleName(name)
        self._view.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._view.viewport().setFocusPolicy(Qt.FocusPolicy.NoFocus)  # else Tab stops at it, too
        plot = self._plot = self._view.getPlotItem()
        plot.setMenuEnabled(False)
        plot.hideButtons()
        plot.setMouseEnabled(False, False)
        plot.setAspectLocked(True)
        plot.hideAxis("left")
        plot.hideAxis("bottom")
        plot.setContentsMargins(0, 0, 0, 0)
        plot.setRange(xRange=(-EDGE_DEG, EDGE_DEG), yRange=(-EDGE_DEG, EDGE_DEG), padding=0.0)
        ground = QGraphicsEllipseItem(-HORIZON_DEG, -HORIZON_DEG, 2.0 * HORIZON_DEG, 2.0 * HORIZON_DEG)
        ground.setBrush(pg.mkBrush(DISC.base))
        ground.setPen(pg.mkPen(None))
        self._image = pg.ImageItem(axisOrder="row-major")
        for item in (ground, self._image):
            plot.addItem(item)
        self._items = PanelItems(plot, DISC)
        for each in RINGS_DEG[:-1]:
            text = pg.TextItem(f"{each:g}°", color=DISC.text, anchor=(0.5, 0.5), fill=pg.mkBrush(f"{DISC.base}a0"))
            text.setPos(0.0, -each)
            text.setZValue(8)
            plot.addItem(text)
        self.colour_bar = ColourBar(colours)
        self._text = QLabel()
        self._text.setWordWrap(True)
        self._text.setAccessibleName("The hemisphere as text")
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(2)
        layout.addWidget(self._view, 1)
        layout.addWidget(self.colour_bar)
        layout.addWidget(self._text)
        self._set_table("values")

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Leave the room to the map where there is little; Qt calls it."""
        super().resizeEvent(event)
        self._text.setVisible(self.height() >= LOW)

    @property
    def summary(self) -> str:
        """The content of the map as text."""
        return self._text.text()

    @property
    def filled(self) -> int:
        """The number of pixels with a value."""
        return int(np.isfinite(self._values).sum())

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme; the disc has its own in both."""
        self._colours = colours
        self._view.setBackground(colours.base)
        self.colour_bar.set_colours(colours)
        self._text.setStyleSheet(f"color: {colours.text}")
        self._show_mark()

    def _empty(self) -> None:
        """Take all values off the image."""
        self._values[:] = np.nan
        self._levels[:] = EMPTY

    def _set_density(self, directions: int) -> None:
        """Choose the radius of the values by the number of pixels that have a direction."""
        share = np.sqrt(np.pi / max(directions, 1)) * PIXELS * HORIZON_DEG / (2.0 * EDGE_DEG)
        self._radius = float(np.clip(FILL * share, LEAST_RADIUS, MOST_RADIUS)) if directions else 3.0

    def _stamp(self, x: Floats, y: Floats, given: Floats) -> None:
        """Put values (n,) at their places into the image; `_paint` shows them."""
        values = given.astype(np.float32)
        levels = self._levels_of(values)
        reach = np.arange(-int(self._radius), int(self._radius) + 1)
        for rows, columns in self._pixels(x, y):
            for down in reach:
                for right in reach:
                    if down * down + right * right <= self._radius**2:
                        at = np.clip(rows + down, 0, PIXELS - 1), np.clip(columns + right, 0, PIXELS - 1)
                        self._values[at], self._levels[at] = values, levels

    def _fill(self, shares: Floats) -> None:
        """Put an image of shares of the bar (PIXELS, PIXELS) in place of stamped values; NaN has no colour."""
        there = np.isfinite(shares)
        self._values[there] = shares[there]
        self._levels[there] = (LEAST_LEVEL + (LEVELS - 1) * shares[there]).astype(np.uint8)

    def _set_table(self, colours: ColourMap) -> None:
        table = np.zeros((LEAST_LEVEL + LEVELS, 4), dtype=np.uint8)
        table[PLANNED] = [int(DISC.dim[k : k + 2], 16) for k in (1, 3, 5)] + [255]
        table[LEAST_LEVEL:] = np.insert(colour_table(colours), 3, 255, axis=1)
        self._image.setLookupTable(table)

    def _set_bar(self, bar: Bar) -> None:
        """Show a bar, and the values that are stamped in its colours."""
        if bar != self.colour_bar.bar:
            self.colour_bar.set_bar(bar)
            self._set_table(bar.colours)
            stamped = np.isfinite(self._values)
            self._levels[stamped] = self._levels_of(self._values[stamped])

    def _levels_of(self, values: np.ndarray) -> np.ndarray:
        bar = self.colour_bar.bar
        share = np.zeros(values.shape) if bar is None else bar.scale.share(values, bar.limits)
        return (LEAST_LEVEL + (LEVELS - 1) * share).astype(np.uint8)

    def _paint(self) -> None:
        self._image.setImage(self._levels, autoLevels=False, levels=(0, LEAST_LEVEL + LEVELS - 1))
        self._image.setRect(QRectF(-EDGE_DEG, -EDGE_DEG, 2.0 * EDGE_DEG, 2.0 * EDGE_DEG))  # possible with an image only

    def _show_mark(self) -> None:
        title = f"<b style='color:{self._colours.bad}'>{self._mark}</b>" if self._mark else None
        self._plot.setTitle(title, size="9pt")

    def _write(self, text: str) -> None:
        self._text.setText(text)
        self._view.setAccessibleDescription(text)

    def _pixels(self, x: Floats, y: Floats) -> Iterator[tuple[Ints, Ints]]:
        """Row and column of places (n,) in the image, and of their images on the other half."""
        column, *rows = (
            np.clip((0.5 * (1.0 + each / EDGE_DEG) * PIXELS).astype(np.int64), 0, PIXELS - 1)
            for each in (x, *((-y, y) if self._mirrored else (y,)))
        )
        for row in rows:
            yield row, column
