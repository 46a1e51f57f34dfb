"""Commands on measured data: `goniotwin export`."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from goniotwin.app.cli.output import CommandWithFormats, Json, answer
from goniotwin.app.errors import UserError

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
    as_json: Json = False,
) -> None:
    """Reduce a data file (journal) and write the BSDF.

    The journal is not changed. A .csv has every measured point, with its standard uncertainty. A table such as a .ddr is in
    specular coordinates and has no gaps: directions without a measurement are filled and listed at its top. The standard
    uncertainties of FILE.ddr are in FILE.u.ddr, on the same grid.
    """
    from goniotwin.app.campaign.journal.writing import Journal
    from goniotwin.app.campaign.reduction.export import check_files, export_format
    from goniotwin.app.campaign.reduction.export import export as export_reduced
    from goniotwin.app.campaign.reduction.reduction import reduce_journal

    form = export_format(file_format)
    if out.resolve() == journal.resolve():
        raise UserError(f"{out}: is the journal itself; choose another name")
    check_files(out, form)
    with Journal.open(journal) as opened:
        reduced = reduce_journal(opened)
    exported = export_reduced(reduced, sample, out, form, light)
    files = [str(file) for file in exported.files]
    result = {
        "file": files[0], "files": files, "format": form.name, "values": exported.values, "simulated": reduced.simulated,
    }  # fmt: skip
    mark = "SIMULATED, " if reduced.simulated else ""
    answer(as_json, result, lambda: print(f"{mark}{exported.values} measured values: {', '.join(files)}"))
