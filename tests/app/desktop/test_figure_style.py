"""One style of curves, shaded intervals, guides and marks, read back from what both back ends draw."""

import numpy as np
import pyqtgraph as pg
import pytest
from matplotlib.colors import to_rgba
from PySide6.QtGui import QPen
from pytestqt.qtbot import QtBot

from goniotwin.app.desktop.figures import PIXELS_A_POINT, PanelItems
from goniotwin.app.figures.description import Figure, Guide, Marks, Panel, Series, Span
from goniotwin.app.figures.matplotlib_figure import draw
from goniotwin.app.figures.style import PAPER


def points(pen: QPen) -> float:
    return pen.widthF() / PIXELS_A_POINT


def test_the_window_and_paper_have_the_same_opacities_and_widths(qtbot: QtBot) -> None:
    x, y = np.array([0.0, 1.0, 2.0]), np.array([1.0, 2.0, 1.0])
    curve, barred = (Series(x, y, "points", lower=y - 0.1, upper=y + 0.1, bars=bars) for bars in (False, True))
    marks = Marks("untrusted", x, y)
    panel = Panel(series=(curve, barred), marks=(marks,), guides=(Guide(1.0, "dim"),), spans=(Span(0.5, 1.5),))
    (axes,) = draw(Figure((panel,), (4.0, 3.0))).axes
    widget = pg.PlotWidget()
    qtbot.addWidget(widget)
    PanelItems(widget.getPlotItem(), PAPER).show(panel)
    items = widget.getPlotItem().items
    (span,) = [each for each in items if isinstance(each, pg.LinearRegionItem)]
    (guide,) = [each for each in items if isinstance(each, pg.InfiniteLine)]
    first = next(each for each in items if isinstance(each, pg.PlotCurveItem))
    bars = [each for each in items if isinstance(each, pg.ErrorBarItem)][1]
    band = next(each for each in items if isinstance(each, pg.FillBetweenItem))
    (crosses,) = [each for each in items if isinstance(each, pg.ScatterPlotItem)]

    (shade,) = axes.patches
    filled, lines = axes.collections
    drawn, _, marked, across = axes.lines
    assert span.brush.color().alphaF() == pytest.approx(to_rgba(shade.get_facecolor())[3], abs=0.005)
    assert band.brush().color().alphaF() == pytest.approx(np.ravel(filled.get_facecolor())[3], abs=0.005)
    assert points(first.opts["pen"]) == pytest.approx(drawn.get_linewidth())
    assert points(bars.opts["pen"]) == pytest.approx(np.ravel(lines.get_linewidth())[0])
    assert points(guide.pen) == pytest.approx(across.get_linewidth())
    assert points(crosses.opts["pen"]) == pytest.approx(marked.get_markeredgewidth())
