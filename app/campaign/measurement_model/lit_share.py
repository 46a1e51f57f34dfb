"""How much of the hole is lit on each optical path, as modes: what the place of the slit's image does to a value.

Mirrors that are tilted move the slit's image, and part of the hole is dark (light_place.py). A quotient of two paths with the
light at one sigma keeps nothing of it, but that two surfaces have heights of their own: one that is lifted meets the beam
elsewhere. The etalon of transmitted light is lit at 180 deg - sigma, where another corner of the hole is dark, and where a
photodiode's disc that is off sees more of the lit part at one of both.

What this does has no normal law: an ensemble of virtual rigs, within what the rig file states, has it for each pose and each
direction of view. All of these functions of the virtual rig are sums of a few modes, orthonormal under its probability: so a
value has the effects of some uncorrelated inputs of mean square 1, the same ones on all paths, and covariances follow. After an
alignment the virtual rigs are those about the one that it has found.

The middle of the light moves, too, but is not in u: with it the variance of the angle between lobe and photodiode is at most
1.03 times as large along the arc, and 1.06 times across, in reflected and in transmitted light.
"""

import itertools
import math
from dataclasses import dataclass, replace
from functools import lru_cache
from statistics import NormalDist
from typing import Literal, Self

import numpy as np

from goniotwin.app.campaign.measurement_model.alignment import Alignment
from goniotwin.app.campaign.measurement_model.inputs import InputQuantity
from goniotwin.app.campaign.measurement_model.light_place import across_beam, change_by_height, place_law, seen_logarithm
from goniotwin.app.campaign.measurement_model.pose import (
    LIGHT,
    MOUNTED,
    Views,
    disc_moves,
    image_shifts,
    mounting_inputs,
    rig_inputs,
    standard_uncertainties,
)
from goniotwin.app.rig import RigFile, nominal_instrument
from goniotwin.app.rig.inputs import MIRROR_TILT
from goniotwin.app.rig.uncertainty import UncertaintyTable
from goniotwin.arrays import Floats
from goniotwin.linear_algebra import one_thread_in_linear_algebra
from goniotwin.twin.optics import Instrument
from goniotwin.twin.optics.geometry.coordinates import HALF_TURN_DEG
from goniotwin.twin.optics.kernel import kernel
from goniotwin.twin.plant.disturbances import ETALON, SAMPLE

SLIT_IMAGE = "slit_image"
"""The component of the light's place, of values and of the closure."""
OF_PUPIL = [LIGHT.index(f"illumination_shift_{axis}") for axis in "xz"]
MODES, MODES_OF_HEIGHT = 48, 6
"""Modes that are kept: the others have at most 2 % of any u. With a height most is done by the two sides in the plane of
incidence.
"""
KEPT_RIGS, KEPT_POSES = 4, 1024
Pose = tuple[float, float, bool, bool]
"""Sigma, gamma, whether the arc is the lower one, and whether it is at the opposite azimuth (`Views.reverse`)."""
Of = Literal["share", "height"]
"""Functions of the virtual rig: the logarithm of the light, and its change for a mm of the sample's height."""
SIGMAS_DEG, GAMMAS_DEG, SIGMAS_OF_HEIGHT_DEG = (10.0, 30.0, 50.0, 70.0), (0.0, 30.0, 60.0), (40.0, 70.0)
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
PAIRS = 400
"""Pairs of virtual rigs about one that an alignment has found."""
BINS = 48
"""Bins of the law of an effect: each with its probability and the mean of its rigs."""
HALVINGS = 30
"""Steps by which the end of an interval is found: from the width of a law to a part in 1e9."""
SOME = 3
"""Of so many of these directions, along either angle, one counts where the modes are found."""


