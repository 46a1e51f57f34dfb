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

    The command prints one JSON line for each port. A line has `device`, `kind`, and either the `path` of a pseudo-terminal or
    `host` and `port`. Modbus adds `unit`, USB/IP adds `bus_id`. All ports belong to one instrument. Ctrl-C or SIGTERM ends the
    command.

    The port `control` simulates operators and faults. A program that cannot use USB/IP reaches the monitor with
    `goniotwin usb`.
    """
    print_note(f"preparing the virtual rig of {rig}")  # before the imports, which load compiled code
    from goniotwin.app.cli.work.serve import serve_rig

    serve_rig(rig, speed, write_rig, ptys, control=control)


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "allow_interspersed_args": False})
def usb(
    context: typer.Context,
    program: Annotated[
        Path,
        typer.Argument(
            metavar="PROGRAM.py", help="Program that uses pyusb, followed by its own arguments.", show_default=False
        ),
    ],
    rig: RigOption,
) -> None:
    """Run a pyusb program with the USB devices of a virtual rig.

    The program runs unmodified. With a rig file from `goniotwin serve --write-rig`, it uses the devices of the served rig. No
    other program may use that rig at the same time.
    """
    from goniotwin.app.cli.work.usb_program import run_program

    run_program(rig, program, context.args)


@app.command()
def replay(
    transcripts: Annotated[
        list[Path], typer.Argument(metavar="TRANSCRIPT.txt", help="Files that the option --transcript wrote.")
    ],
    rig: RigOption,
    device: Annotated[str | None, typer.Option("--device", help="Device of the file, if its name does not state it.")] = None,
    mount: Annotated[str | None, typer.Option("--mount", metavar="SAMPLE", help="Sample on the twin at the start.")] = None,
    as_json: Json = False,
) -> None:
    """Replay transcripts on the twin and list the differences.

    The command shows each difference byte by byte. No real device is opened.

    The file name states the device: axes, monochromator, monitor, photodiodes-0 and so on. Give all files of one recording
    together. The program replays them in the order of their times, so that the shutter and the axes are where they were.

    Values that depend on time or noise differ: counts, encoder positions, measured currents. Serial numbers differ too.

    Exit status: 1 if anything differs, else 0.
    """
    from goniotwin.app.cli.work.replay import print_differences

    print_differences(transcripts, rig, device, mount, as_json)
