"""The rehearsal of a schedule."""

import os
from pathlib import Path

import typer

from goniotwin.app.campaign.rehearsal.rehearsal import plan_rehearsal, rehearse
from goniotwin.app.campaign.rehearsal.report import report_text
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.cli.output import answer, error_console, print_error
from goniotwin.app.cli.work.compilation import compile_ahead, parts_of_rehearsal
from goniotwin.app.cli.work.row_progress import RowProgress
from goniotwin.app.errors import UserError
from goniotwin.app.formats import FormatError
from goniotwin.app.formats.file import check_writable
from goniotwin.app.formats.registry import Holds, format_for
from goniotwin.app.rig import read_rig


def rehearse_schedule(
    schedule: Path, rig: Path, samples: list[str], out: Path | None, points: Path | None, processes: int, as_json: bool
) -> None:
    """Rehearse a campaign and print the result. Raises UserError, and Exit where rows are missing."""
    _check_writable(points, out)
    plan, assumed = plan_rehearsal(read_schedule(schedule), read_rig(rig), _sample_models(samples))
    compile_ahead(parts_of_rehearsal(plan.schedule.file, plan.rig.model()))  # what is refused is not waited for
    with RowProgress(error_console(), f"{plan.schedule.file.name} (rehearsal)", len(plan.rows)) as progress:
        rehearsal = rehearse(plan, assumed, out=out, points=points, listeners=[progress], processes=processes)
    answer(as_json, rehearsal.result, lambda: print(report_text(rehearsal)))
    for fault in rehearsal.result.faults:
        print_error(fault)
    if not rehearsal.done:
        raise typer.Exit(3 if rehearsal.end is State.IDLE else 1)


def _sample_models(texts: list[str]) -> dict[str, str]:
    """The models of samples by name. Raises UserError."""
    models: dict[str, str] = {}
    for each in texts:
        name, equals, model = each.partition("=")
        if not name.strip() or not equals or not model.strip():
            raise UserError(f"--sample {each!r}: write NAME=MODEL, such as paper=lambertian:reflectance=0.8")
        if name.strip() in models:
            raise UserError(f"--sample {name.strip()}: is given twice; leave one of them out")
        models[name.strip()] = model.strip()
    return models


def _check_writable(points: Path | None, out: Path | None) -> None:
    """Check, before a long rehearsal, that its files can be written after it. Raises UserError."""
    if out is not None and out.exists():
        raise UserError(f"--out {out}: exists, and a journal is never overwritten; choose another name")
    if points is not None and out is not None and os.path.realpath(points) == os.path.realpath(out):
        raise UserError(f"--points {points}: is the journal of --out; choose another name for one of them")
    for option, path in (("--points", points), ("--out", out)):
        if path is not None:
            try:
                check_writable(path)
                if path == points:
                    format_for(path, {Holds.COLUMNS})
            except FormatError as error:
                raise UserError(f"{option} {error}") from None
