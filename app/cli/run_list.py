"""The campaigns of a folder as a table for a terminal."""

from pathlib import Path

from rich.console import Console
from rich.table import Table

from goniotwin.app.campaign.journal.runs import CampaignSummary
from goniotwin.app.campaign.wording import duration_text

STYLE = {"done": "green", "running": "cyan", "failed": "red", "killed": "red", "stopped": "yellow", "empty": "dim"}


def show(console: Console, folder: Path, campaigns: list[CampaignSummary]) -> None:
    """One line a campaign."""
    if not campaigns:
        console.print(f"{folder}: no journals (*.journal)", markup=False)
        return
    table = Table(box=None, pad_edge=False)
    for name in ("journal", "campaign", "state", "rows", "left", "begun"):
        table.add_column(name, justify="right" if name in ("rows", "left") else "left", overflow="fold")
    for each in campaigns:
        table.add_row(
            Path(each.journal).name,
            f"{each.name}{' (SIMULATED)' if each.simulated else ''}",
            f"[{STYLE[each.state]}]{each.state}[/]{f', {each.skipped} skipped' if each.skipped else ''}",
            f"{each.rows}/{each.planned}",
            duration_text(each.seconds_left) if each.rows < each.planned else "",
            each.begun or "",
        )
    console.print(table)
