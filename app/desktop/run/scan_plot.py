"""The live plot of a cut: values on a logarithmic axis against the angle from the specular direction.

A logarithmic axis has no place for what is not positive, and pyqtgraph lets a whole curve vanish for one such value. So
values are taken to the logarithm here, and those within the noise become marks of their own at the lower edge.
"""

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import Qt
from PySide6.QtGui import QColor
from PySide6.QtWidgets import QLabel, QVBoxLayout, QWidget

from goniotwin.app.desktop.model.live_scan import Cut, Points
from goniotwin.app.desktop.theme import Colours
from goniotwin.arrays import Flags, Floats

ABOVE_NOISE = 2.0
"""In standard uncertainties: below it a value is not told from nothing."""
POINT_SIZE = 7


class LogAxis(pg.AxisItem):
    """Names decades and what is between them the same way: 0.01, 0.05, 100."""

    def __init__(self) -> None:
        super().__init__("left")
        self.setLogMode(y=True)
        self.enableAutoSIPrefix(False)
        self.setWidth(64)

    def logTickStrings(self, values: list[float], scale: float, spacing: float) -> list[str]:
        """pyqtgraph's name for it."""
        del scale, spacing
        return [f"{10.0**value:.2g}" if value < 2.0 else f"{10.0**value:.0f}" for value in values]


class CutPlot(QWidget):
    """The plot, and what it shows in words for those who do not see it."""

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self._colours = colours
        self._mark = ""
        self._cut: Cut | None = None
        self._spans: list[pg.LinearRegionItem] = []
        self._view = pg.PlotWidget(background=None, axisItems={"left": LogAxis()})
        self._view.setAccessibleName("Plot of the current cut")
        self._view.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._plot = self._view.getPlotItem()
        self._plot.setMenuEnabled(False)
        self._plot.showGrid(x=True, y=True, alpha=0.15)
        self._bars = pg.ErrorBarItem(beam=0.0)
        self._plot.addItem(self._bars)
        self._seen = pg.ScatterPlotItem(symbol="o", size=POINT_SIZE)
        self._hidden = pg.ScatterPlotItem(symbol="o", size=POINT_SIZE)
        self._lost = pg.ScatterPlotItem(symbol="t", size=POINT_SIZE - 2)
        for item in (self._hidden, self._lost, self._seen):
            self._plot.addItem(item)
        self._note = QLabel()
        self._note.setWordWrap(True)
        self._note.setAccessibleName("The current cut in words")
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self._view, 1)
        layout.addWidget(self._note)
        self.set_colours(colours)
        self.clear("")

    @property
    def summary(self) -> str:
        """What the plot shows, in words."""
        return self._note.text()

    @property
    def title(self) -> str:
        """What stands over the plot."""
        return f"{self._mark} {self._cut.title if self._cut else ''}".strip()

    def marks(self) -> dict[str, tuple[Floats, Floats]]:
        """What is drawn, by kind: angles and logarithms to the base 10."""
        return {kind: item.getData() for kind, item in (("seen", self._seen), ("hidden", self._hidden), ("lost", self._lost))}

    def clear(self, mark: str) -> None:
        """Empty, for a rig with this mark in the title (SIMULATED, or nothing)."""
        self._mark = mark
        self._cut = None
        for item in (self._seen, self._hidden, self._lost):
            item.setData([], [])
        self._bars.setData(x=np.empty(0), y=np.empty(0), top=np.empty(0), bottom=np.empty(0))
        self._show_spans(())
        self._plot.setXRange(-90.0, 90.0, padding=0.02)
        self._plot.setYRange(-4.0, 0.0)
        self._plot.enableAutoRange(axis="y")
        self._label()
        self._note.setText("The cut that is being measured appears here, point by point.")

    def show_cut(self, cut: Cut) -> None:
        """Shows a cut as far as it is measured."""
        fresh = self._cut is None or self._cut.title != cut.title
        self._cut = cut
        points = cut.points
        above = np.isfinite(points.values) & (points.values > 0) & (points.values > ABOVE_NOISE * points.u_values)
        logs = np.log10(np.where(above, points.values, 1.0))
        seen, hidden = above & ~points.hidden, above & points.hidden
        lost = np.isfinite(points.values) & ~above
        floor = float(np.min(logs[above])) - 0.3 if above.any() else -4.0
        self._seen.setData(points.x_deg[seen], logs[seen])
        self._hidden.setData(points.x_deg[hidden], logs[hidden])
        self._lost.setData(points.x_deg[lost], np.full(int(lost.sum()), floor))
        share = points.u_values[above] / points.values[above]
        self._bars.setData(x=points.x_deg[above], y=logs[above], top=np.log10(1.0 + share), bottom=-np.log10(1.0 - share))
        if fresh:
            self._show_spans(cut.spans_deg)
            self._plot.setXRange(*cut.range_deg, padding=0.02)
            self._plot.enableAutoRange(axis="y")
            self._label()
        self._note.setText(_in_words(cut, seen, int(hidden.sum()), int(lost.sum())))

    def set_colours(self, colours: Colours) -> None:
        """Follows the scheme."""
        self._colours = colours
        self._view.setBackground(colours.base)
        for name in ("left", "bottom", "right", "top"):
            self._plot.getAxis(name).setPen(colours.line)
            self._plot.getAxis(name).setTextPen(colours.text)
        self._seen.setPen(pg.mkPen(colours.base, width=0.5))
        self._seen.setBrush(pg.mkBrush(colours.points))
        self._hidden.setPen(pg.mkPen(colours.hidden, width=1.2))
        self._hidden.setBrush(pg.mkBrush(None))
        self._lost.setPen(pg.mkPen(colours.hidden, width=0.8))
        self._lost.setBrush(pg.mkBrush(None))
        self._bars.setData(pen=pg.mkPen(colours.points, width=1))
        self._show_spans(self._cut.spans_deg if self._cut else ())
        self._label()

    def _show_spans(self, spans: tuple[tuple[float, float], ...]) -> None:
        for each in self._spans:
            self._plot.removeItem(each)
        shade = QColor(self._colours.hidden)
        shade.setAlpha(50)
        self._spans = [pg.LinearRegionItem(span, movable=False, brush=pg.mkBrush(shade), pen=pg.mkPen(None)) for span in spans]
        for each in self._spans:
            each.setZValue(-10)
            self._plot.addItem(each)

    def _label(self) -> None:
        title = self._cut.title if self._cut else "No cut yet"
        marked = f"<b style='color:{self._colours.bad}'>{self._mark}</b>&nbsp;&nbsp; " if self._mark else ""
        self._plot.setTitle(marked + title, color=self._colours.text, size="10pt")
        style = {"color": self._colours.text}
        self._plot.setLabel("bottom", self._cut.x_label if self._cut else "θ from specular (°)", **style)
        self._plot.setLabel("left", self._cut.y_label if self._cut else "BSDF (1/sr)", **style)


def _in_words(cut: Cut, seen: Flags, hidden: int, lost: int) -> str:
    points: Points = cut.points
    text = f"●\u00a0{int(seen.sum())} measured"
    if seen.any():
        top = int(np.argmax(np.where(seen, points.values, -np.inf)))
        text += f", highest {points.values[top]:.3g} at {points.x_deg[top]:.1f}°"
    if hidden or cut.spans_deg:
        text += f"    ○\u00a0{hidden} in the mirror unit's shadow (shaded)"
    if lost:
        text += f"    ▽\u00a0{lost} within the noise (under {ABOVE_NOISE:g} u)"
    return text
