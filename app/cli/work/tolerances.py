"""The tolerances of the instrument, from a study file."""

from pathlib import Path

from rich.console import Console

from goniotwin.app.cli.output import answer
from goniotwin.app.cli.work.progress import ShareProgress
from goniotwin.app.formats.file import make_folder
from goniotwin.app.simulation.tolerances.report import as_dict, print_study, write_report
from goniotwin.app.simulation.tolerances.result import compute_study
from goniotwin.app.simulation.tolerances.study import read_study


def print_tolerances(study: Path, out: Path | None, as_json: bool) -> None:
    """Compute a study, print it, and write its figure and tables into a folder. Raises UserError."""
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
