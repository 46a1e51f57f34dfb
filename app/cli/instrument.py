"""Commands on the instrument: `doctor`, `devices`, `home`, `here`, `station`, `move`, `read` and `verify-device`."""

from pathlib import Path
from typing import Annotated

import typer

from goniotwin.app.cli.output import Json, RigOption, Speed, TranscriptOption, answer, print_order
from goniotwin.app.log_file import own_log

app = typer.Typer()


@app.command()
def doctor(
    rig: Annotated[
        Path | None,
        typer.Option("--rig", metavar="RIG.toml", help="Examine the ports of this rig file too.", show_default=False),
    ] = None,
    as_json: Json = False,
) -> None:
    """Examine this computer: libraries, ports, rights, disk.

    Each line states ok, a note, or a problem that prevents measuring, with the remedy. No device is opened and nothing is
    changed. You can send the text with the report of a fault: it has no name of a user or a computer. With --rig, it has the
    addresses in the rig file.

    Exit status: 1 if a problem prevents measuring, else 0.
    """
    from goniotwin.app.cli.work.doctor import examine, exit_status, findings_text

    found = examine(rig)
    answer(as_json, {"findings": found}, lambda: print(findings_text(found)))
    raise typer.Exit(exit_status(found))


@app.command()
def devices(
    rig: Annotated[
        Path | None, typer.Option("--rig", metavar="RIG.toml", help="List the devices of this rig file.", show_default=False)
    ] = None,
    as_json: Json = False,
) -> None:
    """List ports and the devices that respond on them.

    With --rig, the command lists the devices of the rig file. Without it, the command lists the serial ports and USB
    instruments of this computer. The program reads the identity of each device. With --rig, it also reads whether the shutter
    is closed. Nothing moves. The program does not open a port that another program uses.

    Exit status: 1 if a device of a rig file does not respond, else 0.
    """
    from goniotwin.app.cli.work.device_search import exit_status, find_devices, status_table

    found = find_devices(rig)
    answer(as_json, {"devices": found}, lambda: print(status_table(found)))
    for each in found:
        if each.order:
            print_order(each.order)
    raise typer.Exit(exit_status(found))


@app.command()
def home(
    rig: RigOption,
    axes: Annotated[
        list[str] | None,
        typer.Argument(metavar="AXIS", help="Axes to home. The default is all axes with a [homing] table.", show_default=False),
    ] = None,
) -> None:
    """Home axes one after the other; the axes move.

    Only axes with a [homing] table in the rig file can be homed. If a station holds the rig, the command works through the
    station. Ctrl-C stops the axes.

    Exit status: 0 if all are homed, 1 after a fault.
    """
    from goniotwin.app.cli.work.referencing import home_axes

    home_axes(rig, list(axes or []), print)


@app.command(context_settings={"ignore_unknown_options": True})  # -10 is an angle
def here(
    rig: RigOption,
    axis: Annotated[str, typer.Argument(metavar="AXIS", help="gamma, sigma, beta or shift.", show_default=False)],
    angle: Annotated[float, typer.Argument(metavar="DEG", help="Current position of the axis, deg.", show_default=False)],
) -> None:
    """Set the current position of an axis (manual referencing).

    Nothing moves. Read the position from the scale of the axis first. If a station holds the rig, the command works through the
    station.

    Exit status: 0 if the position is set, 1 after a fault.
    """
    from goniotwin.app.cli.work.referencing import set_axis_position

    set_axis_position(rig, axis, angle, print)


@app.command()
def station(
    rig: RigOption,
    speed: Speed = 1.0,
    unattended: Annotated[
        float, typer.Option("--unattended", metavar="S", min=0.0, help="The station ends after this time without a client, s.")
    ] = 60.0,
) -> None:
    """Hold a rig for windows and terminals.

    The window starts a station by itself. A campaign continues in the station when the window closes or crashes. The next
    window attaches to the station. Ctrl-C and SIGTERM stop the campaign and the axes, close the shutter and release the rig.

    Exit status: 0 after a disconnect or without clients, 130 after a signal.
    """
    from goniotwin.app.station.process import run_station

    def log(line: str) -> None:
        print(line, flush=True)

    with own_log("station"):
        received = run_station(rig, speed, log, unattended)
    if received:
        raise typer.Exit(130)


@app.command(context_settings={"ignore_unknown_options": True})  # -10 is an angle
def move(
    rig: RigOption,
    axis: Annotated[str, typer.Argument(metavar="AXIS", help="gamma, sigma, beta or shift.", show_default=False)],
    angle: Annotated[float, typer.Argument(metavar="DEG", help="Target, deg.", show_default=False)],
) -> None:
    """Move an axis to an angle.

    The program refuses an angle outside the soft limits of the rig file. Ctrl-C stops all axes.

    Exit status: 0 when the axis has arrived, 1 after a fault.
    """
    from goniotwin.app.cli.work.bench import move_axis

    move_axis(rig, axis, angle)


@app.command()
def read(
    rig: RigOption,
    readings: Annotated[
        int, typer.Option("--readings", metavar="N", min=1, max=1000, help="Number of readings to average.")
    ] = 1,
    gain: Annotated[
        float | None, typer.Option("--gain", metavar="V/A", help="Gain of the amplifiers.", show_default=False)
    ] = None,
    dark: Annotated[bool, typer.Option("--dark", help="Dark reading: close the shutter for the reading.")] = False,
    as_json: Json = False,
) -> None:
    """Read all photodiodes and the monitor once.

    The axes, the wavelength and the shutter stay as they are. With --dark, the shutter closes for the reading.

    Exit status: 0 with the values, 1 after a fault.
    """
    from goniotwin.app.cli.work.bench import read_devices

    read_devices(rig, readings, gain, dark, as_json)


@app.command("verify-device")
def verify_device(
    rig: RigOption,
    devices: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="DEVICE", help="Name from `goniotwin devices`, or an axis. The default is all devices.", show_default=False
        ),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Move without asking.")] = False,
    report: Annotated[
        Path | None, typer.Option("--report", metavar="FILE", help="Write the results to this text file.", show_default=False)
    ] = None,
    transcript: TranscriptOption = None,
    as_json: Json = False,
) -> None:
    """Verify the devices of a rig when it arrives.

    The first checks move nothing: identities, settings, reply times, gains, dark levels. Then the program asks you. After a yes
    it tests small moves, a stop, a change of wavelength, the shutter and the filter wheel. It leaves the devices as it found
    them. Ctrl-C stops all axes. The page "The day the rig arrives" of the documentation lists the checks.

    Exit status: 0 if nothing differs, 1 if something differs, 2 for bad input.
    """
    from goniotwin.app.cli.work.device_verification import verify_devices

    found = verify_devices(rig, list(devices or []), yes=yes, report=report, transcript=transcript, quiet=as_json)
    answer(as_json, found, lambda: print(found.summary))
    raise typer.Exit(int(found.differing > 0))
