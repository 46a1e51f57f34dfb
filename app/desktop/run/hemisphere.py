"""The hemisphere of a run, seen along the normal: an image that fills as rows arrive.

A point is stamped into the image once; only the image is painted, so that the time does not grow with the points.
"""

import cmap
import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QPointF, QRectF, Qt, Slot
from PySide6.QtGui import QColor, QPainter, QPaintEvent, QPixmap, QResizeEvent
from PySide6.QtWidgets import QHBoxLayout, QLabel, QVBoxLayout, QWidget

from goniotwin.app.campaign.geometry.directions import polar_from_zenith
from goniotwin.app.desktop.model.live_scan import Setting
from goniotwin.app.desktop.model.run_points import MapPoints
from goniotwin.app.desktop.theme import Colours
from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics import from_specular
from goniotwin.twin.optics.geometry.coordinates import SPECULAR_AZIMUTH_DEG, incidence_deg, zenith_and_azimuth

PIXELS = 400
"""Side of the image."""
EDGE = 1.06
"""Half the side of the image, with the radius of the horizon as the unit."""
EMPTY, PLANNED, LEAST_LEVEL, LEVELS = 0, 1, 2, 254
"""Levels of a pixel: nothing, a planned direction, and the first of so many for values."""
DECADES = 4.0
"""Largest range of the colours."""
RINGS_DEG = (30.0, 60.0, 90.0)
RING_TEXT_DEG = 65.0
"""Azimuth of the rings' texts: few arcs stand there."""
FILL = 0.5
"""Radius of a point over the side of its share of the hemisphere."""
MOST_RADIUS, LEAST_RADIUS = 9.0, 1.0
ALARM_SIZE, SMALL_ALARM, MANY_ALARMS = 10, 4, 60
"""Size of the square of an alarm, and that of each where there are more than so many: the values stay visible between them."""
NOTHING = "Measured directions appear here."


class ColourBar(QWidget):
    """The colours of the map, from low to high."""

    def __init__(self) -> None:
        super().__init__()
        self._colours = np.zeros((LEVELS, 3), dtype=np.uint8)
        self.setFixedHeight(10)
        self.setMinimumWidth(40)

    def set_colours(self, colours: np.ndarray) -> None:
        """Take the colours (LEVELS, 3)."""
        self._colours = colours
        self.update()

    def paintEvent(self, event: QPaintEvent) -> None:
        """Paint a strip; Qt calls it."""
        del event
        painter = QPainter(self)
        strip = QPixmap.fromImage(_image_of(self._colours[None, :, :]))
        painter.drawPixmap(self.rect(), strip)
        painter.end()


def _image_of(pixels: np.ndarray) -> pg.QtGui.QImage:
    rgb = np.ascontiguousarray(pixels)
    height, width, _ = rgb.shape
    return pg.QtGui.QImage(rgb.data, width, height, 3 * width, pg.QtGui.QImage.Format.Format_RGB888).copy()


