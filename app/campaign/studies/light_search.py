"""The search for the light's place on the sample: how far the mirrors have moved the slit's image, by a lobe and by the etalon.

The direction of the light depends on the place of the slit's image with kinks: as long as no edge is within the hole, not at
all. So no step from the aligned rig finds it, and a fit begins where this search ends. A lobe at several incidences shows in
which direction the light has moved at each of them; all other inputs of the fit are as uncertain as they are stated (a normal
law, linear about where the fit is, in closed form). The etalon shows the share of the hole that is lit: with the sample unit
turned, so that the hole's corners are where its sides were, the light of one pose changes with no other input.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from goniotwin.app.campaign.measurement_model.alignment import Alignment
from goniotwin.app.campaign.measurement_model.light_place import across_beam, spot_weights
from goniotwin.app.campaign.measurement_model.pose import LIGHT, image_shifts
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Instrument

WIDTHS = 3.5
"""Half width of the search in standard uncertainties of the place by the mirrors' tilts."""
PLACES = 33
"""Places that are compared along either direction."""
MOST_PLACES = 4
"""Places from which a fit begins, at most."""
FLUX_U = 0.002
"""Relative standard uncertainty of the etalon's light with the sample turned, beside that by its tilt; assumed."""
POSSIBLE = 100.0
"""Places with so much more chi-square than the best are not the best of a fit either."""
SEEN = 16.0
"""The light is stated to miss part of the hole where the best place has so much less chi-square than a lit hole."""
LIT = 0.995
"""A hole that is lit by this share is counted as lit: the corners of a turned one are beyond the image of any rig."""

Shares = Mapping[tuple[float, float], tuple[float, float]]
"""By sigma and gamma: the logarithm of the etalon's light over that at the first gamma, and that gamma."""


@dataclass(frozen=True)
class LightSeen:
    """What shows the light on the sample beside the lobe: the etalon's `shares`, and the `instrument` with its field of view.

    The field is that of the scans of the open beam; by it the photodiodes see more or less of the hole's edges.
    """

    shares: Shares
    instrument: Instrument


@dataclass(frozen=True)
class LobeData:
    """The normal law of a lobe's residuals about a fit. `white` (c, c) are products of columns with the inverse covariance.

    The columns: two for what the residuals have in common with the place of the image through the inputs; two for each of
    `poses` (m, 2), sigma and gamma, for a middle of the light by a mm along x and y of the rig; the residuals.
    """

    poses: Floats
    white: Floats


@dataclass(frozen=True)
class PlaceOfImage:
    """Places (n, 2) of the slit's image on the sample in mm across the beam: in the plane of incidence, and along y.

    The best one is the first; the others have the least chi-square of all places around them. `gain` is how much less
    chi-square the best has than any place at which the hole is lit. `upright`: the hole's sides are along and across the plane
    of incidence at all poses.
    """

    places: Floats
    gain: float
    upright: bool

    @property
    def seen(self) -> bool:
        """Whether the data show that part of the hole is dark."""
        return self.gain > SEEN


def image_by_inputs(instrument: Instrument, alignment: Alignment) -> Floats:
    """The way (2, inputs) of the image by one unit of each of the alignment's inputs that are mirrors'."""
    sigma = 45.0
    shifts = dict(zip(LIGHT, (image_shifts(instrument, sigma) @ across_beam(sigma).T).tolist(), strict=True))
    mirrors = [each.name.startswith("mirror_") for each in alignment.inputs]
    found = [shifts[each.name] if known else [0.0, 0.0] for each, known in zip(alignment.inputs, mirrors, strict=True)]
    return np.array(found).reshape(-1, 2).T


