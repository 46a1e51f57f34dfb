"""The command `goniotwin`."""

import logging
import sys
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console
from typer.exceptions import TyperException

import goniotwin
from goniotwin import examples
from goniotwin.app.cli import simulation
from goniotwin.app.cli.campaign import Json, RigOption, TranscriptOption, add_campaign_commands, answer, errors
from goniotwin.app.cli.instrument import add_axes_commands
from goniotwin.app.end_signals import heed_requests_to_end
from goniotwin.app.errors import UserError

app = typer.Typer(
    name="goniotwin",
    help=(
        "BSDF measurement campaigns on a goniophotometer, and their rehearsal on its digital twin.\n\n"
        "Without a command the desktop window opens on the virtual rig of the examples."
    ),
    no_args_is_help=False,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.add_typer(simulation.app, name="simulate")


def show_version(wanted: bool) -> None:
    """Print the version and end, where that is asked for."""
    if wanted:
        print(f"goniotwin {goniotwin.__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def start(
    context: typer.Context,
    _version: Annotated[
        bool, typer.Option("--version", callback=show_version, is_eager=True, help="Print the version and end.")
    ] = False,
) -> None:
    """Open the desktop where no command is given."""
    if context.invoked_subcommand is None:
        desktop(examples.RIG, examples.SCHEDULE)


@app.command()
def desktop(
    rig: Annotated[Path, typer.Option("--rig", metavar="RIG.toml", help="Where the devices are.")] = examples.RIG,
    schedule: Annotated[
        Path, typer.Option("--schedule", metavar="SCHEDULE.toml", help="What is to be measured.")
    ] = examples.SCHEDULE,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="The folder for journals.", show_default=False)
    ] = None,
    speed: Annotated[float, typer.Option(min=0.1, max=1000.0, help="How much faster a virtual rig's time passes.")] = 1.0,
) -> None:
    """Open the window."""
    try:
        from goniotwin.app.desktop import run_desktop
    except ImportError as error:
        raise UserError(
            f"the window needs Qt, which cannot be loaded: {error}; on Debian and Ubuntu: "
            "sudo apt-get install -y libegl1 libgl1 libxkbcommon0 libdbus-1-3 libfontconfig1 libglib2.0-0"
        ) from None

    raise typer.Exit(run_desktop(rig, schedule, out, speed))


add_campaign_commands(app)


@app.command()
def export(
    journal: Annotated[Path, typer.Argument(metavar="JOURNAL", help="What a campaign has left.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="The file to write.", show_default=False)],
    file_format: Annotated[
        Literal["ddr", "csv"],
        typer.Option("--format", help="ddr: a table in specular coordinates; csv: every measured point.", show_default=False),
    ],
    sample: Annotated[
        str | None, typer.Option("--sample", help="Which sample, where there are several.", show_default=False)
    ] = None,
    as_json: Json = False,
) -> None:
    """Reduce a journal and write the BSDF.

    The journal stays as it is. Values come with their standard uncertainty (csv). Nothing is filled in silence: what a
    .ddr needs and nobody measured is listed at its top.
    """
    from goniotwin.app.campaign.journal.writing import Journal
    from goniotwin.app.campaign.reduction.export import FORMATS
    from goniotwin.app.campaign.reduction.reduction import reduce_journal

    if out.resolve() == journal.resolve():
        raise UserError(f"{out}: is the journal itself; choose another name")
    with Journal.open(journal) as opened:
        reduced = reduce_journal(opened)
    count = FORMATS[file_format](reduced, sample, out)
    result = {"file": str(out), "format": file_format, "values": count, "simulated": reduced.simulated}
    mark = "SIMULATED, " if reduced.simulated else ""
    answer(as_json, result, lambda: print(f"{mark}{count} measured values: {out}"))


@app.command()
def demo(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="The folder for the files.")] = Path("demo"),
    transcript: TranscriptOption = None,
    as_json: Json = False,
) -> None:
    """Measure a Gaussian sample on the virtual rig, through the wires, and hold it against theory.

    Leaves journal, .ddr, CSV and a figure in a folder; the files of an earlier demo there are replaced.
    """
    from goniotwin.app.cli.demo import run_demo

    result, show = run_demo(examples.RIG, examples.SCHEDULE, out, transcript, errors)
    answer(as_json, result, lambda: show(Console(highlight=False)))


@app.command("examples")
def copy_examples(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder that is made if need be.", show_default=False)],
    as_json: Json = False,
) -> None:
    """Copy the example rigs and schedules into a folder. A file that exists there is never overwritten."""
    from goniotwin.app.formats import FormatError
    from goniotwin.app.formats.whole_file import write_whole

    sources = sorted(examples.FOLDER.glob("*/*.toml"))
    copies = {source: folder / source.relative_to(examples.FOLDER) for source in sources}
    for copy in copies.values():
        if copy.exists():
            raise UserError(f"{copy}: exists, and nothing is overwritten; choose another folder")
    try:
        for source, copy in copies.items():
            copy.parent.mkdir(parents=True, exist_ok=True)
            write_whole(copy, source.read_bytes())
    except (OSError, FormatError) as error:
        raise UserError(f"{folder}: cannot be written: {error}; choose another folder") from None
    copied = list(copies.values())
    answer(as_json, {"files": [str(path) for path in copied]}, lambda: print("\n".join(map(str, copied))))


