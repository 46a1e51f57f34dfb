"""Drawn structures: the same whatever else is drawn, what a user can save and run, and what the planner refuses."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from goniotwin import examples
from goniotwin.app.campaign.proof.judgement import BOUND, SIDES, STEEP, Cell, RigResult, table_of
from goniotwin.app.campaign.proof.pooled import PooledProof, PooledTotals, prove_structures, seed_of
from goniotwin.app.campaign.proof.proof import Proof, prove
from goniotwin.app.campaign.proof.report import pooled_text
from goniotwin.app.campaign.proof.structures import SEEDS, Structure, draw_structure
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.app.cli.main import app
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, parse_rig, read_rig
from goniotwin.app.rig.samples import AnisotropicTable, SumTable, WardTable
from goniotwin.app.sweeps.runners import Here, on_this_computer

pytestmark = pytest.mark.xdist_group("structures")


@pytest.fixture(scope="module")
def base() -> RigDescription:
    return read_rig(examples.FOLDER / "proof" / "rig.toml")


def test_structures_are_of_all_kinds(base: RigDescription) -> None:
    drawn = [draw_structure(number, base) for number in range(1, 31)]
    files = [each.schedule.file for each in drawn]
    for each, file in zip(drawn, files, strict=True):
        assert each.rig.seed == SEEDS * each.number
        assert each.rig.file.twin is not None
        turned = [lobe for name in file.samples for lobe in _lobes(each, name) if _is_anisotropic(lobe)]
        assert (file.symmetry == "anisotropic") is bool(turned), each.number
    assert {file.light for file in files} == {"reflected", "transmitted", "both"}
    assert {file.side for file in files} == {"front", "back", "both"}
    assert {file.open_beam_scan is not None for file in files} == {True, False}
    for name in ("drift", "align"):
        assert {getattr(file, name) is None for file in files} == {True, False}
    kinds = {name.removesuffix("-2") for file in files for name in file.samples}
    assert kinds == {
        "lobe",
        "sum",
        "two-lobes",
        "wide",
        "ward",
        "coloured",
        "diffuser",
        "brushed",
        "brushed-sum",
        "anisotropic-ward",
    }
    steps = {round(b - a) for file in files for a, b in itertools.pairwise(sorted(grid_values(file.beta_deg)))}
    assert min(steps) <= 3
    assert 45 in steps
    sigmas = {sigma for file in files for sigma in grid_values(file.sigma_deg)}
    assert min(sigmas) < 5
    assert 80 < max(sigmas) <= 85


def _lobes(structure: Structure, name: str) -> list[object]:
    assert structure.rig.file.twin is not None
    sample = structure.rig.file.twin.samples[name]
    assert isinstance(sample, SumTable)
    return [*sample.lobes]


def _is_anisotropic(lobe: object) -> bool:
    return isinstance(lobe, AnisotropicTable) or (isinstance(lobe, WardTable) and lobe.alpha_x != lobe.alpha_y)


@pytest.mark.long
def test_what_the_planner_refuses_is_drawn_again(base: RigDescription) -> None:
    """A shift that travels less refuses some drawings; a sigma that does not move refuses all."""
    low = replace_in(base, "upper_deg = 5.5", "upper_deg = 1.4")
    drawn = [draw_structure(number, low) for number in range(1, 6)]
    assert any(each.refused and "shift" in each.refused[0] for each in drawn)
    for each in drawn:
        assert max(grid_values(each.schedule.file.shift_deg)) <= 1.4
        first = draw_structure(each.number, base)
        assert each.refused or each.schedule.text == first.schedule.text
    with pytest.raises(UserError, match=r"structure 1: no drawing of 20 is possible on .*, the last one: structure 1: "):
        draw_structure(1, replace_in(base, "upper_deg = 180.0", "upper_deg = 0.5"))


def replace_in(base: RigDescription, old: str, new: str) -> RigDescription:
    assert base.text.count(old) == 1
    return parse_rig(base.text.replace(old, new), base.folder, base.name)


@pytest.mark.long
def test_a_structure_proves_by_itself_what_it_does_among_others(base: RigDescription, tmp_path: Path) -> None:
    """Its files in the folder of the results, through the parsers of files, on the same rigs: the same sums."""
    pooled = PooledProof(base, 1, 2, tmp_path / "pooled", wires=False)
    found = prove_structures(pooled, Here())
    name = "structure-001"
    schedule, rig = (pooled.folder / f"{name}{end}" for end in (".toml", ".rig.toml"))
    alone = prove(Proof(read_schedule(schedule), read_rig(rig), 2, tmp_path / "alone", wires=False), Here())
    assert found.totals.tables["all"] == alone.tables["all"]
    assert found.totals.tables["decade"] == alone.tables["decade"]
    assert [each.label for each in found.totals.tables["structure"]] == ["structure 1"]
    assert pooled_text(pooled, found).startswith("SIMULATED: 1 structure on 2 virtual rigs of")
    assert max(map(len, pooled_text(pooled, found).partition("\nchi2/n")[0].partition("\n  ")[2].splitlines())) <= 110


def test_the_numbers_of_structures_and_rigs_are_checked(base: RigDescription, tmp_path: Path) -> None:
    for structures, rigs, wrong in (
        (0, 1, "--structures: 0 is not"),
        (1, 1001, "--rigs: 1001 is not possible with --structures"),
    ):
        with pytest.raises(UserError, match=wrong):
            PooledProof(base, structures, rigs, tmp_path, wires=False)


@pytest.mark.parametrize(
    ("arguments", "wrong"),
    [
        (["prove"], "prove: SCHEDULE.toml is missing; write goniotwin prove SCHEDULE.toml --rig RIG.toml, or --structures N"),
        (["prove", "a.toml"], "prove: --rig is missing"),
        (["prove", "a.toml", "--structures", "3"], "--structures: draws the schedules; leave a.toml out"),
    ],
)
def test_a_command_without_schedule_and_structures_is_refused(arguments: list[str], wrong: str) -> None:
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code != 0
    assert isinstance(result.exception, UserError)
    assert wrong in str(result.exception)


def results(scale: float, seed: int = 1, structures: int = 10, kind: str = "") -> list[RigResult]:
    """Rigs whose values, 200 in one cell, are normal with `scale` u as standard deviation."""
    rng, found = np.random.default_rng(seed), []
    table = table_of("reflected", kind)
    for chunk in range(structures * 4):
        z = scale * rng.normal(size=200)
        inside, far = int(np.sum(np.abs(z) <= 1.96)), int(np.sum(np.abs(z) > 5.0))
        cell = Cell(z.size, inside, float(z.sum()), far, square=float(np.sum(z**2)))
        seed_of_rig = seed_of(chunk, 4)
        found.append(RigResult(seed_of_rig, {"all": {"all": cell}, table: {"1e+0 to 1e-1, in plane": cell}}))
    return found


@pytest.mark.parametrize(
    ("scale", "kind", "reason"),
    [
        (1.0, "", ""),
        (1.2, "", "coverage"),
        (0.8, "", "coverage"),
        (0.8, BOUND, ""),
        (0.4, BOUND, "u over scatter 2.5"),
        (0.4, STEEP, "u over scatter 2.5"),
        (1.2, STEEP, "coverage"),
    ],
)
def test_cells_that_miss_are_named(scale: float, kind: str, reason: str) -> None:
    found = PooledTotals(results(scale, kind=kind))
    ((table, ((cell, missed),)),) = found.judged.items()
    assert cell.u_over_scatter == pytest.approx(1.0 / scale, rel=0.05)
    assert (cell.rigs, cell.structures) == (40, 10)
    assert missed.startswith(reason)
    assert cell.coverage == pytest.approx(math.erf(1.96 / scale / math.sqrt(2.0)), abs=0.01)
    assert bool(missed) is bool(reason)
    assert found.as_dict()["missed"] == ({f"{table}: {cell.label}": missed} if reason else {})


def test_a_structure_without_a_value_is_named() -> None:
    found = PooledTotals([*results(1.0), RigResult(11 * SEEDS), RigResult(12 * SEEDS, failed="the lamp")])
    assert found.without_value == [11]
    assert found.structures == 12


def test_a_cell_of_few_rigs_is_not_judged() -> None:
    found = PooledTotals(results(2.0, structures=4))
    assert [missed for cells in found.judged.values() for _, missed in cells] == [""]


@pytest.mark.long
def test_drawn_structures_are_covered_as_stated(base: RigDescription, tmp_path: Path) -> None:
    """Values without a lobe's slope, of 8 structures with 4 rigs each: the noise and what values share are as stated.

    The standard error of each cell is over its rigs. Cells with slopes are of fewer values: docs/physics/uncertainty-proofs.md.
    """
    pooled = PooledProof(base, 8, 4, tmp_path / "pooled", wires=False)
    found = prove_structures(pooled, on_this_computer(None, pooled.chunks))
    assert found.structures == 8
    assert not found.totals.failed
    cells = {cell.label: cell for table in SIDES for cell, _ in found.judged[table] if cell.label.startswith("below")}
    assert cells.keys() == {"below 1e-5, in plane", "below 1e-5, out of plane"}
    for cell in cells.values():
        assert abs(cell.coverage - 0.95) < 0.01 + 2.6 * cell.u_coverage
    whole = found.totals.whole
    assert whole is not None
    assert whole.beyond <= 0.002 * whole.values
