"""Saying where the axes are: by their reference searches, or by somebody who has looked."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from goniotwin.app.campaign.campaign import clock_of
from goniotwin.app.errors import UserError
from goniotwin.app.rig import AXES, open_rig, read_rig
from goniotwin.drivers import Axis, DeviceError, Rig, wait

Say = Callable[[str], None]


def home_axes(path: Path, names: list[str], say: Say) -> None:
    """Homes axes one after the other, all that have a [homing] table where none is named.

    Raises UserError before anything moves, DeviceError after; the axes are at rest then.
    """
    file = read_rig(path).file
    for name in names:
        _known(path, name)
        if getattr(file.axes, name).homing is None:
            raise UserError(
                f"{path}: axes.{name}: has no [axes.{name}.homing] table; add it, or say where the axis is: "
                f"goniotwin here --rig {path} {name} DEG"
            )
    chosen = [name for name in AXES if (name in names if names else getattr(file.axes, name).homing is not None)]
    if not chosen:
        raise UserError(
            f"{path}: no axis has a [homing] table; add them, or say where each axis is: goniotwin here --rig {path} AXIS DEG"
        )
    with _connected(path) as rig:
        for name in chosen:
            _home(rig, rig.axes[name])
            astray = rig.axes[name].last_reference_deg
            told = "" if astray is None else f" (its reference was at {astray:.3f} deg by the old counter)"
            say(f"{name}: homed, at {rig.axes[name].position_deg():.3f} deg{told}")


def state_place(path: Path, name: str, angle_deg: float, say: Say) -> None:
    """Somebody says that an axis stands at an angle: nothing moves. Raises UserError, DeviceError."""
    _known(path, name)
    with _connected(path) as rig:
        axis = rig.axes[name]
        limits = axis.settings
        if not limits.lower_deg <= angle_deg <= limits.upper_deg:
            raise UserError(
                f"{path}: {name} has soft limits of {limits.lower_deg:g} to {limits.upper_deg:g} deg, and "
                f"{angle_deg:g} deg is outside; turn it back by hand, or change the limits"
            )
        axis.assume_referenced(angle_deg)
        say(f"{name}: is at {axis.position_deg():.3f} deg, as you say")


def _known(path: Path, name: str) -> None:
    if name not in AXES:
        raise UserError(f"{path}: {name!r} is no axis; there are {', '.join(AXES)}")


@contextmanager
def _connected(path: Path) -> Iterator[Rig]:
    """A rig of which the axes are connected, and nobody else has it."""
    description = read_rig(path)
    with open_rig(description, clock_of(description.file)) as opened:
        try:
            opened.rig.reconnect_axes()
        except DeviceError as error:
            raise UserError(str(error)) from None
        yield opened.rig


def _home(rig: Rig, axis: Axis) -> None:
    try:
        wait(rig.clock, [axis.start_homing()])
    except (DeviceError, KeyboardInterrupt):
        rig.stop()
        raise
