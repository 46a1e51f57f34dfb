"""The comparison of two BSDFs."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from goniotwin.app.cli.output import answer
from goniotwin.app.cli.work.plot import dataset_of
from goniotwin.app.data.comparison import THEORY, compare, is_model, theory
from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.plotting import plot_comparison
from goniotwin.app.errors import UserError
from goniotwin.app.figures.matplotlib_figure import check_picture, save_figure


def compare_pair(
    names: tuple[str, str], samples: list[str], out: Path | None, log: bool | None, dpi: int, as_json: bool, **limits: Any
) -> None:
    """Compare journals, files or a model within `limits`, as for `app.data.comparison.compare`. Raises UserError."""
    if out is not None:
        check_picture(out)
    a, b = _pair(*names, samples)
    found = compare(a, b, **limits)
    result = {**found.as_dict(), "file": out, "simulated": found.simulated}
    if out is not None:
        save_figure(plot_comparison(found, log=log), out, dpi)

    def show() -> None:
        mark = "SIMULATED: " if found.simulated else ""
        print(f"{mark}{found.first.name} and {found.second.name}\n{found}")
        if out is not None:
            print(out)

    answer(as_json, result, show)


def _pair(first: str, second: str, samples: list[str]) -> tuple[Dataset, Dataset]:
    """Two datasets, of which one may be a model: a text that is no file. Raises UserError."""
    if len(samples) > 2:
        raise UserError("--sample: may be given twice, for one sample of A and one of B")
    of_first, of_second = (samples * 2)[:2] if samples else (None, None)
    models = [is_model(each) for each in (first, second)]
    if all(models):
        raise UserError(f"{first} and {second}: one of them has to be a journal or a file, whose directions are compared")
    if models[0]:
        if first == THEORY:
            raise UserError("theory: is the second of the two, for the sample of a virtual rig's journal")
        b = _named(Path(second), of_second)
        return theory(b, first), b
    a = _named(Path(first), of_first)
    if models[1]:
        if second == THEORY:
            return a, theory(a)
        try:
            return a, theory(a, second)
        except UserError as error:
            raise UserError(f"{error}. Or give a file, or {THEORY}: the sample of a virtual rig's journal") from None
    return a, _named(Path(second), of_second)


def _named(path: Path, sample: str | None) -> Dataset:
    """A dataset with the name of its file: two campaigns of one schedule have one name."""
    return replace(dataset_of(path, sample), name=path.name)
