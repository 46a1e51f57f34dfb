"""Pictures of a sphere with a BSDF in a box."""

from pathlib import Path

from goniotwin.app.cli.output import answer, print_note
from goniotwin.app.data import rendering
from goniotwin.app.formats.file import check_writable
from goniotwin.app.simulation.files import write_figure


def render_spheres(first: Path | None, second: Path | None, out: Path, size: int, rays: int, seed: int, as_json: bool) -> None:
    """Render two files of tables, or figure 14 of the paper without them. Raises UserError."""
    check_writable(out)
    if first is None or second is None:
        rendering.load_mitsuba()
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
