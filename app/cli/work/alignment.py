"""The estimate of a rig's misalignments, from a data file."""

from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from goniotwin.app.campaign.studies.alignment import AlignmentResult
from goniotwin.app.campaign.studies.journals import align_journal
from goniotwin.app.cli.output import answer, print_warning
from goniotwin.app.formats.file import Replaceable, check_writable, write_file
from goniotwin.app.rig.alignment import alignment_text, is_alignment


def estimate_alignment(journal: Path, sample: str | None, output: Path | None, as_json: bool) -> None:
    """Print the misalignments that a journal determines, and write them to a file. Raises UserError."""
    replaceable = Replaceable("an alignment file", is_alignment)
    if output is not None:
        check_writable(output, replaceable)
    result, file = align_journal(journal, sample)
    if output is not None:
        write_file(output, alignment_text(file).encode(), replaceable)
    as_object = {**result.as_dict(), "simulated": file.simulated, "file": output}
    answer(as_json, as_object, lambda: _print_alignment(result, file.simulated))
    for finding in result.findings:
        print_warning(finding)


def _print_alignment(result: AlignmentResult, simulated: bool) -> None:
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
