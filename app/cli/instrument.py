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
        Path | None, typer.Option("--rig", metavar="RIG.toml", help="Examine its ports too.", show_default=False)
    ] = None,
    as_json: Json = False,
) -> None:
    """Examine this computer: libraries, ports, rights, disk.

    Each line is ok, a note, or a problem that prevents measuring, with the remedy. No device is opened and nothing is
    changed. The text is for a report of a fault: it has no name of a user or a computer. With --rig it has the addresses of
    the rig file.

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

    With --rig: the devices of a rig file. Without: the serial ports and USB instruments of this computer.
    Only identities are read, and whether the shutter of a rig file is closed; nothing moves. A port that another program holds
    is not opened.

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
        typer.Argument(metavar="AXIS", help="Default: all axes with a [homing] table.", show_default=False),
    ] = None,
) -> None:
    """Home axes one after the other; the axes move.

    Only axes with a [homing] table in the rig file can be homed. A rig that a station has is homed through it. Ctrl-C stops
    the axes.

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

    Nothing moves. Read the position from the scale of the axis first. A rig that a station has is used through it.

    Exit status: 0 if the position is set, 1 after a fault.
    """
    from goniotwin.app.cli.work.referencing import set_axis_position

    set_axis_position(rig, axis, angle, print)


@app.command()
def station(
    rig: RigOption,
    speed: Speed = 1.0,
    unattended: Annotated[
        float, typer.Option("--unattended", metavar="S", min=0.0, help="Real time without a client after which it ends.")
    ] = 60.0,
) -> None:
    """Hold a rig for windows and terminals.

    The window starts one by itself. A campaign goes on in the station when the window is closed or has crashed; the next
    window attaches to it. Ctrl-C and SIGTERM stop a campaign in order, close the shutter and give the rig back.

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

    Within the soft limits of the rig file. Ctrl-C stops all axes.

    Exit status: 0 when it has arrived, 1 after a fault.
    """
    from goniotwin.app.cli.work.bench import move_axis

    move_axis(rig, axis, angle)


@app.command()
def read(
    rig: RigOption,
    readings: Annotated[int, typer.Option("--readings", metavar="N", min=1, max=1000, help="Readings to average.")] = 1,
    gain: Annotated[
        float | None, typer.Option("--gain", metavar="V/A", help="Gain of the amplifiers, V/A.", show_default=False)
    ] = None,
    dark: Annotated[bool, typer.Option("--dark", help="Close the shutter for it.")] = False,
    as_json: Json = False,
) -> None:
    """Read all photodiodes and the monitor once.

    Pose, wavelength and shutter stay as they are.

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
            metavar="DEVICE", help="A name of `goniotwin devices`, or an axis. Default: all devices.", show_default=False
        ),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Move without asking.")] = False,
    report: Annotated[
        Path | None, typer.Option("--report", metavar="FILE", help="Write the results as text, to be kept.", show_default=False)
    ] = None,
    transcript: TranscriptOption = None,
    as_json: Json = False,
) -> None:
    """Verify the devices of a rig when it arrives.

    First what moves nothing: identities, settings, reply times, gains, dark levels. Then, after a yes, what moves: small moves,
    a stop, a change of wavelength, the shutter, the filter wheel. Devices are left as they were found. Ctrl-C stops all axes.
    The list of checks: docs/rig/arrival.md.

    Exit status: 0 if nothing differs, 1 if something does, 2 for bad input.
    """
    from goniotwin.app.cli.work.device_verification import verify_devices

    found = verify_devices(rig, list(devices or []), yes=yes, report=report, transcript=transcript, quiet=as_json)
    answer(as_json, found, lambda: print(found.summary))
    raise typer.Exit(int(found.differing > 0))
