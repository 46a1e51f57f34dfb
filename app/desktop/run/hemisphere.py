"""The hemisphere of a run, seen along the normal as in every figure: an image that fills as rows arrive.

A point is stamped into the image once; only the image is painted, so that the time does not grow with the points.
"""

from collections.abc import Iterator

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QPointF, QRectF, Qt, Slot
from PySide6.QtGui import QColor, QFontMetricsF, QImage, QPainter, QPaintEvent, QResizeEvent
from PySide6.QtWidgets import QGraphicsEllipseItem, QLabel, QVBoxLayout, QWidget

from goniotwin.app.campaign.geometry.directions import polar_from_zenith
from goniotwin.app.desktop.figures import PanelItems
from goniotwin.app.desktop.model.live_scan import Setting
from goniotwin.app.desktop.model.run_points import MapPoints
from goniotwin.app.desktop.theme import Colours
from goniotwin.app.figures.curves import quantity
from goniotwin.app.figures.description import Bar, Marks, Panel, Series
from goniotwin.app.figures.hemisphere import (
    EDGE_DEG,
    HORIZON_DEG,
    LEVELS,
    RINGS_DEG,
    colour_table,
    disc_marks,
    places,
    ring_lines,
    value_bar,
)
from goniotwin.app.figures.scale import scale_of
from goniotwin.app.figures.style import DISC, MarkKind
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics import from_specular
from goniotwin.twin.optics.geometry.coordinates import HALF_TURN_DEG, incidence_deg, is_lit_from_behind, zenith_and_azimuth

PIXELS = 400
"""Side of the image."""
EMPTY, PLANNED, LEAST_LEVEL = 0, 1, 2
"""Levels of a pixel: nothing, a planned direction, and the first of LEVELS for values."""
FILL = 0.5
"""Radius of a point over the side of its share of the hemisphere."""
MOST_RADIUS, LEAST_RADIUS = 9.0, 1.0
NOTHING = "Measured directions appear here."
LOW = 270
"""Height in logical pixels below which the text is omitted."""
MORE_POINTS = 1.05
"""Growth of the number of points after which their scale is computed again, unless their extremes change."""
NEAR_DEG = 5.0
"""Distance of the mouse from a point whose value is shown."""
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


