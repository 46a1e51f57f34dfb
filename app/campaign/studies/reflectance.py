"""Directional-hemispherical reflectance (or transmittance) of measured values: a sum with weights, so that its u follows.

The integral of f cos(theta) over the half sphere that an arc looks at. On rings of one polar angle f is interpolated linearly
over the azimuth, between rings linearly over the polar angle; cos(theta) sin(theta) is integrated exactly, so that a constant f
has no error. Directions without a value stand for their neighbours on the ring, and the outermost ring for all beyond it:
what these add is stated apart.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np

from goniotwin.app.campaign.geometry.directions import polar_from_zenith, round_azimuth
from goniotwin.app.campaign.measurement_model.effects import Component, merged
from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.settings import ReductionSettings
from goniotwin.app.campaign.schedule.refinement import StatedSymmetry
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import fold_azimuth, round_deg

WIDEST_AZIMUTH_DEG, WIDEST_POLAR_DEG, LEAST_POLAR_DEG = 60.0, 15.0, 60.0
"""Measured directions further apart than these, or none beyond the last, are no half sphere."""
EQUAL_SHARE = 1e-9
CHUNK_POINTS = 20_000
"""Points whose effects are in memory together."""
RICHARDSON = 3.0
"""A rule of second order with half of the nodes is off by four times as much: their difference is three errors. On a lobe that
is not resolved it is less: the error counts up to twice as much, the larger the difference is against the sum.
"""


@dataclass(frozen=True)
class Quadrature:
    """Weights (n,) in sr of the values of one setting: their sum with the values is the reflectance.

    `obstructed` and `extrapolated` are the parts of the weights that stand for directions without a value, and beyond the
    outermost ring. `coarse` (2, 2, n) are the weights of rules with half of the azimuths, and with half of the rings: with
    either half. `hemisphere`: whether the measured directions cover a half sphere closely enough.
    """

    weight: Floats
    obstructed: Floats
    extrapolated: Floats
    coarse: Floats
    hemisphere: bool

    def interpolation_error(self, value: Floats) -> float:
        """The estimated error of the interpolation, in the unit of the sum: of azimuths and rings, by the worse half of each.

        With half of both at once their errors may cancel: on a lobe that neither resolves they have opposite signs.
        """
        used = self.weight != 0.0
        total = abs(float(self.weight[used] @ value[used]))
        change = float(np.abs((self.coarse - self.weight)[..., used] @ value[used]).max(axis=1).sum())
        return change * (1.0 + change / max(total, change)) / RICHARDSON if change else 0.0


class MeasuredRings(Protocol):
    """Directions of values (n,), and which of the values count."""

    @property
    def zenith_deg(self) -> Floats:
        """Angle from the normal of the front."""

    @property
    def azimuth_deg(self) -> Floats:
        """Azimuth from the half plane of the light."""

    @property
    def good(self) -> Flags:
        """The trusted values."""


@dataclass(frozen=True)
class Setting:
    """What one reflectance is of: values `index` with one wavelength, sigma, gamma and light."""

    wavelength_nm: float
    sigma_deg: float
    gamma_deg: float
    transmitted: bool
    index: Ints

    def __str__(self) -> str:
        gamma = f", gamma {self.gamma_deg:g}" if self.gamma_deg else ""
        return f"{self.wavelength_nm:g} nm, sigma {self.sigma_deg:g}{gamma} deg{', transmitted' if self.transmitted else ''}"


def integration_settings(points: BsdfPoints) -> Iterator[Setting]:
    """The settings of points that have good values."""
    keys = round_deg(np.stack([points.wavelength_nm, points.sigma_deg, points.gamma_deg, points.transmitted], axis=1))
    places, which = np.unique(keys, axis=0, return_inverse=True)
    good = points.good
    for k, (wavelength, sigma, gamma, transmitted) in enumerate(places.tolist()):
        index = np.flatnonzero(which.ravel() == k)
        if good[index].any():
            yield Setting(wavelength, sigma, gamma, bool(transmitted), index)


def quadrature(points: MeasuredRings, symmetry: StatedSymmetry) -> Quadrature:
    """The weights of points of one setting; an isotropic sample has the same values on both sides of the plane of incidence."""
    polar = round_deg(polar_from_zenith(points.zenith_deg))
    folded = symmetry == "isotropic"
    azimuth = round_deg(fold_azimuth(points.azimuth_deg)) if folded else round_azimuth(points.azimuth_deg)
    azimuth = np.where(polar == 0.0, 0.0, azimuth)
    rings, ring = np.unique(polar, return_inverse=True)
    good = points.good
    on_ring = [np.flatnonzero(ring == k) for k in range(rings.size)]
    shares = [_azimuth_shares(azimuth[here], good[here], folded) for here in on_ring]
    gaps = np.where(rings > 0.0, [gap for _, _, gap in shares], 0.0)
    with_value = np.array([bool(good[here].any()) for here in on_ring])
    # A few directions outside the rings of a campaign, as those of an overlap or near the specular direction, are no ring.
    dense = gaps <= WIDEST_AZIMUTH_DEG
    if np.count_nonzero(with_value & dense) < 2:
        dense[:] = True
    with_value &= dense
    all_rings, inside, beyond = np.zeros(rings.size), np.zeros(rings.size), np.zeros(rings.size)
    all_rings[dense], _ = _ring_weights(rings[dense])
    inside[with_value], beyond[with_value] = _ring_weights(rings[with_value])
    weight, obstructed, extrapolated = (np.zeros(polar.size) for _ in range(3))
    for k in np.flatnonzero(with_value).tolist():
        here, (own, filled, _) = on_ring[k], shares[k]
        weight[here] = (inside[k] + beyond[k]) * (own + filled)
        extrapolated[here] = beyond[k] * (own + filled)
        obstructed[here] = inside[k] * filled + max(inside[k] - all_rings[k], 0.0) * own
    widest = float(gaps[with_value].max(initial=0.0))
    known = rings[with_value]
    apart = float(np.diff(known).max(initial=0.0))
    return Quadrature(
        weight,
        obstructed,
        extrapolated,
        _coarse(rings, ring, azimuth, good & with_value[ring], folded),
        known.size > 1 and covers_half_sphere(apart, widest, float(np.cos(np.radians(known[-1])) ** 2)),
    )


def covers_half_sphere(polar_step_deg: float, azimuth_step_deg: float, beyond: float) -> bool:
    """Whether directions are close enough for an integral over the half sphere, by their widest steps.

    `beyond` is the share of the projected solid angle that is beyond the outermost ring, or beyond the last theta of a table.
    """
    close = polar_step_deg <= WIDEST_POLAR_DEG and azimuth_step_deg <= WIDEST_AZIMUTH_DEG
    return close and beyond <= math.cos(math.radians(LEAST_POLAR_DEG)) ** 2 + EQUAL_SHARE


def components_of_sum(
    points: BsdfPoints, weight: Floats, settings: ReductionSettings, at_once: int = CHUNK_POINTS
) -> list[Component]:
    """The components of sum(weight * bsdf), the largest first, by the covariance of the points with a weight.

    So many points are in memory `at_once`, with their effects.
    """
    used = np.flatnonzero(weight != 0.0)
    parts = []
    for begin in range(0, used.size, at_once):
        chosen = used[begin : begin + at_once]
        parts.append(effects_of(points.where(chosen), settings).of_sum(weight[chosen]))
    return merged(parts)


def _coarse(rings: Floats, ring: Ints, azimuth: Floats, good: Flags, folded: bool) -> Floats:
    """The weights (2, 2, n) with either half of the azimuths of each ring, and with either half of the rings.

    The outermost ring is in both halves: without it the weights would differ by what they extrapolate.
    """
    result = np.zeros((2, 2, azimuth.size))
    inwards = np.unique(ring[good])[::-1]
    of_all, halves = _totals(rings, inwards), [inwards[::2], np.append(inwards[:1], inwards[1::2])]
    of_half = [_totals(rings, each) for each in halves]
    for k in inwards.tolist():
        here = np.flatnonzero((ring == k) & good)
        nodes, every = np.unique(azimuth[here]), np.ones(here.size, dtype=bool)
        for half in (0, 1):
            some = nodes[half::2]
            kept = np.isin(azimuth[here], some) if some.size else every
            for result_of, total, chosen in ((result[0, half], of_all[k], kept), (result[1, half], of_half[half][k], every)):
                own, filled, _ = _azimuth_shares(azimuth[here], chosen, folded)
                result_of[here] = total * (own + filled)
    return result


def _totals(rings: Floats, chosen: Ints) -> Floats:
    """The weight of each of the rings, where only the chosen ones are used."""
    result, ordered = np.zeros(rings.size), np.sort(chosen)
    inside, beyond = _ring_weights(rings[ordered])
    result[ordered] = inside + beyond
    return result


def _ring_weights(rings_deg: Floats) -> tuple[Floats, Floats]:
    """Integrals of cos sin over the polar angle of the piecewise linear functions that are 1 on one ring and 0 on all others.

    Second: what the innermost ring has inside of it and the outermost one beyond it, up to 90 deg.
    """
    at = np.radians(rings_deg)
    weight, beyond = np.zeros(at.size), np.zeros(at.size)
    if at.size:
        plain = 0.5 * np.sin(at) ** 2  # integral of cos sin, and of the angle times cos sin
        first = 0.125 * np.sin(2.0 * at) - 0.25 * at * np.cos(2.0 * at)
        width = np.diff(at)
        rising = (np.diff(first) - at[:-1] * np.diff(plain)) / np.where(width == 0.0, 1.0, width)
        weight[1:] += rising
        weight[:-1] += np.diff(plain) - rising
        weight[0] += plain[0]
        beyond[-1] = 0.5 - plain[-1]
    return weight, beyond


def _azimuth_shares(azimuth_deg: Floats, good: Flags, folded: bool) -> tuple[Floats, Floats, float]:
    """Shares (n,) in rad of the values of a ring, whose sum is 2 pi: their own, and those of directions without a value.

    Values of one direction share its part. Third: the widest gap between measured directions, deg.
    """
    return _shares_of(azimuth_deg.tobytes(), good.tobytes(), folded)


@lru_cache(maxsize=256)
def _shares_of(azimuths: bytes, flags: bytes, folded: bool) -> tuple[Floats, Floats, float]:
    """`_azimuth_shares`: most rings have the same azimuths, as most rigs of a proof have. Do not write to the arrays."""
    azimuth_deg, good = np.frombuffer(azimuths), np.frombuffer(flags, dtype=bool)
    nodes, node = np.unique(azimuth_deg, return_inverse=True)
    having = np.zeros(nodes.size, dtype=bool)
    having[node[good]] = True
    of_all, gap = _arcs(nodes, folded)
    of_good, _ = _arcs(nodes[having], folded)
    counts = np.bincount(node[good], minlength=nodes.size)
    own, filled = np.zeros(nodes.size), np.zeros(nodes.size)
    own[having] = np.minimum(of_all[having], of_good)
    filled[having] = of_good - own[having]
    each = np.where(good, 1.0 / np.maximum(counts[node], 1), 0.0)
    return own[node] * each, filled[node] * each, gap


def _arcs(nodes_deg: Floats, folded: bool) -> tuple[Floats, float]:
    """Integrals in rad over the azimuth of piecewise linear functions that are 1 at one node; and the widest gap, deg."""
    if nodes_deg.size == 0:
        return np.zeros(0), 360.0
    if folded:
        edges = np.concatenate([[0.0], 0.5 * (nodes_deg[1:] + nodes_deg[:-1]), [180.0]])
        gap = max(float(np.diff(nodes_deg).max(initial=0.0)), 2.0 * float(nodes_deg[0]), 2.0 * (180.0 - float(nodes_deg[-1])))
        return 2.0 * np.radians(np.diff(edges)), gap
    apart = np.diff(nodes_deg, append=nodes_deg[0] + 360.0)
    return np.radians(0.5 * (apart + np.roll(apart, 1))), float(apart.max())
