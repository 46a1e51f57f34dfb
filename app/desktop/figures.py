"""The back end for the window: a panel drawn by pyqtgraph. Its items are made once; a live update gives them new data only."""

from dataclasses import replace
from typing import Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import Qt
from PySide6.QtGui import QColor

from goniotwin.app.figures.description import Colour, Guide, Line, Marks, Panel, Series, Span
from goniotwin.app.figures.scale import Scale, tick_text, ticks
from goniotwin.app.figures.style import (
    BAND_ALPHA,
    BAR_WIDTH,
    GUIDE_WIDTH,
    HALO_WIDTH,
    LINE_WIDTH,
    MARKS,
    OPEN_WIDTH,
    SPAN_ALPHA,
    MarkKind,
    Palette,
    Symbol,
)
from goniotwin.arrays import Floats

SYMBOLS: dict[Symbol, str] = {
    "circle": "o",
    "square": "s",
    "triangle": "t1",
    "diamond": "d",
    "triangle down": "t",
    "pentagon": "p",
    "cross": "x",
    "plus": "+",
    "star": "star",
    "dot": "o",
}
LINES = {
    "solid": Qt.PenStyle.SolidLine,
    "dashed": Qt.PenStyle.DashLine,
    "dotted": Qt.PenStyle.DotLine,
    "none": Qt.PenStyle.NoPen,
}
PIXELS_A_POINT = 4.0 / 3.0
LINEAR = Scale("linear", 0.0, 1.0)
SPOKES_DEG, PIXELS_OF_RING = range(-90, 91, 30), 40.0
"""Spokes of a polar panel on the side of the light, and the least distance of two of its circles."""
ANGLES_AT = 1.06
"""Where the angles of the spokes are, over the outermost circle."""
ORDER: tuple[MarkKind, ...] = tuple(MARKS)
"""The later ones are above."""


class _SeriesItems:
    """The items of one series: its line, and its band or bars."""

    def __init__(self, plot: pg.PlotItem) -> None:
        self._bounds = pg.PlotCurveItem(), pg.PlotCurveItem()
        self._band = pg.FillBetweenItem(*self._bounds)
        self.line = pg.PlotCurveItem()
        self.bars = pg.ErrorBarItem(x=np.empty(0), y=np.empty(0), top=np.empty(0), bottom=np.empty(0), beam=0.0)
        self.line.setZValue(5)  # points may be dense
        self._style: tuple[str, str] | None = None
        self._shown: tuple[Series | None, Scale, Palette] | None = None
        for item in (self._band, self.line, self.bars):
            plot.addItem(item)

    def show(self, series: Series | None, scale: Scale, palette: Palette) -> None:
        """Show a series, or none; one that is shown already costs nothing."""
        if (series, scale, palette) == self._shown:
            return
        self._shown = series, scale, palette
        empty = np.empty(0)
        x, y, low, high = empty, empty, empty, empty
        if series is not None:
            self._set_colour(_colour(series.colour, palette), series.line)
            x, y = series.x, scale.transform(series.y)
            if series.lower is not None and series.upper is not None:
                low, high = scale.transform(series.lower), scale.transform(series.upper)
        bars = series is not None and series.bars
        self.line.setData(x, y, connect="finite")
        for curve, each in zip(self._bounds, (low, high), strict=True):
            curve.setData(*((empty, empty) if bars or not low.size else (x, each)), connect="finite")
        self._band.setVisible(not bars and low.size > 1)
        known = np.isfinite(low) & np.isfinite(high) if bars else np.zeros(low.size, dtype=bool)
        half = 0.5 * (high - low)[known]
        self.bars.setData(x=x[known] if low.size else empty, y=low[known] + half, top=half, bottom=half)

    def _set_colour(self, colour: str, line: Line) -> None:
        if (colour, line) != self._style:  # each would draw the last data again
            self._style = colour, line
            self.line.setPen(pg.mkPen(colour, width=PIXELS_A_POINT * LINE_WIDTH, style=LINES[line]))
            self.bars.setData(pen=pg.mkPen(colour, width=PIXELS_A_POINT * BAR_WIDTH))
            shade = QColor(colour)
            shade.setAlphaF(BAND_ALPHA)
            self._band.setBrush(pg.mkBrush(shade))


