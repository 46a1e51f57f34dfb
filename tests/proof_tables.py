"""The tables of proofs in docs/physics/uncertainty-proofs.md, from folders of results of `goniotwin prove` (`make proof`).

`python -m tests.proof_tables FOLDER...` replaces the table of each folder's proof, between its marks; the others stay. A table
states the command and the sources that computed it, and some rigs alone, which a test computes again.
"""

import json
import math
import re
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

from goniotwin import examples
from goniotwin.app.campaign.proof.judgement import BOUND, SIDES, STEEP, RigResult, table_of
from goniotwin.app.campaign.proof.pooled import PooledProof, PooledTotals, judgeable, rig_of_structure
from goniotwin.app.campaign.proof.proof import Proof, rig_of_chunk, unpacked
from goniotwin.app.campaign.proof.totals import JUDGED_VALUES, CellTotal, Totals
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from goniotwin.app.sweeps.chunk_files import ABOUT, ChunkFiles
from goniotwin.app.sweeps.environment import PARTS, environment

ROOT = Path(__file__).resolve().parents[1]
DOCUMENT = ROOT / "docs" / "physics" / "uncertainty-proofs.md"
FOLDER = examples.FOLDER / "proof"
HEAD = "| | values | coverage, % | mean z | u/scatter | chi2/n | beyond 5 u (expected) |\n|---|---|---|---|---|---|---|\n"
STRUCTURES = 3
"""Structures of which a rig stands in a table alone."""
COMMAND = re.compile(
    r"`goniotwin prove (?P<what>--structures \d+|\S+)(?: --rig \S+)? --rigs (?P<rigs>\d+)(?P<wires> --without-wires)?`"
)
MARKED = re.compile(r"<!-- proof: (?P<name>[^>]+) -->\n(?P<table>.*?)<!-- end of the proof -->", re.DOTALL)


def renewed(text: str, folders: Iterable[Path]) -> str:
    """The text of the document with the tables of the folders. Raises UserError for a folder of another proof."""
    for folder in folders:
        name, table = _table(folder)
        found = [each for each in MARKED.finditer(text) if each["name"] == name]
        if len(found) != 1:
            raise UserError(f"{DOCUMENT}: has no mark <!-- proof: {name} --> for {folder}; write it where the table shall be")
        text = text[: found[0].start("table")] + table + text[found[0].end("table") :]
    return text


