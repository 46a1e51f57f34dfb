"""The live cut says what the reduction of the finished journal says, and its plot loses no point."""

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
from goniotwin.app.desktop.model.live_scan import Cut, LiveCut, Points
from goniotwin.app.desktop.run.scan_plot import CutPlot
from goniotwin.app.desktop.theme import LIGHT
from goniotwin.app.rig import open_rig, read_rig
from goniotwin.protocols.clock import VirtualClock
from tests.conftest import Writer

QUIET = (("noise = true", "noise = false"), ("drift_per_hour = 0.02", "drift_per_hour = 0.0"))


def test_live_values_are_those_of_the_finished_journal(tmp_path: Path, write_rig: Writer, write_schedule: Writer) -> None:
    rig = read_rig(write_rig(*QUIET))
    plan = make_plan(read_schedule(write_schedule(("beta_deg = [180]", "beta_deg = [0, 180]"))), rig)
    live = LiveCut(plan)

    def heed(event: Event) -> None:
        if isinstance(event, RowStarted | RowCommitted):
            live.heed(event)

    with open_rig(rig, VirtualClock()) as opened, Journal.create(tmp_path / "a.journal", plan, {}) as journal:
        opened.connect()
        assert opened.virtual is not None
        assert Engine(opened.rig, plan, journal, VirtualOperator(opened.virtual), [heed]).run() is State.DONE
        assert journal.faults() == []
        expected = reduce_journal(journal).samples["gaussian-5"]
    cut = live.cut()
    assert cut is not None
    order = np.argsort(expected.aspecular_deg, kind="stable")
    assert cut.points.x_deg == pytest.approx(expected.aspecular_deg[order], abs=1e-9)
    assert cut.points.values == pytest.approx(expected.bsdf[order], rel=1e-9, nan_ok=True)
    assert cut.points.hidden.tolist() == expected.shadowed[order].tolist()
    inside = [any(a <= x <= b for a, b in cut.spans_deg) for x in cut.points.x_deg]
    assert cut.points.hidden.any()
    assert inside == cut.points.hidden.tolist()


def test_a_cut_to_which_the_plan_comes_back_is_shown_whole(tmp_path: Path, write_rig: Writer, write_schedule: Writer) -> None:
    """With sigma inside, each cut is visited once for each of its betas."""
    rig = read_rig(write_rig(*QUIET))
    nested = 'readings = 2\norder = ["sigma", "shift", "beta", "gamma", "wavelength"]'
    angles = ("sigma_deg = [30]", "sigma_deg = [30, 60]"), ("beta_deg = [180]", "beta_deg = [0, 180]")
    plan = make_plan(read_schedule(write_schedule(*angles, ("\nreadings = 2", f"\n{nested}"))), rig)
    live = LiveCut(plan)
    with open_rig(rig, VirtualClock()) as opened, Journal.create(tmp_path / "a.journal", plan, {}) as journal:
        opened.connect()
        assert opened.virtual is not None

        def heed(event: Event) -> None:
            if isinstance(event, RowStarted | RowCommitted):
                live.heed(event)

        assert Engine(opened.rig, plan, journal, VirtualOperator(opened.virtual), [heed]).run() is State.DONE
        found = reduce_journal(journal).samples["gaussian-5"]
    cut = live.cut()
    assert cut is not None
    last = next(row for row in reversed(plan.rows) if row.pose is not None)
    assert last.pose is not None
    here = found.where(found.sigma_deg == last.pose[1])
    assert cut.points.x_deg == pytest.approx(np.sort(here.aspecular_deg), abs=1e-9)


@pytest.fixture
def plot(qtbot: QtBot) -> CutPlot:
    plot = CutPlot(LIGHT)
    qtbot.addWidget(plot)
    return plot


def cut_of(values: list[float], u_values: list[float], hidden: list[bool]) -> Cut:
    points = Points(np.arange(float(len(values))), np.array(values), np.array(u_values), np.array(hidden))
    return Cut("a cut", "x", "y", (-90.0, 90.0), ((2.5, 3.5),), points)


def test_what_is_not_above_the_noise_becomes_a_mark_and_makes_nothing_vanish(plot: CutPlot) -> None:
    values = [1.0, 0.0, -0.1, 0.5, float("nan"), 0.01, 1e-9]
    plot.show_cut(cut_of(values, [0.01] * 6 + [1e-12], [False, False, False, True, False, False, False]))
    assert "●\u00a02 measured, highest 1 at 0.0°" in plot.summary
    assert "○\u00a01 in the mirror unit's shadow" in plot.summary
    assert "▽\u00a03 within the noise" in plot.summary
    for x, y in plot.marks().values():
        assert np.all(np.isfinite(x))
        assert np.all(np.isfinite(y))
    assert {name: len(x) for name, (x, _y) in plot.marks().items()} == {"seen": 2, "hidden": 1, "lost": 3}


def test_a_cut_without_any_light_is_shown(plot: CutPlot) -> None:
    plot.show_cut(cut_of([-1.0, float("nan")], [1.0, float("nan")], [False, False]))
    assert "●\u00a00 measured" in plot.summary
    plot.grab()
