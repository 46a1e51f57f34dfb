"""Commands on the instrument: `goniotwin devices`, `home` and `here`."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from goniotwin.app.cli.output import Json, RigOption, answer, print_order
from goniotwin.app.errors import UserError

if TYPE_CHECKING:  # the drivers load numpy, which a command's help does not need
    from goniotwin.app.rig import RigDescription
    from goniotwin.drivers import Axis, Rig

Report = Callable[[str], None]

app = typer.Typer()


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
    # Loads 720 modules, numba and pymodbus among them: 0.7 s, which help does without.
    from goniotwin.app.cli.device_search import exit_status, find_devices, status_table

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
    set_axis_position(rig, axis, angle, print)


def home_axes(path: Path, names: list[str], report: Report) -> None:
    """Home axes one after the other; without `names` all that have a [homing] table.

    Raises UserError before anything moves; BenchFault later, with the axes at rest.
    """
    # Loads 281 modules, numpy and pydantic among them: 0.3 s, which help does without.
    from goniotwin.app.cli.station import attached_bench
    from goniotwin.app.rig import AXES, read_rig

    description = read_rig(path)
    file = description.file
    for name in names:
        _check_axis(path, name)
        if getattr(file.axes, name).homing is None:
            raise UserError(
                f"{path}: axes.{name}: has no [axes.{name}.homing] table; add it, or set the position: "
                f"goniotwin here --rig {path} {name} DEG"
            )
    chosen = [name for name in AXES if (name in names if names else getattr(file.axes, name).homing is not None)]
    if not chosen:
        raise UserError(
            f"{path}: no axis has a [homing] table; add them, or set the position of each axis: "
            f"goniotwin here --rig {path} AXIS DEG"
        )
    with attached_bench(description) as bench:
        if bench is not None:
            for name in chosen:
                bench.finish("home", axis=name)
                report(f"{name}: homed, at {bench.snapshot.positions[name]:.3f} deg")
            return
    with _connected_axes(description, chosen) as rig:
        for name in chosen:
            _home(rig, rig.axes[name])
            previous_deg = rig.axes[name].last_reference_deg
            previous = "" if previous_deg is None else f" (reference found at {previous_deg:.3f} deg of the previous count)"
            report(f"{name}: homed, at {rig.axes[name].position_deg():.3f} deg{previous}")


def set_axis_position(path: Path, name: str, angle_deg: float, report: Report) -> None:
    """Set the current position of an axis; nothing moves. Raises UserError, BenchFault."""
    # Loads 284 modules, numpy and pydantic among them: 0.3 s, which help does without.
    from goniotwin.app.campaign.running.question import position_refusal
    from goniotwin.app.cli.station import attached_bench
    from goniotwin.app.rig import read_rig

    _check_axis(path, name)
    description = read_rig(path)
    with attached_bench(description) as bench:
        if bench is not None:
            bench.finish("set_position", axis=name, angle_deg=angle_deg)
            report(f"{name}: position set to {bench.snapshot.positions[name]:.3f} deg")
            return
    with _connected_axes(description, [name]) as rig:
        axis = rig.axes[name]
        if refusal := position_refusal(name, axis.settings.lower_deg, axis.settings.upper_deg, angle_deg):
            raise UserError(f"{path}: {refusal}; turn the axis back by hand, or change the limits")
        axis.set_position(angle_deg)
        report(f"{name}: position set to {axis.position_deg():.3f} deg")


def _check_axis(path: Path, name: str) -> None:
    # Loads 281 modules, numpy and pydantic among them: 0.3 s, which help does without.
    from goniotwin.app.rig import AXES

    if name not in AXES:
        raise UserError(f"{path}: {name!r} is not an axis; the axes are {', '.join(AXES)}")


@contextlib.contextmanager
def _connected_axes(description: "RigDescription", names: list[str]) -> "Iterator[Rig]":
    """A rig, locked against other programs, with the controllers of these axes connected. Raises BenchFault after a fault."""
    # Loads 821 modules, numba and pymodbus among them: 1.0 s, which help does without.
    from goniotwin.app.campaign.campaign import clock_for
    from goniotwin.app.cli.station import BenchFault
    from goniotwin.app.rig import open_rig
    from goniotwin.drivers import DeviceError

    with open_rig(description, clock_for(description.file)) as opened:
        if (left := opened.guard.left) is not None and not left.done:
            print_order(left.text)
        try:
            for controller in opened.rig.controllers:
                if not controller.axes.keys().isdisjoint(names):
                    controller.connect()
        except DeviceError as error:
            raise UserError(str(opened.rig.in_words(error))) from None
        try:
            yield opened.rig
        except DeviceError as error:
            raise BenchFault(str(opened.rig.in_words(error))) from None


def _home(rig: "Rig", axis: "Axis") -> None:
    # Loads 7 modules: 9 ms, which help does without.
    from goniotwin.drivers import DeviceError, wait

    try:
        wait(rig.clock, [axis.start_homing()])
    except (DeviceError, KeyboardInterrupt):
        rig.stop()
        raise
