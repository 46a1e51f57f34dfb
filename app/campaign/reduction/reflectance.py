"""Directional-hemispherical reflectance of measured points, with its uncertainty by their covariance.

The integral of the BRDF times the cosine over the half sphere, as a sum over the measured directions, each with a weight. A row
measures a half circle through the normal; so the sum goes along each of these lines, then from line to line: linear in
between, with the first and last value held to the end. Both sides of the plane of incidence count as one. What is blocked or
beyond the last photodiode is thus continued from the directions beside it. By how much the sum misses the integral, because
directions are too far apart for the lobe, is not in its uncertainty.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from goniotwin.app.campaign.geometry.directions import polar_from_zenith
from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.reduction.etalon import ReductionSettings
from goniotwin.app.campaign.reduction.points import BsdfPoints, PointSource
from goniotwin.app.campaign.uncertainty.effects import Component, merged
from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.coordinates import HALF_TURN_DEG, fold_azimuth, round_deg

WIDEST_GAP_DEG = 60.0
"""Lines further apart in azimuth are cuts, not a half sphere."""
CHUNK_POINTS = 20_000
"""Points whose effects are in memory together."""


@dataclass(frozen=True)
class Reflectance:
    """The share of the light that is reflected (or transmitted), its components, the largest first, and its setting.

    `directions` is the number of points that it is the sum of.
    """

    wavelength_nm: float
    sigma_deg: float
    gamma_deg: float
    back: bool
    transmitted: bool
    value: float
    components: list[Component]
    directions: int

    @property
    def u(self) -> float:
        """Its standard uncertainty."""
        return float(np.sqrt(sum(each.u**2 for each in self.components)))


def reflectances(source: PointSource, settings: ReductionSettings, wavelength_nm: float | None = None) -> Iterator[Reflectance]:
    """The reflectance, and the transmittance, for each wavelength, sigma and gamma with values all around the normal."""
    for points in source.settings(wavelength_nm):
        good = points.where(points.good & ~points.mirrored)
        keys = np.stack([good.gamma_deg, good.back, good.transmitted], axis=1)
        for key in np.unique(keys, axis=0):
            chosen = good.where(np.all(keys == key, axis=1))
            lines = np.unique(round_deg(fold_azimuth(chosen.azimuth_deg)))
            if np.diff(lines, prepend=0.0, append=HALF_TURN_DEG).max() <= WIDEST_GAP_DEG:
                yield reflectance(chosen, settings)


def reflectance(points: BsdfPoints, settings: ReductionSettings) -> Reflectance:
    """The reflectance from the points of one wavelength, sigma, gamma, side and light, all with values."""
    weights = hemisphere_weights(polar_from_zenith(points.zenith_deg), points.azimuth_deg)
    parts = []
    for begin in range(0, points.size, CHUNK_POINTS):
        chosen = np.arange(begin, min(begin + CHUNK_POINTS, points.size))
        part = points.where(chosen)
        # A value of 0 has another scale in its effects; the sum of the effects is the same.
        parts.append(effects_of(part, settings).of_sum(weights[chosen]))
    return Reflectance(
        wavelength_nm=float(points.wavelength_nm[0]),
        sigma_deg=float(points.sigma_deg[0]),
        gamma_deg=float(points.gamma_deg[0]),
        back=bool(points.back[0]),
        transmitted=bool(points.transmitted[0]),
        value=float(weights @ points.bsdf),
        components=merged(parts),
        directions=points.size,
    )


def hemisphere_weights(polar_deg: Floats, azimuth_deg: Floats) -> Floats:
    """Weights (n,) in sr of directions: their sum with values is the integral of value times cosine over the half sphere.

    A direction that was measured several times counts once, with the mean.
    """
    polar, line = round_deg(polar_deg), round_deg(fold_azimuth(azimuth_deg))
    lines, which = np.unique(line, return_inverse=True)
    between = _trapezoid(np.radians(lines), np.pi)
    result = np.zeros(polar.size)
    for k, width in enumerate(between):
        here = np.flatnonzero(which == k)
        places, node, times = np.unique(polar[here], return_inverse=True, return_counts=True)
        along = _cosine_weights(np.radians(places))
        result[here] = 2.0 * width * (along / times)[node]
    return result


def _trapezoid(places: Floats, end: float) -> Floats:
    """Weights (n,) of ascending places from 0 to `end`."""
    middle = 0.5 * (places[1:] + places[:-1])
    return np.diff(np.concatenate([[0.0], middle, [end]]))


def _cosine_weights(polar: Floats) -> Floats:
    """Weights (n,) of ascending polar angles: exact for what is linear between them, times sine and cosine, to the horizon."""
    # Integrals of sin cos, and of x sin cos, from 0 to x.
    whole, first = np.sin(polar) ** 2 / 2.0, np.sin(2.0 * polar) / 8.0 - polar * np.cos(2.0 * polar) / 4.0
    result = np.zeros(polar.size)
    result[0] += whole[0]
    result[-1] += 0.5 - whole[-1]
    step = np.diff(polar)
    area, moment = np.diff(whole), np.diff(first)
    rising = (moment - polar[:-1] * area) / step
    result[1:] += rising
    result[:-1] += area - rising
    return result
