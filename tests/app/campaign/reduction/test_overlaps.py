"""`[overlap] calibrate`: photodiodes against each other by the directions that two of them have seen."""

import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.reduction.export import export_csv
from goniotwin.app.campaign.reduction.overlaps import CalibrationFactors, OverlapPairs, fit_factors, overlaps
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.reduction import BsdfDataset, check_journal, reduce_journal
from goniotwin.app.campaign.running.events import Event, RowCommitted
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.formats import read_points_csv
from goniotwin.app.rig import OpenRig, read_rig
from tests.app.campaign.campaign_bench import run_plan
from tests.app.campaign.reduction.test_export import points_of
from tests.conftest import SMALL, Writer

GREY = '[twin.samples.grey]\nmodel = "lambertian"\nreflectance = 0.3\n\n[twin.samples.etalon]'
NARROW = '[twin.samples.grey]\nmodel = "gaussian"\nwidth_deg = 2.0\nreflectance = 0.9\n\n[twin.samples.etalon]'
FADED = 5


def measured(write_rig: Writer, write_schedule: Writer, path: Path, *, share: float = 1.0, sample: str = GREY) -> Path:
    """A journal with noise and 84 overlaps, whose photodiode 5 gives only a share when the etalon has been measured."""
    rig = write_rig(("[twin.samples.etalon]", sample))
    changes = (
        ("gaussian-5", "grey"), ("[1e8, 1e10]", '"automatic"'), ("shift_deg = [0, 1]", "shift_deg = [0]"),
        ("beta_deg = [180]", "beta_deg = { start = 0, stop = 180, step = 45 }"),
    )  # fmt: skip
    schedule = write_schedule(*changes, text=f"{SMALL}[overlap]\npoints = 5\n")
    rigs: list[OpenRig] = []

    def fades(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.row.identity == "grey/mount":
            assert rigs[0].virtual is not None
            rigs[0].virtual.plant.fade(FADED, share)

    run_plan(make_plan(read_schedule(schedule), read_rig(rig)), path, rigs.append, listeners=[fades])
    return path


def reduced(path: Path, *, calibrate: bool) -> BsdfDataset:
    """As if the schedule had said so from the beginning."""
    with sqlite3.connect(path) as db:
        (text,) = db.execute("SELECT value FROM campaign WHERE key = 'schedule'").fetchone()
        told = f"points = 5\ncalibrate = {str(calibrate).lower()}\n"
        db.execute("UPDATE campaign SET value = ? WHERE key = 'schedule'", (text.partition("points = 5\n")[0] + told,))
    with Journal.open(path) as journal:
        return reduce_journal(journal)


def off(points: BsdfPoints) -> np.ndarray:
    """By how many of its uncertainties each good value of the grey sample is off."""
    good = points.where(points.good)
    return np.asarray((good.bsdf - 0.3 / np.pi) / good.u_bsdf)


def test_a_photodiode_that_has_faded_by_2_percent_is_told_and_left_as_it_is(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    found = reduced(measured(write_rig, write_schedule, tmp_path / "a.journal", share=0.98), calibrate=False)
    assert not found.overlaps["grey"].agree
    factors = found.overlaps["grey"].factors
    assert factors.significant == [FADED]
    assert factors.of(FADED) == pytest.approx(1.0 / 0.98, abs=0.003)
    assert any(f"would be multiplied by (overlap.calibrate is false) 0: {factors.of(0):.5f}" in note for note in found.notes)
    points = found.samples["grey"]
    mine = points.where(points.good & (points.photodiode == FADED))
    assert float(np.mean(mine.bsdf)) / (0.3 / np.pi) == pytest.approx(0.98, abs=0.001)
    assert np.abs(off(mine)).min() > 5.0
    checks = check_journal(tmp_path / "a.journal")
    assert checks is not None
    assert any("photodiode 5: 1.01" in line and "NOT applied" in line for line in checks.lines)


def test_it_is_brought_within_its_uncertainty(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    path = measured(write_rig, write_schedule, tmp_path / "a.journal", share=0.98)
    before, after = reduced(path, calibrate=False).samples["grey"], reduced(path, calibrate=True)
    points = after.samples["grey"]
    assert np.abs(off(points)).max() < 3.0
    assert float(np.sqrt(np.mean(off(points) ** 2))) < 1.0
    mine = points.where(points.good & (points.photodiode == FADED))
    assert float(np.mean(mine.bsdf)) / (0.3 / np.pi) == pytest.approx(1.0, abs=0.003)
    assert float(np.median(points.u_bsdf[points.good] / points.bsdf[points.good])) < 0.004  # it was 0.0021
    assert np.all(points.u_bsdf[points.good] / points.bsdf[points.good] > before.u_bsdf[points.good] / before.bsdf[points.good])
    assert any("the values have been multiplied by 0:" in note for note in after.notes)
    assert any("beyond 4 u from 1: photodiodes 5" in note for note in after.notes)
    checks = check_journal(path)
    assert checks is not None
    assert any("values have been multiplied by 0.99" in line for line in checks.lines)
    assert checks.as_dict()["overlaps"]["grey"]["calibration"]["significant"] == [FADED]
    export_csv(after, None, tmp_path / "a.csv")
    assert any("have been multiplied by" in each for each in read_points_csv(tmp_path / "a.csv").comments)


def test_where_nothing_is_spoiled_the_factors_are_1_within_their_uncertainty(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    path = measured(write_rig, write_schedule, tmp_path / "a.journal")
    plain, found = reduced(path, calibrate=False), reduced(path, calibrate=True)
    factors = found.overlaps["grey"].factors
    assert factors.photodiodes == tuple(range(18))
    assert not factors.unconnected
    z = (np.array(factors.values) - 1.0) / np.array(factors.uncertainties)
    assert np.abs(z).max() < 3.0
    assert max(factors.uncertainties) < 0.01
    assert np.abs(off(found.samples["grey"])).max() < 3.0
    worse, as_it_was = (float(np.std(off(each.samples["grey"]))) for each in (found, plain))
    assert worse < 1.1 * as_it_was


def test_a_narrow_lobe_connects_no_photodiodes_and_nothing_gets_worse(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    path = measured(write_rig, write_schedule, tmp_path / "a.journal", sample=NARROW)
    plain, found = reduced(path, calibrate=False).samples["grey"], reduced(path, calibrate=True)
    assert found.samples["grey"].bsdf.tobytes() == plain.bsdf.tobytes()
    assert found.samples["grey"].u_bsdf.tobytes() == plain.u_bsdf.tobytes()
    assert found.overlaps["grey"].agree
    assert any("no overlap is known well enough" in note for note in found.notes)


# ---- the least squares ----


def chain(rng: np.random.Generator, g: np.ndarray, each: int, sigma: float, monitor: float, poses: int = 4) -> OverlapPairs:
    """Neighbours overlap, as on an arc; all pairs of two poses share an error."""
    one = np.tile(np.arange(g.size - 1), each)
    together = np.repeat(np.arange(each) % poses, g.size - 1)
    shared = monitor * rng.standard_normal(poses)
    ratio = g[one] - g[one + 1] + sigma * rng.standard_normal(one.size) + shared[together]
    return OverlapPairs(one, one + 1, ratio, np.full(one.size, sigma**2), together)


def test_factors_are_as_uncertain_as_they_say() -> None:
    """Over 200 campaigns: the squares of errors over uncertainties have the mean 1, or a little less, for residuals that are
    greater than they should be widen the uncertainties, and smaller ones never narrow them.
    """
    rng, squares = np.random.default_rng(7), []
    for _ in range(200):
        found = fit_factors(chain(rng, np.zeros(8), 8, 0.002, 0.0006), 0.0006, set(range(8)))
        squares.append(np.mean((np.log(found.values) / np.array(found.uncertainties)) ** 2))
    spread = 5.0 * float(np.std(squares)) / np.sqrt(len(squares))
    assert 0.8 - spread < float(np.mean(squares)) < 1.0 + spread


def test_a_single_outlier_moves_no_factor() -> None:
    rng = np.random.default_rng(3)
    pairs = chain(rng, np.zeros(6), 10, 0.001, 0.0)
    clean = fit_factors(pairs, 0.0, set(range(6)))
    pairs.ratio[12] += 0.5  # as if a reflection had come into one view
    found = fit_factors(pairs, 0.0, set(range(6)))
    assert np.abs(np.array(found.values) - np.array(clean.values)).max() < 0.001
    assert found.significant == []


def test_parts_that_no_overlap_connects_are_levelled_by_themselves() -> None:
    rng = np.random.default_rng(5)
    left = chain(rng, np.array([0.0, 0.02, 0.0, 0.0]), 20, 1e-4, 0.0)
    right = chain(rng, np.zeros(3), 20, 1e-4, 0.0)
    pairs = OverlapPairs(
        np.append(left.one, right.one + 10), np.append(left.other, right.other + 10), np.append(left.ratio, right.ratio),
        np.append(left.variance, right.variance), np.append(left.together, right.together + 100),
    )  # fmt: skip
    found = fit_factors(pairs, 0.0, {*range(4), 10, 11, 12, 20})
    assert found.photodiodes == (0, 1, 2, 3, 10, 11, 12)
    assert found.unconnected == (20,)
    assert np.array(found.values)[4:] == pytest.approx(1.0, abs=2e-4)
    assert found.of(1) / found.of(0) == pytest.approx(np.exp(-0.02), abs=2e-4)
    assert found.of(20) == 1.0


def test_pairs_that_are_known_badly_connect_nothing() -> None:
    pairs = chain(np.random.default_rng(1), np.array([0.0, 0.5]), 4, 0.1, 0.0)
    assert fit_factors(pairs, 0.0, {0, 1}) == CalibrationFactors((), (), (), (0, 1), 0, 1.0)


def test_what_one_sees_of_reflected_and_another_of_transmitted_light_is_no_overlap() -> None:
    """At the horizon both arcs look in one direction."""
    points = points_of(30.0, np.array([90.0, 90.0]), np.array([10.0, 10.0]))
    assert overlaps(points, 0.0).pairs == 1
    assert overlaps(replace(points, transmitted=np.array([False, True])), 0.0).pairs == 0
