"""Commands on measured data: `goniotwin export`."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from goniotwin.app.cli.output import Json, answer
from goniotwin.app.errors import UserError

app = typer.Typer()


@app.command()
def export(
    journal: Annotated[Path, typer.Argument(metavar="JOURNAL", help="Data file (journal) of a campaign.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="File to write.", show_default=False)],
    file_format: Annotated[
        Literal["ddr", "csv"],
        typer.Option("--format", help="ddr: table in specular coordinates; csv: every measured point.", show_default=False),
    ],
    sample: Annotated[
        str | None, typer.Option("--sample", help="Sample, if the journal has several.", show_default=False)
    ] = None,
    as_json: Json = False,
) -> None:
    """Reduce a data file (journal) and write the BSDF.

    The journal is not changed. A .csv has the standard uncertainty of each value. A .ddr has no gaps: directions without a
    measurement are filled and listed at its top.
    """
    from goniotwin.app.campaign.journal.writing import Journal
    from goniotwin.app.campaign.reduction.export import FORMATS
    from goniotwin.app.campaign.reduction.reduction import reduce_journal

    if out.resolve() == journal.resolve():
        raise UserError(f"{out}: is the journal itself; choose another name")
    with Journal.open(journal) as opened:
        reduced = reduce_journal(opened)
    count = FORMATS[file_format](reduced, sample, out)
    result = {"file": str(out), "format": file_format, "values": count, "simulated": reduced.simulated}
    mark = "SIMULATED, " if reduced.simulated else ""
    answer(as_json, result, lambda: print(f"{mark}{count} measured values: {out}"))