def search_place(seen: LightSeen, data: LobeData, prior: Floats, etalon_tilt_deg: float) -> PlaceOfImage:
    """The best places of the image; `prior` (2, 2) is its covariance by the mirrors' stated tilts, in mm^2."""
    spots = [spot_weights(seen.instrument, sigma, gamma) for sigma, gamma in data.poses.tolist()]
    upright = np.array([math.isclose(math.remainder(gamma, 90.0), 0.0, abs_tol=1.0) for gamma in data.poses[:, 1]])
    along = np.linspace(-WIDTHS, WIDTHS, PLACES)
    q = np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1) * np.sqrt(np.diag(prior))
    share, middle = (np.stack(each, axis=1) for each in zip(*(spot.lit(q.reshape(-1, 2)) for spot in spots), strict=True))
    found = _chi_square(data, prior, q.reshape(-1, 2), middle.reshape(PLACES**2, -1))
    found += flux_chi_square(data.poses, share, seen.shares, etalon_tilt_deg)
    known = np.all(share[:, upright] > LIT, axis=1) if upright.any() else np.all(share > LIT, axis=1)
    gain = float(np.min(found[known], initial=math.inf)) - float(found.min())
    table = found.reshape(PLACES, PLACES)
    around = sliding_window_view(np.pad(table, 1, constant_values=math.inf), (3, 3))
    lowest = (table == np.min(around, axis=(2, 3))) & (table < table.min() + POSSIBLE)
    order = np.argsort(np.where(lowest, table, math.inf).ravel(), kind="stable")[: min(MOST_PLACES, int(lowest.sum()))]
    return PlaceOfImage(q.reshape(-1, 2)[order], gain, bool(upright.all()))


def nearest_lit(instrument: Instrument, poses: Floats, place: Floats) -> Floats:
    """The place (2,) furthest on the way to another one with which the hole is lit at all poses."""
    ways = np.linspace(0.0, 1.0, PLACES)[:, None] * place
    share = np.min([spot_weights(instrument, sigma, gamma).lit(ways)[0] for sigma, gamma in poses.tolist()], axis=0)
    return np.asarray(ways[int(np.argmax(np.append(share[1:] <= LIT, True)))])


def flux_chi_square(poses: Floats, share: Floats, shares: Shares, etalon_tilt_deg: float) -> Floats:
    """Chi-square (n,) of the etalon's light at some poses, of which a `share` (n, poses) is seen."""
    total = np.zeros(len(share))
    for here, there, observed, u in _flux_terms(poses, shares, etalon_tilt_deg):
        total += ((np.log(share[:, here] / share[:, there]) - observed) / u) ** 2
    return total


def _chi_square(data: LobeData, prior: Floats, q: Floats, middle: Floats) -> Floats:
    """Twice the logarithm of the probability of the places (n, 2) and the residuals, but for its sign and a constant."""
    weight = np.linalg.inv(prior)
    columns = np.concatenate([-q @ weight, -middle, np.ones((len(q), 1))], axis=1)
    seen = columns @ data.white
    left = np.linalg.inv(prior - data.white[:2, :2])
    found = np.einsum("ni,ni->n", seen, columns) + np.einsum("ni,ij,nj->n", seen[:, :2], left, seen[:, :2])
    return np.asarray(found + np.einsum("ni,ij,nj->n", q, weight, q))


def _flux_terms(poses: Floats, shares: Shares, etalon_tilt_deg: float) -> list[tuple[int, int, float, float]]:
    """Numbers of two poses, the logarithm of the quotient of the etalon's light at them, and its uncertainty."""
    number = {(sigma, gamma): k for k, (sigma, gamma) in enumerate(np.round(poses, 6).tolist())}
    found = []
    for (sigma, gamma), (logarithm, first) in shares.items():
        if (sigma, gamma) in number and (sigma, first) in number and gamma != first:
            steep = 1.0 + abs(math.tan(math.radians(sigma)))
            u = math.hypot(FLUX_U, math.radians(etalon_tilt_deg) * steep)
            found.append((number[sigma, gamma], number[sigma, first], logarithm, u))
    return found
