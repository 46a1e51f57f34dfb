"""The choice of values for the pictures of all kinds, and the words that name them."""

from collections.abc import Iterator, Sequence

import numpy as np

from goniotwin.app.campaign.reduction.components import COVERAGE as INTERVAL_U
from goniotwin.app.campaign.reduction.components import DRAWN_LAW, LOGARITHMIC_LAW, interval
from goniotwin.app.campaign.reduction.points import FLAGS
from goniotwin.app.data.dataset import Dataset
from goniotwin.app.errors import UserError
from goniotwin.app.figures.curves import COVERAGE, WIDEST_GAP_DEG, Curve, curve_of, plane_angle, quantity
from goniotwin.app.figures.description import Figure, Panel
from goniotwin.app.figures.hemisphere import is_half
from goniotwin.app.figures.scale import Scale, scale_of
from goniotwin.app.formats.content import FILLED, UNTRUSTED, flagged
from goniotwin.arrays import Flags, Floats, Ints

MOST_CURVES, MOST_MAPS = 7, 6
NEAR_PLANE_DEG = 1.0
"""Directions so near to the plane of incidence make a cut where none is in it."""


def one_channel(dataset: Dataset) -> Dataset:
    """The values of the middle wavelength, or of the green colour; all where there is one channel."""
    nm = np.unique(dataset.wavelength_nm[dataset.good & np.isfinite(dataset.wavelength_nm)])
    if nm.size:
        return dataset.select(wavelength_nm=float(nm[nm.size // 2]))
    names = np.unique(dataset.channel[dataset.good]).tolist()
    if len(names) > 1:
        return dataset.select(channel=next((each for each in ("green", "Y") if each in names), names[0]))
    return dataset


def one_azimuth(dataset: Dataset) -> Dataset:
    """The values of the first azimuth of the light. At normal incidence the light has none: whichever is there is taken."""
    psi, sigma = dataset.psi_deg, dataset.sigma_deg
    first = psi == psi[dataset.good & (sigma > 0.0)].min(initial=psi[dataset.good].max())
    others = (sigma == 0.0) & ~np.isin(sigma, sigma[first])
    others &= psi == psi[others].min(initial=np.inf)
    return dataset.where(first | others)


def sides(dataset: Dataset) -> Iterator[tuple[bool, bool, Dataset]]:
    """The values by the lit side and by the side that the light leaves on: whether lit on the back, whether transmitted."""
    for back in (False, True):
        for transmitted in (False, True):
            chosen = (dataset.back == back) & (dataset.transmitted == transmitted)
            if (chosen & dataset.good).any():
                yield back, transmitted, dataset.where(chosen)


def side_words(transmitted: bool, back: bool) -> str:
    """The side that light leaves on, and the lit side, in words."""
    return f"{'transmitted' if transmitted else 'reflected'}{', lit on the back' if back else ''}"


def quantity_of(dataset: Dataset) -> str:
    """The quantity of the trusted values with its unit: BSDF where they are of both sides."""
    lit = np.unique(dataset.transmitted[dataset.good])
    return quantity(bool(lit[0]) if lit.size == 1 else None, bool(dataset.back[dataset.good].all()))


def at_sigma(dataset: Dataset, sigma_deg: float) -> Dataset:
    """The values at an incidence."""
    return dataset.where(np.abs(dataset.sigma_deg - sigma_deg) < 1e-5)


def in_plane(dataset: Dataset) -> Dataset:
    """The values in the plane of incidence, or near it where none is in it. Raises UserError where none is near."""
    return dataset.where(is_in_plane(dataset))


def is_in_plane(dataset: Dataset) -> Flags:
    """Whether values (n,) are those `in_plane`. Raises UserError where none is near it."""
    return _near_plane(dataset, around_deg(dataset), "plane of incidence")


def cut_of_plane(dataset: Dataset, plane_deg: float) -> tuple[Ints, Floats]:
    """The values in a plane through the normal, and their abscissae (m,), which grow.

    `plane_deg` is its azimuth from the light's. Of an isotropic sample that was measured on one side of the plane of incidence
    the images are in it too. Raises UserError where no value is near it.
    """
    around = around_deg(dataset)
    twice = 2 if plane_deg and dataset.only.values.isotropic and is_half(around) else 1
    around = np.concatenate([around, -around])[: twice * around.size]
    index = np.tile(np.arange(dataset.size), twice)
    plane = f"plane at {plane_deg:g} deg" if plane_deg else "plane of incidence"
    here = np.flatnonzero(_near_plane(dataset.where(index), around - plane_deg, plane))
    x = plane_angle(dataset.polar_deg[index[here]], around[here], plane_deg)
    order = np.argsort(x, kind="stable")
    return index[here][order], x[order]


def _near_plane(dataset: Dataset, around: Floats, plane: str) -> Flags:
    """Whether values (n,) are in the plane at azimuth 0 of `around`; where no trusted one is, whether they are near it."""
    out = np.degrees(np.arcsin(np.minimum(np.abs(np.sin(np.radians(dataset.polar_deg)) * np.sin(np.radians(around))), 1.0)))
    in_it = out <= 1e-4
    if not (in_it & dataset.good).any():
        in_it = out <= NEAR_PLANE_DEG
    if not (in_it & dataset.good).any():
        raise UserError(
            f"{dataset.name}: no trusted value is within {NEAR_PLANE_DEG:g} deg of the {plane}; draw the hemisphere"
        )
    return np.asarray(in_it)


def around_deg(dataset: Dataset) -> Floats:
    """Azimuths (n,) of the directions from the light's."""
    return dataset.azimuth_deg - dataset.psi_deg


def abscissa(dataset: Dataset) -> Floats:
    """The abscissa of a cut (n,)."""
    return plane_angle(dataset.polar_deg, around_deg(dataset))


def scale_for(dataset: Dataset, log: bool | None) -> Scale:
    """The scale of the trusted values."""
    return scale_of(dataset.bsdf[dataset.good], dataset.u[dataset.good], log)


def band(dataset: Dataset, coverage: float = COVERAGE) -> tuple[Floats, Floats]:
    """Lower and upper ends (n,) of the values' intervals, of their law where it is stated; NaN without an uncertainty."""
    added = np.asarray(dataset.interval != LOGARITHMIC_LAW)
    with np.errstate(invalid="ignore"):
        low, high = interval(dataset.bsdf, dataset.u, added, coverage, coverage)
        drawn, wider = dataset.interval == DRAWN_LAW, coverage / INTERVAL_U
        low = np.where(drawn, dataset.bsdf + wider * (dataset.low95 - dataset.bsdf), low)
        return low, np.where(drawn, dataset.bsdf + wider * (dataset.high95 - dataset.bsdf), high)


def curve(dataset: Dataset, x: Floats, widest: float = WIDEST_GAP_DEG) -> Curve:
    """The values over `x` (n,)."""
    return curve_of(
        x,
        dataset.bsdf,
        band(dataset),
        good=dataset.good,
        # A logarithmic interval never reaches zero, however large u is.
        lost=flagged(dataset.flags, {"under-range"}) | np.asarray(dataset.bsdf <= COVERAGE * dataset.u),
        blocked=flagged(dataset.flags, {"shadowed"}),
        widest=widest,
    )


def reasons_of(drawn: Sequence[Dataset]) -> str:
    """Why values that are drawn are not to be trusted, but those that the mirror unit blocks, in words."""
    names = {name for each in drawn for text in each.flags.tolist() if "shadowed" not in text for name in text.split()}
    meanings = {FILLED: "filled, not measured", **{name: flag.meaning for name, flag in FLAGS.items()}}
    return ", ".join(meanings.get(name, name) for name in sorted(names & UNTRUSTED))


def some_of(shown: int, there: int) -> str:
    """The words for incidences of which some are shown; empty for all of them."""
    return f"{shown} of {there} incidences" if shown < there else ""


def about_curves(drawn: Sequence[Dataset], scale: Scale, more: str = "") -> str:
    """What bands and marks are, for the top of a legend; of the values that are drawn."""
    values, u = (np.concatenate([getattr(each, name)[each.good] for each in drawn]) for name in ("bsdf", "u"))
    parts = [f"bands: {_relative_u_text(values, u)}" if np.isfinite(u).any() else "no uncertainties"]
    parts += [more] if more else []
    if low := int(scale.below(values).sum()):
        negative = int((values <= 0.0).sum())
        parts.append(
            f"{low} of {values.size} values are below the scale{f', {negative} of them not above 0' if negative else ''}"
        )
    return "; ".join(parts)


def relative_u_text(dataset: Dataset) -> str:
    """The median of the expanded uncertainty of the trusted values relative to them, in words."""
    return _relative_u_text(dataset.bsdf[dataset.good], dataset.u[dataset.good])


def _relative_u_text(bsdf: Floats, u: Floats) -> str:
    with np.errstate(invalid="ignore", divide="ignore"):
        relative = COVERAGE * u / bsdf
    relative = relative[np.isfinite(relative) & (relative >= 0.0)]
    if not relative.size:
        return "no uncertainties"
    return f"U (k = {COVERAGE:g}), median {100.0 * np.median(relative):.2g} %"


def figure_of(
    dataset: Dataset, panels: Sequence[Panel], size: tuple[float, float], *, columns: int = 1, about: str = "", legend: str = ""
) -> Figure:
    """A figure with the title of its values, and the mark of simulated ones."""
    psi = np.unique(dataset.psi_deg[dataset.sigma_deg > 0.0])
    sample = f", {dataset.sample}" if dataset.sample and dataset.sample != dataset.name else ""
    more = [_channel_words(dataset), f"psi {psi[0]:g} deg" if psi.size == 1 and psi[0] else "", about]
    after = "".join(f"; {each}" for each in more if each)
    return Figure(tuple(panels), size, columns, f"{dataset.name}{sample}", after, legend, dataset.simulated)


def _channel_words(dataset: Dataset) -> str:
    nm = np.unique(dataset.wavelength_nm[np.isfinite(dataset.wavelength_nm)])
    names = [each for each in np.unique(dataset.channel).tolist() if each]
    if nm.size == 1:
        return f"{nm[0]:g} nm"
    return names[0] if len(names) == 1 else ""
