"""Pictures of a dataset, and of a comparison of two: their description (`kinds`), drawn by matplotlib."""

from collections.abc import Sequence
from importlib import import_module

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from goniotwin.app.data.comparison import DatasetComparison
from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.kinds import KINDS, comparison
from goniotwin.app.data.kinds.choice import one_azimuth
from goniotwin.app.data.opening import open_dataset
from goniotwin.app.data.values import Number, flag, quoted, with_names
from goniotwin.app.errors import UserError
from goniotwin.app.figures.description import Figure as Description
from goniotwin.app.figures.matplotlib_figure import draw
from goniotwin.app.formats.file import StrPath


@with_names
def plot(
    dataset: Dataset | DatasetComparison | StrPath,
    kind: str = "cuts",
    *,
    sigma_deg: Number | None = None,
    psi_deg: Number | None = None,
    wavelength_nm: Number | None = None,
    log: bool | None = None,
    ax: Axes | Sequence[Axes] | None = None,
) -> Figure:
    """Draw the values of one sample, of a dataset or a file, or a comparison; returns the matplotlib figure, not shown yet.

    There are four kinds. "cuts" shows the plane of incidence at each sigma, and "hemisphere" a map of all directions at each
    sigma. "polar" is a polar diagram of the plane of incidence, and "spectrum" shows some directions over the wavelength. A
    comparison has one kind: profiles and deviations of its lights. Bands show U (k = 2).

    `sigma_deg`, `psi_deg` and `wavelength_nm` choose among the values. Without them you see all sigmas (some, if there are
    many), the first psi, and the middle wavelength or the green colour. `log` chooses the scale. `ax` are axes to draw on, a
    list of them if the figure has several panels. A wrong argument raises GoniotwinError.
    """
    if isinstance(dataset, DatasetComparison):
        if kind != "cuts" or (sigma_deg, psi_deg, wavelength_nm) != (None, None, None):
            raise UserError("plot: a comparison has one kind of picture, of all its lights: give it with log and ax alone")
        return plot_comparison(dataset, log=log, ax=ax)
    return draw(describe(dataset, kind, sigma_deg, psi_deg, wavelength_nm, log), ax)


def describe(
    dataset: Dataset | StrPath,
    kind: str = "cuts",
    sigma_deg: Number | None = None,
    psi_deg: Number | None = None,
    wavelength_nm: Number | None = None,
    log: bool | None = None,
) -> Description:
    """The description of what `plot` draws of a dataset. Raises GoniotwinError."""
    given: object = kind
    if not isinstance(given, str) or given not in KINDS:
        raise UserError(f"kind: {quoted(kind)}: give one of {', '.join(map(repr, KINDS))}")
    log = flag("log", log)
    dataset = dataset if isinstance(dataset, Dataset) else open_dataset(dataset)
    chosen = dataset.select(sigma_deg=sigma_deg, psi_deg=psi_deg, wavelength_nm=wavelength_nm)
    if not chosen.good.any():
        raise UserError(f"{dataset.name}: there is no trusted value to draw")
    if psi_deg is None:
        chosen = one_azimuth(chosen)
    found: Description = import_module(f"goniotwin.app.data.kinds.{kind}").describe(chosen, log)
    return found


def plot_comparison(found: DatasetComparison, *, log: bool | None = None, ax: Axes | Sequence[Axes] | None = None) -> Figure:
    """Draw a comparison: profiles of both in the plane of incidence, with bands, and maps of z for some of its lights."""
    return draw(comparison.describe(found, flag("log", log)), ax)