@app.command()
def serve(
    rig: RigOption,
    speed: Annotated[float, typer.Option(min=0.1, max=1000.0, help="How much faster the rig's time passes.")] = 1.0,
    write_rig: Annotated[
        Path | None,
        typer.Option(
            "--write-rig", metavar="FILE", help="Write the rig file with which others measure on it.", show_default=False
        ),
    ] = None,
    control: Annotated[
        bool, typer.Option("--control/--no-control", help="Open its back door, a port for orders in JSON.")
    ] = True,
    ptys: Annotated[
        Path | None,
        typer.Option("--ptys", metavar="DIR", help="Where pseudo-terminals get their stable names.", show_default=False),
    ] = None,
) -> None:
    """Put the devices of a virtual rig on real endpoints, on this computer alone.

    Prints a JSON line for each: `device`, `kind`, and `path` of a pseudo-terminal or `host` and `port`, for Modbus the
    `unit`, for USB/IP the `bus_id`. All share one instrument. `control` is its back door. Serves until interrupted.

    Programs that know USB but not USB/IP reach the monitor with `goniotwin usb`.
    """
    from goniotwin.app.cli.serving import serve_until_interrupted
    from goniotwin.app.rig import read_rig

    serve_until_interrupted(read_rig(rig), speed, ptys, write_rig, control=control)


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "allow_interspersed_args": False})
def usb(
    context: typer.Context,
    program: Annotated[Path, typer.Argument(metavar="PROGRAM.py", help="A program that uses pyusb.", show_default=False)],
    rig: RigOption,
) -> None:
    """Run an unmodified pyusb program that finds the virtual rig's USB devices. What follows PROGRAM.py is its own."""
    from goniotwin.app.cli.serving import run_with_usb
    from goniotwin.app.rig import read_rig

    run_with_usb(read_rig(rig), program, context.args)


add_axes_commands(app)


@app.command()
def devices(
    rig: Annotated[
        Path | None, typer.Option("--rig", metavar="RIG.toml", help="Ask the devices of this rig.", show_default=False)
    ] = None,
    as_json: Json = False,
) -> None:
    """List ports and who answers on them: of this computer, or of a rig file.

    Devices are asked who they are, and for nothing else. A port that another program holds is left alone.
    The status is 1 when a device of a rig file does not answer, else 0.
    """
    from goniotwin.app.cli.instrument import exit_status, found_devices, in_words

    found = found_devices(rig)
    answer(as_json, {"devices": [each.as_dict() for each in found]}, lambda: print(in_words(found)))
    raise typer.Exit(exit_status(found))


@app.command()
def replay(
    transcripts: Annotated[list[Path], typer.Argument(metavar="TRANSCRIPT.txt", help="What --transcript wrote.")],
    rig: RigOption,
    device: Annotated[str | None, typer.Option("--device", help="Of which device, if the file's name does not tell.")] = None,
    mount: Annotated[str | None, typer.Option("--mount", metavar="SAMPLE", help="A sample that is in.")] = None,
    as_json: Json = False,
) -> None:
    """Tell the twin of a rig file what was recorded; show byte by byte where it answers otherwise (status 1, else 0).

    The file's name tells the device: axes, monochromator, photodiodes-0 and so on, monitor. Files of one recording, named
    together, are told in the order of their times, so that shutter and axes are where they were. No real device is opened.

    Numbers that depend on time and noise differ: counts, encoder positions, measured currents. Serial numbers do too.
    """
    from goniotwin.app.cli.replay import replay_transcripts
    from goniotwin.app.rig import read_rig

    result = replay_transcripts(transcripts, read_rig(rig), device, mount)
    answer(as_json, result.as_dict(), lambda: print(result.in_words()))
    raise typer.Exit(1 if result.differences else 0)


def main() -> None:
    """The entry point: what a person can mend is one line on standard error, and status 2."""
    logging.getLogger("pymodbus.logging").addHandler(logging.NullHandler())  # its errors come to us as exceptions
    heed_requests_to_end()  # a request to end is a stop: axes at rest, journal whole
    try:
        sys.exit(app(standalone_mode=False) or 0)
    except (KeyboardInterrupt, typer.Abort):
        errors.print("goniotwin: stopped")
        sys.exit(130)
    except TyperException as error:
        told = error.format_message().replace("Value error, ", "")
        errors.print(f"goniotwin: {told} See: goniotwin --help", style="red", markup=False)
        sys.exit(2)
    except UserError as error:
        errors.print(f"goniotwin: {error}", style="red", markup=False)
        sys.exit(2)