@dataclass(frozen=True)
class RigLaw:
    """What is known of the inputs LIGHT and VIEW of a rig: rectangular laws of these half widths.

    Or, `found` by an alignment, a normal law about their `mean`.
    """

    instrument: Instrument
    half_widths: tuple[float, ...]
    mean: tuple[float, ...] = ()
    covariance: tuple[tuple[float, ...], ...] = ()

    @classmethod
    def of(cls, rig: RigFile, alignment: Alignment | None = None) -> Self:
        """That of a rig file, and of an alignment of its rig."""
        inputs = rig_inputs(rig.uncertainty)
        half_widths = tuple((math.sqrt(3.0) * standard_uncertainties(inputs)).tolist())
        of_place = None if alignment is None else alignment.of_place
        if of_place is None:
            return cls(nominal_instrument(rig), half_widths)
        known = of_place.with_inputs(inputs)
        chosen = np.array([[float(one.name == each.name) for one in known.inputs] for each in inputs])
        covariance = map(tuple, (chosen @ known.covariance @ chosen.T).tolist())
        return cls(nominal_instrument(rig), half_widths, tuple((chosen @ known.value).tolist()), tuple(covariance))

    @property
    def found(self) -> bool:
        """Whether an alignment has found it."""
        return bool(self.mean)


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
    def of(cls, rig: RigLaw) -> Self:
        """Those of a law; about a rig that an alignment has found all have the same probability."""
        widths, ways = np.array(rig.half_widths), image_shifts(rig.instrument, 0.0) @ across_beam(0.0).T
        ways[OF_PUPIL] = 0.0
        if rig.found:
            own = [*OF_PUPIL, *range(len(LIGHT), widths.size)]
            parts = np.concatenate([np.pad(ways, ((0, widths.size - len(LIGHT)), (0, 0))), np.eye(widths.size)[:, own]], axis=1)
            values = np.array(rig.mean) @ parts + _normal_draws(parts.T @ np.array(rig.covariance) @ parts)
            by_mirrors, shifts, views = np.split(values, [2, 2 + len(OF_PUPIL)], axis=1)
            return cls(by_mirrors, shifts, views, np.full(len(values), 1.0 / len(values)))
        law = place_law(ways, widths[: len(LIGHT)])
        places, probability = (each[law.probability > LEAST_PROBABILITY] for each in (law.places, law.probability))
        # Each place with other values of the rest: a sequence that fills their cube evenly.
        others = np.concatenate([widths[OF_PUPIL], widths[len(LIGHT) :]])
        values = (2.0 * _even_points(len(places), others.size) - 1.0) * others
        return cls(places, values[:, : len(OF_PUPIL)], values[:, len(OF_PUPIL) :], probability / probability.sum())

    def places(self, instrument: Instrument, sigma_deg: float) -> Floats:
        """The places (n, 2) of the image at a sigma."""
        return self.by_mirrors + self.shifts @ (image_shifts(instrument, sigma_deg) @ across_beam(sigma_deg).T)[OF_PUPIL]


def _even_points(count: int, dimensions: int) -> Floats:
    """Points (count, dimensions) that fill a cube evenly: by powers of the golden ratio's counterpart in its dimensions."""
    ratio = np.roots([1.0, *[0.0] * (dimensions - 1), -1.0, -1.0])
    largest = float(np.max(ratio[np.isreal(ratio)].real))
    return np.asarray((np.arange(count)[:, None] * largest ** -np.arange(1.0, dimensions + 1.0) + 0.5) % 1.0)


def _normal_draws(covariance: Floats) -> Floats:
    """Values (n, m) of a normal law of mean 0, in pairs of both signs."""
    values, vectors = np.linalg.eigh(covariance)
    points = np.vectorize(NormalDist().inv_cdf)(_even_points(PAIRS, len(values)))
    spread = vectors[:, ::-1] * np.sqrt(np.maximum(values[::-1], 0.0))
    return np.asarray(np.concatenate([points, -points]) @ spread.T)


@dataclass(frozen=True)
class LitModes:
    """Modes (modes, n) of an ensemble, orthonormal under its probability.

    Of a rig that an alignment has found the first one is 1: its effect is the mean.
    """

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
            with one_thread_in_linear_algebra():
                effect = effects[part] @ self.modes
            _find_quantiles(effect, self.ensemble.probability, u[part], np.array(probability), found[part])
        return found

    def deviate(self, effects: Floats, u: float, error: float) -> float:
        """The normal deviate with the probability of an `error`: a sum of effects (modes,) and of a normal error with `u`."""
        scaled = (error - effects @ self.modes) / max(math.sqrt(2.0) * u, SMALLEST)
        below = 0.5 + 0.5 * float(np.dot(self.ensemble.probability, [math.erf(each) for each in scaled.tolist()]))
        return NormalDist().inv_cdf(min(max(below, SMALLEST), 1.0 - SMALLEST))


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
def lit_modes(rig: RigLaw, of: Of = "share") -> LitModes:
    """The modes of a rig; those of a share span what the light at two sigmas differs by, sigma and 180 deg - sigma."""
    ensemble = LitEnsemble.of(rig)
    root = np.sqrt(ensemble.probability)
    functions = []
    if of == "height":
        for sigma, gamma in itertools.product(SIGMAS_OF_HEIGHT_DEG, GAMMAS_DEG):
            functions.append(_functions(rig.instrument, (sigma, gamma, False, False), ensemble, of, SOME))
    else:
        for sigma, gamma, lower in itertools.product(SIGMAS_DEG, GAMMAS_DEG, (False, True)):
            poses = [(at, gamma, lower, False) for at in (sigma, HALF_TURN_DEG - sigma)]
            one, other = (_functions(rig.instrument, each, ensemble, of, SOME) for each in poses)
            functions.append(one - other)
    weighted = np.concatenate([each.reshape(-1, root.size) for each in functions]) * root
    count = MODES if of == "share" else MODES_OF_HEIGHT
    if rig.found:
        weighted -= np.outer(weighted @ root, root)
    _, vectors = np.linalg.eigh(weighted.T @ weighted)  # the largest last
    found = vectors.T[::-1]
    return LitModes(ensemble, (np.concatenate([root[None], found]) if rig.found else found)[:count] / root)