class HemisphereMap(QWidget):
    """The values of a setting over the hemisphere, on a logarithmic scale of lightness; points in alarm have a red square."""

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self._colours = colours
        self._setting: Setting | None = None
        self._radius = LEAST_RADIUS
        self._shown: MapPoints | None = None
        self._logs = np.full((PIXELS, PIXELS), np.nan, dtype=np.float32)
        self._levels = np.zeros((PIXELS, PIXELS), dtype=np.uint8)
        self._range = (0.0, 1.0)
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
        plot.setRange(xRange=(-EDGE, EDGE), yRange=(-EDGE, EDGE), padding=0.0)
        self._image = pg.ImageItem(axisOrder="row-major")
        plot.addItem(self._image)
        around = np.radians(np.linspace(0.0, 360.0, 181))
        self._rings = [pg.PlotCurveItem(each / 90.0 * np.cos(around), each / 90.0 * np.sin(around)) for each in RINGS_DEG]
        self._texts = [pg.TextItem(f"{each:g}°", anchor=(0.5, 0.5)) for each in RINGS_DEG[:-1]]
        self._plane = pg.PlotCurveItem()
        self._specular = pg.ScatterPlotItem(symbol="+", size=15)
        self._light = pg.ScatterPlotItem(symbol="star", size=14)
        self._alarms = pg.ScatterPlotItem(symbol="s", size=ALARM_SIZE)
        for item in (*self._rings, self._plane, self._specular, self._light, self._alarms, *self._texts):
            plot.addItem(item)
        for text, at in zip(self._texts, RINGS_DEG, strict=False):
            text.setPos(at / 90.0 * np.cos(np.radians(RING_TEXT_DEG)), at / 90.0 * np.sin(np.radians(RING_TEXT_DEG)))
        self._bar = ColourBar()
        self._low, self._high = QLabel(), QLabel()
        self._low.setAccessibleName("Lowest value of the colours")
        self._high.setAccessibleName("Highest value of the colours")
        self._text = QLabel(NOTHING)
        self._text.setWordWrap(True)
        self._text.setAccessibleName("The hemisphere as text")
        legend = QHBoxLayout()
        legend.addWidget(self._low)
        legend.addWidget(self._bar, 1)
        legend.addWidget(self._high)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(2)
        layout.addWidget(self._view, 1)
        layout.addLayout(legend)
        layout.addWidget(self._text)
        self._view.scene().sigMouseMoved.connect(self._follow_mouse)
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
        return int(np.isfinite(self._logs).sum())

    def clear(self, mark: str = "") -> None:
        """Clear the map; `mark` is its title (SIMULATED, or empty)."""
        self._mark = mark
        self._show_mark()
        self._setting, self._shown = None, None
        self._logs[:] = np.nan
        self._levels[:] = EMPTY
        for item in (self._specular, self._light, self._alarms, self._plane):
            item.setData([], [])
        self._low.setText("")
        self._high.setText("")
        self._write(NOTHING)
        self._paint()

    def begin(self, setting: Setting, planned: MapPoints) -> None:
        """Show a setting from now on, none of which is measured; `planned` are its directions, as far as they are known."""
        self._setting, self._shown = setting, None
        self._logs[:] = np.nan
        self._levels[:] = EMPTY
        rows, columns = _pixels(planned)
        self._levels[rows, columns] = PLANNED
        distinct = int(np.count_nonzero(self._levels))
        share = np.sqrt(np.pi / max(distinct, 1)) * PIXELS / (2.0 * EDGE)
        self._radius = float(np.clip(FILL * share, LEAST_RADIUS, MOST_RADIUS)) if distinct else 3.0
        radius = incidence_deg(setting[2]) / 90.0
        turn = np.radians(SPECULAR_AZIMUTH_DEG)
        self._specular.setData([radius * np.cos(turn)], [radius * np.sin(turn)])
        self._light.setData([-radius * np.cos(turn)], [-radius * np.sin(turn)])

    @property
    def setting(self) -> Setting | None:
        """The setting that is shown."""
        return self._setting

    def stamp(self, points: MapPoints) -> None:
        """Add points of the setting; `show_points` paints them."""
        shown = points.values > 0.0
        rows, columns = (each[shown] for each in _pixels(points))
        logs = np.log10(points.values[shown]).astype(np.float32)
        levels = self._levels_of(logs)
        reach = np.arange(-int(self._radius), int(self._radius) + 1)
        for down in reach:
            for right in reach:
                if down * down + right * right <= self._radius**2:
                    at = np.clip(rows + down, 0, PIXELS - 1), np.clip(columns + right, 0, PIXELS - 1)
                    self._logs[at], self._levels[at] = logs, levels

    def show_points(self, points: MapPoints, planned: int) -> None:
        """Paint what has been stamped; `points` are all of the setting, for the marks and the text."""
        self._shown = points
        known = points.values[points.values > 0.0]
        if known.size:
            high = float(np.log10(known.max()))
            low = max(float(np.log10(known.min())), high - DECADES)
            if self._range != (low, max(high, low + 0.3)):
                self._range = (low, max(high, low + 0.3))
                stamped = np.isfinite(self._logs)
                self._levels[stamped] = self._levels_of(self._logs[stamped])
            self._low.setText(f"{10.0**low:.2g}")
            self._high.setText(f"{10.0**high:.2g}")
        rows = points.alarms
        self._alarms.setSize(ALARM_SIZE if rows.sum() <= MANY_ALARMS else SMALL_ALARM)
        self._alarms.setData(*_places(points.zenith_deg[rows], points.azimuth_deg[rows]))
        text = f"{points.values.size} directions" if not planned else f"{points.values.size} of {planned} directions"
        if known.size:
            top = int(np.argmax(points.values))
            text += f", highest {points.values[top]:.3g} at zenith {points.zenith_deg[top]:.0f}°"
            text += f", azimuth {points.azimuth_deg[top]:.0f}°"
        alarms = int(rows.sum())
        self._write(text + (f", ✗ {alarms} in alarm" if alarms else ""))
        self._paint()

    def show_plane(self, plane_deg: float | None, phi_deg: float | None) -> None:
        """Show the line of the cut: of the arc's plane at an azimuth, or of a plane through the specular direction."""
        if self._setting is None:
            return
        if phi_deg is None:
            x = np.array([-1.0, 1.0]) * np.cos(np.radians(plane_deg or 0.0))
            y = np.array([-1.0, 1.0]) * np.sin(np.radians(plane_deg or 0.0))
        else:
            signed = np.linspace(-180.0, 180.0, 361)
            phi = np.where(signed < 0.0, phi_deg + 180.0, phi_deg)
            vectors = from_specular(incidence_deg(self._setting[2]), np.abs(signed), phi)
            above = vectors[:, 2] >= -1e-9
            zenith, azimuth = zenith_and_azimuth(vectors[above])
            x, y = (zenith / 90.0 * trig(np.radians(azimuth)) for trig in (np.cos, np.sin))
        self._plane.setData(x, y)

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        self._view.setBackground(colours.base)
        values = np.asarray(255.0 * np.asarray(cmap.Colormap(colours.map).lut(LEVELS))[:, :3], dtype=np.uint8)
        self._bar.set_colours(values)
        others = [(each.red(), each.green(), each.blue()) for each in (QColor(colours.base), QColor(colours.line))]
        self._image.setLookupTable(np.vstack((np.array(others, dtype=np.uint8), values)))
        for each in self._rings:
            each.setPen(pg.mkPen(colours.line, width=1))
        ground = QColor(colours.base)
        ground.setAlpha(200)
        for text in self._texts:
            text.setColor(colours.text)
            text.fill = pg.mkBrush(ground)  # to be read over the points
            text.update()
        self._plane.setPen(pg.mkPen(colours.predicted, width=1.5, style=Qt.PenStyle.DashLine))
        self._specular.setPen(pg.mkPen(colours.bad, width=2))
        self._light.setPen(pg.mkPen(colours.text, width=1))
        self._light.setBrush(pg.mkBrush(colours.simulated))
        self._alarms.setPen(pg.mkPen(colours.bad, width=2))
        self._alarms.setBrush(pg.mkBrush(None))
        self._text.setStyleSheet(f"color: {colours.text}")
        self._show_mark()
        self._paint()

    def _levels_of(self, logs: np.ndarray) -> np.ndarray:
        low, high = self._range
        scaled = (logs - low) * ((LEVELS - 1) / (high - low))
        return (LEAST_LEVEL + np.clip(scaled, 0, LEVELS - 1)).astype(np.uint8)

    def _paint(self) -> None:
        self._image.setImage(self._levels, autoLevels=False, levels=(0, LEAST_LEVEL + LEVELS - 1))
        self._image.setRect(QRectF(-EDGE, -EDGE, 2.0 * EDGE, 2.0 * EDGE))  # possible with an image only

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
        x, y = _places(points.zenith_deg, points.azimuth_deg)
        nearest = int(np.argmin((x - mouse.x()) ** 2 + (y - mouse.y()) ** 2))
        near = np.hypot(x[nearest] - mouse.x(), y[nearest] - mouse.y()) < NEAR
        where = f"zenith {points.zenith_deg[nearest]:.1f}°, azimuth {points.azimuth_deg[nearest]:.1f}°"
        self._view.setToolTip(f"{where}: {points.values[nearest]:.4g}" if near else "")


LOW = 270
"""Height in logical pixels below which the text is omitted."""
NEAR = 0.06
"""Distance of the mouse from a point whose value is shown, with the radius of the horizon as the unit."""


def _places(zenith_deg: Floats, azimuth_deg: Floats) -> tuple[Floats, Floats]:
    """Places in the map, seen along the normal of the side: the radius is the polar angle."""
    radius = polar_from_zenith(zenith_deg) / 90.0
    azimuth = np.radians(azimuth_deg)
    return radius * np.cos(azimuth), radius * np.sin(azimuth)


def _pixels(points: MapPoints) -> tuple[Ints, Ints]:
    """Row and column of points in the image."""
    x, y = _places(points.zenith_deg, points.azimuth_deg)
    rows, columns = ((0.5 * (1.0 + each / EDGE) * PIXELS).astype(np.int64) for each in (y, x))
    return np.clip(rows, 0, PIXELS - 1), np.clip(columns, 0, PIXELS - 1)