def _table(folder: Path) -> tuple[str, str]:
    """The name and the table of a folder's proof."""
    about = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
    data, chunks = json.loads(about["content"]), 1 + max(int(each.stem[6:]) for each in folder.glob("chunk-*.npz"))
    wires = "" if data["wires"] else " --without-wires"
    proof: Proof | PooledProof
    if "schedule" in data:
        paths = [each for each in FOLDER.glob("*.toml") if each.read_text(encoding="utf-8") == data["schedule"]["text"]]
        if not paths:
            raise UserError(f"{folder}: is of a schedule that is none of {FOLDER}")
        schedule = parse_schedule(data["schedule"]["text"], paths[0].name)
        proof = Proof(schedule, read_rig(FOLDER / "rig.toml"), chunks, folder, data["wires"])
        what, name = f"examples/proof/{paths[0].name} --rig examples/proof/rig.toml --rigs {chunks}", paths[0].stem
    else:
        proof = PooledProof(read_rig(FOLDER / "rig.toml"), chunks // data["rigs"], data["rigs"], folder, data["wires"])
        what, name = f"--structures {proof.structures} --rigs {proof.rigs}", "structures"
    if proof.specification.digest != about["digest"]:
        raise UserError(f"{folder}: is of another rig file than {FOLDER / 'rig.toml'}, or of another version of goniotwin")
    files = proof.files()
    alone = [part(unpacked(each.arrays)) for chunk in parts(proof) if (each := files.read(chunk)) is not None]
    found = proof.totals(files, {})
    lines, text = _pooled_rows(found) if isinstance(found, PooledTotals) else _rows(found)
    command = f"`goniotwin prove {what}{wires}`, by {_sources(files, chunks)}:"
    table = f"{command}\n\n{HEAD}{''.join([*lines, *alone])}\n{text}\n"
    return f"{name}{', through the wires' if data['wires'] else ''}", table


def parts(proof: Proof | PooledProof) -> list[int]:
    """The chunks that stand in a table alone: the first rig, of the first structures."""
    return [k * proof.rigs for k in range(min(STRUCTURES, proof.structures))] if isinstance(proof, PooledProof) else [0]


def _sources(files: ChunkFiles, chunks: int) -> str:
    """What computed the results: the version with the digest of its sources, and the commit where that is the one here."""
    found = {computed.environment.goniotwin for chunk in range(chunks) if (computed := files.read(chunk)) is not None}
    if len(found) != 1:
        raise UserError(f"{files.folder}: has results of several versions: {', '.join(sorted(found))}")
    (version,) = found
    commit = _git("rev-parse", "--short", "HEAD")
    changed = _git("status", "--porcelain", "--", *PARTS)
    here = commit and not changed and version == environment().goniotwin
    return f"goniotwin {version}{f', commit {commit}' if here else ''}"


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.strip()


def _rows(totals: Totals) -> tuple[list[str], str]:
    """The rows of one schedule, and the sentences below them."""
    cells = [("all but `steep`", each) for each in totals.tables.get("all", [])]
    cells += [(f"{table}: {each.label}", each) for table in _tables() for each in totals.tables.get(table, [])]
    integrals = totals.reflectances
    within = sum(not each.outside for each in integrals)
    text = (
        f"Cells of less than {JUDGED_VALUES} values are omitted. Of {len(integrals)} integrals {within} have chi2/n within "
        f"the limits of 99 %. Variance of the fitted inputs over u^2: {totals.variance_shared:.2f}."
    )
    return [_row(*each) for each in cells if each[1].values >= JUDGED_VALUES], text


def _pooled_rows(found: PooledTotals) -> tuple[list[str], str]:
    """The rows of structures, and the sentences below them."""
    judged = [(f"{table}: {cell.label}", cell, reason) for table, cells in found.judged.items() for cell, reason in cells]
    rows = [_row("all but `steep`", each) for each in found.totals.tables.get("all", [])]
    rows += [_row(label, cell) for label, cell, _ in judged if judgeable(cell)]
    missed = [f"- {label} ({reason})" for label, _, reason in judged if reason]
    integrals, outside, deviations, beyond = found.outside
    text = (
        f"{len(judged) - len(rows) + 1} cells of too few values are omitted. Of {integrals} reflectances and transmittances "
        f"{outside} have chi2/n outside the limits of 99 %, and {beyond} of {deviations} deviations are beyond 2.58 u. "
        f"Variance of the fitted inputs over u^2: {found.totals.variance_shared:.2f}. "
        + "\n".join(["Cells that miss:\n", *missed] if missed else ["No cell misses."])
    )
    return rows, text


def _tables() -> list[str]:
    return [table_of(side, kind) for side in SIDES for kind in ("", BOUND, STEEP)]


def _row(label: str, cell: CellTotal) -> str:
    coverage = f"{100.0 * cell.coverage:.1f} +- {100.0 * cell.u_coverage:.1f}"
    chi_square = f"{cell.chi_square:.2f}" if math.isfinite(cell.chi_square) else ""
    law = f"{cell.mean:.2f} | {cell.u_over_scatter:.2f} | {chi_square}"
    return f"| {label} | {cell.values:,} | {coverage} | {law} | {cell.beyond} ({cell.expected_beyond:.1g}) |\n"


def part(result: RigResult) -> str:
    """The row of one rig alone, with more digits."""
    cell = Totals([result]).whole
    assert cell is not None
    label = f"seed {result.seed} alone"
    return (
        f"| {label} | {cell.values:,} | {100.0 * cell.coverage:.3f} | {cell.mean:.5f} | {cell.u_over_scatter:.5f} | "
        f"{cell.chi_square:.5f} | {cell.beyond} |\n"
    )


def computed_parts(table: str) -> list[str]:
    """The rows of single rigs of a table in the document, computed anew by the command that the table states."""
    command = COMMAND.search(table)
    assert command is not None, table
    rig, wires = read_rig(FOLDER / "rig.toml"), command["wires"] is None
    if command["what"].startswith("--"):
        pooled = PooledProof(rig, int(command["what"].split()[1]), int(command["rigs"]), Path(), wires)
        return [part(unpacked(rig_of_structure(pooled.specification, chunk))) for chunk in parts(pooled)]
    path = ROOT / command["what"]
    proof = Proof(parse_schedule(path.read_text(encoding="utf-8"), str(path)), rig, 1, Path(), wires)
    return [part(unpacked(rig_of_chunk(proof.specification, chunk))) for chunk in parts(proof)]


if __name__ == "__main__":
    try:
        DOCUMENT.write_text(renewed(DOCUMENT.read_text(encoding="utf-8"), map(Path, sys.argv[1:])), encoding="utf-8")
    except UserError as error:
        sys.exit(str(error))
