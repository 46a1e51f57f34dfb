"""Commands on measured data: `goniotwin export`, `budget`, `verify` and `copy`."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from goniotwin.app.cli.output import CommandWithFormats, Json, answer, print_error
from goniotwin.app.errors import UserError

if TYPE_CHECKING:  # the reduction loads numpy, which a command's help does not need
    from goniotwin.app.campaign.reduction.budget import Budget

JournalArgument = Annotated[
    Path, typer.Argument(metavar="JOURNAL", help="Data file (journal) of a campaign.", show_default=False)
]
FAILS_STYLE = {"fails": "red", "holds": "green", "nothing to judge": "dim"}

app = typer.Typer()


@app.command(cls=CommandWithFormats)
def export(
    journal: Annotated[Path, typer.Argument(metavar="JOURNAL", help="Data file (journal) of a campaign.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="File to write.", show_default=False)],
    file_format: Annotated[
        str, typer.Option("--format", metavar="FORMAT", help="A format of the list below, by its name.", show_default=False)
    ],
    sample: Annotated[
        str | None, typer.Option("--sample", help="Sample, if the journal has several.", show_default=False)
    ] = None,
    light: Annotated[
        Literal["reflected", "transmitted"] | None,
        typer.Option("--light", help="Light, if the journal has both and the format holds one table.", show_default=False),
    ] = None,
    without_damaged: Annotated[
        bool, typer.Option("--without-damaged", help="Leave out the rows that are damaged, instead of writing nothing.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Reduce a data file (journal) and write the BSDF.

    The journal is not changed. A .csv has every measured point, with its standard uncertainty. A table such as a .ddr is in
    specular coordinates and has no gaps: directions without a measurement are filled and listed at its top. The standard
    uncertainties of FILE.ddr are in FILE.u.ddr, on the same grid.

    Exit status: 1 if the journal differs from what was measured, row by row or as a whole.
    """
    from goniotwin.app.campaign.journal.writing import Journal
    from goniotwin.app.campaign.reduction.export import check_files, export_format
    from goniotwin.app.campaign.reduction.export import export as export_reduced
    from goniotwin.app.campaign.reduction.reduction import reduce_to_files

    form = export_format(file_format)
    if os.path.realpath(out) == os.path.realpath(journal):
        raise UserError(f"{out}: is the journal itself; choose another name")
    check_files(out, form)
    folder = Path(os.path.realpath(out)).parent
    with Journal.open(journal) as opened, reduce_to_files(opened, folder, without_damaged=without_damaged) as reduced:
        chain = opened.chain
        exported = export_reduced(reduced, sample, out, form, light)
    files = [str(file) for file in exported.files]
    result = {
        "file": files[0], "files": files, "format": form.name, "values": exported.values, "simulated": reduced.simulated,
        "chain": chain.as_dict(), "damaged": sorted(chain.without_values),
    }  # fmt: skip
    mark = "SIMULATED, " if reduced.simulated else ""
    text = f"{mark}{exported.values} measured values: {', '.join(files)}\n{reduced.chain}"
    answer(as_json, result, lambda: print(text))
    if chain.damage:
        print_error(f"{journal}: exported without what differs from what was measured: {chain.damage}")


@app.command()
def budget(
    journal: JournalArgument,
    at: Annotated[
        str,
        typer.Option(
            "--at",
            metavar="PLACE",
            help="Where: sigma=30,zenith=35,azimuth=180, or theta and phi; also sample, wavelength, gamma, light and photodiode, "
            "as far as the journal has several.",
            show_default=False,
        ),
    ],
    reflectance: Annotated[
        bool, typer.Option("--reflectance", help="Of the directional-hemispherical reflectance, instead of one value.")
    ] = False,
    as_json: Json = False,
) -> None:
    """List the components of a value's uncertainty, the largest first.

    For each: u in the unit of the value and in percent, its share of u squared, which values share it, and its source. The
    squares of the components add up to the square of u.
    """
    from goniotwin.app.campaign.journal.writing import Journal
    from goniotwin.app.campaign.reduction.budget import budget_of_reflectance, budget_of_value, parse_place
    from goniotwin.app.campaign.reduction.reduction import Reduction

    place = parse_place(at)
    with Journal.open(journal) as opened:
        simulated = opened.simulated
        found = (budget_of_reflectance if reflectance else budget_of_value)(Reduction(opened), place)
    answer(
        as_json, {**found.as_dict(), "simulated": simulated}, lambda: _print_budget(Console(highlight=False), found, simulated)
    )


