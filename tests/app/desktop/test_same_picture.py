"""One journal by window, plot and report: the same picture, read back from what is drawn."""

import base64
import re
from io import BytesIO
from pathlib import Path

import numpy as np
import pyqtgraph as pg
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from PySide6.QtCore import QObject, QPointF
from PySide6.QtGui import QImage
from PySide6.QtWidgets import QWidget
from pytestqt.qtbot import QtBot

import goniotwin
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.rehearsal.without_wires import rows_without_wires, run_without_wires
from goniotwin.app.campaign.running.events import RowCommitted
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.data.report.report import report_html
from goniotwin.app.desktop.model.live_scan import LiveScan
from goniotwin.app.desktop.model.run_points import match
from goniotwin.app.desktop.run.hemisphere import HemisphereMap
from goniotwin.app.desktop.run.live_plot import LivePlot, ScanPlot
from goniotwin.app.desktop.theme import DARK, LIGHT, Colours
from goniotwin.app.figures.hemisphere import colour_table
from goniotwin.app.figures.matplotlib_figure import picture
from goniotwin.app.rig import read_rig
from goniotwin.arrays import Floats
from tests.app.desktop.test_live_scan import complete
from tests.conftest import Writer

TILT_DEG = 6.0
"""Of the sample about the x axis: its lobe is beside the plane of incidence."""
SCHEDULE = """
name = "tilted"
samples = ["gaussian-5"]
etalon = "etalon"
symmetry = "anisotropic"
sigma_deg = [30]
beta_deg = { start = 0, stop = 352.5, step = 7.5 }
shift_deg = [0]
wavelength_nm = [550]
gains_v_per_a = [1e8]
readings = 2
dark_readings = 4
"""
DPI = 160


