"""What all commands share: answers on standard output, messages on standard error, common options."""

import contextlib
import logging
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
import typer.core

from goniotwin.app.errors import one_line
from goniotwin.app.json_document import json_text
from goniotwin.protocols.clock import GREATEST_SPEED, LEAST_SPEED

if TYPE_CHECKING:  # rich is loaded by what prints with it
    from rich.console import Console

LOG = logging.getLogger(__name__)
LOG.addHandler(logging.NullHandler())  # without a log, printing is enough
RigOption = Annotated[Path, typer.Option("--rig", metavar="RIG.toml", help="Rig file.", show_default=False)]
Json = Annotated[bool, typer.Option("--json", help="Print the result as one JSON object. Messages go to standard error.")]
Speed = Annotated[
    float, typer.Option("--speed", min=LEAST_SPEED, max=GREATEST_SPEED, help="Simulation speed of a virtual rig.")
]
TranscriptOption = Annotated[
    Path | None,
    typer.Option(
        "--transcript",
        metavar="DIR",
        help="Record all bytes to and from the devices in this folder, with their times.",
        show_default=False,
    ),
]
Processes = Annotated[
    int | None,
    typer.Option("--processes", metavar="P", help="Number of processes. The default is one for each core.", show_default=False),
]
Dask = Annotated[
    str | None,
    typer.Option(
        "--dask",
        metavar="ADDRESS",
        help="Compute on the workers of this Dask scheduler: tcp://HOST:8786, or `local` for this computer.",
        show_default=False,
    ),
]
RunnerOptions = tuple[int | None, str | None]
"""Of --processes and --dask."""


@cache
def error_console() -> "Console":
    """Standard error."""
    from rich.console import Console

    return Console(stderr=True, highlight=False, soft_wrap=True)


class CommandWithFormats(typer.core.TyperCommand):
    """A command that reads or writes tables: its help ends with the file formats of the registry, other packages' included."""

    def format_epilog(self, _context: Any, formatter: Any) -> None:
        """Write the list (the command-line library calls this)."""
        from goniotwin.app.formats.registry import Holds, formats

        with formatter.section("Formats"):
            rows = [(str(each), each.title) for each in formats() if Holds.RAYS not in each.holds]
            formatter.write_dl(rows)


def answer(as_json: bool, result: object, show: Callable[[], None]) -> None:
    """Print the result of a command, see `app.json_document`: as one JSON object, or as text by `show`."""
    if as_json:
        print(json_text(result))
    else:
        show()


def print_error(text: object) -> None:
    """Print an error on standard error, in red and in one line, and log it."""
    LOG.error("%s", one_line(str(text)))
    with contextlib.suppress(OSError):  # a closed terminal
        error_console().print(f"goniotwin: {one_line(str(text))}", style="red", markup=False)


def print_warning(text: object) -> None:
    """Print what needs attention on standard error, in yellow and in one line, and log it."""
    LOG.warning("%s", one_line(str(text)))
    with contextlib.suppress(OSError):  # a closed terminal
        error_console().print(f"goniotwin: {one_line(str(text))}", style="yellow", markup=False)


def print_order(text: str) -> None:
    """Print a safety order on standard error, as an error."""
    print_error(f"SAFETY: {text}")


def print_note(text: str) -> None:
    """Print what the program is doing on standard error, in one line, and log it."""
    LOG.info("%s", one_line(text))
    with contextlib.suppress(OSError):  # a closed terminal
        error_console().print(f"goniotwin: {one_line(text)}", style="dim", markup=False)
