"""What the twin predicts of a plan beside what is measured: residuals, alarms, planes through the specular direction."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.planning.plan import NewPlan, make_plan
from goniotwin.app.campaign.rehearsal.without_wires import expected_model, rows_without_wires
from goniotwin.app.campaign.running.events import RowCommitted
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.desktop.model.live_scan import LiveScan, ScanData, ScanPoints
from goniotwin.app.desktop.model.run_points import PLANE_HALF_WIDTH_DEG, RunPoints, match
from goniotwin.app.desktop.model.values import PlanTexts, RunValues, planned_directions, predicted_scans
from goniotwin.app.errors import UserError
from goniotwin.app.figures.curves import gaps_of
from goniotwin.app.rig import read_rig
from goniotwin.twin.optics import from_specular
from goniotwin.twin.optics.geometry.coordinates import zenith_and_azimuth
from goniotwin.twin.plant import TwinModel
from tests.app.campaign.rehearsal.test_rehearsal import real_rig_file
from tests.conftest import Writer

SETTING = ("satin", 550.0, 30.0, 0.0)


def measured(plan: NewPlan, model: TwinModel) -> list[ScanData]:
    """The scans of a plan on a virtual rig, without wires."""
    live = LiveScan(plan)
    for each in rows_without_wires(plan, model):
        live.add_row(RowCommitted(each.row, each.data, 0, 1_000_000, 0.0))
    scans = []
    for key in live.scans:
        while (scan := live.data(key)) is None or not scan.complete:
            pass
        scans.append(scan)
    return scans


@pytest.fixture
def plan(write_rig: Writer, write_schedule: Writer) -> NewPlan:
    return make_plan(read_schedule(write_schedule()), read_rig(write_rig()))


def test_the_residuals_of_a_rig_as_in_its_file_are_those_of_noise(plan: NewPlan) -> None:
    model = plan.rig.model()
    assert model is not None
    points = RunPoints()
    for scan in predicted_scans(plan):
        if scan is not None:
            points.predict(scan)
    cuts = [points.add(each) for each in measured(plan, model)]
    assert len(cuts) == len(points.predicted) == 2  # the etalon and the sample
    for setting in (key[0] for key in points.predicted):
        assert planned_directions(plan)[setting, False] == points.planned(setting, False).values.size
    signals, sample = cuts
    assert np.isnan(signals.residual).all()
    trusted = ~signals.scan.points.blocked & ~signals.scan.points.untrusted & np.isfinite(signals.expected)
    deviations = ((signals.scan.points.values - signals.expected) / signals.scan.points.u_values)[trusted]
    residuals = np.concatenate([deviations, sample.residual[np.isfinite(sample.residual)]])
    assert residuals.size > 60
    for each in (deviations, residuals):
        assert 0.5 < float(np.std(each)) < 1.5
        assert float(np.max(np.abs(each))) < 4.5
    assert all(np.isnan(each.residual[each.scan.points.blocked]).all() for each in cuts)


def test_a_sample_of_half_the_reflectance_is_in_alarm(plan: NewPlan, write_rig: Writer) -> None:
    other = read_rig(write_rig(('quantity = "luminance"\nreflectance = 0.9', 'quantity = "luminance"\nreflectance = 0.45')))
    model = other.model()
    assert model is not None
    predicted = {scan.key: scan for scan in predicted_scans(plan) if scan is not None}
    by_sample = {scan.key[0][0]: match(scan, predicted[scan.key]) for scan in measured(plan, model) if scan.key is not None}
    assert by_sample["gaussian-5"].alarms.any()
    assert by_sample["gaussian-5"].residual[by_sample["gaussian-5"].alarms].max() < -4.0
    assert not by_sample["etalon"].alarms.any()
    assert np.isfinite(by_sample["etalon"].expected).any()


def test_a_rig_file_without_a_twin_has_no_prediction(write_rig: Writer, write_schedule: Writer) -> None:
    real = make_plan(read_schedule(write_schedule()), read_rig(real_rig_file(write_rig)))
    with pytest.raises(UserError, match="no \\[twin\\]"):
        expected_model(real)


def test_a_worker_makes_the_same_plan_from_its_texts(plan: NewPlan) -> None:
    texts = PlanTexts.of(plan)
    assert [each.identity for each in texts.plan_with_rows().rows] == [each.identity for each in plan.rows]
    moved = replace(texts, rig=(texts.rig[0], Path("elsewhere"), "other", None))
    assert moved.same == texts.same


def test_the_scan_in_progress_comes_while_rows_do_and_all_scans_in_the_end(plan: NewPlan) -> None:
    model = plan.rig.model()
    assert model is not None
    values, seen = RunValues(PlanTexts.of(plan).plan()), []
    for each in rows_without_wires(plan, model):
        values.add_row(RowCommitted(each.row, each.data, 0, 1_000_000, 0.0))
        if (scan := values.next()) is not None:
            seen.append(scan.key)
    assert seen[0] == (("etalon", 550.0, 30.0, 0.0), 0.0)
    assert values.current == (("gaussian-5", 550.0, 30.0, 0.0), 0.0)
    values.finish()
    ended = set()
    while values.wait_s is not None:
        if (scan := values.next()) is not None and scan.complete:
            ended.add(scan.key)
    assert ended == {seen[0], values.current}


def points_at(theta: np.ndarray, phi: np.ndarray, transmitted: np.ndarray | None = None) -> ScanPoints:
    zenith, azimuth = zenith_and_azimuth(from_specular(30.0, theta, phi))
    none = np.zeros(theta.size, dtype=bool)
    values = 1.0 + theta
    return ScanPoints(
        theta,
        values,
        0.1 * values,
        none,
        none,
        none if transmitted is None else transmitted,
        none,
        none,
        none.astype(np.uint16),
        np.stack([zenith, azimuth, theta, phi], axis=1),
    )


def scan_of(points: ScanPoints, plane: float = 0.0) -> ScanData:
    return ScanData("a scan", "x", "BSDF (1/sr)", (-90.0, 90.0), (), points, key=(SETTING, plane))


def test_a_plane_through_the_specular_direction_has_the_points_near_it() -> None:
    points = RunPoints()
    theta = np.array([20.0, 20.0, 20.0, 20.0, 1.0])
    phi = np.array([30.0, 210.0, 120.0, 33.0, 120.0])
    points.add(scan_of(points_at(theta, phi)))
    cut = points.plane(SETTING, 30.0)
    assert cut is not None
    assert np.abs(cut.scan.points.x_deg).tolist() == [20.0, 1.0, 20.0, 20.0]
    assert (cut.scan.points.x_deg[0], cut.scan.points.x_deg[-1]) == (-20.0, 20.0)
    assert PLANE_HALF_WIDTH_DEG < 5.0
    assert "φ 30°" in cut.scan.title


def test_a_line_has_a_gap_where_cuts_are_missing() -> None:
    theta = np.concatenate([np.arange(0.0, 20.0), np.arange(50.0, 70.0)])
    assert gaps_of(theta).tolist() == [19]
    assert gaps_of(np.delete(theta, 10)).tolist() == [18]  # a single missing point is no gap
    assert gaps_of(np.arange(0.0, 90.0, 10.0)).size == gaps_of(theta[:1]).size == 0


def test_points_are_matched_by_angle_and_side_and_a_residual_is_in_u() -> None:
    theta, phi = np.array([10.0, 10.0, 20.0]), np.zeros(3)
    sides = np.array([False, True, False])
    predicted = scan_of(points_at(theta, phi, sides))
    here = points_at(theta[:2], phi[:2], sides[:2])
    here = replace(here, values=here.values + np.array([0.0, 5.5]), blocked=np.array([False, False]))
    cut = match(scan_of(here), predicted)
    assert cut.expected.tolist() == [11.0, 11.0]
    assert cut.residual[0] == 0.0
    assert cut.residual[1] == pytest.approx(5.0)
    assert cut.alarms.tolist() == [False, True]
    blocked = match(scan_of(replace(here, blocked=np.array([True, True]))), predicted)
    assert np.isnan(blocked.residual).all()
    signals = match(replace(scan_of(here), y_label="photocurrent / monitor"), predicted)
    assert np.isnan(signals.expected).all()