class HemisphereMap(QWidget):
    """The values of a setting over the hemisphere; points in alarm have a red square, those not to be trusted a cross."""

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self._colours = colours
        self._setting: Setting | None = None
        self._radius = LEAST_RADIUS
        self._mirrored = False
        self._shown: MapPoints | None = None
        self._values = np.full((PIXELS, PIXELS), np.nan, dtype=np.float32)
        self._levels = np.zeros((PIXELS, PIXELS), dtype=np.uint8)
        self._plane: tuple[Series, ...] = ()
        self._ends, self._scaled = (0.0, 0.0), 0
        self._mark = ""
        self._view = pg.PlotWidget()
        self._view.setAccessibleName("Hemisphere of the run")
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
        self._text = QLabel(NOTHING)
        self._text.setWordWrap(True)
        self._text.setAccessibleName("The hemisphere as text")
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(2)
        layout.addWidget(self._view, 1)
        layout.addWidget(self.colour_bar)
        layout.addWidget(self._text)
        self._view.scene().sigMouseMoved.connect(self._follow_mouse)
        table = np.zeros((LEAST_LEVEL + LEVELS, 4), dtype=np.uint8)
        table[PLANNED] = [int(DISC.dim[k : k + 2], 16) for k in (1, 3, 5)] + [255]
        table[LEAST_LEVEL:] = np.insert(colour_table("values"), 3, 255, axis=1)
        self._image.setLookupTable(table)
        self.set_colours(colours)
        self.clear()

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

    def clear(self, mark: str = "", *, mirrored: bool = False) -> None:
        """Clear the map; `mark` is its title (SIMULATED, or empty). `mirrored`: half of an isotropic sample is measured."""
        self._mark, self._mirrored = mark, mirrored
        self._show_mark()
        self._setting, self._shown, self._plane = None, None, ()
        self._values[:] = np.nan
        self._levels[:] = EMPTY
        self.colour_bar.set_bar(None)
        self._write(NOTHING)
        self._show_panel()
        self._paint()

    def begin(self, setting: Setting, planned: MapPoints) -> None:
        """Show a setting from now on, none of which is measured; `planned` are its directions, as far as they are known."""
        self._setting, self._shown = setting, None
        self._values[:] = np.nan
        self._levels[:] = EMPTY
        for rows, columns in self._pixels(planned):
            self._levels[rows, columns] = PLANNED
        distinct = int(np.count_nonzero(self._levels))
        share = np.sqrt(np.pi / max(distinct, 1)) * PIXELS * HORIZON_DEG / (2.0 * EDGE_DEG)
        self._radius = float(np.clip(FILL * share, LEAST_RADIUS, MOST_RADIUS)) if distinct else 3.0
        self._show_panel()

    @property
    def setting(self) -> Setting | None:
        """The setting that is shown."""
        return self._setting

    def stamp(self, points: MapPoints) -> None:
        """Add points of the setting; `show_points` paints them."""
        shown = ~points.untrusted
        values = points.values[shown].astype(np.float32)
        levels = self._levels_of(values)
        reach = np.arange(-int(self._radius), int(self._radius) + 1)
        for rows, columns in self._pixels(points):
            for down in reach:
                for right in reach:
                    if down * down + right * right <= self._radius**2:
                        at = np.clip(rows[shown] + down, 0, PIXELS - 1), np.clip(columns[shown] + right, 0, PIXELS - 1)
                        self._values[at], self._levels[at] = values, levels

    def show_points(self, points: MapPoints, planned: int, label: str = "") -> None:
        """Paint what has been stamped; `points` are all of the setting, for the bar, the marks and the text."""
        self._shown = points
        trusted = points.where(~points.untrusted) if points.untrusted.any() else points
        if trusted.values.size:
            self._update_bar(trusted, label or quantity(None), last=points.values.size == planned)
        self._show_panel()
        text = f"{points.values.size} directions" if not planned else f"{points.values.size} of {planned} directions"
        if trusted.values.size:
            top = int(np.argmax(trusted.values))
            text += f", highest {trusted.values[top]:.3g} at zenith {trusted.zenith_deg[top]:.0f}°"
            text += f", azimuth {trusted.azimuth_deg[top]:.0f}°"
        alarms = int(points.alarms.sum())
        self._write(text + (f", ✗ {alarms} in alarm" if alarms else ""))
        self._paint()

    def _update_bar(self, points: MapPoints, label: str, *, last: bool) -> None:
        """Compute the scale of all points again where it may be another: it takes longer than all else of a repaint."""
        bar, size = self.colour_bar.bar, points.values.size
        ends = float(points.values.min()), float(points.values.max())
        if bar is not None and label == bar.label and ends == self._ends and not last and size < MORE_POINTS * self._scaled:
            return
        self._ends, self._scaled = ends, size
        found = value_bar(scale_of(points.values, points.u_values, None), points.values, label)
        if found != bar:
            self.colour_bar.set_bar(found)
            stamped = np.isfinite(self._values)
            self._levels[stamped] = self._levels_of(self._values[stamped])

    def show_plane(self, plane_deg: float | None, phi_deg: float | None) -> None:
        """Show the line of the cut: of the arc's plane at an azimuth, or of a plane through the specular direction."""
        if self._setting is None:
            return
        if phi_deg is None:
            polar, azimuth = np.full(2, HORIZON_DEG), np.array([plane_deg or 0.0, (plane_deg or 0.0) + HALF_TURN_DEG])
        else:
            signed = np.linspace(-180.0, 180.0, 361)
            phi = np.where(signed < 0.0, phi_deg + HALF_TURN_DEG, phi_deg)
            vectors = from_specular(incidence_deg(self._setting[2]), np.abs(signed), phi)
            polar, azimuth = zenith_and_azimuth(vectors[vectors[:, 2] >= -1e-9])
        self._plane = (Series(*places(polar, self._around(azimuth)), "predicted", line="dashed"),)
        self._show_panel()

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme; the disc has its own in both."""
        self._colours = colours
        self._view.setBackground(colours.base)
        self.colour_bar.set_colours(colours)
        self._text.setStyleSheet(f"color: {colours.text}")
        self._show_mark()

    def _show_panel(self) -> None:
        """Show rings, plane and marks."""
        marks: tuple[Marks, ...] = ()
        if self._setting is not None:
            marks = disc_marks(incidence_deg(self._setting[2]))
        if self._shown is not None:
            groups: dict[MarkKind, Flags] = {"untrusted": self._shown.untrusted, "alarm": self._shown.alarms}
            some = {kind: self._shown.where(chosen) for kind, chosen in groups.items() if chosen.any()}
            marks += tuple(Marks(kind, *self._places(each)) for kind, each in some.items())
        self._items.show(Panel(projection="disc", series=(*ring_lines(), *self._plane), marks=marks))

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

    @Slot(object)
    def _follow_mouse(self, at: QPointF) -> None:
        """Show the value of the direction under the mouse."""
        points = self._shown
        if points is None or not points.values.size:
            return
        mouse = self._plot.vb.mapSceneToView(at)
        x, y = self._places(points)
        nearest = int(np.argmin((x - mouse.x()) ** 2 + (y - mouse.y()) ** 2))
        near = np.hypot(x[nearest] - mouse.x(), y[nearest] - mouse.y()) < NEAR_DEG
        where = f"zenith {points.zenith_deg[nearest]:.1f}°, azimuth {points.azimuth_deg[nearest]:.1f}°"
        self._view.setToolTip(f"{where}: {points.values[nearest]:.4g}" if near else "")

    def _around(self, azimuth_deg: Floats) -> Floats:
        """Azimuths from the light's, counter-clockwise about the normal of the lit side."""
        return -azimuth_deg if self._setting is not None and is_lit_from_behind(self._setting[2]) else azimuth_deg

    def _places(self, points: MapPoints) -> tuple[Floats, Floats]:
        return places(polar_from_zenith(points.zenith_deg), self._around(points.azimuth_deg))

    def _pixels(self, points: MapPoints) -> Iterator[tuple[Ints, Ints]]:
        """Row and column of points in the image, and of their images on the other half."""
        x, y = self._places(points)
        column, *rows = (
            np.clip((0.5 * (1.0 + each / EDGE_DEG) * PIXELS).astype(np.int64), 0, PIXELS - 1)
            for each in (x, *((-y, y) if self._mirrored else (y,)))
        )
        for row in rows:
            yield row, column
