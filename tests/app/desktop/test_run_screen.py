"""The plots of the run screen: prediction, residual, alarm, scales, cursor, hemisphere."""

from dataclasses import replace

import numpy as np
import pyqtgraph as pg
import pytest
from PySide6.QtCore import Qt
from pytestqt.qtbot import QtBot

from goniotwin.app.desktop.disc import LEAST_LEVEL
from goniotwin.app.desktop.model.run_points import MapPoints, match
from goniotwin.app.desktop.run.axes import ValueAxis
from goniotwin.app.desktop.run.hemisphere import HemisphereMap
from goniotwin.app.desktop.run.live_plot import ScanPlot
from goniotwin.app.desktop.theme import LIGHT
from goniotwin.app.figures.hemisphere import LEVELS
from goniotwin.app.figures.scale import SCALES, Scale
from goniotwin.arrays import Ints
from tests.app.desktop.test_live_scan import scan_data

KEY = (("satin", 550.0, 30.0, 0.0), 0.0)


@pytest.fixture
def plot(qtbot: QtBot) -> ScanPlot:
    plot = ScanPlot(LIGHT)
    qtbot.addWidget(plot)
    plot.resize(500, 400)
    plot.show()
    return plot


@pytest.fixture
def view(plot: ScanPlot) -> pg.GraphicsLayoutWidget:
    """The plot of the values in row 0, and that of the residuals in row 1."""
    return plot.findChild(pg.GraphicsLayoutWidget)


def show(plot: ScanPlot, values: list[float], expected: list[float], u: float = 0.01) -> None:
    """Show values with a u beside expected ones."""
    here, there = (scan_data(each, [u] * len(each), [False] * len(each)) for each in (values, expected))
    here, there = (replace(each, y_label="BSDF (1/sr)", key=KEY) for each in (here, there))
    plot.show_cut(match(here, there))


def test_a_residual_beyond_4_u_is_marked_and_named(plot: ScanPlot, view: pg.GraphicsLayoutWidget) -> None:
    show(plot, [1.0, 1.02, 0.95], [1.0, 1.0, 1.0])
    assert plot.alarms == 1
    assert "□\u00a01 residual above 4 u" in plot.summary
    assert "predicted ± 2 u" in plot.summary
    shown = plot.residual_marks()
    assert shown["measured"][1] == pytest.approx([0.0, 2.0])
    ((kind, (x, y)),) = [each for each in shown.items() if each[0] != "measured"]
    assert kind in ("alarm", "alarm below")
    assert x.tolist() == [2.0]
    assert -5.0 <= y[0] <= -4.0
    assert view.getItem(1, 0).isVisible()
    plot.show_cut(match(scan_data([1.0], [0.01], [False]), None))
    assert not view.getItem(1, 0).isVisible()
    assert plot.alarms == 0


def test_a_prediction_without_points_is_shown_where_it_is_and_a_long_title_is_shortened(
    plot: ScanPlot, view: pg.GraphicsLayoutWidget
) -> None:
    show(plot, [np.nan, np.nan], [1e-6, 2e-6], u=1e-8)
    assert plot.line.getData()[1] == pytest.approx(np.log10([1e-6, 2e-6]))
    long = replace(scan_data([1.0], [0.01], [False]), title="facade panel after weathering: σ 60°, plane of incidence, 550 nm")
    plot.clear("SIMULATED (seed 1)")
    plot.show_cut(match(long, None))
    drawn = view.getItem(0, 0)
    assert drawn.sceneBoundingRect().right() <= view.width()
    assert "…" in drawn.titleLabel.text
    assert "SIMULATED" in drawn.titleLabel.text


def test_the_cursor_reads_a_value_by_mouse_or_by_arrow_keys(
    qtbot: QtBot, plot: ScanPlot, view: pg.GraphicsLayoutWidget
) -> None:
    show(plot, [1.0, 1.02, 0.95], [1.0, 1.0, 1.0])
    for _ in range(3):
        qtbot.keyClick(view, Qt.Key.Key_Right)
    assert plot.reading.startswith("2.00°: 0.95 ± 0.01 1/sr (u), predicted 1, residual -5.0 u")
    assert plot.reading.endswith("✗ ALARM")
    qtbot.keyClick(view, Qt.Key.Key_Left)
    assert plot.reading.startswith("1.00°: 1.02")
    assert "ALARM" not in plot.reading
    for key, at in ((Qt.Key.Key_Home, "0.00°"), (Qt.Key.Key_End, "2.00°")):
        qtbot.keyClick(view, key)
        assert plot.reading.startswith(at)