class PanelItems:
    """The items of a panel in a plot; the axes of values have the transform of its scale."""

    def __init__(self, plot: pg.PlotItem, palette: Palette) -> None:
        self.mark_share = 1.0
        """Size of the marks over that of their style."""
        self._plot = plot
        self._palette = palette
        self._panel = Panel()
        self._series: list[_SeriesItems] = []
        self._marks: dict[MarkKind, pg.ScatterPlotItem] = {}
        self._drawn: dict[MarkKind, tuple[list[Marks], Scale, Palette]] = {}
        self._styles: dict[MarkKind, tuple[str, Palette]] = {}
        self._halos: dict[MarkKind, pg.ScatterPlotItem] = {}
        self._spans: list[pg.LinearRegionItem] = []
        self._guides: list[pg.InfiniteLine] = []
        self._texts: list[pg.TextItem] = []

    @property
    def lines(self) -> list[pg.PlotCurveItem]:
        """The lines of the series, in their order."""
        return [each.line for each in self._series]

    def marks(self) -> dict[MarkKind, tuple[Floats, Floats]]:
        """The marks that are drawn, by kind: abscissae, and values on the scale."""
        found = {kind: item.getData() for kind, item in self._marks.items()}
        return {kind: (x, y) for kind, (x, y) in found.items() if len(x)}

    def show(self, panel: Panel) -> None:
        """Show a panel in the place of the last one."""
        self._show_texts(panel)
        if panel.projection == "polar":
            panel = flat_panel(panel)
        dots = [(each, np.isfinite(each.y)) for each in panel.series if each.symbol is not None]
        few = tuple(Marks("measured", each.x[there], each.y[there], each.colour) for each, there in dots)
        panel = replace(panel, marks=(*panel.marks, *few)) if few else panel
        last, self._panel = self._panel, panel
        scale = panel.scale or LINEAR
        while len(self._series) < len(panel.series):
            self._series.append(_SeriesItems(self._plot))
        for k, items in enumerate(self._series):
            items.show(panel.series[k] if k < len(panel.series) else None, scale, self._palette)
        for kind in {*self._marks, *(each.kind for each in panel.marks)}:
            self._show_marks(kind, [each for each in panel.marks if each.kind == kind], scale)
        if panel.spans != last.spans:
            self._show_spans(panel.spans)
        if panel.guides != last.guides:
            self._show_guides(panel.guides)

    def set_palette(self, palette: Palette) -> None:
        """Draw in the colours of another palette."""
        self._palette = palette
        self._show_spans(self._panel.spans)
        self._show_guides(self._panel.guides)
        self.show(self._panel)

    def _show_marks(self, kind: MarkKind, several: list[Marks], scale: Scale) -> None:
        if (several, scale, self._palette) == self._drawn.get(kind):
            return
        self._drawn[kind] = several, scale, self._palette
        item = self._marks.get(kind)
        style = MARKS[kind]
        if item is None:
            item = self._marks[kind] = pg.ScatterPlotItem(symbol=SYMBOLS[style.symbol], size=PIXELS_A_POINT * style.size)
            item.setZValue(6 + 0.1 * ORDER.index(kind))
            self._plot.addItem(item)
        colour = _colour(style.colour or (several[0].colour if several else "points"), self._palette)
        if (colour, self._palette) != self._styles.get(kind):  # each would draw the last data again
            self._styles[kind] = colour, self._palette
            edge = (
                pg.mkPen(self._palette.base, width=0.5) if style.filled else pg.mkPen(colour, width=PIXELS_A_POINT * OPEN_WIDTH)
            )
            bare = style.symbol == "dot" or (style.filled and self.mark_share < 1.0)
            item.setPen(pg.mkPen(None) if bare else edge)
            item.setBrush(pg.mkBrush(colour if style.filled else None))
        item.setSize(self.mark_share * PIXELS_A_POINT * style.size)
        x, y = (np.concatenate([np.empty(0), *(getattr(each, name) for each in several)]) for name in ("x", "y"))
        item.setData(x, scale.transform(y))
        if self._panel.projection == "disc" and not style.filled:  # to be seen on any colour of the map
            if kind not in self._halos:
                halo = pg.ScatterPlotItem(symbol=SYMBOLS[style.symbol], size=item.opts["size"], brush=None)
                halo.setPen(pg.mkPen(self._palette.base, width=PIXELS_A_POINT * HALO_WIDTH))
                halo.setZValue(item.zValue() - 0.05)
                self._halos[kind] = halo
                self._plot.addItem(halo)
            self._halos[kind].setData(x, y)

    def _show_texts(self, panel: Panel) -> None:
        """Show the values of the circles of a polar panel, and the angles of its spokes."""
        for each in self._texts:
            self._plot.removeItem(each)
        self._texts = []
        if panel.projection != "polar":
            return
        outside = ANGLES_AT * (panel.y.limits or (0.0, 1.0))[1]
        angles = [(outside * np.sin(at), outside * np.cos(at), f"{deg}°") for deg in SPOKES_DEG for at in (np.radians(deg),)]
        for x, y, text in [*((0.0, radius, text) for radius, text in rings(panel)), *angles]:
            item = pg.TextItem(text, color=self._palette.dim, anchor=(0.5, 0.5), fill=self._palette.base)
            item.setPos(x, y)
            item.setZValue(5.5)  # above the lines, below the marks
            self._texts.append(item)
            self._plot.addItem(item, ignoreBounds=True)

    def _show_spans(self, spans: tuple[Span, ...]) -> None:
        for each in self._spans:
            self._plot.removeItem(each)
        self._spans = []
        for span in spans:
            shade = QColor(_colour(span.colour, self._palette))
            shade.setAlphaF(SPAN_ALPHA)
            way = "vertical" if span.upright else "horizontal"
            ends, brush, pen = (span.low, span.high), pg.mkBrush(shade), pg.mkPen(None)
            region = pg.LinearRegionItem(ends, orientation=way, movable=False, brush=brush, pen=pen)
            region.setZValue(-10)
            self._spans.append(region)
            self._plot.addItem(region, ignoreBounds=True)

    def _show_guides(self, guides: tuple[Guide, ...]) -> None:
        for each in self._guides:
            self._plot.removeItem(each)
        self._guides = []
        for guide in guides:
            pen: Any = pg.mkPen(
                _colour(guide.colour, self._palette), width=PIXELS_A_POINT * GUIDE_WIDTH, style=LINES[guide.line]
            )
            self._guides.append(pg.InfiniteLine(guide.at, angle=90 if guide.upright else 0, pen=pen))
            self._plot.addItem(self._guides[-1], ignoreBounds=True)


