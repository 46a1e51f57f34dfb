"""The list of the campaigns of a folder."""

from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from goniotwin.app.campaign.journal.summary import CampaignSummary, campaign_summaries
from goniotwin.app.campaign.wording import duration_text
from goniotwin.app.cli.output import answer, print_error, print_order
from goniotwin.app.errors import one_line
from goniotwin.app.rig.left import left_unsafe
from goniotwin.protocols.clock import local_stamp

STATE_STYLES = {"done": "green", "running": "cyan", "failed": "red", "killed": "red", "stopped": "yellow", "empty": "dim"}


def list_runs(folder: Path, as_json: bool) -> None:
    """Print the campaigns of a folder, and the safety orders that are not acknowledged. Raises UserError."""
    found, refused = campaign_summaries(folder)
    listed = {order for each in found for order in each.orders}
    others = [each.text for each in left_unsafe() if each.text not in listed]  # its journal is elsewhere, or there is none
    answer(
        as_json,
        {"campaigns": found, "unreadable": refused, "orders": others},
        lambda: _print_campaigns(folder, found),
    )
    for reason in refused:
        print_error(one_line(reason))
    for each in found:
        for order in each.orders:
            print_order(f"of {each.journal}, not acknowledged: {order}")
    for order in others:
        print_order(order)


def _print_campaigns(folder: Path, campaigns: list[CampaignSummary]) -> None:
    """Print one line for each campaign."""
    console = Console(highlight=False)
    if not campaigns:
        console.print(f"{folder}: no journals (*.journal)", markup=False)
        return
    table = Table(box=None, pad_edge=False)
    for name in ("journal", "campaign", "state", "rows", "left", "started"):
        table.add_column(name, justify="right" if name in ("rows", "left") else "left", overflow="fold")
    for each in campaigns:
        table.add_row(
            Text(one_line(Path(each.journal).name)),
            Text(one_line(f"{each.name}{' (SIMULATED)' if each.simulated else ''}")),
            f"[{STATE_STYLES[each.state]}]{each.state}[/]{f', {each.skipped} skipped' if each.skipped else ''}",
            f"{each.rows}/{each.planned}",
            duration_text(each.seconds_left) if each.rows < each.planned else "",
            Text(local_stamp(one_line(each.begun or ""))),
        )
    console.print(table)
