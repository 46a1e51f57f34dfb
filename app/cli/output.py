"""What all commands share: answers on standard output, messages and progress bars on standard error, common options."""

import contextlib
import json
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Annotated, Any, Self

import typer
import typer.core
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskProgressColumn,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Column
from rich.text import Text

from goniotwin.app.errors import one_line
from goniotwin.protocols.clock import GREATEST_SPEED, LEAST_SPEED

if TYPE_CHECKING:  # the events load numpy, which a command's help does not need
    from goniotwin.app.campaign.running.events import Event

RigOption = Annotated[Path, typer.Option("--rig", metavar="RIG.toml", help="Rig file.", show_default=False)]
Json = Annotated[bool, typer.Option("--json", help="One JSON object on standard output, everything else on standard error.")]
Speed = Annotated[
    float, typer.Option("--speed", min=LEAST_SPEED, max=GREATEST_SPEED, help="Simulation speed of a virtual rig.")
]
TranscriptOption = Annotated[
    Path | None,
    typer.Option(
        "--transcript",
        metavar="DIR",
        help="Record every byte on every wire in this folder, with its time.",
        show_default=False,
    ),
]

errors = Console(stderr=True, highlight=False, soft_wrap=True)
"""Standard error."""


class _WithFormats:
    """A command whose help ends with the file formats of the registry, those of other packages included."""

    def format_epilog(self, _context: Any, formatter: Any) -> None:
        """Write the list (the command-line library calls this)."""
        from goniotwin.app.formats.registry import Holds, formats

        with formatter.section("Formats"):
            rows = [(str(each), each.title) for each in formats() if Holds.RAYS not in each.holds]
            formatter.write_dl(rows)


class CommandWithFormats(_WithFormats, typer.core.TyperCommand):
    """A command that reads or writes tables."""


class GroupWithFormats(_WithFormats, typer.core.TyperGroup):
    """A group of commands, itself a command that reads or writes tables."""


def answer(as_json: bool, result: dict[str, Any], show: Callable[[], None]) -> None:
    """Print the result of a command: as one JSON object, or as text by `show`."""
    if as_json:
        print(json.dumps(result, indent=2, allow_nan=False))
    else:
        show()


def print_error(text: object) -> None:
    """Print an error on standard error, in red and in one line."""
    with contextlib.suppress(OSError):  # a closed terminal
        errors.print(f"goniotwin: {one_line(str(text))}", style="red", markup=False)


def print_warning(text: object) -> None:
    """Print what needs attention on standard error, in yellow and in one line."""
    with contextlib.suppress(OSError):  # a closed terminal
        errors.print(f"goniotwin: {one_line(str(text))}", style="yellow", markup=False)


def print_order(text: str) -> None:
    """Print a safety order on standard error, as an error."""
    print_error(f"SAFETY: {text}")


def print_note(text: str) -> None:
    """Print what the program is doing on standard error, in one line."""
    with contextlib.suppress(OSError):  # a closed terminal
        errors.print(f"goniotwin: {one_line(text)}", style="dim", markup=False)


class CurrentStepColumn(ProgressColumn):
    """The current step. In a narrow terminal this column is cut off, and not the numbers before it."""

    def render(self, task: Task) -> Text:
        """The text of a task (Rich calls it)."""
        return Text(task.fields["now"], style="dim", no_wrap=True, overflow="ellipsis")


class ProgressBar:
    """A progress bar with the time left. It appears with the first progress: a command that is refused shows none."""

    def __init__(self, console: Console, title: str, total: float | None, *columns: ProgressColumn) -> None:
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            *columns,
            TimeRemainingColumn(compact=True, table_column=Column(no_wrap=True)),
            TextColumn("left "),
            CurrentStepColumn(),
            console=console,
        )
        self._task = self._bar.add_task(title, total=total, now="")

    def _update(self, now: str, completed: float | None = None, total: float | None = None) -> None:
        self._bar.start()
        self._bar.update(self._task, now=now, completed=completed, total=total)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._bar.live.is_started:
            self._bar.stop()


class RowProgress(ProgressBar):
    """Progress of a campaign in rows; a listener of the engine. If `rows` is None, the first committed row gives the number."""

    def __init__(self, console: Console, title: str, rows: int | None) -> None:
        super().__init__(console, title, rows, MofNCompleteColumn(table_column=Column(no_wrap=True)), TextColumn("rows,"))
        self.orders: list[str] = []

    def __call__(self, event: "Event") -> None:
        """Show an event of the engine. A safety order is printed at once, and kept in `orders` to be printed again."""
        from goniotwin.app.campaign.running.events import RowCommitted, RowStarted, SafetyOrder

        if isinstance(event, SafetyOrder):
            if event.text not in self.orders:
                self.orders.append(event.text)
            print_order(event.text)
            return
        self._bar.start()
        if isinstance(event, RowStarted):
            self._update(event.row.identity)
        elif isinstance(event, RowCommitted):
            self._update(f"rig: {event.seconds_left:.0f} s left", event.done, event.total)


class ShareProgress(ProgressBar):
    """Progress of a simulation as a share of 1, with the current step."""

    def __init__(self, console: Console, title: str) -> None:
        super().__init__(console, title, 1.0, TaskProgressColumn())

    def __call__(self, share: float, now: str) -> None:
        """Show the share that is done, and the current step."""
        self._update(now, share)