def rings(panel: Panel) -> list[tuple[float, str]]:
    """The circles of a polar panel: their radii, and the values there."""
    scale, limits = panel.scale or LINEAR, panel.y.limits or (0.0, 1.0)
    low = float(np.log10(scale.floor)) if scale.log else 0.0
    at = ticks(scale, low, low + limits[1], 4.0 * PIXELS_OF_RING, PIXELS_OF_RING)
    return [(each - low, tick_text(scale, each)) for each in at if each > low]


def flat_panel(panel: Panel) -> Panel:
    """A polar panel as lines in a plane: the light comes from above, positive angles are on the right."""

    def flat(each: Any, radius: Floats) -> tuple[Floats, Floats]:
        return radius * np.sin(each.x), radius * np.cos(each.x)

    outer = (panel.y.limits or (0.0, 1.0))[1]
    around = np.linspace(-np.pi, np.pi, 181) if panel.angles else np.linspace(-np.pi / 2.0, np.pi / 2.0, 91)
    grid = [Series(radius * np.sin(around), radius * np.cos(around), "line") for radius, _ in (*rings(panel), (outer, ""))]
    spoke = np.array([-outer if panel.angles else 0.0, outer])
    grid += [Series(spoke * np.sin(each), spoke * np.cos(each), "line") for each in np.radians(SPOKES_DEG).tolist()]
    for arrow in panel.arrows:
        at = np.radians(arrow.angle_deg)
        ends = np.array([0.82, 1.0]) * outer
        grid.append(Series(ends * np.sin(at), ends * np.cos(at), arrow.colour))
    drawn = []
    for each in panel.series:
        x, y = flat(each, each.y)
        drawn.append(replace(each, x=x, y=y, lower=None, upper=None, symbol=None))
        for edge in (each.lower, each.upper):
            if edge is not None:
                x, y = flat(each, edge)
                drawn.append(replace(each, x=x, y=y, lower=None, upper=None, symbol=None, line="dashed", name=""))
    marks = tuple(replace(each, x=flat(each, each.y)[0], y=flat(each, each.y)[1]) for each in panel.marks)
    return replace(panel, projection="rectangular", scale=None, series=(*grid, *drawn), marks=marks, arrows=(), angles=())


def _colour(colour: Colour, palette: Palette) -> str:
    return str(getattr(palette, colour, colour))
