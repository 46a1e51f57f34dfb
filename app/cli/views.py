"""Commands that show data: `goniotwin plot`, `compare`, `report` and `render`."""

import os
from pathlib import Path
from typing import Annotated

import typer

from goniotwin.app.cli.output import Json, answer, print_error, print_warning
from goniotwin.app.data.kinds import KINDS
from goniotwin.app.errors import UserError

SampleOption = Annotated[str | None, typer.Option("--sample", help="Which sample, if there are several.", show_default=False)]
ScaleOption = Annotated[
    bool | None,
    typer.Option("--log/--linear", help="Scale of the values.", show_default="by their range"),
]
Dpi = Annotated[int, typer.Option("--dpi", min=50, max=1200, help="Resolution of a PNG, pixels per inch.")]

app = typer.Typer()


@app.command(epilog="\n\n".join(f"{kind}: {text}" for kind, text in KINDS.items()))
def plot(
    data: Annotated[Path, typer.Argument(metavar="DATA", help="Journal, or a file of any format.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="Picture to write: .png or .svg.", show_default=False)],
    kind: Annotated[str, typer.Option("--kind", metavar="|".join(KINDS), help="What to draw. See the list below.")] = "cuts",
    sample: SampleOption = None,
    sigma: Annotated[
        list[float] | None,
        typer.Option(
            "--sigma", metavar="DEG", help="Angle of incidence, deg. You can repeat the option.", show_default="all of them"
        ),
    ] = None,
    psi: Annotated[
        float | None, typer.Option("--psi", metavar="DEG", help="Azimuth of the light, deg.", show_default="the first one")
    ] = None,
    wavelength: Annotated[
        list[float] | None,
        typer.Option(
            "--wavelength", metavar="NM", help="Wavelength. Repeat the option for a spectrum.", show_default="the middle one"
        ),
    ] = None,
    log: ScaleOption = None,
    dpi: Dpi = 150,
    as_json: Json = False,
) -> None:
    """Draw the values of a journal or a file.

    Marks at the lower edge of a logarithmic scale show values that the scale cannot have, such as negative ones.
    """
    from goniotwin.app.cli.work.plot import plot_values

    chosen = {"sigma_deg": sigma or None, "psi_deg": psi, "wavelength_nm": wavelength or None, "log": log}
    plot_values(data, sample, kind, out, dpi, as_json, **chosen)


@app.command()
def compare(
    first: Annotated[
        str, typer.Argument(metavar="A", help="Journal, file, or model such as gaussian:width_deg=5.", show_default=False)
    ],
    second: Annotated[
        str,
        typer.Argument(
            metavar="B", help="The same, or the word theory: the known sample of A's virtual rig.", show_default=False
        ),
    ],
    sample: Annotated[
        list[str] | None,
        typer.Option("--sample", help="Which sample, if there are several. Give it twice for A and for B.", show_default=False),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="Picture to write: .png or .svg.", show_default=False)
    ] = None,
    theta: Annotated[float, typer.Option("--theta", min=0.0, max=180.0, help="Largest theta in formula 5, deg.")] = 180.0,
    polar: Annotated[float, typer.Option("--polar", min=0.0, max=90.0, help="Largest polar angle in formula 5, deg.")] = 85.0,
    least_share: Annotated[
        float,
        typer.Option("--least-share", min=0.0, max=1.0, help="Smallest value in formula 5, as a fraction of the largest."),
    ] = 0.01,
    in_plane: Annotated[bool, typer.Option("--in-plane", help="Use only the plane of incidence for formula 5.")] = False,
    log: ScaleOption = None,
    dpi: Dpi = 150,
    as_json: Json = False,
) -> None:
    """Compare two BSDFs: measured, simulated, or theoretical.

    A and B are journals, files of any format, or models. The program compares them in the directions of A, and interpolates B
    where B has no value. It evaluates a model in the directions of the other data. "theory" is the known sample of the virtual
    rig with which A was measured.

    The command prints the relative RMS (the paper's formula 5) with its range of directions, the deviations z in units of their
    uncertainty, and chi-square. Reflected and transmitted light have figures of their own. The picture has profiles with bands,
    and maps of z.
    """
    from goniotwin.app.cli.work.comparison import compare_pair

    limits = {"theta_deg": theta, "polar_deg": polar, "least_share": least_share, "in_plane": in_plane}
    compare_pair((first, second), sample or [], out, log, dpi, as_json, **limits)


@app.command()
def report(
    journal: Annotated[Path, typer.Argument(metavar="JOURNAL", help="Data file (journal) of a campaign.", show_default=False)],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="File to write: .html or .pdf.", show_default="beside the journal"),
    ] = None,
    number: Annotated[
        str, typer.Option("--number", metavar="TEXT", help="Number of the report, for each page.", show_default=False)
    ] = "",
    approved_by: Annotated[
        str, typer.Option("--approved-by", metavar="NAME", help="Person who authorises the report.", show_default=False)
    ] = "",
    without_damaged: Annotated[
        bool, typer.Option("--without-damaged", help="Leave out damaged rows. Otherwise they prevent the output.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Write the report of a campaign, one HTML file or a PDF.

    Any browser shows and prints the HTML. It needs no other file. A PDF needs WeasyPrint: pip install 'goniotwin[pdf]'. Without
    it, the program writes the HTML beside the PDF's place and ends with status 2.

    The report states what was measured and how, with the uncertainties and the budget. It has values at standard geometries,
    plots, the checks of goniotwin verify and closure, faults and flags, the metadata, and the digest of the raw data. Times are
    in this computer's time zone. The journal is not changed.
    """
    from goniotwin.app.data.report.report import PAGES, PDF, write_report

    if not journal.name:
        raise UserError(f"{journal}: is no journal; give the path of one, NAME.journal")
    file = journal.with_suffix(".html") if out is None else out
    if os.path.realpath(file) == os.path.realpath(journal):
        raise UserError(f"{file}: is the journal itself; choose another name with --out")
    if file.suffix.lower() not in (*PAGES, PDF):
        raise UserError(f"{file}: a report is HTML or a PDF; give a name that ends with .html or .pdf")
    result = write_report(journal, file, without_damaged=without_damaged, number=number, approved_by=approved_by)
    mark = "SIMULATED, " if result["simulated"] else ""
    answer(as_json, result, lambda: print(f"{mark}report: {file}"))
    for finding in result["findings"]:
        print_warning(finding)
    if result["fails"]:
        print_warning(f"checks that fail: {', '.join(result['fails'])}")
    if result["damaged"]:
        print_error(f"{journal}: the report is without what differs from what was measured")


@app.command()
def render(
    first: Annotated[Path | None, typer.Argument(metavar="A", help="Table, in any file format.", show_default=False)] = None,
    second: Annotated[Path | None, typer.Argument(metavar="B", help="Another table.", show_default=False)] = None,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="Picture to write, .png.")] = Path("render.png"),
    figure14: Annotated[
        bool, typer.Option("--figure14", help="Instead of A and B: render the Gaussians of the paper's figure 14.")
    ] = False,
    size: Annotated[int, typer.Option("--size", min=8, max=2048, help="Width and height of each picture, pixels.")] = 128,
    rays: Annotated[int, typer.Option("--rays", min=1, max=65536, help="Number of light paths for each pixel.")] = 64,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the random numbers of both pictures.")] = 1,
    as_json: Json = False,
) -> None:
    """Render a sphere with two BSDFs, and their difference.

    The sphere is in a box with checkerboard walls, under a rectangular light. The picture has three rows: the first BSDF, the
    second, and their difference. With --figure14, it has four columns: Gaussians of 2, 5, 15 and 30 deg. There the first row
    shows formula 6. The second row shows what the virtual prototype measures with the worst combination of its deviations. The
    command needs Mitsuba 3: pip install 'goniotwin[render]'.
    """
    if figure14 != (first is None and second is None) or (first is None) != (second is None):
        raise UserError("render: give two files, or --figure14 alone")
    if out.suffix.lower() != ".png":
        raise UserError(f"{out}: a picture is a PNG; give a name that ends with .png")
    from goniotwin.app.cli.work.spheres import render_spheres

    render_spheres(first, second, out, size, rays, seed, as_json)
