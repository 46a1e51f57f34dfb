"""The spectrum: some directions over the wavelength, at the middle sigma."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.kinds.choice import about_curves, at_sigma, curve, figure_of, reasons_of, scale_for, sides
from goniotwin.app.errors import UserError
from goniotwin.app.figures.curves import curve_panel, curve_parts, quantity
from goniotwin.app.figures.description import Axis, Figure, Panel
from goniotwin.app.figures.scale import Scale
from goniotwin.app.figures.style import CURVE_COLOURS, CURVE_SYMBOLS
from goniotwin.twin.optics.geometry.coordinates import from_specular, round_deg

SHOWN_THETA_DEG = (0.0, 10.0, 30.0, 60.0)
"""The directions nearest to these aspecular angles are shown."""
NEAR_DEG = 1.0
"""Directions of two wavelengths that are no further apart are one direction of a spectrum."""


def describe(dataset: Dataset, log: bool | None) -> Figure:
    """The description of the spectra, a panel for each side. Raises UserError for values of one wavelength."""
    wavelengths = np.unique(dataset.wavelength_nm[dataset.good & np.isfinite(dataset.wavelength_nm)])
    if wavelengths.size < 2:
        has = f"only {wavelengths[0]:g} nm" if wavelengths.size else "no wavelengths"
        raise UserError(f"{dataset.name}: a spectrum needs values at two wavelengths at least, and it has {has}")
    panels = []
    for _, _, side in sides(dataset):
        sigmas = np.unique(side.sigma_deg[side.good])
        sigma = float(sigmas[sigmas.size // 2])
        here = at_sigma(side, sigma)
        panels.append(_panel(list(_directions(here)), scale_for(here, log)))
    return figure_of(dataset, panels, (8.0, 1.0 + 3.8 * len(panels)))


def describe_at(dataset: Dataset, theta_deg: float, phi_deg: float) -> Panel:
    """The spectrum in a direction, of values of one incidence and side; of each wavelength the nearest one within NEAR_DEG.

    Raises UserError where fewer than two wavelengths have one.
    """
    apart = np.linalg.norm(
        from_specular(0.0, dataset.theta_deg, dataset.phi_deg) - from_specular(0.0, theta_deg, phi_deg), axis=1
    )
    near = dataset.good & np.isfinite(dataset.wavelength_nm) & (apart <= math.radians(NEAR_DEG))
    order = np.flatnonzero(near)[np.argsort(apart[near], kind="stable")]
    wavelengths, first = np.unique(dataset.wavelength_nm[order], return_index=True)
    if wavelengths.size < 2:
        raise UserError(f"{dataset.name}: there are values of one wavelength in this direction, so there is no spectrum")
    here = dataset.where(order[first])
    return _panel([here], scale_for(here, None))


def _panel(drawn: Sequence[Dataset], scale: Scale) -> Panel:
    """The spectra of some directions, of one incidence and side."""
    parts = [
        curve_parts(
            curve(each, each.wavelength_nm, math.inf),
            scale,
            colour,
            f"theta {each.theta_deg[0]:.3g}, phi {each.phi_deg[0]:.3g} deg",
            symbol,
        )
        for each, colour, symbol in zip(drawn, CURVE_COLOURS, CURVE_SYMBOLS, strict=False)
    ]
    light = drawn[0].only.lights[0]
    legend = f"sigma {light.sigma_deg:g} deg; {about_curves(drawn, scale)}"
    of = quantity(light.transmitted, light.back)
    return curve_panel(parts, scale, Axis("wavelength, nm"), of, legend=legend, reasons=reasons_of(drawn))


def _directions(dataset: Dataset) -> Iterator[Dataset]:
    """The values over the wavelength in the directions nearest to SHOWN_THETA_DEG that have most wavelengths, each once."""
    keys = round_deg(np.stack([dataset.theta_deg, np.where(dataset.theta_deg == 0.0, 0.0, dataset.phi_deg)], axis=1))
    places, which = np.unique(keys, axis=0, return_inverse=True)
    pairs = np.unique(np.stack([which.ravel(), round_deg(dataset.wavelength_nm)], axis=1)[dataset.good], axis=0)
    counts = np.bincount(pairs[:, 0].astype(np.int64), minlength=len(places))
    whole = np.flatnonzero(counts == counts.max())
    taken = dict.fromkeys(int(whole[np.argmin(np.abs(places[whole, 0] - theta))]) for theta in SHOWN_THETA_DEG)
    for each in taken:
        here = dataset.where((which.ravel() == each) & dataset.good)
        yield here.where(np.unique(here.wavelength_nm, return_index=True)[1])
