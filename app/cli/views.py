"""Commands that show data: `goniotwin plot`, `compare` and `report`."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from goniotwin.app.cli.output import Json, answer, print_error, print_warning
from goniotwin.app.errors import UserError

if TYPE_CHECKING:  # a dataset loads numpy, which a command's help does not need
    from goniotwin.app.data.dataset import Dataset

SampleOption = Annotated[str | None, typer.Option("--sample", help="Sample, if there are several.", show_default=False)]
ScaleOption = Annotated[
    bool | None,
    typer.Option("--log/--linear", help="Scale of the values.", show_default="by their range"),
]
Dpi = Annotated[int, typer.Option("--dpi", min=50, max=1200, help="Pixels an inch, of a PNG.")]

app = typer.Typer()


@app.command()
def plot(
    data: Annotated[Path, typer.Argument(metavar="DATA", help="Journal, or any file that can be read.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="Picture to write: .png or .svg.", show_default=False)],
    kind: Annotated[
        Literal["cuts", "hemisphere", "polar", "spectrum"], typer.Option("--kind", help="What is drawn; see above.")
    ] = "cuts",
    sample: SampleOption = None,
    sigma: Annotated[
        list[float] | None,
        typer.Option("--sigma", metavar="DEG", help="Incidence; may be given several times.", show_default="all of them"),
    ] = None,
    wavelength: Annotated[
        list[float] | None,
        typer.Option("--wavelength", metavar="NM", help="Wavelength; several for a spectrum.", show_default="the middle one"),
    ] = None,
    log: ScaleOption = None,
    dpi: Dpi = 150,
    as_json: Json = False,
) -> None:
    """Draw the values of a journal or a file.

    cuts: the plane of incidence, with bands of two standard uncertainties. hemisphere: a map of all directions for each
    incidence. polar: the plane of incidence as a polar diagram. spectrum: some directions over the wavelength. Values that
    have no place on a logarithmic scale are marked at its lower edge.
    """
    from goniotwin.app.data.plotting import check_picture, save_figure
    from goniotwin.app.data.plotting import plot as draw

    check_picture(out)
    dataset = _dataset(data, sample)
    save_figure(draw(dataset, kind, sigma_deg=sigma or None, wavelength_nm=wavelength or None, log=log), out, dpi)
    result = {"file": str(out), "kind": kind, "sample": dataset.sample, "simulated": dataset.simulated}
    answer(as_json, result, lambda: print(f"{'SIMULATED, ' if dataset.simulated else ''}{kind}: {out}"))


@app.command()
def report(
    journal: Annotated[Path, typer.Argument(metavar="JOURNAL", help="Data file (journal) of a campaign.", show_default=False)],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE.html", help="File to write.", show_default="beside the journal")
    ] = None,
    without_damaged: Annotated[
        bool, typer.Option("--without-damaged", help="Leave out the rows that are damaged, instead of writing nothing.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Write the report of a campaign: one HTML file that needs no other, to be read or printed.

    What was measured, on what, how, and with which uncertainty and budget; plots; the checks of goniotwin verify and closure;
    faults and flags; the metadata; the digest of the raw data. The journal is not changed.
    """
    from goniotwin.app.data.report.report import write_report

    file = journal.with_suffix(".html") if out is None else out
    if os.path.realpath(file) == os.path.realpath(journal):
        raise UserError(f"{file}: is the journal itself; choose another name with --out")
    result = write_report(journal, file, without_damaged=without_damaged)
    mark = "SIMULATED, " if result["simulated"] else ""
    answer(as_json, result, lambda: print(f"{mark}report: {file}"))
    for finding in result["findings"]:
        print_warning(finding)
    if result["fails"]:
        print_warning(f"checks that fail: {', '.join(result['fails'])}")
    if result["damaged"]:
        print_error(f"{journal}: the report is without what differs from what was measured")


def _dataset(path: Path, sample: str | None) -> "Dataset":
    """The dataset of a file, of one sample where it is chosen. Raises UserError."""
    from goniotwin.app.data.opening import open_dataset

    dataset = open_dataset(path)
    if sample is not None:
        return dataset[sample]
    if len(dataset.samples) > 1:
        raise UserError(f"{path}: has several samples: {', '.join(dataset.samples)}; choose one with --sample")
    return dataset
