"""Proofs on small schedules: what is drawn, both ways to run a rig, a proof that continues, and the law of all."""

import contextlib
import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.proof.judgement import RigResult
from goniotwin.app.campaign.proof.proof import Proof, prove, rig_of_chunk, unpacked
from goniotwin.app.campaign.proof.report import proof_text
from goniotwin.app.campaign.proof.virtual_rigs import run_with_wires
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.schedule.file import parse_schedule, read_schedule
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.errors import UserError
from goniotwin.app.formats import BsdfTable, registry, writing
from goniotwin.app.formats.content import BsdfFile
from goniotwin.app.json_document import json_value
from goniotwin.app.rig import read_rig
from goniotwin.app.rig.inputs import inputs
from goniotwin.app.sweeps.runners import Here
from goniotwin.app.sweeps.specification import Specification
from goniotwin.linear_algebra import one_thread_in_linear_algebra
from tests.conftest import RIG, SMALL, Writer

FAULT = ("[twin.samples.etalon]", "[twin.disturbances]\nsigma_zero_deg = 0.7\n\n[twin.samples.etalon]")


TABLE = (
    '[twin.samples.gaussian-5]\nmodel = "gaussian"\nwidth_deg = 5.0\nform = "one_over_e"\n'
    'quantity = "luminance"\nreflectance = 0.9',
    '[twin.samples.gaussian-5]\nmodel = "table"\nfile = "paint.ddr"',
)


def write_table(path: Path, factor: float = 1.0) -> None:
    """The BRDF of a grey diffuser as a table."""
    zenith = np.linspace(0.0, 180.0, 37)
    table = BsdfTable(np.array([0.0, 90.0]), np.array([0.0, 180.0]), zenith, np.full((1, 1, 2, 2, zenith.size), 0.2 * factor))
    writing.write(path, BsdfFile((table,)), registry.format_named("ddr", {registry.Holds.GRID}))


def small_proof(write_rig: Writer, write_schedule: Writer, folder: Path, rigs: int = 2, *, wires: bool = False) -> Proof:
    return Proof(read_schedule(write_schedule()), read_rig(write_rig()), rigs, folder, wires)


