"""A pooled proof: a sweep over drawn structures, each with virtual rigs of its own, whose values are counted together."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from goniotwin.app.campaign.proof.judgement import BOUND, SIDES, STEEP, RigResult, table_of
from goniotwin.app.campaign.proof.proof import RESULTS, Proof, packed, unpacked
from goniotwin.app.campaign.proof.structures import MOST_STRUCTURES, SEEDS, Structure, draw_structure
from goniotwin.app.campaign.proof.totals import JUDGED_VALUES, CellTotal, Totals
from goniotwin.app.errors import UserError
from goniotwin.app.formats.file import write_file
from goniotwin.app.rig import RigDescription, parse_rig
from goniotwin.app.sweeps.chunk_files import ChunkFiles, Note
from goniotwin.app.sweeps.runners import Runner
from goniotwin.app.sweeps.specification import Arrays, Specification
from goniotwin.app.sweeps.sweep import Report, run_sweep

ALLOWED, STANDARD_ERRORS = 0.01, 2.6
"""A coverage may be off by so much, and so many of its standard errors."""
LEAST_COVERAGE, MOST_U = 0.94, 2.0
"""Of values whose u is for the most part a limit: their coverage at least, and their u over the scatter at most."""
JUDGED_RIGS = 20
"""Rigs that a cell needs: the standard error of fewer is hardly known."""
NAME = "the rig file"


@dataclass(frozen=True)
class PooledProof:
    """What a pooled proof runs: the first `structures` drawn ones for a rig file, each on so many `rigs` of its own."""

    rig: RigDescription
    structures: int
    rigs: int
    folder: Path
    wires: bool

    def __post_init__(self) -> None:
        if not 1 <= self.structures <= MOST_STRUCTURES:
            raise UserError(f"--structures: {self.structures} is not possible; give 1 to {MOST_STRUCTURES}")
        if not 1 <= self.rigs <= SEEDS:
            raise UserError(f"--rigs: {self.rigs} is not possible with --structures; give 1 to {SEEDS}")

    @property
    def chunks(self) -> int:
        """The number of rigs of all structures."""
        return self.structures * self.rigs

    @cached_property
    def drawn(self) -> list[Structure]:
        """The structures. Raises UserError for a rig file on which none is possible."""
        return [draw_structure(number, self.rig) for number in range(1, self.structures + 1)]

    @property
    def drawn_again(self) -> dict[int, tuple[str, ...]]:
        """Why drawings of a structure, by its number, were refused."""
        return {each.number: each.refused for each in self.drawn if each.refused}

    @cached_property
    def specification(self) -> Specification:
        """The sweep: the rigs of a structure are chunks in a row. Of the rig file the samples are not used."""
        rig = {"text": self.rig.text, "alignment": self.rig.alignment}
        content = {"rig": rig, "wires": self.wires, "rigs": self.rigs}
        return Specification.of("proof of structures", RESULTS, 1, 0, content)

    def files(self, note: Note = lambda _: None) -> ChunkFiles:
        """The files of the results."""
        return ChunkFiles(
            self.folder,
            self.specification,
            "--out",
            "rig file, number of --rigs, kind of proof or version of the results",
            note,
        )

    def write_structures(self) -> None:
        """Write schedule and rig file of each structure into the folder of the results. Raises UserError."""
        for each in self.drawn:
            write_file(self.folder / f"{each.name}.toml", each.schedule.text.encode())
            write_file(self.folder / f"{each.name}.rig.toml", each.rig.text.encode())

    def totals(self, files: ChunkFiles, failures: dict[int, str]) -> "PooledTotals":
        """The totals of all rigs of all structures."""
        return PooledTotals(list(self._results(files, failures)))

    def _results(self, files: ChunkFiles, failures: dict[int, str]) -> Iterator[RigResult]:
        for chunk in range(self.chunks):
            if chunk in failures:
                yield RigResult(seed_of(chunk, self.rigs), failed=failures[chunk])
            elif (computed := files.read(chunk)) is not None:
                yield unpacked(computed.arrays)


def seed_of(chunk: int, rigs: int) -> int:
    """The seed of a chunk's rig, from which follows its structure."""
    return SEEDS * (chunk // rigs + 1) + chunk % rigs


def prove_structures(
    proof: PooledProof, runner: Runner, report: Report = lambda _done, _now: None, note: Note = lambda _: None
) -> "PooledTotals":
    """Run all rigs that are not done yet, and give the totals. Raises as `prove`."""
    _ = proof.drawn  # refused before anything is written
    files = proof.files(note)
    with files.opened():
        proof.write_structures()
    return proof.totals(files, run_sweep(rig_of_structure, files, proof.chunks, runner, report))


def rig_of_structure(specification: Specification, chunk: int) -> Arrays:
    """The result of one rig of a pooled proof. Raises UserError where its campaign comes to no end."""
    seed = seed_of(chunk, specification.data["rigs"])
    return packed(_proof_of(specification, seed // SEEDS).result(seed))


@lru_cache(maxsize=4)
def _proof_of(specification: Specification, number: int) -> Proof:
    data = specification.data
    base = parse_rig(data["rig"]["text"], Path(), NAME, data["rig"]["alignment"])
    structure = draw_structure(number, base)
    return Proof(structure.schedule, structure.rig, data["rigs"], Path(), data["wires"])


class PooledTotals:
    """The totals of a pooled proof: those of all rigs, and which cells miss what is asked of them.

    `without_value` are the structures whose rigs have no good value: too little light, or flagged.
    """

    def __init__(self, results: list[RigResult]) -> None:
        numbers = {each.seed: each.seed // SEEDS for each in results}
        self.totals = Totals([_of_structure(each, numbers[each.seed]) for each in results], numbers)
        self.structures = len({*numbers.values()})
        with_values = {numbers[each.seed] for each in results if each.cells or each.failed}
        self.without_value = sorted({*numbers.values()} - with_values)

    @property
    def judged(self) -> dict[str, list[tuple[CellTotal, str]]]:
        """By side and kind of u, the cells, each with what it misses: empty for nothing."""
        return {
            table: [(each, missed(each, kind)) for each in self.totals.tables.get(table, [])]
            for side in SIDES
            for kind in ("", BOUND, STEEP)
            if (table := table_of(side, kind)) in self.totals.tables
        }

    @property
    def outside(self) -> tuple[int, int, int, int]:
        """Reflectances and transmittances: how many there are, those whose chi2/n over the rigs is outside the limits of 99 %;
        deviations of a rig, those beyond 2.58 u.
        """
        integrals = self.totals.reflectances
        out = sum(each.outside for each in integrals)
        return len(integrals), out, sum(each.rigs for each in integrals), sum(each.beyond for each in integrals)

    def as_dict(self) -> dict[str, Any]:
        """The totals for JSON."""
        integrals, outside, deviations, beyond = self.outside
        return {
            **self.totals.as_dict(),
            "structures": self.structures,
            "structures_without_value": self.without_value,
            "missed": {
                f"{table}: {cell.label}": reason for table, cells in self.judged.items() for cell, reason in cells if reason
            },
            "integrals": {"number": integrals, "outside_99": outside, "of_rigs": deviations, "beyond_99": beyond},
        }


def missed(cell: CellTotal, kind: str) -> str:
    """What a cell misses, in words: empty for nothing, and for one with too few values or rigs to judge."""
    if not judgeable(cell):
        return ""
    allowed = STANDARD_ERRORS * cell.u_coverage
    if not kind:
        wrong = abs(cell.coverage - 0.95) > ALLOWED + allowed
        return f"coverage {100.0 * cell.coverage:.1f} %" if wrong else ""
    if cell.coverage + allowed < LEAST_COVERAGE:
        return f"coverage {100.0 * cell.coverage:.1f} %"
    return f"u over scatter {cell.u_over_scatter:.2f}" if cell.u_over_scatter > MOST_U else ""


def judgeable(cell: CellTotal) -> bool:
    """Whether a cell has enough values and rigs."""
    return cell.values >= JUDGED_VALUES and cell.rigs >= JUDGED_RIGS and math.isfinite(cell.u_coverage)


def _of_structure(result: RigResult, number: int) -> RigResult:
    """A result whose names are those of its structure."""
    name = f"structure {number}"
    whole = result.cells.get("all")
    cells = {**result.cells, "structure": {name: whole["all"]}} if whole else result.cells
    return replace(
        result,
        cells=cells,
        angles={f"{name}: {key}": each for key, each in result.angles.items()},
        reflectances={f"{name}: {key}": each for key, each in result.reflectances.items()},
        far=[{"structure": number, **each} for each in result.far],
    )
