"""How much of the hole is lit on each optical path, as modes: what the place of the slit's image does to a value.

Mirrors that are tilted move the slit's image, and part of the hole is dark (light_place.py). A quotient of two paths with the
light at one sigma keeps nothing of it; the etalon of transmitted light is lit at 180 deg - sigma, where another corner of the
hole is dark, and where a photodiode's disc that is off sees more of the lit part at one of both.

What this does has no normal law: an ensemble of virtual rigs, within what the rig file states, has it for each pose and each
direction of view. All of these functions of the virtual rig are sums of a few modes, orthonormal under its probability: so a
value has the effects of some uncorrelated inputs of mean square 1, the same ones on all paths, and covariances follow.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Self

import numpy as np

from goniotwin.app.campaign.measurement_model.light_place import across_beam, place_law, seen_logarithm
from goniotwin.app.campaign.measurement_model.pose import LIGHT, Views, disc_moves, image_shifts
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Instrument
from goniotwin.twin.optics.geometry.coordinates import HALF_TURN_DEG
from goniotwin.twin.optics.kernel import kernel

OF_PUPIL = [LIGHT.index(f"illumination_shift_{axis}") for axis in "xz"]
MODES = 48
"""Modes that are kept: the others have at most 2 % of any u."""
KEPT_RIGS, KEPT_POSES = 4, 512
SIGMAS_DEG, GAMMAS_DEG = (10.0, 30.0, 50.0, 70.0), (0.0, 30.0, 60.0)
"""Poses whose functions span those of all: the hole is a square, alike after a quarter of a turn."""
POLAR_DEG = np.array([1e-3, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0])
AZIMUTH_DEG = np.arange(0.0, 361.0, 10.0)
"""Directions of view at which a pose is computed, from the pole of the arc and about it; between them it is interpolated.

The first is next to the pole.
"""
LEAST_PROBABILITY = 1e-7
"""Places of the image that are less probable do not count."""
QUARTER_DEG = 90.0
TOGETHER = 2000
"""Values whose laws are in memory together."""
SMALLEST = 1e-12
BINS = 48
"""Bins of the law of an effect: each with its probability and the mean of its rigs."""
HALVINGS = 30
"""Steps by which the end of an interval is found: from the width of a law to a part in 1e9."""
SOME = 3
"""Of so many of these directions, along either angle, one counts where the modes are found."""


@dataclass(frozen=True)
class LitEnsemble:
    """Virtual rigs (n,), each with its `probability`: places (n, 2) of the image by the mirrors, mm across the beam, which go
    with the mirror unit; shifts (n, 2) of the exit pupil along x and z, which do not; and values (n, inputs) of VIEW.
    """

    by_mirrors: Floats
    shifts: Floats
    views: Floats
    probability: Floats

    @classmethod
    def of(cls, instrument: Instrument, half_widths: tuple[float, ...]) -> Self:
        """Those of a rig whose inputs LIGHT and VIEW are rectangular with these half widths."""
        widths, ways = np.array(half_widths), image_shifts(instrument, 0.0) @ across_beam(0.0).T
        ways[OF_PUPIL] = 0.0
        law = place_law(ways, widths[: len(LIGHT)])
        places, probability = (each[law.probability > LEAST_PROBABILITY] for each in (law.places, law.probability))
        # Each place with other values of the rest: a sequence that fills their cube evenly.
        others = np.concatenate([widths[OF_PUPIL], widths[len(LIGHT) :]])
        values = (2.0 * ((np.arange(len(places))[:, None] * _even_steps(others.size) + 0.5) % 1.0) - 1.0) * others
        return cls(places, values[:, : len(OF_PUPIL)], values[:, len(OF_PUPIL) :], probability / probability.sum())

    def places(self, instrument: Instrument, sigma_deg: float) -> Floats:
        """The places (n, 2) of the image at a sigma."""
        return self.by_mirrors + self.shifts @ (image_shifts(instrument, sigma_deg) @ across_beam(sigma_deg).T)[OF_PUPIL]


def _even_steps(dimensions: int) -> Floats:
    """Steps of a sequence of points that fills a cube evenly: powers of the golden ratio's counterpart in its dimensions."""
    ratio = np.roots([1.0, *[0.0] * (dimensions - 1), -1.0, -1.0])
    largest = float(np.max(ratio[np.isreal(ratio)].real))
    return np.asarray(largest ** -np.arange(1.0, dimensions + 1.0))


@dataclass(frozen=True)
class LitModes:
    """Modes (modes, n) of an ensemble, orthonormal under its probability."""

    ensemble: LitEnsemble
    modes: Floats

    def of(self, logarithm: Floats) -> Floats:
        """The effects (..., modes) of functions (..., n) of the virtual rig."""
        return np.asarray((logarithm * self.ensemble.probability) @ self.modes.T)

    def quantiles(self, effects: Floats, u: Floats, probability: tuple[float, float]) -> Floats:
        """Quantiles (n, 2) of the sums of effects (n, modes) over the virtual rigs and of normal errors with `u` (n,)."""
        found = np.empty((u.size, 2))
        for begin in range(0, u.size, TOGETHER):
            part = slice(begin, begin + TOGETHER)
            _find_quantiles(effects[part] @ self.modes, self.ensemble.probability, u[part], np.array(probability), found[part])
        return found


