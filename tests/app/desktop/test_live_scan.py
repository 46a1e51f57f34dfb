"""The live scan has the values of the reduction of the finished journal, and its plot shows every point."""

from pathlib import Path

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.reduction.reduction import reduce_journal
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import Event, RowCommitted, RowStarted, State
from goniotwin.app.campaign.running.operator import VirtualOperator
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.desktop.model.live_scan import LiveScan, ScanData, ScanPoints
from goniotwin.app.desktop.run.live_plot import ScanPlot
from goniotwin.app.desktop.theme import LIGHT
from goniotwin.app.rig import open_rig, read_rig
from goniotwin.protocols.clock import VirtualClock
from tests.conftest import Writer

QUIET = (("noise = true", "noise = false"), ("drift_per_hour = 0.02", "drift_per_hour = 0.0"))


def test_live_values_equal_those_of_the_finished_journal(tmp_path: Path, write_rig: Writer, write_schedule: Writer) -> None:
    rig = read_rig(write_rig(*QUIET))
    plan = make_plan(read_schedule(write_schedule(("beta_deg = [180]", "beta_deg = [0, 180]"))), rig)
    live = LiveScan(plan)

    def listen(event: Event) -> None:
        if isinstance(event, RowStarted | RowCommitted):
            live.add_row(event)

    with open_rig(rig, VirtualClock()) as opened, Journal.create(tmp_path / "a.journal", plan, {}) as journal:
        opened.connect()
        assert opened.virtual is not None
        assert Engine(opened.rig, plan, journal, VirtualOperator(opened.virtual), [listen]).run() is State.DONE
        assert journal.faults() == []
        expected = reduce_journal(journal).samples["gaussian-5"]
    scan = live.data()
    assert scan is not None
    order = np.argsort(expected.aspecular_deg, kind="stable")
    assert scan.points.x_deg == pytest.approx(expected.aspecular_deg[order], abs=1e-9)
    assert scan.points.values == pytest.approx(expected.bsdf[order], rel=1e-9, nan_ok=True)
    assert scan.points.blocked.tolist() == expected.shadowed[order].tolist()
    inside = [any(a <= x <= b for a, b in scan.blocked_deg) for x in scan.points.x_deg]
    assert scan.points.blocked.any()
    assert inside == scan.points.blocked.tolist()


def test_a_scan_in_several_visits_is_shown_whole(tmp_path: Path, write_rig: Writer, write_schedule: Writer) -> None:
    """With sigma as the inner loop, each scan is visited once for each of its betas."""
    rig = read_rig(write_rig(*QUIET))
    nested = 'readings = 2\norder = ["sigma", "shift", "beta", "gamma", "wavelength"]'
    angles = ("sigma_deg = [30]", "sigma_deg = [30, 60]"), ("beta_deg = [180]", "beta_deg = [0, 180]")
    plan = make_plan(read_schedule(write_schedule(*angles, ("\nreadings = 2", f"\n{nested}"))), rig)
    live = LiveScan(plan)
    with open_rig(rig, VirtualClock()) as opened, Journal.create(tmp_path / "a.journal", plan, {}) as journal:
        opened.connect()
        assert opened.virtual is not None

        def listen(event: Event) -> None:
            if isinstance(event, RowStarted | RowCommitted):
                live.add_row(event)

        assert Engine(opened.rig, plan, journal, VirtualOperator(opened.virtual), [listen]).run() is State.DONE
        points = reduce_journal(journal).samples["gaussian-5"]
    scan = live.data()
    assert scan is not None
    last = next(row for row in reversed(plan.rows) if row.pose is not None)
    assert last.pose is not None
    same_sigma = points.where(points.sigma_deg == last.pose[1])
    assert scan.points.x_deg == pytest.approx(np.sort(same_sigma.aspecular_deg), abs=1e-9)


@pytest.fixture
def plot(qtbot: QtBot) -> ScanPlot:
    plot = ScanPlot(LIGHT)
    qtbot.addWidget(plot)
    return plot


def scan_data(values: list[float], u_values: list[float], blocked: list[bool]) -> ScanData:
    points = ScanPoints(np.arange(float(len(values))), np.array(values), np.array(u_values), np.array(blocked))
    return ScanData("a scan", "x", "y", (-90.0, 90.0), ((2.5, 3.5),), points)


def test_values_below_the_detection_limit_are_marks_and_hide_no_other_point(plot: ScanPlot) -> None:
    values = [1.0, 0.0, -0.1, 0.5, float("nan"), 0.01, 1e-9]
    plot.show_scan(scan_data(values, [0.01] * 6 + [1e-12], [False, False, False, True, False, False, False]))
    assert "●\u00a02 measured, highest 1 at 0.0°" in plot.summary
    assert "○\u00a01 blocked by the mirror unit" in plot.summary
    assert "▽\u00a03 below detection limit" in plot.summary
    for x, y in plot.marks().values():
        assert np.all(np.isfinite(x))
        assert np.all(np.isfinite(y))
    assert {name: len(x) for name, (x, _y) in plot.marks().items()} == {"measured": 2, "blocked": 1, "below limit": 3}


def test_a_scan_without_light_is_shown(plot: ScanPlot) -> None:
    plot.show_scan(scan_data([-1.0, float("nan")], [1.0, float("nan")], [False, False]))
    assert "●\u00a00 measured" in plot.summary
    plot.grab()
