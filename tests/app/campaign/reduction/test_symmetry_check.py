"""`[symmetry_check]`: the verdict on the symmetry that a schedule states, and what is done with the rows that it takes."""

import json
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.reduction.export import export_csv, export_ddr
from goniotwin.app.campaign.reduction.points import steepness
from goniotwin.app.campaign.reduction.reduction import BsdfDataset, reduce_journal
from goniotwin.app.campaign.reduction.symmetry import SymmetryResult
from goniotwin.app.campaign.rehearsal.rehearsal import plan_rehearsal, rehearse
from goniotwin.app.campaign.rehearsal.report import report_text
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.cli.main import app
from goniotwin.app.formats import read_ddr, read_points_csv
from goniotwin.app.rig import RigDescription, read_rig
from goniotwin.twin.optics import Scatterer, table_sample
from tests.app.campaign.reduction.test_export import points_of
from tests.conftest import SMALL, Change, Writer

WIDE = ("beta_deg = [180]", "beta_deg = { start = 0, stop = 180, step = 30 }")
GAINS = ("[1e8, 1e10]", "[1e8, 1e10, 1e11]")
CHECK = "[symmetry_check]\npoints = 4\n"


def measured(write_rig: Writer, write_schedule: Writer, tmp_path: Path, *changes: Change, text: str = SMALL + CHECK) -> Path:
    """A journal on the rig with noise."""
    plan = make_plan(read_schedule(write_schedule(WIDE, GAINS, *changes, text=text)), read_rig(write_rig()))
    run_campaign(plan, tmp_path / "a.journal")
    return tmp_path / "a.journal"


def reduced(path: Path) -> BsdfDataset:
    with Journal.open(path) as journal:
        return reduce_journal(journal)


def brushed(share: float) -> Scatterer:
    """White where the light comes from the sample's azimuth 90, greyer by so much on either side where from -90."""
    psi, phi, theta = np.arange(0.0, 360.0, 15.0), np.array([0.0, 180.0]), np.array([0.0, 180.0])
    values = 0.5 / np.pi * (1.0 + share * np.sin(np.radians(psi)))
    return table_sample([30.0], phi, theta, np.broadcast_to(values[:, None, None, None], (psi.size, 1, 2, 2)), psi_deg=psi)


@pytest.fixture
def anisotropic(monkeypatch: pytest.MonkeyPatch) -> None:
    """gaussian-5 is another sample than anybody knows."""
    known = RigDescription.model

    def model(self: RigDescription) -> object:
        found = known(self)
        assert found is not None
        return replace(found, samples={**found.samples, "gaussian-5": brushed(0.1)})

    monkeypatch.setattr(RigDescription, "model", model)


