"""The commands that say where the axes are: `goniotwin home` and `goniotwin here`."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

RigOption = Annotated[Path, typer.Option("--rig", metavar="RIG.toml", help="Where the devices are.", show_default=False)]
AxisArgument = Annotated[str, typer.Argument(metavar="AXIS", help="gamma, sigma, beta or shift.", show_default=False)]
errors = Console(stderr=True, highlight=False, soft_wrap=True)


def add_axes_commands(app: typer.Typer) -> None:
    """Registers them."""
    app.command()(home)
    app.command(context_settings={"ignore_unknown_options": True})(here)  # -10 is an angle


def home(
    rig: RigOption,
    axes: Annotated[
        list[str] | None, typer.Argument(metavar="[AXIS ...]", help="All that can, if none is named.", show_default=False)
    ] = None,
) -> None:
    """Have axes look for their references, one after the other: they move.

    Only axes with a [homing] table in the rig file can. Ends with status 0 when all are homed, 1 after a fault; Ctrl-C stops
    the axes.
    """
    from goniotwin.app.homing_command import home_axes

    with _faults_are_status_1():
        home_axes(rig, list(axes or []), print)


def here(
    rig: RigOption,
    axis: AxisArgument,
    angle: Annotated[float, typer.Argument(metavar="DEG", help="Where it stands.", show_default=False)],
) -> None:
    """Say that an axis stands at an angle: somebody has looked. Nothing moves."""
    from goniotwin.app.homing_command import state_place

    with _faults_are_status_1():
        state_place(rig, axis, angle, print)


@contextlib.contextmanager
def _faults_are_status_1() -> Iterator[None]:
    from goniotwin.drivers import DeviceError

    try:
        yield
    except DeviceError as error:
        errors.print(f"goniotwin: {error}", style="red", markup=False)
        raise typer.Exit(1) from None
