"""Commands on a virtual rig for other programs: `goniotwin serve`, `usb` and `replay`."""

from pathlib import Path
from typing import Annotated

import typer

from goniotwin.app.cli.output import Json, RigOption, Speed, print_note

app = typer.Typer()


@app.command()
def serve(
    rig: RigOption,
    speed: Speed = 1.0,
    write_rig: Annotated[
        Path | None,
        typer.Option(
            "--write-rig", metavar="FILE", help="Write a rig file for programs that measure on this rig.", show_default=False
        ),
    ] = None,
    control: Annotated[
        bool, typer.Option("--control/--no-control", help="Open the simulation control port (JSON commands).")
    ] = True,
    ptys: Annotated[
        Path | None,
        typer.Option("--ptys", metavar="DIR", help="Folder for links to the pseudo-terminals.", show_default=False),
    ] = None,
) -> None:
    """Serve a virtual rig on ports of this computer.

    Prints one JSON line for each port: `device`, `kind`, and `path` of a pseudo-terminal or `host` and `port`; `unit` for
    Modbus; `bus_id` for USB/IP. All ports belong to one instrument. `control` is the simulation control port. Ctrl-C or
    SIGTERM ends it.

    Programs that use USB but not USB/IP reach the monitor with `goniotwin usb`.
    """
    print_note(f"preparing the virtual rig of {rig}")  # before the imports, which load compiled code
    from goniotwin.app.cli.work.serve import serve_rig

    serve_rig(rig, speed, write_rig, ptys, control=control)


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "allow_interspersed_args": False})
def usb(
    context: typer.Context,
    program: Annotated[
        Path,
        typer.Argument(metavar="PROGRAM.py", help="Program that uses pyusb; its own arguments follow.", show_default=False),
    ],
    rig: RigOption,
) -> None:
    """Run a pyusb program with the USB devices of a virtual rig.

    With the rig file of a served rig (`goniotwin serve --write-rig`) they are those of that rig, which no other program may use
    meanwhile. The program is not modified.
    """
    from goniotwin.app.cli.work.usb_program import run_program

    run_program(rig, program, context.args)


@app.command()
def replay(
    transcripts: Annotated[list[Path], typer.Argument(metavar="TRANSCRIPT.txt", help="Files that --transcript wrote.")],
    rig: RigOption,
    device: Annotated[
        str | None, typer.Option("--device", help="Device of the file, if the file name does not have it.")
    ] = None,
    mount: Annotated[str | None, typer.Option("--mount", metavar="SAMPLE", help="Sample that is mounted at the start.")] = None,
    as_json: Json = False,
) -> None:
    """Replay transcripts on the twin and list the differences.

    Each difference is shown byte by byte. No real device is opened.

    The file name is the device: axes, monochromator, photodiodes-0 and so on, monitor. Give all files of one recording
    together: they are replayed in the order of their times, so that shutter and axes are where they were.

    Values that depend on time and noise differ: counts, encoder positions, measured currents. Serial numbers do too.

    Exit status: 1 if anything differs, else 0.
    """
    from goniotwin.app.cli.work.replay import print_differences

    print_differences(transcripts, rig, device, mount, as_json)
