"""The back end for the window: a panel drawn by pyqtgraph. Its items are made once; a live update gives them new data only."""

from typing import Any

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import Qt
from PySide6.QtGui import QColor

from goniotwin.app.figures.description import Colour, Guide, Line, Marks, Panel, Series, Span
from goniotwin.app.figures.scale import Scale
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
            item.setPen(pg.mkPen(None) if style.symbol == "dot" else edge)
            item.setBrush(pg.mkBrush(colour if style.filled else None))
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


def _colour(colour: Colour, palette: Palette) -> str:
    return str(getattr(palette, colour, colour))
