"""The response of the whole instrument: a Gaussian sample against its formula (paper, formula 5), and its measured peak."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.simulation.paper.gaussian_cut import (
    HIGHEST_ZENITH_DEG,
    gaussian_theory,
    in_plane_directions,
    in_plane_theta,
    relative_deviation,
)
from goniotwin.app.simulation.tolerances.study import GaussianTable, Parameter, component_matrix
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Instrument, Pose, Scenes, Surrogate, from_specular, gaussian
from goniotwin.twin.optics.geometry.coordinates import polar_and_azimuth
from goniotwin.twin.optics.geometry.instrument import COMPONENTS, ELEMENTS, deviation_mapping


@dataclass(frozen=True, eq=False)
class Directions:
    """Directions at one sigma: aspecular angles in and across the plane of incidence `place_deg` (n, 2), and `axes` (n, 3)."""

    sigma_deg: float
    place_deg: Floats
    axes: Floats


def directions_of(criterion: GaussianTable) -> list[Directions]:
    """The range of i, one for each sigma."""
    found = []
    for sigma in criterion.sigma_deg:
        theta = in_plane_theta(sigma, criterion.width_deg, criterion.widths, criterion.step_deg)
        if criterion.directions == "plane":
            found.append(Directions(sigma, np.stack([theta, 0.0 * theta], axis=1), in_plane_directions(sigma, theta)))
            continue
        reach = criterion.widths * criterion.width_deg
        line = criterion.step_deg * np.arange(-math.floor(reach / criterion.step_deg + 1e-9), reach / criterion.step_deg + 0.5)
        place = np.array([(u, v) for u in line for v in line if math.hypot(u, v) <= reach + 1e-9])
        polar, azimuth = polar_and_azimuth(np.hypot(*place.T), np.degrees(np.arctan2(place[:, 1], place[:, 0])))
        axes = from_specular(sigma, polar, azimuth)
        seen = axes[:, 2] > math.cos(math.radians(HIGHEST_ZENITH_DEG)) + 1e-12
        found.append(Directions(sigma, place[seen], axes[seen]))
    return found


class GaussianLobe:
    """Luminance factors of a Gaussian as the instrument with deviations measures it, exactly, by the fast estimator.

    `parameters` are the deviations, in the order of the columns of `values` (n, k), deg or mm. Residuals are the relative
    deviations of formula 5, over all sigmas and directions (m,).
    """

    def __init__(self, instrument: Instrument, criterion: GaussianTable, parameters: Sequence[Parameter]) -> None:
        self.instrument, self.criterion, self.parameters = instrument, criterion, tuple(parameters)
        self.directions = directions_of(criterion)
        self._matrix = component_matrix(parameters, ELEMENTS)
        poses = [Pose(each.sigma_deg, each.axes) for each in self.directions]
        self.sample = gaussian(criterion.width_deg, criterion.form, peak=1.0 / math.pi)
        self.scenes = Scenes(instrument, poses, [self.sample])
        self.theory = np.concatenate([self._theory(np.hypot(*each.place_deg.T)) for each in self.directions])
        self._peaks = [_peak_fit(each.place_deg, self._theory(np.hypot(*each.place_deg.T))) for each in self.directions]

    def deviations(self, values: Floats) -> Floats:
        """Components (n, elements, 6) of the instrument's elements, in the order of `ELEMENTS` and of `Deviation`."""
        return np.asarray((values @ self._matrix).reshape(len(values), len(ELEMENTS), len(COMPONENTS)))

    def with_deviations(self, values: Floats) -> Instrument:
        """The instrument with one combination (k,)."""
        return replace(self.instrument, deviations=deviation_mapping(self.deviations(values[None])[0]))

    def factors(self, values: Floats) -> Floats:
        """Luminance factors (n, m) of combinations (n, k). NaN where the etalon gives no signal."""
        return self.scenes.ratios(self.deviations(values))[:, 0, 0]

    def residuals(self, values: Floats) -> Floats:
        """Relative deviations (n, m) from the formula about the nominal specular direction."""
        return relative_deviation(self.factors(values), self.theory)

    def peaks(self, factors: Floats) -> tuple[Floats, Floats]:
        """Place (n, sigmas, 2) of the measured peak, deg in and across the plane of incidence, and its height (n, sigmas).

        The vertex of a paraboloid through the logarithms of luminance factors (n, m), each with the weight of its value.
        Directions in the plane alone give no place across it: zero.
        """
        places, heights, first = [], [], 0
        for fit, each in zip(self._peaks, self.directions, strict=True):
            piece = factors[:, first : first + len(each.place_deg)]
            first += len(each.place_deg)
            # A value of zero has no logarithm: where a direction has no light, there is no peak.
            logarithm = np.log(np.where(piece > 0.0, piece, np.nan))
            height, along, across, bend = (logarithm @ fit.T).T
            place = np.stack([along, across], axis=1) / (-2.0 * bend[:, None])
            places.append(place)
            heights.append(np.exp(height - bend * np.sum(place**2, axis=1)))
        return np.stack(places, axis=1), np.stack(heights, axis=1)

    def recentred(self, values: Floats) -> Floats:
        """Relative deviations (n, m) from the formula about the measured peak."""
        factors = self.factors(values)
        places, _ = self.peaks(factors)
        theory = []
        for k, each in enumerate(self.directions):
            offset = each.place_deg[None] - places[:, k, None]
            theory.append(self._theory(np.hypot(offset[..., 0], offset[..., 1])))
        return relative_deviation(factors, np.concatenate(theory, axis=1))

    def _theory(self, theta_deg: Floats) -> Floats:
        return gaussian_theory(theta_deg, self.criterion.width_deg, self.criterion.form)


class LobeSurrogate:
    """The criterion of a lobe to the second order of its deviations, fitted to exact values at their limits (k,).

    Raises ValueError for directions without light.
    """

    def __init__(self, lobe: GaussianLobe, limits: Floats) -> None:
        self._limits, self._theory = limits, lobe.theory
        self._surrogate = Surrogate(lobe.scenes, lobe.deviations(np.diag(limits)))

    def percents(self, blocks: Iterable[Floats]) -> Iterator[Floats]:
        """The criterion (n,) of each block of combinations (n, k)."""
        factors = (values / self._limits for values in blocks)
        return (100.0 * found for found in self._surrogate.relative_rms(factors, self._theory))


class Recentred:
    """The response of a lobe relative to its measured peak."""

    def __init__(self, lobe: GaussianLobe) -> None:
        self._lobe = lobe

    def residuals(self, values: Floats) -> Floats:
        """Relative deviations (n, m) about the measured peak."""
        return self._lobe.recentred(values)


def _peak_fit(place_deg: Floats, weights: Floats) -> Floats:
    """Matrix (4, n) from logarithms at places (n, 2) to height, slopes and bend of a paraboloid, by weighted least squares."""
    along, across = place_deg.T
    columns = np.stack([np.ones_like(along), along, across, along**2 + across**2], axis=1)
    used = [0, 1, 2, 3] if np.ptp(across) else [0, 1, 3]
    fit = np.zeros((4, len(along)))
    fit[used] = np.linalg.pinv(columns[:, used] * weights[:, None]) * weights
    return fit