def test_a_residual_beyond_the_range_is_an_arrow_and_the_predicted_line_has_gaps(plot: ScanPlot) -> None:
    show(plot, [1.0, 0.05, 1.05, 1.96], [1.0] * 4)
    alarms = {kind: x.tolist() for kind, (x, _y) in plot.residual_marks().items() if kind != "measured"}
    assert alarms == {"alarm below": [1.0], "alarm": [2.0], "alarm above": [3.0]}
    here = scan_data([1.0] * 40, [0.01] * 40, [False] * 40)
    x = np.concatenate([np.arange(20.0), np.arange(50.0, 70.0)])
    here = replace(here, y_label="BSDF (1/sr)", key=KEY, points=replace(here.points, x_deg=x))
    plot.show_cut(match(here, here))
    shown, values = plot.line.getData()
    assert np.flatnonzero(np.isnan(values)).tolist() == [20]
    assert shown.size == 41
    assert plot.line.opts["connect"] == "finite"
    plot.grab()


@pytest.mark.parametrize("scale", SCALES)
def test_each_scale_shows_all_values_and_the_values_at_its_ticks(
    plot: ScanPlot, view: pg.GraphicsLayoutWidget, scale: str
) -> None:
    plot.set_scale(next(each for each in SCALES if each == scale))
    show(plot, [1.0, 100.0, -0.5], [1.0, 100.0, 0.0])
    plot.grab()
    assert sum(len(x) for x, _y in plot.marks().values()) == 3
    drawn = view.getItem(0, 0)
    axis = drawn.getAxis("left")
    low, high = drawn.viewRange()[1]
    (texts, *_more) = axis.tickValues(low, high, 300.0)
    assert len(texts[1]) >= 3
    assert len(set(axis.tickStrings(texts[1], 1.0, 1.0))) == len(texts[1])


def test_a_symmetric_scale_has_zero_and_both_signs() -> None:
    scale = Scale("symlog", 0.0, 100.0, 1e-3)
    axis = ValueAxis(scale)
    low, high = scale.transform(np.array([-1.0, 100.0]))
    ticks = axis.tickValues(low, high, 400.0)[0][1]
    texts = axis.tickStrings(ticks, 1.0, 1.0)
    assert "0" in texts
    assert {"-1", "100"} & set(texts)
    assert ticks == sorted(ticks)


def points(zenith: list[float], azimuth: list[float], values: list[float], alarms: list[bool] | None = None) -> MapPoints:
    none = np.zeros(len(values), dtype=bool)
    u = 0.01 * np.array(values)
    return MapPoints(np.array(zenith), np.array(azimuth), np.array(values), u, none, np.array(alarms or none, dtype=bool))


def image_of(shown: HemisphereMap) -> Ints:
    """The levels of the image that is drawn; rows go up."""
    (view,) = shown.findChildren(pg.PlotWidget)
    (image,) = [each for each in view.getPlotItem().items if isinstance(each, pg.ImageItem)]
    return np.asarray(image.image, dtype=np.int64)


def test_the_hemisphere_fills_where_a_direction_is(qtbot: QtBot) -> None:
    shown = HemisphereMap(LIGHT)
    qtbot.addWidget(shown)
    shown.begin(KEY[0], points([], [], []))
    assert shown.filled == 0
    some = points([30.0, 60.0], [180.0, 0.0], [10.0, 0.1], [True, False])
    shown.stamp(some)
    shown.show_points(some, 40)
    image = image_of(shown)
    rows, columns = np.nonzero(image >= LEAST_LEVEL)
    middle = image.shape[0] / 2
    left, right = columns < middle, columns > middle
    assert left.any()
    assert right.any()
    assert np.abs(rows - middle).max() < 10  # in the plane of incidence
    top = LEAST_LEVEL + LEVELS - 1
    assert set(image[rows[right], columns[right]].tolist()) == {top}  # the specular side has the 10
    assert image[rows[left], columns[left]].max() < top
    assert "2 of 40 directions" in shown.summary
    assert "highest 10 at zenith 30°, azimuth 180°" in shown.summary
    assert "1 in alarm" in shown.summary
    shown.show_plane(0.0, None)
    shown.show_plane(None, 45.0)
    shown.grab()
    shown.clear()
    assert shown.filled == 0


def test_a_sample_lit_on_its_back_is_seen_along_the_normal_of_that_side_and_a_half_has_its_image(qtbot: QtBot) -> None:
    """A direction at azimuth 210 of the rig is above the plane of incidence from the front, and below it from the back."""
    for sigma, zenith, mirrored, expected in (
        (30.0, 40.0, False, {1}),
        (150.0, 140.0, False, {-1}),
        (30.0, 40.0, True, {-1, 1}),
    ):
        shown = HemisphereMap(LIGHT)
        qtbot.addWidget(shown)
        shown.clear(mirrored=mirrored)
        shown.begin(("satin", 550.0, sigma, 0.0), points([], [], []))
        some = points([zenith], [210.0], [1.0])
        shown.stamp(some)
        shown.show_points(some, 1)
        image = image_of(shown)
        rows, columns = np.nonzero(image >= LEAST_LEVEL)
        middle = (image.shape[0] - 1) / 2
        assert set(np.sign(rows - middle).astype(int).tolist()) == expected
        assert np.all(columns > middle)  # the specular side
