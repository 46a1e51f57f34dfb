"""A campaign's progress on a terminal: on standard error, so that standard output stays a program's.

Progress of a simulation on a terminal: on standard error, so that standard output stays a program's.
"""

from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TaskProgressColumn, TextColumn, TimeRemainingColumn

from goniotwin.app.campaign.running.events import Event, RowCommitted, RowStarted


class RowProgress:
    """A bar of rows with the time left; a listener of the engine. Without `rows` the first of them tells how many there are."""

    def __init__(self, console: Console, title: str, rows: int | None) -> None:
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=32),
            MofNCompleteColumn(),
            TextColumn("rows,"),
            TimeRemainingColumn(compact=True),
            TextColumn("left  [dim]{task.fields[now]}"),
            console=console,
        )
        self._task: TaskID = self._bar.add_task(title, total=rows, now="")

    def __call__(self, event: Event) -> None:
        """Heeds the rows; the bar appears with the first, so that a campaign that cannot start leaves none."""
        self._bar.start()
        if isinstance(event, RowStarted):
            self._bar.update(self._task, now=event.row.identity)
        elif isinstance(event, RowCommitted):
            left = f"rig's time left {event.seconds_left:.0f} s"
            self._bar.update(self._task, completed=event.done, total=event.total, now=left)

    def __enter__(self) -> "RowProgress":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._bar.live.is_started:
            self._bar.stop()


class ShareProgress:
    """A bar that is told the share that is done, and what is done now."""

    def __init__(self, console: Console, title: str) -> None:
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=32),
            TaskProgressColumn(),
            TimeRemainingColumn(compact=True),
            TextColumn("left  [dim]{task.fields[now]}"),
            console=console,
        )
        self._task = self._bar.add_task(title, total=1.0, now="")

    def __call__(self, share: float, now: str) -> None:
        """The bar appears with the first word of progress, so that what cannot start leaves none."""
        self._bar.start()
        self._bar.update(self._task, completed=share, now=now)

    def __enter__(self) -> "ShareProgress":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._bar.live.is_started:
            self._bar.stop()
