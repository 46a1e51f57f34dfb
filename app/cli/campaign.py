"""The commands that measure: `goniotwin run`, `rehearse`, `check` and `runs`; and what all commands answer with."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from goniotwin.app.cli.instrument import RigOption, errors
from goniotwin.app.cli.progress import RowProgress
from goniotwin.app.errors import UserError

__all__ = ["Json", "RigOption", "TranscriptOption", "add_campaign_commands", "answer", "errors"]

Schedule = Annotated[Path, typer.Argument(metavar="SCHEDULE.toml", help="What is to be measured.", show_default=False)]
Json = Annotated[bool, typer.Option("--json", help="One JSON object on standard output, everything else on standard error.")]
TranscriptOption = Annotated[
    Path | None,
    typer.Option(
        "--transcript", metavar="DIR", help="Write every byte on every wire there, with its time.", show_default=False
    ),
]


def add_campaign_commands(app: typer.Typer) -> None:
    """Registers them."""
    for command in (run, rehearse, check, runs):
        app.command()(command)


def answer(as_json: bool, result: dict[str, Any], show: Callable[[], None]) -> None:
    """What a command found: one JSON object for programs, or as `show` prints it."""
    if as_json:
        print(json.dumps(result, indent=2, allow_nan=False))
    else:
        show()


def run(
    schedule: Annotated[
        Path | None, typer.Argument(metavar="[SCHEDULE.toml]", help="What is to be measured.", show_default=False)
    ] = None,
    rig: Annotated[
        Path | None, typer.Option("--rig", metavar="RIG.toml", help="Where the devices are.", show_default=False)
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="JOURNAL", help="The journal, a new file.", show_default=False)
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option("--resume", metavar="JOURNAL", help="Go on with this campaign where it ended.", show_default=False),
    ] = None,
    transcript: TranscriptOption = None,
    as_json: Json = False,
) -> None:
    """Measure a campaign, or go on with one.

    Checks schedule and rig first and refuses what cannot work (status 2, no journal). A row is on the disk before the next
    begins. Ends with status 0 when all rows are done, 1 after a fault or when rows were skipped for faults, 3 where the
    schedule has ended it ([stop], or a drift beyond its limit), 130 after Ctrl-C: the journal has what was measured until
    then, and --resume goes on.

    With --resume the journal says what is to be measured and on which rig; --rig is only needed where the devices are reached
    at other ports than before, and anything else that differs is refused. It goes on with the rows that are not in the
    journal, or were skipped, after the sample has been mounted again, a dark taken and the light compared with what it was.
    """
    from goniotwin.app.campaign.campaign import resume_campaign, run_campaign
    from goniotwin.app.campaign.reduction.reduction import check_journal
    from goniotwin.app.campaign.running.events import State
    from goniotwin.app.rig import read_rig

    _check_what_is_given(schedule, rig, out, resume)
    if resume is not None:
        journal, title = resume, str(resume)
        with RowProgress(errors, title, None) as progress:
            outcome = resume_campaign(
                resume, read_rig(rig) if rig is not None else None, listeners=[progress], transcript=transcript, ask=_ask_person
            )
    else:
        assert schedule is not None
        assert rig is not None
        assert out is not None
        plan, journal = _plan(schedule, rig), out
        with RowProgress(errors, plan.schedule.file.name, len(plan.rows)) as progress:
            outcome = run_campaign(plan, out, listeners=[progress], transcript=transcript, ask=_ask_person)
    result = {
        "journal": str(journal),
        "state": "stopped" if outcome.state is State.IDLE else str(outcome.state),
        "reason": outcome.ended_by_schedule,
        "rows": outcome.rows,
        "skipped": outcome.skipped,
        "planned": outcome.of,
        "duration_s": outcome.seconds,
        "simulated": outcome.simulated,
        "faults": list(outcome.faults),
    }
    if (checks := check_journal(journal)) is not None:
        result["checks"] = checks.as_dict()
    for fault in outcome.faults:
        errors.print(f"goniotwin: {fault}", style="red", markup=False)
    mark = "SIMULATED, " if outcome.simulated else ""
    skipped = f" ({outcome.skipped} skipped)" if outcome.skipped else ""
    rows = f"{outcome.rows} of {outcome.of} rows{skipped} in {outcome.seconds:.1f} s of the rig's time"
    text = f"{mark}{result['state']}: {rows}: {journal}"
    answer(as_json, result, lambda: print("\n".join([text, *(checks.lines if checks is not None else [])])))
    if outcome.ended_by_schedule:
        errors.print(f"goniotwin: the schedule has ended it: {outcome.ended_by_schedule}", style="yellow", markup=False)
    if outcome.rows < outcome.of:
        errors.print(f"go on with: goniotwin run --resume {journal}", markup=False)
    if outcome.state is not State.DONE or outcome.skipped:
        raise typer.Exit((3 if outcome.ended_by_schedule else 130) if outcome.state is State.IDLE else 1)


def rehearse(
    schedule: Schedule,
    rig: RigOption,
    sample: Annotated[
        list[str] | None,
        typer.Option(
            "--sample",
            metavar="NAME=MODEL",
            help="What a sample of the schedule is, such as paper=lambertian:reflectance=0.8; may be given several times.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="JOURNAL", help="Keep the rehearsal's journal.", show_default=False)
    ] = None,
    points: Annotated[
        Path | None,
        typer.Option("--points", metavar="FILE.csv", help="The uncertainty foretold for each direction.", show_default=False),
    ] = None,
    as_json: Json = False,
) -> None:
    """Run a whole campaign against the twin, on its own fast clock: how long it takes, how good it will be, what is wrong.

    The same drivers, bytes and plan as in the campaign itself. For a real rig's file the twin is built that the file
    describes; nothing of the rig is opened. What the operator believes wrongly of the rig (a sense, a gear) is wrong in that
    twin too, so it cannot show. Ends with status 0 when all rows are done, 1 after a fault, 3 where the schedule's own [stop]
    lets it come no further.
    """
    from goniotwin.app.campaign.rehearsal.rehearsal import plan_rehearsal, rehearse
    from goniotwin.app.campaign.rehearsal.report import report_text
    from goniotwin.app.campaign.schedule.file import read_schedule
    from goniotwin.app.rig import read_rig

    _refuse_unwritable(points, out)
    plan, assumed = plan_rehearsal(read_schedule(schedule), read_rig(rig), _models(sample or []))
    with RowProgress(errors, f"{plan.schedule.file.name} (rehearsal)", len(plan.rows)) as progress:
        found = rehearse(plan, assumed, out=out, points=points, listeners=[progress])
    answer(as_json, found.result, lambda: print(report_text(found)))
    for fault in found.result["faults"]:
        errors.print(f"goniotwin: {fault}", style="red", markup=False)
    if not found.done:
        raise typer.Exit(3 if found.result["state"] == "stopped" else 1)


def check(schedule: Schedule, rig: RigOption, as_json: Json = False) -> None:
    """Tell what a campaign would be: its rows, how long it takes, how far each axis goes, what the mirror unit hides.

    Nothing is opened and nothing moves. What the rig cannot do is refused with status 2.
    """
    from goniotwin.app.campaign.planning.check import checked_plan, in_words

    plan = _plan(schedule, rig)
    plan.rig.model()  # samples' files that cannot be read are found now, not at the start
    result = checked_plan(plan)
    answer(as_json, result, lambda: print(in_words(plan, result)))


def runs(
    folder: Annotated[Path, typer.Argument(metavar="[DIR]", help="Where the journals are.")] = Path(),
    as_json: Json = False,
) -> None:
    """List the campaigns of a folder: how each ended, what is left of it, and how long that takes."""
    from rich.console import Console

    from goniotwin.app.campaign.journal.runs import campaign_summaries
    from goniotwin.app.cli.run_list import show

    found, refused = campaign_summaries(folder)
    answer(
        as_json,
        {"campaigns": [each.as_dict() for each in found], "unreadable": refused},
        lambda: show(Console(highlight=False), folder, found),
    )
    for reason in refused:
        errors.print(f"goniotwin: {reason}", style="red", markup=False)


def _models(given: list[str]) -> dict[str, str]:
    """By name what samples are. Raises UserError."""
    models: dict[str, str] = {}
    for each in given:
        name, equals, model = each.partition("=")
        if not name.strip() or not equals or not model.strip():
            raise UserError(f"--sample {each!r}: write NAME=MODEL, such as paper=lambertian:reflectance=0.8")
        if name.strip() in models:
            raise UserError(f"--sample {name.strip()}: is given twice; leave one of them")
        models[name.strip()] = model.strip()
    return models


def _refuse_unwritable(points: Path | None, out: Path | None) -> None:
    """Raises UserError for files that could not be written when the rehearsal is over."""
    from goniotwin.app.formats import FormatError
    from goniotwin.app.formats.whole_file import refuse_unwritable

    if out is not None and out.exists():
        raise UserError(f"--out {out}: is there already, and no journal is ever overwritten; choose another name")
    if points is not None and out is not None and points.resolve() == out.resolve():
        raise UserError(f"--points {points}: is the journal of --out; choose another name for one of them")
    for option, path in (("--points", points), ("--out", out)):
        if path is not None:
            try:
                refuse_unwritable(path)
            except FormatError as error:
                raise UserError(f"{option} {error}") from None


def _check_what_is_given(schedule: Path | None, rig: Path | None, out: Path | None, resume: Path | None) -> None:
    if resume is not None:
        for name, given in (("SCHEDULE.toml", schedule), ("--out", out)):
            if given is not None:
                raise UserError(f"run --resume: takes no {name}, for the journal has the schedule in it; leave {given} out")
        return
    for name, given in (("SCHEDULE.toml", schedule), ("--rig", rig), ("--out", out)):
        if given is None:
            raise UserError(
                f"run: {name} is missing; write goniotwin run SCHEDULE.toml --rig RIG.toml --out JOURNAL, "
                "or goniotwin run --resume JOURNAL"
            )


def _plan(schedule: Path, rig: Path) -> Any:
    from goniotwin.app.campaign.planning.plan import make_plan
    from goniotwin.app.campaign.schedule.file import read_schedule
    from goniotwin.app.rig import read_rig

    return make_plan(read_schedule(schedule), read_rig(rig))


def _ask_person(text: str) -> None:
    errors.print(f"{text}  (Enter)", style="bold", markup=False)
    if not sys.stdin.readline():
        raise UserError("nobody is at the terminal to mount samples; run it where somebody is")
