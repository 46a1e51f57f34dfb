"""The plan of a campaign for an alignment."""

from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from goniotwin.app.campaign.rehearsal.alignment_design import AlignmentDesign, design_alignment, is_planned
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.campaign.wording import duration_text
from goniotwin.app.cli.output import answer, print_warning
from goniotwin.app.formats.file import Replaceable, check_writable, write_file
from goniotwin.app.rig import read_rig


def plan_alignment(schedule: Path, rig: Path, minutes: float, sample: str | None, output: Path | None, as_json: bool) -> None:
    """Print levels of the axes for an alignment, and write the schedule. Raises UserError."""
    replaceable = Replaceable("a schedule that align --plan has written", is_planned)
    if output is not None:
        check_writable(output, replaceable)
    design = design_alignment(read_schedule(schedule), read_rig(rig), minutes, sample)
    if output is not None:
        write_file(output, design.text.encode(), replaceable)
    as_object = {**design.as_dict(), "file": output}
    answer(as_json, as_object, lambda: _print_design(design))
    if design.ended_early:
        print_warning("the search has ended after a bounded number of plans, and better levels may exist; give fewer minutes")


def _print_design(design: AlignmentDesign) -> None:
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
