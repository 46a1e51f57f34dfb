"""`[symmetry_check]`: the test of the symmetry that a schedule states, and the rows measured for it."""

import json
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.journal.copies import copy_journal
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.reduction.points import steepness
from goniotwin.app.campaign.rehearsal.rehearsal import plan_rehearsal, rehearse
from goniotwin.app.campaign.rehearsal.report import report_text
from goniotwin.app.campaign.schedule.file import parse_schedule, read_schedule
from goniotwin.app.campaign.studies.reduced_journal import BsdfDataset, reduce_journal
from goniotwin.app.campaign.studies.symmetry import SymmetryResult
from goniotwin.app.cli.main import app
from goniotwin.app.formats import read_ddr, read_points_csv
from goniotwin.app.json_document import json_text
from goniotwin.app.rig import RigDescription, read_rig
from goniotwin.twin.optics import Scatterer, table_sample
from tests.app.campaign.campaign_bench import remove_checksums
from tests.app.data.exporting import export
from tests.app.data.test_export import points_of
from tests.conftest import RIG, SMALL, Change, Writer, changed

pytestmark = pytest.mark.xdist_group("symmetry check")

WIDE = ("beta_deg = [180]", "beta_deg = { start = 0, stop = 180, step = 30 }")
GAINS = ("[1e8, 1e10]", "[1e8, 1e10, 1e11]")
CHECK = "[symmetry_check]\npoints = 4\n"


def measure(write_rig: Writer, write_schedule: Writer, tmp_path: Path, *changes: Change, text: str = SMALL + CHECK) -> Path:
    """A journal on the rig with noise."""
    plan = make_plan(read_schedule(write_schedule(WIDE, GAINS, *changes, text=text)), read_rig(write_rig()))
    run_campaign(plan, tmp_path / "a.journal")
    return tmp_path / "a.journal"


def reduced(path: Path) -> BsdfDataset:
    with Journal.open(path) as journal:
        return reduce_journal(journal)


@pytest.fixture(scope="session")
def checked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, BsdfDataset]:
    """The journal of the schedule with a check, and its reduction. Tests only read it."""
    path = tmp_path_factory.mktemp("symmetry") / "a.journal"
    run_campaign(make_plan(parse_schedule(changed(SMALL + CHECK, (WIDE, GAINS)), "schedule.toml"), read_rig(RIG)), path)
    return path, reduced(path)


def brushed(share: float) -> Scatterer:
    """An anisotropic diffuser: its BSDF varies by plus and minus `share` with the sine of the light's azimuth."""
    psi, phi, theta = np.arange(0.0, 360.0, 15.0), np.array([0.0, 180.0]), np.array([0.0, 180.0])
    values = 0.5 / np.pi * (1.0 + share * np.sin(np.radians(psi)))
    return table_sample([30.0], phi, theta, np.broadcast_to(values[:, None, None, None], (psi.size, 1, 2, 2)), psi_deg=psi)


@pytest.fixture
def anisotropic(monkeypatch: pytest.MonkeyPatch) -> None:
    """The virtual rig's gaussian-5 is an anisotropic sample, unknown to the schedule."""
    known = RigDescription.model

    def model(self: RigDescription) -> object:
        found = known(self)
        assert found is not None
        return replace(found, samples={**found.samples, "gaussian-5": brushed(0.1)})

    monkeypatch.setattr(RigDescription, "model", model)


def test_an_isotropic_sample_passes(checked: tuple[Path, BsdfDataset]) -> None:
    found = checked[1]
    result = found.symmetry["gaussian-5"]
    assert result.holds
    assert result.pairs > 60  # 4 poses of 18 photodiodes, some blocked
    assert 0.3 * result.pairs < result.chi_square < 1.7 * result.pairs
    assert result.largest < 0.1
    assert any(note.startswith("symmetry of gaussian-5: the stated symmetry (isotropic) holds within") for note in found.notes)


@pytest.mark.long
@pytest.mark.parametrize(
    ("repeats", "changes"),
    [
        pytest.param("repeats = 2\n", (("[20, 40, 60]", "[20, 60]"),), id="repeats that share an etalon"),
        pytest.param(
            "",
            (("[1e8, 1e10, 1e11]", "[1e11]"), ("readings = 2", "readings = 10"), ("points = 4", "points = 16")),
            id="so many readings that the lamp's flicker dominates",
        ),
    ],
)
def test_a_grey_sample_passes_with_repeats_and_with_many_readings(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, repeats: str, changes: tuple[Change, ...]
) -> None:
    grey = ("[twin.samples.etalon]", '[twin.samples.grey]\nmodel = "lambertian"\nreflectance = 0.8\n\n[twin.samples.etalon]')
    three = ("sigma_deg = [30]", "sigma_deg = [20, 40, 60]")
    schedule = write_schedule(WIDE, GAINS, ("gaussian-5", "grey"), three, *changes, text=SMALL + repeats + CHECK)
    run_campaign(make_plan(read_schedule(schedule), read_rig(write_rig(grey))), tmp_path / "a.journal")
    result = reduced(tmp_path / "a.journal").symmetry["grey"]
    assert result.holds, result
    assert result.pairs > 60


def test_without_pairs_the_json_result_is_null() -> None:
    empty = SymmetryResult("isotropic", 0, 0.0, 0.0, 0.0, float("nan"), float("nan"), "")
    assert empty.as_dict()["holds"] is None