def test_a_rig_is_drawn_from_what_its_file_states(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    rig = read_rig(write_rig(FAULT, ("gain_uncertainty = 0.001", "gain_uncertainty = 0.003")))
    proof = Proof(read_schedule(write_schedule()), rig, 3, tmp_path / "proof", wires=False)
    assert proof.seeds == [1, 2, 3]
    drawn = proof.drawn.rig(3)
    assert drawn.seed == 3
    assert "seed = 3" in drawn.text
    model = drawn.model()
    assert model is not None
    assert model.seed == 3
    assert model.electronics.gain_spread == 0.003
    assert model.disturbances.etalon == "etalon"
    assert model.disturbances.etalon_years == 1.0  # as the reduction assumes without a date
    drawn_by = {key: width for key, (_, width) in model.disturbances.widths.items()}
    assert drawn_by.pop("sigma_zero_deg") == 0.7  # a fault of which [uncertainty] knows nothing
    assert drawn_by.pop("certificate_level") == rig.file.etalon.relative_uncertainty
    assert drawn_by == {each.key: rig.file.uncertainty.width(each) for each in inputs() if each.key in drawn_by}


def test_without_wires_the_values_are_those_of_the_wires(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    """The same drawn rig measured both ways: the values differ by their noise alone."""
    proof = small_proof(write_rig, write_schedule, tmp_path / "proof")
    values = []
    for run in (run_with_wires, run_without_wires):
        path = tmp_path / f"{run.__name__}.journal"
        run(proof.plan, path)
        with Journal.open(path) as journal:
            values.append(reduce_journal(journal).samples["gaussian-5"])
    wired, direct = values
    assert np.array_equal(wired.zenith_deg, direct.zenith_deg)
    both = wired.good & direct.good
    noise = np.sqrt(sum(each.components[name] for each in values for name in ("noise", "dark", "etalon_reading", "monitor")))
    bright = both & ~wired.flag("under-range")
    assert bright.sum() >= 5
    # Drawn at each move: the position of an axis, which has other numbers of moves with a search for the reference.
    slack = 0.02 * np.abs(wired.bsdf)
    assert np.all(np.abs(wired.bsdf - direct.bsdf)[bright] < (5.0 * noise + slack)[bright])


def test_a_warm_up_has_no_pose_to_go_to_without_wires(tmp_path: Path) -> None:
    warm = parse_schedule(f"{SMALL}[warm_up]\npercent_per_10min = 2.0\nlongest_s = 60.0\n", "warm.toml")
    run_without_wires(make_plan(warm, read_rig(RIG)), tmp_path / "a.journal")
    with Journal.open(tmp_path / "a.journal") as journal:
        (row,) = journal.rows("warm-up")
        assert row.data.ended_s - row.data.started_s >= 60.0
        assert reduce_journal(journal).samples["gaussian-5"].good.any()


def test_a_proof_continues_and_its_results_are_those_of_one_run(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "proof"
    prove(small_proof(write_rig, write_schedule, folder, rigs=1), Here())
    first = (folder / "chunk-000000.npz").read_bytes()
    run: list[int] = []
    result = Proof.result

    def counted(proof: Proof, seed: int) -> RigResult:
        run.append(seed)
        return result(proof, seed)

    monkeypatch.setattr(Proof, "result", counted)
    done: list[int] = []
    proof = small_proof(write_rig, write_schedule, folder)
    totals = prove(proof, Here(), lambda count, _now: done.append(count))
    assert run == [2]
    assert done == [1, 2]
    assert (folder / "chunk-000000.npz").read_bytes() == first
    assert totals.rigs == 2
    second = folder / "chunk-000001.npz"
    second.write_bytes(second.read_bytes()[:-100])  # not whole
    again = prove(proof, Here())
    assert run == [2, 2]
    assert json_value(again) == json_value(totals)
    assert {
        "rigs",
        "points",
        "coverage_percent",
        "standard_error_percent",
        "chi2_independent",
        "variance_shared",
        "mean_z",
        "worst_cell_percent",
        "beyond_5u",
        "expected_beyond_5u",
    } <= again.as_dict().keys()
    assert proof_text(proof, totals).startswith("SIMULATED: small on 2 virtual rigs")
    with pytest.raises(UserError, match="has results of another schedule, rig file, kind of proof or version"):
        prove(small_proof(write_rig, write_schedule, folder, wires=True), Here())


@pytest.mark.long
def test_the_tables_of_samples_go_with_the_proof(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    """A worker on another computer has no files of this one."""
    write_table(tmp_path / "paint.ddr")
    proof = Proof(read_schedule(write_schedule()), read_rig(write_rig(TABLE)), 1, tmp_path / "proof", wires=False)
    own, specification = proof.result(1), proof.specification
    for each in ("paint.ddr", "rig.toml", "schedule.toml"):
        (tmp_path / each).unlink()
    elsewhere = Specification(**json.loads(json.dumps(asdict(specification))))
    assert unpacked(rig_of_chunk(elsewhere, 0)) == own


def test_a_folder_of_other_files_and_a_wrong_number_are_refused(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    with pytest.raises(UserError, match="--rigs: 0 is not possible; give 1 to"):
        small_proof(write_rig, write_schedule, tmp_path / "proof", rigs=0)
    with pytest.raises(UserError, match="is not empty, and no folder of a proof; choose another one with --out"):
        prove(small_proof(write_rig, write_schedule, tmp_path), Here())


def test_a_folder_in_use_is_refused_and_its_file_too(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    proof = small_proof(write_rig, write_schedule, tmp_path / "proof", rigs=1)
    with proof.files().opened(), pytest.raises(UserError, match=r"is in use by process .*: proof; wait for it"):
        prove(proof, Here())
    prove(proof, Here())
    assert sorted(each.name for each in proof.folder.iterdir()) == ["chunk-000000.npz", "sweep.json"]
    (tmp_path / "a.csv").write_text("a", encoding="utf-8")
    with pytest.raises(UserError, match=r"a\.csv: is a file; choose another folder with --out"):
        prove(replace(proof, folder=tmp_path / "a.csv"), Here())


def test_the_report_fits_80_columns(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    proof = small_proof(write_rig, write_schedule, tmp_path / "proof", rigs=1)
    table = proof_text(proof, prove(proof, Here())).partition("\nall ")[2].partition("\nangle")[0]
    assert "gaussian-5, 1e+0 to 1e-1" in table
    assert max(map(len, table.splitlines())) <= 80


def test_a_rig_without_a_result_does_not_end_the_others(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(plan: object, path: Path) -> None:
        raise UserError("the arc is in the beam")

    proof = small_proof(write_rig, write_schedule, tmp_path / "proof")
    with monkeypatch.context() as at_first:
        at_first.setattr("goniotwin.app.campaign.proof.proof.run_without_wires", fail)
        totals = prove(proof, Here())
    assert totals.failed == {1: "the arc is in the beam", 2: "the arc is in the beam"}
    assert totals.as_dict()["points"] == 0
    again = prove(proof, Here())  # as after a full disk: the same command runs them again
    assert not again.failed
    assert again.as_dict()["points"] > 0


def test_another_table_of_a_sample_is_another_proof(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    for factor in (1.0, 1.1):
        write_table(tmp_path / "paint.ddr", factor)
        rig = read_rig(write_rig(TABLE))
        proof = Proof(read_schedule(write_schedule()), rig, 1, tmp_path / "proof", wires=False)
        refused = pytest.raises(UserError, match="results of another schedule")
        with contextlib.nullcontext() if factor == 1.0 else refused, proof.files().opened():
            pass


def test_a_result_is_read_as_it_was_written(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    proof = small_proof(write_rig, write_schedule, tmp_path / "proof")
    with one_thread_in_linear_algebra():  # as in a sweep
        result = proof.result(1)
    prove(proof, Here())
    kept = proof.files().read(0)
    assert kept is not None
    assert unpacked(kept.arrays) == result
    assert isinstance(result, RigResult)
    assert result.cells["all"]["all"].values > 0
    assert not [each for each in (tmp_path / "proof").iterdir() if each.is_dir()]
