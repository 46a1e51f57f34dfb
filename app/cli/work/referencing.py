"""References of axes: homing, and a position that is set by hand."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

from goniotwin.app.campaign.campaign import clock_for
from goniotwin.app.campaign.running.question import position_refusal
from goniotwin.app.cli.output import print_order
from goniotwin.app.cli.work.bench import BenchFault, attached_bench
from goniotwin.app.errors import UserError
from goniotwin.app.rig import AXES, RigDescription, open_rig, read_rig
from goniotwin.drivers import Axis, DeviceError, Rig, wait

Report = Callable[[str], None]


def home_axes(path: Path, names: list[str], report: Report) -> None:
    """Home axes one after the other; without `names` all that have a [homing] table.

    Raises UserError before anything moves; BenchFault later, with the axes at rest.
    """
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
    if name not in AXES:
        raise UserError(f"{path}: {name!r} is not an axis; the axes are {', '.join(AXES)}")


@contextlib.contextmanager
def _connected_axes(description: RigDescription, names: list[str]) -> Iterator[Rig]:
    """A rig, locked against other programs, with the controllers of these axes connected. Raises BenchFault after a fault."""
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


def _home(rig: Rig, axis: Axis) -> None:
    try:
        wait(rig.clock, [axis.start_homing()])
    except (DeviceError, KeyboardInterrupt):
        rig.stop()
        raise
