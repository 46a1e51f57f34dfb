"""Overlaps: photodiodes that measured the same direction are compared, and calibrated against each other."""

import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.reduction.calibration import CalibrationFactors
from goniotwin.app.campaign.reduction.overlaps import OverlapPairs, fit_factors, overlaps
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.running.events import Event, RowCommitted
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.campaign.studies.journals import check_journal
from goniotwin.app.campaign.studies.reduced_journal import BsdfDataset, reduce_journal
from goniotwin.app.formats import read_points_csv
from goniotwin.app.json_document import json_value
from goniotwin.app.rig import OpenRig, read_rig
from tests.app.campaign.campaign_bench import remove_checksums, run_plan
from tests.app.campaign.reduction import grey_campaign
from tests.app.data.exporting import export
from tests.app.data.test_export import points_of
from tests.conftest import SMALL, Writer

GREY = '[twin.samples.grey]\nmodel = "lambertian"\nreflectance = 0.3\n\n[twin.samples.etalon]'
NARROW = '[twin.samples.grey]\nmodel = "gaussian"\nwidth_deg = 2.0\nreflectance = 0.9\n\n[twin.samples.etalon]'
FADED = 5


def measure(write_rig: Writer, write_schedule: Writer, path: Path, *, share: float = 1.0, sample: str = GREY) -> Path:
    """A journal with noise and 84 overlaps; after the etalon, photodiode 5 gives only a `share` of its signal."""
    rig = write_rig(("[twin.samples.etalon]", sample))
    changes = (
        ("gaussian-5", "grey"),
        ("[1e8, 1e10]", '"automatic"'),
        ("shift_deg = [0, 1]", "shift_deg = [0]"),
        ("beta_deg = [180]", "beta_deg = { start = 0, stop = 180, step = 45 }"),
    )
    schedule = write_schedule(*changes, text=f"{SMALL}[overlap]\npoints = 5\n")
    rigs: list[OpenRig] = []

    def fade(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.row.identity == "grey/mount":
            assert rigs[0].virtual is not None
            rigs[0].virtual.plant.fade(FADED, share)

    run_plan(make_plan(read_schedule(schedule), read_rig(rig)), path, rigs.append, listeners=[fade])
    return path


def reduced(path: Path, *, calibrate: bool) -> BsdfDataset:
    """The reduction of a journal, with `overlap.calibrate` changed in its schedule."""
    with sqlite3.connect(path) as db:
        (text,) = db.execute("SELECT value FROM campaign WHERE key = 'schedule'").fetchone()
        table = f"points = 5\ncalibrate = {str(calibrate).lower()}\n"
        db.execute("UPDATE campaign SET value = ? WHERE key = 'schedule'", (text.partition("points = 5\n")[0] + table,))
        remove_checksums(db)
    with Journal.open(path) as journal:
        return reduce_journal(journal)


def deviations(points: BsdfPoints) -> np.ndarray:
    """Deviations of the good values of the grey sample, in their standard uncertainties."""
    good = points.where(points.good)
    return np.asarray((good.bsdf - 0.3 / np.pi) / good.u_bsdf)


def test_a_photodiode_that_has_faded_by_2_percent_is_reported_and_not_corrected(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    result = reduced(measure(write_rig, write_schedule, tmp_path / "a.journal", share=0.98), calibrate=False)
    assert not result.overlaps["grey"].agree
    factors = result.overlaps["grey"].factors
    assert factors.significant == [FADED]
    assert factors.of(FADED) == pytest.approx(1.0 / 0.98, abs=0.003)
    assert any(f"not applied, as [overlap] calibrate is false: 0: {factors.of(0):.5f}" in note for note in result.notes)
    points = result.samples["grey"]
    faded = points.where(points.good & (points.photodiode == FADED))
    assert float(np.mean(faded.bsdf)) / (0.3 / np.pi) == pytest.approx(0.98, abs=0.001)
    assert np.abs(deviations(faded)).min() > 4.5
    checks = check_journal(tmp_path / "a.journal")
    assert checks is not None
    assert any("photodiode 5: 1.01" in line and "NOT applied" in line for line in checks.lines)


def test_calibration_corrects_a_faded_photodiode_within_its_uncertainty(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    path = measure(write_rig, write_schedule, tmp_path / "a.journal", share=0.98)
    before, after = reduced(path, calibrate=False).samples["grey"], reduced(path, calibrate=True)
    points = after.samples["grey"]
    assert np.abs(deviations(points)).max() < 3.0
    assert float(np.sqrt(np.mean(deviations(points) ** 2))) < 1.0
    faded = points.where(points.good & (points.photodiode == FADED))
    assert float(np.mean(faded.bsdf)) / (0.3 / np.pi) == pytest.approx(1.0, abs=0.003)
    # Without angles and heights it would be 0.0021.
    assert float(np.median(points.u_bsdf[points.good] / points.bsdf[points.good])) < 0.005
    assert np.all(points.u_bsdf[points.good] / points.bsdf[points.good] > before.u_bsdf[points.good] / before.bsdf[points.good])
    assert any("applied to the values: 0: " in note for note in after.notes)
    assert any("beyond 4 u from 1: photodiodes 5" in note for note in after.notes)
    checks = check_journal(path)
    assert checks is not None
    assert any("values have been multiplied by 0.99" in line for line in checks.lines)
    assert json_value(checks)["overlaps"]["grey"]["calibration"]["significant"] == [FADED]
    export(after, None, tmp_path / "a.csv", "csv")
    assert any("applied to the values: 0: " in each for each in read_points_csv(tmp_path / "a.csv").comments)


def test_without_a_fault_the_factors_are_1_within_their_uncertainty(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    path = measure(write_rig, write_schedule, tmp_path / "a.journal")
    plain, result = reduced(path, calibrate=False), reduced(path, calibrate=True)
    factors = result.overlaps["grey"].factors
    assert factors.photodiodes == tuple(range(18))
    assert not factors.unconnected
    z = (np.array(factors.values) - 1.0) / np.array(factors.uncertainties)
    assert np.abs(z).max() < 3.0
    assert max(factors.uncertainties) < 0.01
    assert np.abs(deviations(result.samples["grey"])).max() < 3.0
    calibrated, uncalibrated = (float(np.std(deviations(each.samples["grey"]))) for each in (result, plain))
    assert calibrated < 1.1 * uncalibrated


def test_a_narrow_lobe_connects_no_photodiodes_and_changes_no_value(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    path = measure(write_rig, write_schedule, tmp_path / "a.journal", sample=NARROW)
    plain, result = reduced(path, calibrate=False).samples["grey"], reduced(path, calibrate=True)
    assert result.samples["grey"].bsdf.tobytes() == plain.bsdf.tobytes()
    assert result.samples["grey"].u_bsdf.tobytes() == plain.u_bsdf.tobytes()
    assert result.overlaps["grey"].agree
    assert any("no overlap is known well enough" in note for note in result.notes)


def test_photodiodes_that_measured_the_same_direction_agree(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    """With noise. At shift 5 deg each photodiode looks where the next one was."""
    rig = write_rig(("[twin.samples.etalon]", f"{grey_campaign.GREY}[twin.samples.etalon]"))
    shifts = ("shift_deg = [0, 1]", "shift_deg = [0, 5]")
    run_campaign(
        make_plan(read_schedule(write_schedule(*grey_campaign.GREY_ONLY, shifts)), read_rig(rig)), tmp_path / "a.journal"
    )
    dataset = grey_campaign.reduced(tmp_path / "a.journal")
    assert dataset.overlaps["grey"].pairs == 17
    assert dataset.overlaps["grey"].agree
    points = dataset.samples["grey"]
    points.bsdf[points.photodiode == 4] *= 1.1  # as if its sensitivity had changed between etalon and sample
    other = overlaps(points, 0.002)
    assert not other.agree
    assert "do NOT agree" in str(other)


# ---- the least squares ----


def chain(rng: np.random.Generator, g: np.ndarray, each: int, sigma: float, monitor: float, poses: int = 4) -> OverlapPairs:
    """Pairs of neighbours, as on an arc; all pairs of two poses share an error."""
    one = np.tile(np.arange(g.size - 1), each)
    together = np.repeat(np.arange(each) % poses, g.size - 1)
    shared = monitor * rng.standard_normal(poses)
    ratio = g[one] - g[one + 1] + sigma * rng.standard_normal(one.size) + shared[together]
    return OverlapPairs(one, one + 1, ratio, np.full(one.size, sigma**2), together)


def test_errors_of_the_factors_fit_their_uncertainties() -> None:
    """Over 200 campaigns the squares of errors over uncertainties have the mean 1 or a little less: large residuals widen the
    uncertainties, small ones never narrow them.
    """
    rng, squares = np.random.default_rng(7), []
    for _ in range(200):
        result = fit_factors(chain(rng, np.zeros(8), 8, 0.002, 0.0006), 0.0006, set(range(8)))
        squares.append(np.mean((np.log(result.values) / np.array(result.uncertainties)) ** 2))
    spread = 5.0 * float(np.std(squares)) / np.sqrt(len(squares))
    assert 0.8 - spread < float(np.mean(squares)) < 1.0 + spread


def test_a_single_outlier_moves_no_factor() -> None:
    rng = np.random.default_rng(3)
    pairs = chain(rng, np.zeros(6), 10, 0.001, 0.0)
    clean = fit_factors(pairs, 0.0, set(range(6)))
    pairs.ratio[12] += 0.5  # as if a reflection were in the view of one photodiode
    result = fit_factors(pairs, 0.0, set(range(6)))
    assert np.abs(np.array(result.values) - np.array(clean.values)).max() < 0.001
    assert result.significant == []


def test_parts_without_a_connecting_overlap_have_levels_of_their_own() -> None:
    rng = np.random.default_rng(5)
    left = chain(rng, np.array([0.0, 0.02, 0.0, 0.0]), 20, 1e-4, 0.0)
    right = chain(rng, np.zeros(3), 20, 1e-4, 0.0)
    pairs = OverlapPairs(
        np.append(left.one, right.one + 10),
        np.append(left.other, right.other + 10),
        np.append(left.ratio, right.ratio),
        np.append(left.variance, right.variance),
        np.append(left.together, right.together + 100),
    )
    result = fit_factors(pairs, 0.0, {*range(4), 10, 11, 12, 20})
    assert result.photodiodes == (0, 1, 2, 3, 10, 11, 12)
    assert result.unconnected == (20,)
    assert np.array(result.values)[4:] == pytest.approx(1.0, abs=2e-4)
    assert result.of(1) / result.of(0) == pytest.approx(np.exp(-0.02), abs=2e-4)
    assert result.of(20) == 1.0


def test_pairs_with_a_large_uncertainty_connect_no_photodiodes() -> None:
    pairs = chain(np.random.default_rng(1), np.array([0.0, 0.5]), 4, 0.1, 0.0)
    assert fit_factors(pairs, 0.0, {0, 1}) == CalibrationFactors((), (), (), (0, 1), 0, 1.0)


def test_reflected_and_transmitted_light_in_one_direction_are_no_overlap() -> None:
    """At the horizon both arcs look in the same direction."""
    points = points_of(30.0, np.array([90.0, 90.0]), np.array([10.0, 10.0]))
    assert overlaps(points, 0.0).pairs == 1
    assert overlaps(replace(points, transmitted=np.array([False, True])), 0.0).pairs == 0


@pytest.mark.parametrize("pole", [0.0, 180.0])
def test_at_either_pole_opposite_half_planes_measure_one_direction(pole: float) -> None:
    """Two photodiodes are at the pole, one of them with the arc at beta 180 deg."""
    points = points_of(30.0, np.array([pole, pole]), np.array([0.0, 180.0]))
    assert overlaps(points, 0.0).pairs == 1