def test_a_campaign_without_the_check_has_no_result(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    found = reduced(measure(write_rig, write_schedule, tmp_path, text=SMALL))
    assert not found.symmetry
    assert not found.samples["gaussian-5"].mirrored.any()


@pytest.mark.parametrize("stated", ["isotropic", pytest.param("plane-symmetric", marks=pytest.mark.long)])
def test_an_anisotropic_sample_fails(
    stated: str, write_rig: Writer, write_schedule: Writer, tmp_path: Path, anisotropic: None
) -> None:
    gammas = "gamma_deg = [0, 60]\n" if stated == "plane-symmetric" else ""
    text = f'{SMALL}symmetry = "{stated}"\n{gammas}{CHECK}'
    found = reduced(measure(write_rig, write_schedule, tmp_path, text=text))
    result = found.symmetry["gaussian-5"]
    assert not result.holds
    assert result.stated == stated
    # 10 % of sin 90 deg against sin 0 deg; or of sin 60 deg against sin -60 deg
    assert result.largest == pytest.approx(0.105 if stated == "isotropic" else 0.173, abs=0.02)
    assert "does NOT hold" in str(result)
    assert any("does NOT hold" in note for note in found.notes)


def test_mirrored_rows_with_half_their_counts_fail(checked: tuple[Path, BsdfDataset], tmp_path: Path) -> None:
    path = tmp_path / "a.journal"
    copy_journal(checked[0], path)
    with Journal.open(path) as journal:
        first = next(each for each in journal.rows() if each.row.kind == "dark")
        dark = {reading.gain_v_per_a: reading.counts.mean(axis=0) for reading in first.data.readings}
    with sqlite3.connect(path) as db:
        chosen = "SELECT number FROM plan WHERE sample = 'gaussian-5' AND identity LIKE '%/mirrored'"
        for number, gain, counts in db.execute(
            f"SELECT number, gain_v_per_a, counts FROM reading WHERE number IN ({chosen})"
        ).fetchall():
            raw = np.frombuffer(counts, dtype="<u2").reshape(-1, dark[gain].size)
            halved = np.where(raw == 65535, raw, np.round(0.5 * (raw + dark[gain])))  # saturated counts stay
            where = "WHERE number = ? AND gain_v_per_a = ?"
            db.execute(f"UPDATE reading SET counts = ? {where}", (halved.astype("<u2").tobytes(), number, gain))
        remove_checksums(db)
    found = reduced(path)
    assert not found.symmetry["gaussian-5"].holds
    assert found.symmetry["gaussian-5"].largest == pytest.approx(2.0 / 3.0, abs=0.1)  # a half over the mean, three quarters


def test_the_exported_table_has_no_mirrored_rows_and_the_csv_marks_them(
    checked: tuple[Path, BsdfDataset], tmp_path: Path
) -> None:
    found = checked[1]
    export(found, None, tmp_path / "a.ddr", "ddr")  # a .ddr file has one gamma
    assert any("symmetry: the stated symmetry (isotropic) holds" in each for each in read_ddr(tmp_path / "a.ddr").comments)
    export(found, None, tmp_path / "a.csv", "csv")
    table = read_points_csv(tmp_path / "a.csv")
    mirrored = table.columns["check"] == "mirrored"
    assert int(mirrored.sum()) == 4 * 18
    assert set(table.columns["gamma_deg"][mirrored]) == {90.0}
    assert set(table.columns["gamma_deg"][~mirrored]) == {0.0}
    assert any("symmetry of gaussian-5" in each for each in table.comments)


@pytest.mark.long
def test_run_and_rehearsal_report_a_failed_symmetry_check(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, anisotropic: None
) -> None:
    schedule, rig = write_schedule(WIDE, GAINS, ("shift_deg = [0, 1]", "shift_deg = [0]"), text=SMALL + CHECK), write_rig()
    command = ["run", str(schedule), "--rig", str(rig), "--out", str(tmp_path / "a.journal")]
    assert "does NOT hold" in CliRunner().invoke(app, command).stdout
    command[-1] = str(tmp_path / "b.journal")
    assert (
        json.loads(CliRunner().invoke(app, [*command, "--json"]).stdout)["checks"]["symmetry"]["gaussian-5"]["holds"] is False
    )
    found = rehearse(*plan_rehearsal(read_schedule(schedule), read_rig(rig), {}))
    assert found.result.checks.symmetry["gaussian-5"].holds is False
    assert any("does NOT hold" in each for each in found.result.warnings)
    assert "check       symmetry of gaussian-5" in report_text(found)
    assert json_text(found.result)


def test_steepness_is_the_larger_relative_change_of_both_sides() -> None:
    points = points_of(30.0, np.array([10.0, 20.0, 40.0]), np.array([180.0]))
    points.bsdf[:] = np.exp([0.0, 1.0, 1.5])
    assert steepness(points).tolist() == pytest.approx([0.1, 0.1, 0.025])
    points.bsdf[1] = -1.0  # a negative value has no logarithm
    assert steepness(points).tolist() == pytest.approx([0.05, 0.0, 0.05])
    over = points_of(30.0, np.array([10.0, 5.0]), np.array([0.0, 180.0]))  # one arc, over the normal
    over = replace(over, place=np.array([1, 1], dtype=np.int32), bsdf=np.exp([0.0, 3.0]))
    assert steepness(over).tolist() == pytest.approx([0.2, 0.2])
