"""Progress bars on standard error. Rich, which draws them, is loaded by the commands that show one."""

from types import TracebackType
from typing import TYPE_CHECKING, Self

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

from goniotwin.app.cli.output import print_order

if TYPE_CHECKING:  # the events load numpy, which a simulation's bar does not need
    from goniotwin.app.campaign.running.events import Event


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
        # Loads 95 modules, numpy among them: 82 ms, which help does without.
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

    def __init__(self, title: str) -> None:
        super().__init__(Console(stderr=True), title, 1.0, TaskProgressColumn())

    def __call__(self, share: float, now: str) -> None:
        """Show the share that is done, and the current step."""
        self._update(now, share)


class SweepProgress(ProgressBar):
    """Progress of a sweep in its chunks, which are `rigs` or such."""

    def __init__(self, console: Console, title: str, chunks: int, name: str) -> None:
        super().__init__(console, title, chunks, MofNCompleteColumn(table_column=Column(no_wrap=True)), TextColumn(f"{name},"))

    def __call__(self, done: int, now: str) -> None:
        """Show the number of chunks that are done, and what computes."""
        self._update(now, done)
