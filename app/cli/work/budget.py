"""The budget of a value's uncertainty."""

import math
from dataclasses import replace
from functools import partial
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.studies.budget import Budget, budget_of_reflectance, budget_of_value, parse_place
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.cli.output import answer

WIDE_COLUMNS = 110
"""Width of a terminal from which a budget has a column for each of its texts."""
LEAST_SHARE = 1e-4
"""Share of u squared below which a component is not listed without --all: a hundredth of u."""


def list_components(journal: Path, at: str, as_json: bool, *, of_reflectance: bool, every: bool) -> None:
    """Print the components of the uncertainty at a place. Raises UserError."""
    place = parse_place(at)
    with Journal.open(journal) as opened:
        simulated = opened.simulated
        found = (budget_of_reflectance if of_reflectance else budget_of_value)(evaluate_journal(opened).reduction, place)
    show = partial(_print_budget, found, simulated, every)
    answer(as_json, replace(found.listed, simulated=simulated), show)


def _print_budget(budget: Budget, simulated: bool, every: bool) -> None:
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
