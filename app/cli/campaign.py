"""Commands on campaigns: `goniotwin check`, `rehearse`, `prove`, `run` and `runs`."""

from pathlib import Path
from typing import Annotated

import typer

from goniotwin.app.cli.output import CommandWithFormats, Dask, Json, Processes, RigOption, TranscriptOption
from goniotwin.app.errors import UserError
from goniotwin.protocols.clock import GREATEST_SPEED, LEAST_SPEED

Schedule = Annotated[Path, typer.Argument(metavar="SCHEDULE.toml", help="Schedule file.", show_default=False)]


app = typer.Typer()


@app.command()
def check(schedule: Schedule, rig: RigOption, as_json: Json = False) -> None:
    """Check a schedule against a rig: rows, duration, warnings.

    Also: how far each axis moves, which directions are blocked by the mirror unit, and with a second standard which difference
    of the two would be found. No device is opened and nothing moves.

    Exit status: 2 if the rig cannot do the schedule.
    """
    from goniotwin.app.cli.work.check import check_schedule

    check_schedule(schedule, rig, as_json)


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
    """Run a campaign on the digital twin, in simulated time.

    Gives the duration, the predicted uncertainty and warnings. Drivers, bytes and plan are those of the campaign. For the
    file of a real rig, the twin is built from that file; no device is opened. An error in the rig file (a direction of
    rotation, a gear ratio) is in the twin too, so a rehearsal cannot show it. With several processes lamp, noise and random
    positions are those of other times; without noise, drift and disturbances the values are the same.

    Exit status: 0 if all rows are done, 1 after a fault, 3 if the schedule's [stop] ended it.
    """
    from goniotwin.app.cli.work.rehearsal import rehearse_schedule

    rehearse_schedule(schedule, rig, sample or [], out, points, processes, as_json)


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
    --structures, are added to those that are done. With --dask other computers compute them (docs/analyse/sweeps.md).

    Exit status: 0 if all rigs are done, 1 if a campaign came to no end, 130 after Ctrl-C.
    """
    if structures is not None and schedule is not None:
        raise UserError(f"--structures: draws the schedules; leave {schedule} out")
    if structures is None and (schedule is None or rig is None):
        missing = "SCHEDULE.toml" if schedule is None else "--rig"
        raise UserError(f"prove: {missing} is missing; write goniotwin prove SCHEDULE.toml --rig RIG.toml, or --structures N")
    from goniotwin.app.cli.work.proof import prove_drawn, prove_schedule

    if structures is not None:
        prove_drawn(structures, rig, rigs, out, (processes, dask), as_json, wires=not without_wires)
    elif schedule is not None and rig is not None:
        prove_schedule(schedule, rig, rigs, out, (processes, dask), as_json, wires=not without_wires)


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
    _check_arguments(schedule, rig, out, resume)
    from goniotwin.app.cli.work.run import resume_journal, run_schedule

    if resume is not None:
        resume_journal(resume, rig, accept_rig, transcript, speed, as_json)
    elif schedule is not None and rig is not None and out is not None:
        run_schedule(schedule, rig, out, transcript, speed, as_json)


@app.command()
def runs(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of data files (journals).")] = Path(),
    as_json: Json = False,
) -> None:
    """List the campaigns of a folder: state, rows, time left."""
    from goniotwin.app.cli.work.runs import list_runs

    list_runs(folder, as_json)


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
