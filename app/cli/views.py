"""Commands that show data: `goniotwin plot`, `compare` and `report`."""

import os
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from goniotwin.app.cli.output import Json, answer, print_error, print_warning
from goniotwin.app.data.kinds import KINDS
from goniotwin.app.errors import UserError

if TYPE_CHECKING:  # a dataset loads numpy, which a command's help does not need
    from goniotwin.app.data.dataset import Dataset

SampleOption = Annotated[str | None, typer.Option("--sample", help="Sample, if there are several.", show_default=False)]
ScaleOption = Annotated[
    bool | None,
    typer.Option("--log/--linear", help="Scale of the values.", show_default="by their range"),
]
Dpi = Annotated[int, typer.Option("--dpi", min=50, max=1200, help="Pixels an inch, of a PNG.")]

THEORY = "theory"
MODEL = re.compile(r"[a-z-]+(:|$)")
"""The beginning of a model's text, as `simulate sample` takes it; THEORY is one too."""

app = typer.Typer()


@app.command(epilog="\n\n".join(f"{kind}: {text}" for kind, text in KINDS.items()))
def plot(
    data: Annotated[Path, typer.Argument(metavar="DATA", help="Journal, or any file that can be read.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="Picture to write: .png or .svg.", show_default=False)],
    kind: Annotated[str, typer.Option("--kind", metavar="|".join(KINDS), help="What is drawn; see below.")] = "cuts",
    sample: SampleOption = None,
    sigma: Annotated[
        list[float] | None,
        typer.Option("--sigma", metavar="DEG", help="Incidence; may be given several times.", show_default="all of them"),
    ] = None,
    psi: Annotated[
        float | None, typer.Option("--psi", metavar="DEG", help="Azimuth of the light.", show_default="the first one")
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

    Values that have no place on a logarithmic scale are marked at its lower edge.
    """
    # Loads 676 modules, numba and sqlite3 among them: 0.9 s, which help does without.
    from goniotwin.app.data.plotting import plot as draw
    from goniotwin.app.data.values import listed
    from goniotwin.app.figures.matplotlib_figure import check_picture, save_figure

    check_picture(out)
    dataset = _dataset(data, sample)
    figure = draw(dataset, kind, sigma_deg=sigma or None, psi_deg=psi, wavelength_nm=wavelength or None, log=log)
    save_figure(figure, out, dpi)
    if psi is None and (dataset.psi_deg != dataset.psi_deg[0]).any():
        print_warning(f"of the light's azimuths one is drawn, the first; psi: {listed(dataset.psi_deg, 'deg')} (--psi DEG)")
    result = {"file": out, "kind": kind, "sample": dataset.sample, "simulated": dataset.simulated}
    answer(as_json, result, lambda: print(f"{'SIMULATED, ' if dataset.simulated else ''}{kind}: {out}"))


@app.command()
def compare(
    first: Annotated[
        str, typer.Argument(metavar="A", help="Journal, file, or model such as gaussian:width_deg=5.", show_default=False)
    ],
    second: Annotated[
        str, typer.Argument(metavar="B", help="The same, or theory: the known sample of A's virtual rig.", show_default=False)
    ],
    sample: Annotated[
        list[str] | None,
        typer.Option("--sample", help="Sample, if there are several; twice for one of A and one of B.", show_default=False),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="Picture to write: .png or .svg.", show_default=False)
    ] = None,
    theta: Annotated[float, typer.Option("--theta", min=0.0, max=180.0, help="Largest theta in formula 5, deg.")] = 180.0,
    polar: Annotated[float, typer.Option("--polar", min=0.0, max=90.0, help="Largest polar angle in formula 5, deg.")] = 85.0,
    least_share: Annotated[
        float, typer.Option("--least-share", min=0.0, max=1.0, help="Least value in formula 5, of the largest one.")
    ] = 0.01,
    in_plane: Annotated[bool, typer.Option("--in-plane", help="Formula 5 in the plane of incidence alone.")] = False,
    log: ScaleOption = None,
    dpi: Dpi = 150,
    as_json: Json = False,
) -> None:
    """Compare two BSDFs: measured, simulated, or theoretical.

    The paper's formula 5 (relative RMS) with its range of directions, the deviations z in their uncertainty, and chi-square,
    light by light, in the directions of A; where B has no value there it is interpolated. A and B are journals, files of any
    format, or models. A model is evaluated in the directions of the other; "theory" is that of the virtual rig with which A was
    measured. The picture has profiles with bands, and maps of z.
    """
    # Loads 703 modules, numba and sqlite3 among them: 1.0 s, which help does without.
    from goniotwin.app.data.comparison import compare as compare_datasets
    from goniotwin.app.data.plotting import plot_comparison
    from goniotwin.app.figures.matplotlib_figure import check_picture, save_figure

    if out is not None:
        check_picture(out)
    a, b = _pair(first, second, sample or [])
    found = compare_datasets(a, b, theta_deg=theta, polar_deg=polar, least_share=least_share, in_plane=in_plane)
    result = {**found.as_dict(), "file": out, "simulated": found.simulated}
    if out is not None:
        save_figure(plot_comparison(found, log=log), out, dpi)

    def show() -> None:
        mark = "SIMULATED: " if found.simulated else ""
        print(f"{mark}{found.first.name} and {found.second.name}\n{found}")
        if out is not None:
            print(out)

    answer(as_json, result, show)


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
    """Write the report of a campaign, one HTML file.

    It needs no other file, and can be read and printed.

    What was measured, on what, how, and with which uncertainty and budget; plots; the checks of goniotwin verify and closure;
    faults and flags; the metadata; the digest of the raw data. The journal is not changed.
    """
    # Loads 680 modules, numba and sqlite3 among them: 0.9 s, which help does without.
    from goniotwin.app.data.report.report import write_report

    if not journal.name:
        raise UserError(f"{journal}: is no journal; give the path of one, NAME.journal")
    file = journal.with_suffix(".html") if out is None else out
    if os.path.realpath(file) == os.path.realpath(journal):
        raise UserError(f"{file}: is the journal itself; choose another name with --out")
    if file.suffix.lower() not in (".html", ".htm"):
        raise UserError(f"{file}: a report is an HTML file; give a name that ends with .html")
    result = write_report(journal, file, without_damaged=without_damaged)
    mark = "SIMULATED, " if result["simulated"] else ""
    answer(as_json, result, lambda: print(f"{mark}report: {file}"))
    for finding in result["findings"]:
        print_warning(finding)
    if result["fails"]:
        print_warning(f"checks that fail: {', '.join(result['fails'])}")
    if result["damaged"]:
        print_error(f"{journal}: the report is without what differs from what was measured")


def _pair(first: str, second: str, samples: list[str]) -> tuple["Dataset", "Dataset"]:
    """Two datasets, of which one may be a model: a text that is no file. Raises UserError."""
    # Loads 702 modules, numba and sqlite3 among them: 0.9 s, which help does without.
    from goniotwin.app.data.comparison import theory

    if len(samples) > 2:
        raise UserError("--sample: may be given twice, for one sample of A and one of B")
    of_first, of_second = (samples * 2)[:2] if samples else (None, None)
    models = [MODEL.match(each) is not None and not Path(each).exists() for each in (first, second)]
    if all(models):
        raise UserError(f"{first} and {second}: one of them has to be a journal or a file, whose directions are compared")
    if models[0]:
        if first == THEORY:
            raise UserError("theory: is the second of the two, for the sample of a virtual rig's journal")
        b = _named(Path(second), of_second)
        return theory(b, first), b
    a = _named(Path(first), of_first)
    if models[1]:
        return a, theory(a, None if second == THEORY else second)
    return a, _named(Path(second), of_second)


def _named(path: Path, sample: str | None) -> "Dataset":
    """A dataset with the name of its file: two campaigns of one schedule have one name."""
    return replace(_dataset(path, sample), name=path.name)


def _dataset(path: Path, sample: str | None) -> "Dataset":
    """The dataset of a file, of one sample where it is chosen. Raises UserError."""
    # Loads 675 modules, numba and sqlite3 among them: 0.8 s, which help does without.
    from goniotwin.app.data.opening import open_dataset

    dataset = open_dataset(path)
    if sample is not None:
        return dataset[sample]
    if len(dataset.samples) > 1:
        raise UserError(f"{path}: has several samples: {', '.join(dataset.samples)}; choose one with --sample")
    return dataset
