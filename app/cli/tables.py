"""Results of commands as tables for a terminal."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

from goniotwin.app.campaign.wording import duration_text
from goniotwin.app.errors import one_line

if TYPE_CHECKING:  # a table needs its own result alone
    from goniotwin.app.campaign.journal.summary import CampaignSummary
    from goniotwin.app.campaign.rehearsal.alignment_design import AlignmentDesign
    from goniotwin.app.campaign.studies.alignment import AlignmentResult
    from goniotwin.app.campaign.studies.budget import Budget
    from goniotwin.app.campaign.studies.verification import Verdict

FAILS_STYLE = {"fails": "red", "warns": "yellow", "holds": "green", "nothing to judge": "dim"}
STATE_STYLES = {"done": "green", "running": "cyan", "failed": "red", "killed": "red", "stopped": "yellow", "empty": "dim"}
WIDE_COLUMNS = 110
"""Width of a terminal from which a budget has a column for each of its texts."""
LEAST_SHARE = 1e-4
"""Share of u squared below which a component is not listed without --all: a hundredth of u."""


def print_campaigns(folder: Path, campaigns: "list[CampaignSummary]") -> None:
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
            Text(one_line(each.begun or "")),
        )
    console.print(table)


def print_budget(budget: "Budget", simulated: bool, every: bool) -> None:
    """Print a budget: the components from LEAST_SHARE on, or `every` one."""
    console = Console(highlight=False)
    result = budget.listed
    unit = "" if budget.unit == "1" else f" {budget.unit}"
    relative = f" ({100.0 * result.relative_u:.3g} %)" if result.relative_u is not None else ""
    console.print(f"{'SIMULATED, ' if simulated else ''}{budget.title}", markup=False, soft_wrap=True)
    freedom = result.degrees_of_freedom
    degrees = "" if freedom is None else f", {freedom:.0f} effective degrees of freedom"
    console.print(f"{budget.value:.6g}{unit}, u {budget.u:.3g}{unit}{relative}{degrees}", markup=False, soft_wrap=True)
    for remark in budget.about:
        console.print(remark, markup=False, soft_wrap=True)
    wide = console.width >= WIDE_COLUMNS
    table = Table(box=None, pad_edge=False)
    for name in ("component", f"u{unit and ','}{unit}", "u, %", "share, %", *(["shared by", "source; u is"] if wide else [])):
        number = name.startswith(("u", "share,"))
        width = (41 if wide else 27) if name == "component" else None  # the name of a product is longer
        table.add_column(name, justify="right" if number else "left", no_wrap=number, overflow="fold", width=width)
    if not wide:
        table.add_column("shared by; source; u is", overflow="fold")
    components = result.components
    shown = [each for each in components if every or each.share >= LEAST_SHARE] or components
    for each in shown:
        percent = "" if each.relative_u is None else f"{100.0 * each.relative_u:.3g}"
        known = f"{each.degrees_of_freedom:.0f} degrees of freedom" if each.degrees_of_freedom is not None else ""
        source = each.source or ""
        origin = "" if f"({each.origin})" in source else each.origin
        about = (each.shared_by, "; ".join(filter(None, (source, ", ".join(filter(None, (origin, known)))))))
        texts = (each.name, f"{each.u:.3g}", percent, f"{100.0 * each.share:.2f}")
        table.add_row(*map(Text, (*texts, *(about if wide else ["; ".join(filter(None, about))]))))
    console.print(table)
    if rest := components[len(shown) :]:
        share = math.sqrt(math.fsum(each.share for each in rest))
        console.print(f"and {len(rest)} smaller ones, together {100.0 * share:.2g} % of u (--all lists them)", soft_wrap=True)


def print_design(design: "AlignmentDesign") -> None:
    """Print the design of an alignment."""
    console = Console(highlight=False)
    mark = "SIMULATED, " if design.plan.rig.simulated else ""
    forecast = design.forecast
    console.print(
        f"{mark}alignment on {design.sample}: {forecast.rows} rows, {duration_text(forecast.seconds)} of "
        f"{duration_text(design.allowed_s)}; the schedule's own: {duration_text(design.began_s)}",
        markup=False,
        soft_wrap=True,
    )
    for key, values in design.levels.items():
        console.print(f"{key} = [{', '.join(f'{each:g}' for each in values)}]", markup=False, soft_wrap=True)
    table = Table(box=None, pad_edge=False)
    for name in ("expected u, deg", "schedule, equal time", "u before"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("combination", overflow="fold")
    for each, u in zip(forecast.combinations, forecast.u_before, strict=True):
        table.add_row(f"{each.u:.5f}", f"{u:.5f}", f"{each.prior_u:.3f}", Text(each.words))
    console.print(table)


def print_alignment(result: "AlignmentResult", simulated: bool) -> None:
    """Print what an alignment has found."""
    console = Console(highlight=False)
    mark = "SIMULATED, " if simulated else ""
    scans = f" and {result.scans} scan{'s' if result.scans > 1 else ''} of the open beam" if result.scans else ""
    console.print(
        f"{mark}alignment on {', '.join(result.mountings)}: {len(result.combinations)} combinations from {result.values} "
        f"values{scans}, chi-square {result.chi_square:.2f} per degree of freedom",
        markup=False,
        soft_wrap=True,
    )
    table = Table(box=None, pad_edge=False)
    for name in ("value, deg", "u, deg", "u before"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("combination", overflow="fold")
    for each in result.combinations:
        table.add_row(f"{each.value:+.4f}", f"{each.u:.4f}", f"{each.prior_u:.3f}", Text(each.words))
    console.print(table)
    if result.before:
        console.print(f"it begins with {result.before}", markup=False, soft_wrap=True)
    if result.light is not None and not result.light.missing:
        console.print(result.light.text, soft_wrap=True)
    if not result.scans:
        console.print(
            "light and arc are one sum in the plane of incidence: a scan of the open beam separates them", soft_wrap=True
        )


def print_verdicts(verdicts: "list[Verdict]", evidence: str, simulated: bool) -> None:
    """Print each verdict with its reason, and the table of the evidence."""
    console = Console(highlight=False)
    if simulated:
        console.print("SIMULATED")
    for each in verdicts:
        line = Text(f"{each.name}: ").append(each.verdict, style=FAILS_STYLE[each.verdict]).append(f": {each.text}")
        console.print(line, soft_wrap=True)
    if evidence:
        console.print(evidence, soft_wrap=True)