@kernel()
def _find_quantiles(effect: Floats, probability: Floats, u: Floats, wanted: Floats, found: Floats) -> None:
    share, mean = np.empty(BINS), np.empty(BINS)
    for i in range(u.size):
        least, most = effect[i].min(), effect[i].max()
        width = (most - least) / BINS
        share[:], mean[:] = 0.0, 0.0
        for k in range(probability.size):
            at = min(int((effect[i, k] - least) / width), BINS - 1) if width > 0.0 else 0
            share[at] += probability[k]
            mean[at] += probability[k] * effect[i, k]
        # What a bin's rigs differ among themselves is at most the spread of its width.
        spread = math.sqrt(2.0 * (u[i] ** 2 + width**2 / 12.0)) + SMALLEST
        for q in range(wanted.size):
            low, high = least - 4.0 * spread, most + 4.0 * spread
            for _ in range(HALVINGS):
                middle, below = 0.5 * (low + high), 0.0
                for k in range(BINS):
                    if share[k] > 0.0:
                        below += 0.5 * share[k] * (1.0 + math.erf((middle - mean[k] / share[k]) / spread))
                if below < wanted[q]:
                    low = middle
                else:
                    high = middle
            found[i, q] = 0.5 * (low + high)


@lru_cache(maxsize=KEPT_RIGS)
def lit_modes(instrument: Instrument, half_widths: tuple[float, ...]) -> LitModes:
    """The modes of a rig whose inputs LIGHT and VIEW are rectangular with these half widths."""
    ensemble = LitEnsemble.of(instrument, half_widths)
    root = np.sqrt(ensemble.probability)
    functions = []
    for sigma in SIGMAS_DEG:
        for gamma in GAMMAS_DEG:
            for lower in (False, True):
                one, other = (_seen(instrument, at, gamma, lower, ensemble, SOME) for at in (sigma, 180.0 - sigma))
                functions.append((one - other).reshape(-1, root.size))
    _, _, found = np.linalg.svd(np.concatenate(functions) * root, full_matrices=False)
    return LitModes(ensemble, found[:MODES] / root)


@lru_cache(maxsize=KEPT_POSES)
def _effects(
    instrument: Instrument, half_widths: tuple[float, ...], sigma_deg: float, gamma_deg: float, lower: bool, reverse: bool
) -> Floats:  # fmt: skip
    """The effects (polar angles, azimuths, modes) at a pose on the light at sigma over that at 180 deg - sigma."""
    known = lit_modes(instrument, half_widths)
    sigmas = sigma_deg, 180.0 - sigma_deg
    one, other = (_seen(instrument, at, gamma_deg, lower, known.ensemble, reverse=reverse) for at in sigmas)
    return known.of(one - other)


def _seen(
    instrument: Instrument, sigma_deg: float, gamma_deg: float, lower: bool, ensemble: LitEnsemble, step: int = 1,
    reverse: bool = False,
) -> Floats:  # fmt: skip
    """The logarithm (polar angles, azimuths, n) of the light at a pose, in each of so many directions of view of an arc."""
    grid = np.meshgrid(np.radians(POLAR_DEG[::step]), np.radians(AZIMUTH_DEG[::step]), indexing="ij")
    polar, azimuth = (each.ravel() for each in grid)
    none, flags = np.zeros(polar.size), np.full(polar.size, lower)
    at = Views(none + sigma_deg, none + gamma_deg, polar, azimuth, flags, flags, np.full(polar.size, reverse))
    views, moves = disc_moves(instrument, at)
    discs = np.einsum("nk,mki->mni", ensemble.views, moves)
    found = seen_logarithm(instrument, (sigma_deg, gamma_deg), views, ensemble.places(instrument, sigma_deg), discs)
    return found.reshape(*grid[0].shape, -1)


def lit_effects(
    instrument: Instrument, half_widths: tuple[float, ...], pose: tuple[float, float, bool, bool], polar_deg: Floats,
    azimuth_deg: Floats,
) -> Floats:  # fmt: skip
    """The effects (n, modes) on the logarithm of the light at sigma over that at 180 deg - sigma, seen in directions (n,).

    `pose` is of sigma, gamma, whether the arc is the lower one and whether it is at the opposite azimuth (`Views.reverse`);
    the directions are from its pole, and about it.
    """
    sigma, gamma, lower, reverse = pose
    front = min(sigma, HALF_TURN_DEG - sigma)
    table = _effects(instrument, half_widths, front, gamma % QUARTER_DEG, lower, reverse) * (1.0 if sigma == front else -1.0)
    row, up = _place(POLAR_DEG, polar_deg)
    column, on = _place(AZIMUTH_DEG, azimuth_deg % 360.0)
    corners = [(0, 0, (1.0 - up) * (1.0 - on)), (0, 1, (1.0 - up) * on), (1, 0, up * (1.0 - on)), (1, 1, up * on)]
    return np.asarray(sum(weight[:, None] * table[row + i, column + j] for i, j, weight in corners))


def _place(grid: Floats, at: Floats) -> tuple[np.ndarray, Floats]:
    """The interval of a grid in which each of `at` (n,) is, and where in it, from 0 to 1."""
    k = np.clip(np.searchsorted(grid, at, side="right") - 1, 0, grid.size - 2)
    return k, np.clip((at - grid[k]) / (grid[k + 1] - grid[k]), 0.0, 1.0)
