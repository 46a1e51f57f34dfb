"""The command `goniotwin render`: a sphere with a BSDF in a box, by Mitsuba 3, and figure 14 of the paper."""

from pathlib import Path
from typing import Annotated

import typer

from goniotwin.app.cli.output import Json, answer, print_note
from goniotwin.app.errors import UserError

app = typer.Typer()


@app.command()
def render(
    first: Annotated[
        Path | None, typer.Argument(metavar="A", help="File of a table, of any format.", show_default=False)
    ] = None,
    second: Annotated[Path | None, typer.Argument(metavar="B", help="File of another table.", show_default=False)] = None,
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="Picture to write, .png.")] = Path("render.png"),
    figure14: Annotated[
        bool, typer.Option("--figure14", help="Instead of A and B: the paper's Gaussians, and as the prototype measures them.")
    ] = False,
    size: Annotated[int, typer.Option("--size", min=8, max=2048, help="Pixels of a side of each picture.")] = 128,
    rays: Annotated[int, typer.Option("--rays", min=1, max=65536, help="Paths of each pixel.")] = 64,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the random numbers, the same for both.")] = 1,
    as_json: Json = False,
) -> None:
    """Render a sphere with either of two BSDFs, and the difference.

    The sphere is in a box with walls of a checkerboard, under a rectangular light. With --figure14 there are four columns:
    Gaussians of 2, 5, 15 and 30 deg by formula 6 above, as the virtual prototype with the worst combination of its deviations
    measures them below. Needs Mitsuba 3: pip install 'goniotwin[render]'.
    """
    if figure14 != (first is None and second is None) or (first is None) != (second is None):
        raise UserError("render: give two files, or --figure14 alone")
    if out.suffix.lower() != ".png":
        raise UserError(f"{out}: a picture is a PNG; give a name that ends with .png")
    # Loads 902 modules, numba and matplotlib among them: 1.4 s, which help does without.
    from goniotwin.app.data import rendering
    from goniotwin.app.formats.file import check_writable
    from goniotwin.app.simulation.files import write_figure

    check_writable(out)
    if figure14:
        rendering.load_mitsuba()
    if first is None or second is None:
        pairs = rendering.figure14(print_note, size, rays, seed)
        names = ("theory", "measured (SIMULATED)")
    else:
        one, other = (rendering.read_table(path) for path in (first, second))
        rendering.load_mitsuba()
        pairs = [rendering.render_pair(one, other, f"{first.stem}, {second.stem}", size, rays, seed)]
        marks = (" (SIMULATED)" if table.generated else "" for table in (one, other))
        names = (f"{first.name}{next(marks)}", f"{second.name}{next(marks)}")
    write_figure(rendering.picture(pairs, names), out, 150)
    figures = [pair.figures for pair in pairs]

    def show() -> None:
        print(f"{out}: {names[0]}, {names[1]}")
        for each in figures:
            one, other = ("not known" if value is None else f"{value:.3f}" for value in each.reflectances)
            difference = f"the difference is {each.rms_percent_of_white:.2g} % of white (RMS)"
            print(f"{each.title}: {difference}; reflectances at the first sigma: {one}, {other}")

    answer(as_json, {"file": out, "variant": rendering.VARIANT, "of": names, "pairs": figures}, show)