def _print_budget(console: Console, budget: "Budget", simulated: bool) -> None:
    result = budget.as_dict()
    unit = "" if budget.unit == "1" else f" {budget.unit}"
    relative = f" ({result['relative_u']:.3%})" if result["relative_u"] is not None else ""
    console.print(f"{'SIMULATED, ' if simulated else ''}{budget.title}", markup=False, soft_wrap=True)
    console.print(f"{budget.value:.6g}{unit}, u {budget.u:.3g}{unit}{relative}", markup=False)
    for each in budget.about:
        console.print(each, markup=False, soft_wrap=True)
    table = Table(box=None, pad_edge=False)
    for name in ("component", f"u{unit and ','}{unit}", "u, %", "share", "shared by", "source"):
        table.add_column(name, justify="right" if name.startswith(("u", "share")) and name != "shared by" else "left")
    for each in result["components"]:
        percent = "" if each["relative_u"] is None else f"{100.0 * each['relative_u']:.3g}"
        texts = (each["name"], f"{each['u']:.3g}", percent, f"{each['share']:.1%}", each["shared_by"], each.get("source", ""))
        table.add_row(*map(Text, texts))
    console.print(table)


@app.command()
def verify(
    journal: JournalArgument,
    as_json: Json = False,
) -> None:
    """Check the values of a data file (journal) against physics and against each other.

    Reciprocity, energy, symmetry, overlaps of photodiodes, gains, drift, instrument signature, obstructed directions: one
    verdict each, with figures. "Nothing to judge" where the schedule measures nothing for it.

    Exit status: 1 if a verdict is "fails".
    """
    from goniotwin.app.campaign.journal.writing import Journal
    from goniotwin.app.campaign.reduction.reduction import Reduction
    from goniotwin.app.campaign.reduction.verification import verify_journal

    with Journal.open(journal) as opened:
        simulated = opened.simulated
        verdicts = verify_journal(Reduction(opened))
    holds = all(each.verdict != "fails" for each in verdicts)
    result = {"simulated": simulated, "holds": holds, "verdicts": [each.as_dict() for each in verdicts]}

    def show() -> None:
        console = Console(highlight=False)
        if simulated:
            console.print("SIMULATED")
        for each in verdicts:
            line = Text(f"{each.name}: ").append(each.verdict, style=FAILS_STYLE[each.verdict]).append(f": {each.text}")
            console.print(line, soft_wrap=True)

    answer(as_json, result, show)
    if not holds:
        raise typer.Exit(1)


@app.command()
def copy(
    journal: Annotated[Path, typer.Argument(metavar="JOURNAL", help="Data file (journal) of a campaign.", show_default=False)],
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Copy to make; not overwritten.", show_default=False)],
    as_json: Json = False,
) -> None:
    """Copy a data file (journal), also while its campaign runs.

    The copy has every row that is committed when it begins, in one file, and is checked.

    Exit status: 1 if the journal is damaged; with damaged rows the copy is kept.
    """
    from goniotwin.app.campaign.journal.writing import copy_journal

    chain = copy_journal(journal, file)
    result = {"file": str(file), "chain": chain.as_dict(), "damaged": sorted(chain.damaged)}
    answer(as_json, result, lambda: print(f"{file}\n{chain.statement}"))
    if chain.damage:
        print_error(f"{file}: differs from what was measured, as {journal} does: {chain.damage}")
        raise typer.Exit(1)
