"""The proof of stated uncertainties: of a schedule, and of drawn structures."""

from pathlib import Path

import typer

from goniotwin import examples
from goniotwin.app.campaign.proof.pooled import PooledProof, prove_structures
from goniotwin.app.campaign.proof.proof import Proof, prove
from goniotwin.app.campaign.proof.report import pooled_text, proof_text
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.cli.output import RunnerOptions, answer, error_console, print_error, print_note
from goniotwin.app.cli.work.compilation import compile_ahead, parts_of_rehearsal
from goniotwin.app.cli.work.progress import SweepProgress
from goniotwin.app.cli.work.sweeps import kept, runner_of
from goniotwin.app.rig import read_rig


def prove_schedule(
    schedule: Path, rig: Path, rigs: int, out: Path | None, options: RunnerOptions, as_json: bool, *, wires: bool
) -> None:
    """Prove a schedule on virtual rigs and print the result. Raises UserError, and Exit where a rig has none."""
    folder = out if out is not None else Path(f"{schedule.stem}.proof")
    proof = Proof(read_schedule(schedule), read_rig(rig), rigs, folder, wires=wires)
    compile_ahead(parts_of_rehearsal(proof.plan.schedule.file, proof.rig.model()))  # what is refused is not waited for
    with (
        runner_of(options, rigs) as runner,
        kept(folder, "rigs"),
        SweepProgress(error_console(), f"{proof.schedule.file.name} (proof)", rigs, "rigs") as progress,
    ):
        totals = prove(proof, runner, progress, print_note)
    answer(as_json, totals, lambda: print(proof_text(proof, totals)))
    _end_proof(totals.failed)


def prove_drawn(
    structures: int, rig: Path | None, rigs: int, out: Path | None, options: RunnerOptions, as_json: bool, *, wires: bool
) -> None:
    """Prove drawn structures and print the result. Raises UserError, and Exit where a rig has none."""
    folder = out if out is not None else Path("structures.proof")
    base = read_rig(rig if rig is not None else examples.FOLDER / "proof" / "rig.toml")
    proof = PooledProof(base, structures, rigs, folder, wires=wires)
    for each in proof.drawn:
        compile_ahead(parts_of_rehearsal(each.schedule.file, each.rig.model()))
    with (
        runner_of(options, proof.chunks) as runner,
        kept(folder, "rigs"),
        SweepProgress(error_console(), f"{structures} structures (proof)", proof.chunks, "rigs") as progress,
    ):
        found = prove_structures(proof, runner, progress, print_note)
    answer(as_json, {**found.as_dict(), "drawn_again": proof.drawn_again}, lambda: print(pooled_text(proof, found)))
    _end_proof(found.totals.failed)


def _end_proof(failed: dict[int, str]) -> None:
    """Print the rigs without a result, and end with their exit status."""
    for seed, reason in failed.items():
        print_error(f"seed {seed}: {reason}")
    if failed:
        raise typer.Exit(1)