class Window(QObject):
    """The two plots of the run screen after a run."""

    def __init__(self, qtbot: QtBot, schedule: Path, rig: Path, colours: Colours) -> None:
        super().__init__()
        self.plot, self.hemisphere = ScanPlot(colours), HemisphereMap(colours)
        (self.disc,), (self.cut,) = self.hemisphere.findChildren(pg.PlotWidget), self.plot.findChildren(pg.GraphicsLayoutWidget)
        for widget, size in ((self.plot, (760, 480)), (self.hemisphere, (460, 560))):
            qtbot.addWidget(widget)
            widget.resize(*size)
            widget.show()
        live = LivePlot(self.plot, self.hemisphere, self, processes=False)
        plan = make_plan(read_schedule(schedule), read_rig(rig))
        model = plan.rig.model()
        assert model is not None
        live.start(plan, "SIMULATED (seed 1)")
        rows = list(rows_without_wires(plan, model))
        for k, each in enumerate(rows, 1):
            live.add_row(RowCommitted(each.row, each.data, k, len(rows), 0.0))
        live.finish()
        qtbot.waitUntil(lambda: self.hemisphere.summary.startswith("714 directions"), timeout=60_000)
        live.stop()
        scans = LiveScan(plan)
        for each in rows:
            scans.add_row(RowCommitted(each.row, each.data, 0, len(rows), 0.0))
        scans.finish()
        key = next(key for key in scans.scans if key[0][0] == "gaussian-5" and key[1] == 0.0)
        self.plot.show_cut(match(complete(scans, key), None))  # the plane of incidence, and not the last one of the run

    def pixels(self) -> Floats:
        return _pixels(self.disc)

    def place(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Row and column of places in degrees."""
        box = self.disc.getPlotItem().vb
        at = [self.disc.mapFromScene(box.mapViewToScene(QPointF(*each))) for each in zip(x, y, strict=True)]
        return np.array([each.y() for each in at]), np.array([each.x() for each in at])


def _pixels(widget: QWidget) -> Floats:
    image = widget.grab().toImage().convertToFormat(QImage.Format.Format_RGB888)
    raw = np.frombuffer(image.constBits(), dtype=np.uint8).reshape(image.height(), image.bytesPerLine())
    return raw[:, : 3 * image.width()].reshape(image.height(), image.width(), 3).astype(float)


def drawn(figure: Figure) -> tuple[Floats, Floats, Floats]:
    """The pixels of a figure, and those of places along the axes of its first panel: columns of -90 to 90, and rows."""
    for dots in [line for line in figure.axes[0].lines if line.get_marker() == "."]:
        dots.set_visible(False)  # they are on the colours that are read
    pixels = 255.0 * imread(BytesIO(picture(figure, "png", DPI)))[..., :3].astype(float)
    figure.set_dpi(DPI)
    ends = figure.axes[0].transData.transform([(-90.0, -90.0), (90.0, 90.0)])
    return pixels, ends[:, 0], pixels.shape[0] - ends[:, 1]


def values_of(colours: Floats, limits: tuple[float, float]) -> Floats:
    """The values (n,) whose colours on a logarithmic bar are nearest."""
    table = colour_table("values").astype(float)
    nearest = np.argmin(np.sum((colours[:, None, :] - table) ** 2, axis=2), axis=1)
    low, high = np.log10(limits)
    return np.asarray(10.0 ** (low + nearest / (len(table) - 1) * (high - low)))


@pytest.fixture
def files(write_rig: Writer, write_schedule: Writer) -> tuple[Path, Path]:
    tilted = f"[twin.deviations.sample]\nrx_deg = {TILT_DEG}\n\n[twin.samples.etalon]"
    return write_schedule(text=SCHEDULE), write_rig(("[twin.samples.etalon]", tilted))


@pytest.mark.parametrize("colours", [LIGHT, DARK], ids=["light", "dark"])
@pytest.mark.long
def test_window_plot_and_report_give_one_picture_of_a_journal(
    qtbot: QtBot, files: tuple[Path, Path], tmp_path: Path, colours: Colours
) -> None:
    schedule, rig = files
    journal = tmp_path / "a.journal"
    run_without_wires(make_plan(read_schedule(schedule), read_rig(rig)), journal)
    dataset = goniotwin.open(journal)
    window = Window(qtbot, schedule, rig, colours)

    # The hemisphere: the lobe of the tilted sample by the law of reflection, right of the normal and above the plane.
    sine, cosine = np.sin(np.radians(TILT_DEG)), np.cos(np.radians(TILT_DEG))
    light, normal = np.array([0.5, 0.0, np.sqrt(0.75)]), np.array([0.0, -sine, cosine])
    lobe = 2.0 * (light @ normal) * normal - light
    polar = np.degrees(np.arccos(lobe[2]))
    expected = polar * np.array([-lobe[0], -lobe[1]]) / np.hypot(lobe[0], lobe[1])
    figure = goniotwin.plot(dataset, "hemisphere")
    pixels, columns, rows = drawn(figure)
    shown = window.pixels()
    bar = window.hemisphere.colour_bar.bar
    assert bar is not None
    across, down = np.polyfit(columns, [-90.0, 90.0], 1), np.polyfit(rows, [-90.0, 90.0], 1)
    (top, bottom), (left, right) = window.place(np.array([-90.0, 90.0]), np.array([90.0, -90.0]))
    peaks = [
        peak_of(pixels, across, down),
        peak_of(shown, np.polyfit([left, right], [-90.0, 90.0], 1), np.polyfit([top, bottom], [90.0, -90.0], 1)),
    ]
    for peak in peaks:
        assert peak == pytest.approx(expected, abs=4.0)

    # The colours: those of the values, in both.
    some = np.flatnonzero(dataset.good & (dataset.bsdf > 0.01) & (np.abs(dataset.polar_deg - 30.0) > 2.0))
    around = np.radians(dataset.azimuth_deg[some] - 180.0)
    x, y = dataset.polar_deg[some] * np.cos(around), dataset.polar_deg[some] * np.sin(around)
    at_plot = (y - down[1]) / down[0], (x - across[1]) / across[0]
    for image, (row, column) in ((pixels, at_plot), (shown, window.place(x, y))):
        found = values_of(image[np.round(row).astype(int), np.round(column).astype(int)], bar.limits)
        assert np.median(np.abs(np.log10(found / dataset.bsdf[some]))) < 0.1
    assert figure.axes[-1].get_ylabel() == bar.label == "BRDF, 1/sr"
    assert [each.get_text() for each in figure.axes[-1].get_yticklabels()] == [f"{each:g}" for each in bar.ticks]
    assert figure.axes[-1].get_ylim() == pytest.approx(bar.limits)

    # The cut: abscissae, values and words.
    cut = goniotwin.plot(dataset, "cuts").axes[0]
    shapes = {each.get_marker(): np.asarray(each.get_data(), dtype=float) for each in cut.lines}
    shapes["line"] = np.asarray(cut.lines[0].get_data(), dtype=float)
    for shape, kinds in (("line", ("measured", "steep")), (".", ("lost",)), ("v", ("below",))):
        there = [np.stack(marks) for kind, marks in window.plot.marks().items() if kind in kinds]
        (x, y), (line_x, line_y) = np.concatenate(there, axis=1), shapes[shape][:, np.isfinite(shapes[shape][1])]
        order, aside = np.argsort(x, kind="stable"), np.abs(line_x) > 1e-9  # at the normal the plot has every half plane
        x, y = x[order][np.abs(x[order]) > 1e-9], y[order][np.abs(x[order]) > 1e-9]
        assert x.size > 2
        assert x == pytest.approx(line_x[aside])
        assert 10.0**y == pytest.approx(line_y[aside], rel=1e-6)
    assert cut.get_xlabel() == window.plot.x_label
    assert cut.get_ylabel() == window.plot.y_label
    x_limits, y_limits = window.cut.getItem(0, 0).viewRange()
    assert cut.get_xlim() == pytest.approx(x_limits)
    assert cut.get_ylim() == pytest.approx(10.0 ** np.array(y_limits))

    # The report has the plot's pictures.
    html, _ = report_html(journal)
    pictures = dict(re.findall(r'src="data:image/(png|svg\+xml);base64,([^"]+)"', html)[k] for k in (1, 0))
    assert base64.b64decode(pictures["png"]) == picture(goniotwin.plot(dataset, "hemisphere"), "png", DPI)
    assert base64.b64decode(pictures["svg+xml"]) == picture(goniotwin.plot(dataset, "cuts"), "svg", DPI)


def peak_of(pixels: Floats, across: Floats, down: Floats) -> Floats:
    """The place in degrees of the colours of the largest values."""
    off = np.abs(pixels - colour_table("values")[-1]).max(axis=2)
    x, y = np.meshgrid(np.polyval(across, np.arange(pixels.shape[1])), np.polyval(down, np.arange(pixels.shape[0])))
    near = (off < 25.0) & (np.hypot(x, y) < 88.0)
    assert near.any()
    return np.array([x[near].mean(), y[near].mean()])