def test_an_isotropic_sample_holds(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    found = reduced(measured(write_rig, write_schedule, tmp_path))
    verdict = found.symmetry["gaussian-5"]
    assert verdict.holds
    assert verdict.pairs > 60  # 4 poses of 18 photodiodes, some hidden
    assert 0.3 * verdict.pairs < verdict.chi_square < 1.7 * verdict.pairs
    assert verdict.largest < 0.1
    assert any(note.startswith("symmetry of gaussian-5: the stated symmetry (isotropic) holds within") for note in found.notes)


@pytest.mark.parametrize(
    ("repeats", "changes"),
    [
        ("repeats = 2\n", ()),
        ("", (("[1e8, 1e10, 1e11]", "[1e11]"), ("readings = 2", "readings = 10"), ("points = 4", "points = 16"))),
    ],
    ids=["repeats that share an etalon", "readings so many that the lamp's flicker is left"],
)
def test_a_grey_sample_holds_however_it_is_read(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, repeats: str, changes: tuple[Change, ...]
) -> None:
    grey = ("[twin.samples.etalon]", '[twin.samples.grey]\nmodel = "lambertian"\nreflectance = 0.8\n\n[twin.samples.etalon]')
    three = ("sigma_deg = [30]", "sigma_deg = [20, 40, 60]")
    schedule = write_schedule(WIDE, GAINS, ("gaussian-5", "grey"), three, *changes, text=SMALL + repeats + CHECK)
    run_campaign(make_plan(read_schedule(schedule), read_rig(write_rig(grey))), tmp_path / "a.journal")
    verdict = reduced(tmp_path / "a.journal").symmetry["grey"]
    assert verdict.holds, verdict
    assert verdict.pairs > 60


def test_where_nothing_can_be_said_a_program_reads_null() -> None:
    nothing = SymmetryResult("isotropic", 0, 0.0, 0.0, 0.0, float("nan"), float("nan"), "")
    assert nothing.as_dict()["holds"] is None


def test_a_campaign_without_the_check_has_no_verdict(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    found = reduced(measured(write_rig, write_schedule, tmp_path, text=SMALL))
    assert not found.symmetry
    assert not found.samples["gaussian-5"].mirrored.any()


@pytest.mark.parametrize("stated", ["isotropic", "plane-symmetric"])
def test_a_planted_anisotropy_is_found(
    stated: str, write_rig: Writer, write_schedule: Writer, tmp_path: Path, anisotropic: None
) -> None:
    gammas = "gamma_deg = [0, 60]\n" if stated == "plane-symmetric" else ""
    text = f'{SMALL}symmetry = "{stated}"\n{gammas}{CHECK}'
    found = reduced(measured(write_rig, write_schedule, tmp_path, text=text))
    verdict = found.symmetry["gaussian-5"]
    assert not verdict.holds
    assert verdict.stated == stated
    # 10 % of sin 90 deg against sin 0 deg; or of sin 60 deg against sin -60 deg
    assert verdict.largest == pytest.approx(0.105 if stated == "isotropic" else 0.173, abs=0.02)
    assert "does NOT hold" in str(verdict)
    assert any("does NOT hold" in note for note in found.notes)


def test_mirrored_rows_with_half_their_counts_do_not_hold(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    path = measured(write_rig, write_schedule, tmp_path)
    with Journal.open(path) as journal:
        dark = next(each for each in journal.rows() if each.row.kind == "dark")
        darks = {reading.gain_v_per_a: reading.counts.mean(axis=0) for reading in dark.data.readings}
    with sqlite3.connect(path) as db:
        chosen = "SELECT number FROM plan WHERE sample = 'gaussian-5' AND identity LIKE '%/mirrored'"
        for number, gain, counts in db.execute(
            f"SELECT number, gain_v_per_a, counts FROM reading WHERE number IN ({chosen})"
        ).fetchall():
            raw = np.frombuffer(counts, dtype="<u2").reshape(-1, darks[gain].size)
            halved = np.where(raw == 65535, raw, np.round(0.5 * (raw + darks[gain])))  # what is clipped stays so
            where = "WHERE number = ? AND gain_v_per_a = ?"
            db.execute(f"UPDATE reading SET counts = ? {where}", (halved.astype("<u2").tobytes(), number, gain))
    found = reduced(path)
    assert not found.symmetry["gaussian-5"].holds
    assert found.symmetry["gaussian-5"].largest == pytest.approx(2.0 / 3.0, abs=0.1)  # a half of a mean of three quarters


def test_the_exported_table_has_no_mirrored_rows_and_the_csv_marks_them(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    found = reduced(measured(write_rig, write_schedule, tmp_path))
    export_ddr(found, None, tmp_path / "a.ddr")  # which has one gamma
    assert any("symmetry: the stated symmetry (isotropic) holds" in each for each in read_ddr(tmp_path / "a.ddr").comments)
    export_csv(found, None, tmp_path / "a.csv")
    table = read_points_csv(tmp_path / "a.csv")
    mirrored = table.columns["check"] == "mirrored"
    assert int(mirrored.sum()) == 4 * 18
    assert set(table.columns["gamma_deg"][mirrored]) == {90.0}
    assert set(table.columns["gamma_deg"][~mirrored]) == {0.0}
    assert any("symmetry of gaussian-5" in each for each in table.comments)


def test_the_end_of_a_run_and_of_a_rehearsal_says_it(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, anisotropic: None
) -> None:
    schedule, rig = write_schedule(WIDE, GAINS, text=SMALL + CHECK), write_rig()
    command = ["run", str(schedule), "--rig", str(rig), "--out", str(tmp_path / "a.journal")]
    assert "does NOT hold" in CliRunner().invoke(app, command).stdout
    command[-1] = str(tmp_path / "b.journal")
    assert (
        json.loads(CliRunner().invoke(app, [*command, "--json"]).stdout)["checks"]["symmetry"]["gaussian-5"]["holds"] is False
    )
    found = rehearse(*plan_rehearsal(read_schedule(schedule), read_rig(rig), {}))
    assert found.result["checks"]["symmetry"]["gaussian-5"]["holds"] is False
    assert any("does NOT hold" in each for each in found.result["warnings"])
    assert "check       symmetry of gaussian-5" in report_text(found)
    json.dumps(found.result, allow_nan=False)


def test_steepness_is_the_relative_change_to_the_steeper_side() -> None:
    points = points_of(30.0, np.array([10.0, 20.0, 40.0]), np.array([180.0]))
    points.bsdf[:] = np.exp([0.0, 1.0, 1.5])
    assert steepness(points).tolist() == pytest.approx([0.1, 0.1, 0.025])
    points.bsdf[1] = -1.0  # noise about nothing has no logarithm
    assert steepness(points).tolist() == pytest.approx([0.05, 0.0, 0.05])
    over = points_of(30.0, np.array([10.0, 5.0]), np.array([0.0, 180.0]))  # one arc, over the normal
    over = replace(over, beta_deg=np.array([180.0, 180.0]), bsdf=np.exp([0.0, 3.0]))
    assert steepness(over).tolist() == pytest.approx([0.2, 0.2])
