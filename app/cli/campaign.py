"""Commands on campaigns: `goniotwin new`, `check`, `rehearse`, `prove`, `run` and `runs`."""

from pathlib import Path
from typing import Annotated

import typer

from goniotwin.app.cli.output import CommandWithFormats, Dask, Json, Processes, RigOption, TranscriptOption
from goniotwin.app.errors import UserError
from goniotwin.protocols.clock import GREATEST_SPEED, LEAST_SPEED

Schedule = Annotated[Path, typer.Argument(metavar="SCHEDULE.toml", help="Schedule file.", show_default=False)]


app = typer.Typer()


@app.command()
def new(
    schedule: Annotated[
        Path | None, typer.Argument(metavar="FILE.toml", help="Schedule file to create.", show_default=False)
    ] = None,
    rig: Annotated[Path | None, typer.Option("--rig", metavar="RIG.toml", help="Rig file.", show_default=False)] = None,
    template: Annotated[
        str | None,
        typer.Option(
            "--template",
            metavar="NAME",
            help="What to measure: 45:0, aspecular, plane, isotropic, anisotropic, transmitted or gloss.",
            show_default=False,
        ),
    ] = None,
    sample: Annotated[
        str | None, typer.Option("--sample", metavar="NAME", help="Name of the sample.", show_default=False)
    ] = None,
    etalon: Annotated[
        str | None,
        typer.Option(
            "--etalon", metavar="NAME", help="Name of the reference standard. The default is `etalon`.", show_default=False
        ),
    ] = None,
    target_u: Annotated[
        float | None,
        typer.Option(
            "--target-u",
            metavar="U",
            help="Relative standard uncertainty (k = 1) that you ask for: 0.01 is 1 %.",
            show_default=False,
        ),
    ] = None,
    longest_h: Annotated[
        float | None,
        typer.Option("--longest-h", metavar="H", help="Longest machine time, in hours.", show_default=False),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
    as_json: Json = False,
) -> None:
    """Create a schedule from a template.

    In a terminal the command asks for what you leave out. It chooses the finest steps with which the estimated duration is
    within the longest time. A direction that the rig does not reach is replaced by the nearest one, with a note. At the end
    the command prints the next commands. An existing file is kept, unless you confirm or give --force.

    Exit status: 0 if the schedule is written, else 2.
    """
    from goniotwin.app.cli.work.new import new_schedule

    new_schedule(schedule, rig, template, sample, etalon, target_u, longest_h, force, as_json)


@app.command()
def check(schedule: Schedule, rig: RigOption, as_json: Json = False) -> None:
    """Check a schedule against a rig: rows, duration, warnings.

    The command also lists how far each axis moves and which directions the mirror unit blocks. With a second standard it
    states the smallest difference between the two standards that the campaign can detect. No device is opened and nothing
    moves.

    Exit status: 0 if the rig can do the schedule, else 2.
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
            help="Use this model for a sample of the schedule: paper=lambertian:reflectance=0.8 or paper=table:FILE. "
            "You can repeat the option.",
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
        typer.Option("--processes", metavar="P", min=1, help="Number of processes that share the rows of a long schedule."),
    ] = 1,
    as_json: Json = False,
) -> None:
    """Run a campaign on the digital twin, in simulated time.

    The command prints the duration, the predicted uncertainty and warnings. A rehearsal uses the same drivers, the same
    commands to the devices and the same plan as the campaign. No device is opened.

    For a real rig, the program builds the twin from the rig file. The twin repeats an error of that file, such as a wrong
    direction of rotation or gear ratio. A rehearsal cannot show such an error.

    With several processes, the lamp, the noise and the random positions follow the times that the plan expects. Without noise,
    drift and disturbances, the values do not depend on the number of processes.

    Exit status: 0 if all rows are done, 1 after a fault, 3 if the schedule's [stop] ended the rehearsal.
    """
    from goniotwin.app.cli.work.rehearsal import rehearse_schedule

    rehearse_schedule(schedule, rig, sample or [], out, points, processes, as_json)


@app.command()
def prove(
    schedule: Annotated[Path | None, typer.Argument(metavar="SCHEDULE.toml", help="Schedule file.", show_default=False)] = None,
    rig: Annotated[
        Path | None,
        typer.Option(
            "--rig", metavar="RIG.toml", help="Rig file. With --structures, the default is an example rig.", show_default=False
        ),
    ] = None,
    structures: Annotated[
        int | None,
        typer.Option(
            "--structures",
            metavar="N",
            help="Draw this number of random schedules and samples, instead of a given schedule.",
            show_default=False,
        ),
    ] = None,
    rigs: Annotated[int, typer.Option("--rigs", metavar="M", help="Number of virtual rigs for each schedule.")] = 20,
    without_wires: Annotated[
        bool, typer.Option("--without-wires", help="Simulate the light alone, without devices. The reduction is the same.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            help="Folder for the results. The default is SCHEDULE.proof, or structures.proof.",
            show_default=False,
        ),
    ] = None,
    processes: Processes = None,
    dask: Dask = None,
    as_json: Json = False,
) -> None:
    """Prove the stated uncertainties on many virtual rigs.

    The program draws the errors of each virtual rig from [uncertainty] of the rig file, with a seed of its own. Each rig
    measures the whole schedule in simulated time. The program then compares its values with the truth.

    The command prints the coverage of the 95 % interval by decade of signal, side, plane, zenith, sigma, wavelength and sample.
    Each coverage has its standard error over the rigs. It also prints the reflectances, and the chi-square that remains after a
    fit of the inputs that the values share. A key of [twin.disturbances] adds a fault that [uncertainty] does not include.

    With --structures, the program also draws the schedules and the samples. Structure number k is the same in every run. The
    folder of the results has the files of each structure, and you can prove each one by itself. The command names each group
    whose coverage is off by more than 1 % and by more than 2.6 standard errors.

    A finished rig is not run again. After Ctrl-C the same command continues, and you can ask for more --rigs or
    --structures. With --dask, other computers compute them (page "Sweeps" of the documentation).

    Exit status: 0 if all rigs are done, 1 if a campaign did not finish, 130 after Ctrl-C.
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
        bool, typer.Option("--accept-rig", help="With --resume: do not ask when this computer used another rig last.")
    ] = False,
    transcript: TranscriptOption = None,
    speed: Annotated[
        float | None,
        typer.Option(
            "--speed",
            min=LEAST_SPEED,
            max=GREATEST_SPEED,
            help="Simulation speed of a virtual rig. A window can then show the run.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Measure a campaign, or resume one.

    The program checks the schedule and the rig first. It writes each row to the disk before the next one starts. A window
    with the same rig file shows the run and can pause or stop it. For a virtual rig, this needs --speed.

    With --resume, the schedule and the rig come from the journal. Give --rig only if the devices have other ports now. The
    program refuses a rig that differs in anything else. If this computer used another rig last, the program asks first, unless
    you give --accept-rig. You mount the sample again. After a dark reading and a drift check, the program measures the missing
    and the skipped rows.

    Exit status: 0 if all rows are done. 1 after a fault, if rows were skipped after faults, or if the data file cannot be read
    back. 2 if the schedule or the rig is refused. Then there is no journal. 3 if the schedule ended the campaign, by [stop] or
    by a drift beyond its limit. 130 after Ctrl-C. After 1, 3 and 130, the journal has all measured rows, and --resume
    continues.
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
