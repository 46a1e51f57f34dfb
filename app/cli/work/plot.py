"""The picture of a journal or a file."""

from pathlib import Path
from typing import Any

from goniotwin.app.cli.output import answer, print_warning
from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.opening import open_dataset
from goniotwin.app.data.plotting import plot
from goniotwin.app.data.values import listed
from goniotwin.app.errors import UserError
from goniotwin.app.figures.matplotlib_figure import check_picture, save_figure


def plot_values(data: Path, sample: str | None, kind: str, out: Path, dpi: int, as_json: bool, **chosen: Any) -> None:
    """Draw the values that are `chosen`, as for `app.data.plotting.plot`. Raises UserError."""
    check_picture(out)
    dataset = dataset_of(data, sample)
    figure = plot(dataset, kind, **chosen)
    save_figure(figure, out, dpi)
    if chosen["psi_deg"] is None and (dataset.psi_deg != dataset.psi_deg[0]).any():
        print_warning(f"of the light's azimuths one is drawn, the first; psi: {listed(dataset.psi_deg, 'deg')} (--psi DEG)")
    result = {"file": out, "kind": kind, "sample": dataset.sample, "simulated": dataset.simulated}
    answer(as_json, result, lambda: print(f"{'SIMULATED, ' if dataset.simulated else ''}{kind}: {out}"))


def dataset_of(path: Path, sample: str | None) -> Dataset:
    """The dataset of a file, of one sample where it is chosen. Raises UserError."""
    dataset = open_dataset(path)
    if sample is not None:
        return dataset[sample]
    if len(dataset.samples) > 1:
        raise UserError(f"{path}: has several samples: {', '.join(dataset.samples)}; choose one with --sample")
    return dataset
