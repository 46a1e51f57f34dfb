"""The paper's Table 3."""

from pathlib import Path

from rich.console import Console

from goniotwin.app.cli.output import answer
from goniotwin.app.cli.work.progress import ShareProgress
from goniotwin.app.formats.file import make_folder
from goniotwin.app.simulation.paper.table3 import STEPS, compute_table3
from goniotwin.app.simulation.paper.table3_report import as_dict, print_table3, write_figures


def print_deviations(out: Path | None, as_json: bool) -> None:
    """Compute the table, print it, and write the figures into a folder. Raises UserError."""
    if out is not None:
        make_folder(out)
    done = 0

    def step(text: str) -> None:
        nonlocal done
        progress(done / STEPS, text)
        done += 1

    with ShareProgress("table 3") as progress:
        table = compute_table3(step)
        progress(1.0, "done")
    files = {name: str(path) for name, path in write_figures(table, out).items()} if out is not None else {}

    def show_all() -> None:
        print_table3(Console(highlight=False), table)
        for name, path in files.items():
            print(f"{name}: {path}")

    answer(as_json, {**as_dict(table), "files": files}, show_all)
