"""Commands on campaigns: `goniotwin check`, `rehearse`, `prove`, `run` and `runs`."""

import contextlib
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from goniotwin.app.cli.compilation import compile_ahead, parts_of_rehearsal
from goniotwin.app.cli.output import (
    CommandWithFormats,
    Json,
    RigOption,
    TranscriptOption,
    answer,
    error_console,
    print_error,
    print_note,
    print_order,
    print_warning,
)
from goniotwin.app.cli.sweeps import Dask, Processes, kept, runner_of
from goniotwin.app.errors import UserError, one_line
from goniotwin.app.json_document import OPTIONAL_KEY
from goniotwin.protocols.clock import GREATEST_SPEED, LEAST_SPEED

if TYPE_CHECKING:  # the planner loads numpy, which a command's help does not need
    from goniotwin.app.campaign.campaign import Outcome
    from goniotwin.app.campaign.journal.chain import Chain
    from goniotwin.app.campaign.planning.plan import NewPlan
    from goniotwin.app.campaign.running.question import Ask
    from goniotwin.app.campaign.studies.checks import CheckResults
    from goniotwin.app.rig import RigDescription
    from goniotwin.app.station.hosting import HostedRun

Schedule = Annotated[Path, typer.Argument(metavar="SCHEDULE.toml", help="Schedule file.", show_default=False)]


app = typer.Typer()


@dataclass(frozen=True)
class RunResult:
    """What `goniotwin run --json` prints; `checks` are absent where the data file cannot be read back."""

    journal: Path
    state: str
    reason: str
    rows: int
    skipped: int
    planned: int
    duration_s: float
    simulated: bool
    faults: Sequence[str]
    orders: list[str]
    chain: "Chain"
    checks: "CheckResults | None" = field(default=None, metadata=OPTIONAL_KEY)


@app.command()
def check(schedule: Schedule, rig: RigOption, as_json: Json = False) -> None:
    """Check a schedule against a rig: rows, duration, warnings.

    Also: how far each axis moves, which directions are blocked by the mirror unit, and with a second standard which difference
    of the two would be found. No device is opened and nothing moves.

    Exit status: 2 if the rig cannot do the schedule.
    """
    # Loads 317 modules, numpy and pydantic among them: 0.4 s, which help does without.
    from goniotwin.app.campaign.planning.check import check_plan, describe_check

    plan = _make_plan(schedule, rig)
    plan.rig.model()  # reads the files of the samples, so that an error in them shows now
    result, standards = check_plan(plan), ""
    document: object = result
    if plan.schedule.file.second_standard is not None:
        # Loads 628 modules, numba and sqlite3 among them: 0.8 s, which help does without.
        from goniotwin.app.campaign.studies.standards import expected_comparison

        expected = expected_comparison(plan)
        document = {**vars(result), "standards": expected}
        words = "no photodiode sees both standards" if expected is None else str(expected)
        standards = f"\n  standards   {' and '.join(plan.schedule.file.standards)}: {words}"
    answer(as_json, document, lambda: print(f"{describe_check(plan, result)}{standards}"))


