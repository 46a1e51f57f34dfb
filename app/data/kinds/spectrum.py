"""The spectrum: some directions over the wavelength, at the middle sigma."""

import math
from collections.abc import Iterator

import numpy as np

from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.kinds.choice import about_curves, at_sigma, curve, figure_of, reasons_of, scale_for, sides
from goniotwin.app.errors import UserError
from goniotwin.app.figures.curves import curve_panel, curve_parts, quantity
from goniotwin.app.figures.description import Axis, Figure
from goniotwin.app.figures.style import CURVE_COLOURS, CURVE_SYMBOLS
from goniotwin.twin.optics.geometry.coordinates import round_deg

SHOWN_THETA_DEG = (0.0, 10.0, 30.0, 60.0)
"""The directions nearest to these aspecular angles are shown."""


def describe(dataset: Dataset, log: bool | None) -> Figure:
    """The description of the spectra, a panel for each side. Raises UserError for values of one wavelength."""
    wavelengths = np.unique(dataset.wavelength_nm[dataset.good & np.isfinite(dataset.wavelength_nm)])
    if wavelengths.size < 2:
        has = f"only {wavelengths[0]:g} nm" if wavelengths.size else "no wavelengths"
        raise UserError(f"{dataset.name}: a spectrum needs values at two wavelengths at least, and it has {has}")
    panels = []
    for back, transmitted, side in sides(dataset):
        sigmas = np.unique(side.sigma_deg[side.good])
        sigma = float(sigmas[sigmas.size // 2])
        here = at_sigma(side, sigma)
        scale = scale_for(here, log)
        drawn = list(_directions(here))
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
        legend = f"sigma {sigma:g} deg; {about_curves(drawn, scale)}"
        axis, of = Axis("wavelength, nm"), quantity(transmitted, back)
        panels.append(curve_panel(parts, scale, axis, of, legend=legend, reasons=reasons_of(drawn)))
    return figure_of(dataset, panels, (8.0, 1.0 + 3.8 * len(panels)))


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
