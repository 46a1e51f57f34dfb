"""Progress bars on standard error."""

from types import TracebackType
from typing import Self

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