@app.command(cls=CommandWithFormats)
def rehearse(
    schedule: Schedule,
    rig: RigOption,
    sample: Annotated[
        list[str] | None,
        typer.Option(
            "--sample",
            metavar="NAME=MODEL",
            help="Model of a sample of the schedule, such as paper=lambertian:reflectance=0.8 or paper=table:FILE; may be "
            "repeated.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="JOURNAL", help="Keep the rehearsal's data file.", show_default=False)
    ] = None,
    points: Annotated[
        Path | None,
        typer.Option("--points", metavar="FILE.csv", help="Write the predicted uncertainty of each point.", show_default=False),
    ] = None,
    processes: Annotated[
        int,
        typer.Option("--processes", metavar="P", min=1, help="Rehearse a long schedule in so many blocks of rows at once."),
    ] = 1,
    as_json: Json = False,
) -> None:
    """Run a whole campaign on the digital twin, in simulated time.

    Gives the duration, the predicted uncertainty and warnings. Drivers, bytes and plan are those of the campaign. For the
    file of a real rig, the twin is built from that file; no device is opened. An error in the rig file (a direction of
    rotation, a gear ratio) is in the twin too, so a rehearsal cannot show it. With several processes lamp, noise and random
    positions are those of other times; without noise, drift and disturbances the values are the same.

    Exit status: 0 if all rows are done, 1 after a fault, 3 if the schedule's [stop] ended it.
    """
    # Loads 941 modules, numba and pymodbus among them: 1.3 s, which help does without.
    from goniotwin.app.campaign.rehearsal.rehearsal import plan_rehearsal, rehearse
    from goniotwin.app.campaign.rehearsal.report import report_text
    from goniotwin.app.campaign.running.events import State
    from goniotwin.app.campaign.schedule.file import read_schedule
    from goniotwin.app.cli.progress import RowProgress
    from goniotwin.app.rig import read_rig

    _check_writable(points, out)
    plan, assumed = plan_rehearsal(read_schedule(schedule), read_rig(rig), _sample_models(sample or []))
    compile_ahead(parts_of_rehearsal(plan.schedule.file, plan.rig.model()))  # what is refused is not waited for
    with RowProgress(error_console(), f"{plan.schedule.file.name} (rehearsal)", len(plan.rows)) as progress:
        rehearsal = rehearse(plan, assumed, out=out, points=points, listeners=[progress], processes=processes)
    answer(as_json, rehearsal.result, lambda: print(report_text(rehearsal)))
    for fault in rehearsal.result.faults:
        print_error(fault)
    if not rehearsal.done:
        raise typer.Exit(3 if rehearsal.end is State.IDLE else 1)


@app.command()
def prove(
    schedule: Annotated[Path | None, typer.Argument(metavar="SCHEDULE.toml", help="Schedule file.", show_default=False)] = None,
    rig: Annotated[
        Path | None,
        typer.Option(
            "--rig", metavar="RIG.toml", help="Rig file; with --structures that of the examples by default.", show_default=False
        ),
    ] = None,
    structures: Annotated[
        int | None,
        typer.Option(
            "--structures",
            metavar="N",
            help="In place of a schedule: so many drawn ones with drawn samples, counted together.",
            show_default=False,
        ),
    ] = None,
    rigs: Annotated[int, typer.Option("--rigs", metavar="M", help="Number of virtual rigs, of each structure.")] = 20,
    without_wires: Annotated[
        bool, typer.Option("--without-wires", help="Without devices: the light of the fast estimator into the same reduction.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            help="Folder for the results; default SCHEDULE.proof, or structures.proof.",
            show_default=False,
        ),
    ] = None,
    processes: Processes = None,
    dask: Dask = None,
    as_json: Json = False,
) -> None:
    """Prove the stated uncertainties on many virtual rigs.

    They are off by as much as the rig file states as uncertain: each is drawn from [uncertainty] with a seed of its own,
    measures the whole schedule on the virtual clock, and its values are compared with the truth. Given are the coverage of
    the 95 % interval by decade of signal, side, plane, zenith, sigma, wavelength and sample, with its standard error over rigs,
    what is left after a fit of the shared inputs, and reflectances. A key of [twin.disturbances] in the rig file is a fault of
    which the rest of the file knows nothing.

    With --structures the schedules and the samples are drawn too, structure k always alike, and each has rigs of its own. The
    files of a structure are in the folder of the results, and are proved by themselves like any others. The cells are judged:
    those whose coverage is off by more than 1 % and 2.6 of its standard errors are named.

    A rig that is done is not run again: after Ctrl-C the same command continues, and more --rigs of a schedule, or more
    --structures, are added to those that are done. With --dask the rigs are computed on other computers (docs/sweeps.md).

    Exit status: 0 if all rigs are done, 1 if a campaign came to no end, 130 after Ctrl-C.
    """
    if structures is not None:
        if schedule is not None:
            raise UserError(f"--structures: draws the schedules; leave {schedule} out")
        _prove_structures(structures, rig, rigs, without_wires, out, processes, dask, as_json)
        return
    if schedule is None or rig is None:
        missing = "SCHEDULE.toml" if schedule is None else "--rig"
        raise UserError(f"prove: {missing} is missing; write goniotwin prove SCHEDULE.toml --rig RIG.toml, or --structures N")
    # Loads 953 modules, numba and pymodbus among them: 1.2 s, which help does without.
    from goniotwin.app.campaign.proof.proof import Proof
    from goniotwin.app.campaign.proof.proof import prove as prove_rigs
    from goniotwin.app.campaign.proof.report import proof_text
    from goniotwin.app.campaign.schedule.file import read_schedule
    from goniotwin.app.cli.progress import SweepProgress
    from goniotwin.app.rig import read_rig

    folder = out if out is not None else Path(f"{schedule.stem}.proof")
    proof = Proof(read_schedule(schedule), read_rig(rig), rigs, folder, wires=not without_wires)
    compile_ahead(parts_of_rehearsal(proof.plan.schedule.file, proof.rig.model()))  # what is refused is not waited for
    with (
        runner_of(processes, dask, rigs) as runner,
        kept(folder, "rigs"),
        SweepProgress(error_console(), f"{proof.schedule.file.name} (proof)", rigs, "rigs") as progress,
    ):
        totals = prove_rigs(proof, runner, progress, print_note)
    answer(as_json, totals, lambda: print(proof_text(proof, totals)))
    _end_proof(totals.failed)


def _prove_structures(
    structures: int,
    rig: Path | None,
    rigs: int,
    without_wires: bool,
    out: Path | None,
    processes: int | None,
    dask: str | None,
    as_json: bool,
) -> None:
    # Loads 953 modules, numba and pymodbus among them: 1.2 s, which help does without.
    from goniotwin import examples
    from goniotwin.app.campaign.proof.pooled import PooledProof, prove_structures
    from goniotwin.app.campaign.proof.report import pooled_text
    from goniotwin.app.cli.progress import SweepProgress
    from goniotwin.app.rig import read_rig

    folder = out if out is not None else Path("structures.proof")
    base = read_rig(rig if rig is not None else examples.FOLDER / "proof" / "rig.toml")
    proof = PooledProof(base, structures, rigs, folder, wires=not without_wires)
    for each in proof.drawn:
        compile_ahead(parts_of_rehearsal(each.schedule.file, each.rig.model()))
    with (
        runner_of(processes, dask, proof.chunks) as runner,
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


@app.command()
def run(
    schedule: Annotated[Path | None, typer.Argument(metavar="SCHEDULE.toml", help="Schedule file.", show_default=False)] = None,
    rig: Annotated[Path | None, typer.Option("--rig", metavar="RIG.toml", help="Rig file.", show_default=False)] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="JOURNAL", help="Data file (journal) to create.", show_default=False)
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option("--resume", metavar="JOURNAL", help="Resume the campaign of this data file.", show_default=False),
    ] = None,
    accept_rig: Annotated[
        bool, typer.Option("--accept-rig", help="With --resume: use the journal's rig, though another was used last.")
    ] = False,
    transcript: TranscriptOption = None,
    speed: Annotated[
        float | None,
        typer.Option(
            "--speed",
            min=LEAST_SPEED,
            max=GREATEST_SPEED,
            help="Simulation speed of a virtual rig, which a window can then show.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Measure a campaign, or resume one.

    Schedule and rig are checked first. Each row is on the disk before the next one starts. A window with the same rig file
    shows the run and can pause or stop it; for a virtual rig only with --speed, because without it the time is not real.

    With --resume, the schedule and the rig come from the journal. Give --rig only if the devices have other ports now; a rig
    that differs in anything else is refused. A rig other than the one that this computer used last is used only after a
    question, or with --accept-rig. Missing and skipped rows are measured, after the sample is mounted again, a
    dark reading and a drift check.

    Exit status: 0 if all rows are done; 1 after a fault, if rows were skipped after faults, or if the data file cannot be read
    back; 2 if schedule or rig are
    refused (no journal is created); 3 if the schedule ended the campaign ([stop], or a drift beyond its limit); 130 after
    Ctrl-C. After 1, 3 and 130 the journal has all measured rows, and --resume continues.
    """
    # Loads 897 modules, numba and pymodbus among them: 1.1 s, which help does without.
    from goniotwin.app.campaign.campaign import resume_campaign, run_campaign
    from goniotwin.app.campaign.running.events import State
    from goniotwin.app.campaign.studies.journals import check_journal
    from goniotwin.app.cli.progress import RowProgress
    from goniotwin.app.rig import read_rig

    _check_arguments(schedule, rig, out, resume)
    if resume is not None:
        journal, title = resume, str(resume)
        rig_now = read_rig(rig) if rig is not None else None
        with RowProgress(error_console(), title, None) as progress, _hosted(speed, _rig_of(resume, rig_now)) as (host, ask):
            outcome = resume_campaign(
                resume,
                rig_now,
                listeners=[progress],
                transcript=transcript,
                ask=ask,
                host=host,
                accept_rig=(lambda _: True) if accept_rig else _ask_rig if sys.stdin.isatty() else None,
                remind=lambda order: print_order(f"of the last session, not acknowledged: {order}"),
            )
            _report_end(host, outcome)
    else:
        assert schedule is not None
        assert rig is not None
        assert out is not None
        plan, journal = _make_plan(schedule, rig), out
        with (
            RowProgress(error_console(), plan.schedule.file.name, len(plan.rows)) as progress,
            _hosted(speed, plan.rig) as (host, ask),
        ):
            outcome = run_campaign(plan, out, listeners=[progress], transcript=transcript, ask=ask, host=host)
            _report_end(host, outcome)
    moved, journal = outcome.journal != journal, outcome.journal
    checks, unread = None, ""
    try:
        checks = check_journal(journal, outcome.chain)
    except UserError as error:
        unread = str(error)
    result = RunResult(
        journal=journal,
        state="stopped" if outcome.state is State.IDLE else str(outcome.state),
        reason=outcome.ended_by_schedule,
        rows=outcome.rows,
        skipped=outcome.skipped,
        planned=outcome.planned,
        duration_s=outcome.seconds,
        simulated=outcome.simulated,
        faults=outcome.faults,
        orders=progress.orders,
        chain=outcome.chain,
        checks=checks,
    )
    for fault in outcome.faults:
        print_error(fault)
    for each in filter(None, (outcome.journal_note, unread)):
        print_error(each)
    mark = "SIMULATED, " if outcome.simulated else ""
    skipped = f" ({outcome.skipped} skipped)" if outcome.skipped else ""
    rows = f"{outcome.rows} of {outcome.planned} rows{skipped} in {outcome.seconds:.1f} s of instrument time"
    text = f"{mark}{result.state}: {rows}: {journal}"
    answer(
        as_json,
        result,
        lambda: print("\n".join([text, outcome.chain.statement, *(checks.lines if checks is not None else [])])),
    )
    for finding in checks.findings if checks is not None else ():
        print_warning(finding)
    if outcome.ended_by_schedule:
        print_warning(f"ended by the schedule: {outcome.ended_by_schedule}")
    if outcome.rows < outcome.planned:
        error_console().print(f"to continue: goniotwin run --resume {journal}", markup=False)
    for order in progress.orders:
        print_order(order)
    if outcome.state is State.DONE and (moved or unread):
        raise typer.Exit(1)
    if outcome.state is not State.DONE or outcome.skipped:
        raise typer.Exit((3 if outcome.ended_by_schedule else 130) if outcome.state is State.IDLE else 1)


@app.command()
def runs(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of data files (journals).")] = Path(),
    as_json: Json = False,
) -> None:
    """List the campaigns of a folder: state, rows, time left."""
    # Loads 393 modules, rich and sqlite3 among them: 0.5 s, which help does without.
    from goniotwin.app.campaign.journal.summary import campaign_summaries
    from goniotwin.app.cli.tables import print_campaigns
    from goniotwin.app.rig.left import left_unsafe

    found, refused = campaign_summaries(folder)
    listed = {order for each in found for order in each.orders}
    others = [each.text for each in left_unsafe() if each.text not in listed]  # its journal is elsewhere, or there is none
    answer(
        as_json,
        {"campaigns": found, "unreadable": refused, "orders": others},
        lambda: print_campaigns(folder, found),
    )
    for reason in refused:
        print_error(one_line(reason))
    for each in found:
        for order in each.orders:
            print_order(f"of {each.journal}, not acknowledged: {order}")
    for order in others:
        print_order(order)


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
    # Loads 36 modules, importlib.metadata among them: 30 ms, which help does without.
    from goniotwin.app.formats import FormatError
    from goniotwin.app.formats.file import check_writable
    from goniotwin.app.formats.registry import Holds, format_for

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


def _check_arguments(schedule: Path | None, rig: Path | None, out: Path | None, resume: Path | None) -> None:
    """Check that `run` has what a new campaign needs, or --resume alone. Raises UserError."""
    if resume is not None:
        for name, value in (("SCHEDULE.toml", schedule), ("--out", out)):
            if value is not None:
                raise UserError(f"run --resume: takes no {name}, because the journal has the schedule; leave {value} out")
        return
    for name, value in (("SCHEDULE.toml", schedule), ("--rig", rig), ("--out", out)):
        if value is None:
            raise UserError(
                f"run: {name} is missing; write goniotwin run SCHEDULE.toml --rig RIG.toml --out JOURNAL, "
                "or goniotwin run --resume JOURNAL"
            )


def _make_plan(schedule: Path, rig: Path) -> "NewPlan":
    # Loads 314 modules, numpy and pydantic among them: 0.4 s, which help does without.
    from goniotwin.app.campaign.planning.plan import make_plan
    from goniotwin.app.campaign.schedule.file import read_schedule
    from goniotwin.app.rig import read_rig

    return make_plan(read_schedule(schedule), read_rig(rig))


def _rig_of(journal: Path, rig: "RigDescription | None") -> "RigDescription":
    """The rig of a campaign that is resumed. Raises UserError."""
    # Loads 345 modules, sqlite3 and numpy among them: 0.4 s, which help does without.
    from goniotwin.app.campaign.journal.writing import Journal
    from goniotwin.app.campaign.running.resume import recorded_rig

    if rig is not None:
        return rig
    with Journal.open(journal) as opened:
        return recorded_rig(opened)


@contextlib.contextmanager
def _hosted(speed: float | None, rig: "RigDescription") -> "Iterator[tuple[HostedRun | None, Ask]]":
    """The host of a run that others can attach to, and what asks the operator; no host on the virtual clock."""
    if speed is not None and not rig.file.in_process:
        raise UserError(f"{rig.name}: --speed: the rig is not virtual in this process; leave --speed out")
    # Loads 836 modules, numba and pymodbus among them: 1.1 s, which help does without.
    from goniotwin.app.cli.terminal import TerminalAsk, ask_operator

    if speed is None and rig.file.in_process:
        yield None, ask_operator
        return
    # Loads 835 modules, numba and pymodbus among them: 1.2 s, which help does without.
    from goniotwin.app.campaign.running.events import EventLogged
    from goniotwin.app.station.hosting import hosted_run

    def print_guardian(_number: int, message: object) -> None:
        if isinstance(message, EventLogged) and message.kind == "guardian":  # orders are printed with the run's progress
            print_warning(message.what)

    with hosted_run(speed or 1.0, print_warning) as host:
        host.station.board.subscribe(print_guardian)
        yield host, TerminalAsk(host)


def _report_end(host: "HostedRun | None", outcome: "Outcome") -> None:
    if host is not None:
        host.station.release()
        host.station.runs.end(outcome.state, outcome.ended_by_schedule, outcome.journal, outcome.journal_note)


def _ask_rig(text: str) -> bool:
    """Ask whether to resume on another rig than the last one; only an explicit yes is one."""
    return typer.confirm(f"{text}. Use these devices?", default=False, err=True)