@lru_cache(maxsize=KEPT_POSES)
def _effects(rig: RigLaw, pose: Pose, of: Of) -> Floats:
    """The effects (polar angles, azimuths, modes) at a pose."""
    known = lit_modes(rig, of)
    return known.of(_functions(rig.instrument, pose, known.ensemble, of))


def _functions(instrument: Instrument, pose: Pose, ensemble: LitEnsemble, of: Of, step: int = 1) -> Floats:
    """The functions (polar angles, azimuths, n) at a pose, in each of so many directions of view."""
    sigma, gamma, lower, reverse = pose
    grid = np.meshgrid(np.radians(POLAR_DEG[::step]), np.radians(AZIMUTH_DEG[::step]), indexing="ij")
    polar, azimuth = (each.ravel() for each in grid)
    none, flags = np.zeros(polar.size), np.full(polar.size, lower)
    at = Views(none + sigma, none + gamma, polar, azimuth, flags, flags, np.full(polar.size, reverse))
    views, moves = disc_moves(instrument, at)
    places = ensemble.places(instrument, sigma)
    if of == "share":
        discs = np.einsum("nk,mki->mni", ensemble.views, moves)
        found = seen_logarithm(instrument, (sigma, gamma), views, places, discs)
    else:
        found = change_by_height(instrument, (sigma, gamma), views, places)
    return found.reshape(*grid[0].shape, -1)


def lit_effects(rig: RigLaw, views: Views, sigma_deg: Floats, of: Of = "share") -> Floats:
    """The effects (n, modes) on the logarithm of the light at `sigma_deg` (n,), seen in the directions of `views`.

    Or on its change for a mm of the height of what is lit.
    """
    poses = np.stack([sigma_deg, views.gamma_deg % QUARTER_DEG, views.lower, views.reverse], axis=1)
    distinct, which = np.unique(poses, axis=0, return_inverse=True)
    row, up = _place(POLAR_DEG, np.degrees(views.polar))
    column, on = _place(AZIMUTH_DEG, np.degrees(views.azimuth) % 360.0)
    found = np.zeros((which.size, MODES if of == "share" else MODES_OF_HEIGHT))
    for k, (sigma, gamma, lower, reverse) in enumerate(distinct.tolist()):
        here = np.flatnonzero(which.ravel() == k)
        with one_thread_in_linear_algebra():
            table = _effects(rig, (sigma, gamma, bool(lower), bool(reverse)), of)
        for i, by_row in ((0, 1.0 - up[here]), (1, up[here])):
            for j, by_column in ((0, 1.0 - on[here]), (1, on[here])):
                found[here] += (by_row * by_column)[:, None] * table[row[here] + i, column[here] + j]
    return found


def height_effects(rig: RigLaw, views: Views) -> dict[str, Floats]:
    """The effects (n, modes) of a mm of the height of sample and of etalon on their light at `views`.

    The etalon of transmitted light is lit at 180 deg - sigma.
    """
    at_sample = lit_effects(rig, views, views.sigma_deg, "height")
    if not views.transmitted.any():
        return {SAMPLE: at_sample, ETALON: at_sample}
    opposite = np.where(views.transmitted, HALF_TURN_DEG - views.sigma_deg, views.sigma_deg)
    return {SAMPLE: at_sample, ETALON: lit_effects(rig, views, opposite, "height")}


def height_inputs(table: UncertaintyTable, kind: str, mounting: str) -> list[InputQuantity]:
    """The products of the height of a mounting with each of the modes: of mean 0, and correlated with no other input."""
    height = mounting_inputs(table, kind, mounting)[MOUNTED.index("height")]
    names = [f"{kind}_height*{SLIT_IMAGE}[{k}]@{mounting}" for k in range(1, MODES_OF_HEIGHT + 1)]
    source = f"{height.source}, {table.source(MIRROR_TILT)}"
    return [replace(height, name=name, source=source, distribution="normal") for name in names]


def _place(grid: Floats, at: Floats) -> tuple[np.ndarray, Floats]:
    """The interval of a grid in which each of `at` (n,) is, and where in it, from 0 to 1."""
    k = np.clip(np.searchsorted(grid, at, side="right") - 1, 0, grid.size - 2)
    return k, np.clip((at - grid[k]) / (grid[k + 1] - grid[k]), 0.0, 1.0)
