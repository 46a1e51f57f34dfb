"""A new schedule from a template."""

import shlex
import sys
from pathlib import Path
from typing import Any

import typer

from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.templates import (
    TEMPLATES,
    USUAL_ETALON,
    USUAL_H,
    USUAL_U,
    MadeSchedule,
    choose_template,
    make_schedule,
)
from goniotwin.app.campaign.wording import duration_text
from goniotwin.app.cli.output import answer, error_console
from goniotwin.app.errors import UserError
from goniotwin.app.formats.file import check_writable, write_file
from goniotwin.app.rig import read_rig


def new_schedule(
    path: Path | None,
    rig: Path | None,
    template: str | None,
    sample: str | None,
    etalon: str | None,
    target_u: float | None,
    longest_h: float | None,
    force: bool,
    as_json: bool,
) -> None:
    """Ask for what is None, write the schedule, and print the next commands. Raises UserError."""
    given = {
        "FILE.toml": path,
        "--rig": rig,
        "--template": template,
        "--sample": sample,
        "--target-u": target_u,
        "--longest-h": longest_h,
    }
    missing = [name for name, value in given.items() if value is None]
    if missing and not sys.stdin.isatty():
        raise UserError(f"new: {', '.join(missing)}: missing; add this, or run the command in a terminal, which asks for it")
    rig = _asked("Rig file", rig, Path)
    description = read_rig(rig)
    if template is None:
        for name, each in TEMPLATES.items():
            error_console().print(f"  {name:12}{each.title}", markup=False)
    template = _asked("Template", template, str)
    if choose_template(template).light == "transmitted" and sys.stdin.isatty():
        etalon = _asked("Reference standard, white on both sides", etalon, str, USUAL_ETALON)
    etalon = etalon or USUAL_ETALON
    twin = description.file.twin
    known = "" if twin is None else f" (the virtual rig has {', '.join(sorted({*twin.samples} - {etalon}))})"
    sample = _asked(f"Name of the sample{known}", sample, str)
    target_u = _asked("Relative standard uncertainty (k = 1)", target_u, float, USUAL_U)
    longest_h = _asked("Longest machine time, h", longest_h, float, USUAL_H)
    path = _asked("File of the schedule", path, Path, Path(f"{sample.replace(' ', '-')}.toml"))
    _refuse_existing(path, rig, force)
    made = make_schedule(template, description, str(path), sample, etalon, target_u, longest_h)
    write_file(path, made.text.encode())
    notes = (*made.notes, *check_plan(made.plan).warnings)
    result = {"schedule": str(path), "rows": len(made.plan.rows), "duration_s": made.plan.seconds, "notes": notes}
    answer(as_json, result, lambda: _print(made, notes, path, rig))


def _asked(question: str, given: Any, kind: Any, default: Any = None) -> Any:
    """The value that is given, or else the answer at the terminal."""
    return typer.prompt(question, type=kind, default=default, err=True) if given is None else given


def _refuse_existing(path: Path, rig: Path, force: bool) -> None:
    """Raise UserError for a file that cannot be written, and for one that exists and is not to be overwritten."""
    check_writable(path)
    if path.exists() and rig.exists() and path.samefile(rig):
        raise UserError(f"{path}: is the rig file, and is kept; choose another name for the schedule")
    if path.exists() and not force:
        if not sys.stdin.isatty():
            raise UserError(f"{path}: exists, and is kept; choose another name, or give --force")
        if not typer.confirm(f"{path} exists. Overwrite it?", default=False, err=True):
            raise UserError(f"{path}: exists, and is kept; choose another name")


def _print(made: MadeSchedule, notes: tuple[str, ...], path: Path, rig: Path) -> None:
    print(f"{path}: {len(made.plan.rows)} rows, about {duration_text(made.plan.seconds)}")
    for note in notes:
        print(f"  note        {note}")
    file, on = shlex.quote(str(path)), f"--rig {shlex.quote(str(rig))}"
    for command, more in (("check", ""), ("rehearse", ""), ("run", f" --out {shlex.quote(str(path.with_suffix('.journal')))}")):
        print(f"  next        goniotwin {command} {file} {on}{more}")
