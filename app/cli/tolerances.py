"""The command `goniotwin tolerances`: the paper's section 3.3 for a study file."""

from pathlib import Path
from typing import Annotated

import typer

from goniotwin.app.cli.output import Json, answer

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)


@app.command()
def tolerances(
    study: Annotated[Path, typer.Argument(metavar="FILE.toml", help="Study file (docs/tolerances.md).", show_default=False)],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Folder for the figure and the tables as CSV.", show_default=False),
    ] = None,
    as_json: Json = False,
) -> None:
    """Find the tolerances of the instrument.

    Each deviation alone, all combinations, limits with which none fails; the yield, the worst corner, sensitivities, and what
    remains about the measured peak (the paper's section 3.3, Tables 1 and 2). Everything is computed on the optical twin.
    """
    # Loads 779 modules, numba and matplotlib among them: 0.9 s, which help does without.
    from rich.console import Console

    from goniotwin.app.cli.progress import ShareProgress
    from goniotwin.app.formats.file import make_folder
    from goniotwin.app.simulation.tolerances.report import as_dict, print_study, write_report
    from goniotwin.app.simulation.tolerances.result import compute_study
    from goniotwin.app.simulation.tolerances.study import read_study

    file = read_study(study)
    if out is not None:
        make_folder(out)
    with ShareProgress("tolerances") as progress:
        result = compute_study(file, progress)
    files = write_report(result, out, study.stem) if out is not None else {}

    def show() -> None:
        print_study(Console(highlight=False), result)
        for name, path in files.items():
            print(f"{name}: {path}")

    answer(as_json, {"file": study, **as_dict(result), "files": files}, show)
