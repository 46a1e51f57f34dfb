"""The progress bar of a campaign."""

from rich.console import Console
from rich.progress import MofNCompleteColumn, TextColumn
from rich.table import Column

from goniotwin.app.campaign.running.events import Event, RowCommitted, RowStarted, SafetyOrder
from goniotwin.app.cli.output import print_order
from goniotwin.app.cli.work.progress import ProgressBar


class RowProgress(ProgressBar):
    """Progress of a campaign in rows; a listener of the engine. If `rows` is None, the first committed row gives the number."""

    def __init__(self, console: Console, title: str, rows: int | None) -> None:
        super().__init__(console, title, rows, MofNCompleteColumn(table_column=Column(no_wrap=True)), TextColumn("rows,"))
        self.orders: list[str] = []

    def __call__(self, event: Event) -> None:
        """Show an event of the engine. A safety order is printed at once, and kept in `orders` to be printed again."""
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
