"""Photodiodes calibrated against each other, by the directions that two of them have seen.

Formula 1 has scaled each photodiode by what it has itself seen of the etalon. What is then left between two of them is what the
etalon cannot show: a photodiode or amplifier that has changed since, an etalon that was soiled where one of them looked. A
photodiode k is taken to give exp(g_k) of what it should, at all directions and wavelengths of a sample. Each direction that two
of them have seen tells g_a - g_b, and the g are the weighted least squares of all, robust against outliers (Huber).

- The weight of a pair has its noise, gain and etalon in it, the field's part where u_bsdf has one, and the slope of the lobe
  times an angular tolerance, so that a steep lobe, of which it is not known where it was seen, says little. What the overlap
  of two photodiodes altogether tells to no better than 1 % is not used.
- All pairs of two poses share the monitor's error. Along an arc it would add up from photodiode to photodiode; so it is
  estimated with the g, as one number for each pair of poses whose uncertainty is known.
- The level of all photodiodes that overlaps connect is left to the etalon: the weighted mean of their g is 0. The errors of
  few photodiodes do not quite cancel in it: what is left, the root of the sum of squares of their shares in that mean, is in
  the uncertainty of each.
- Where residuals are greater than the weights allow, the uncertainties are widened by as much.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.arrays import Flags, Floats, Ints

KNOWN_TO = 0.01
"""An overlap of two photodiodes that is known no better does not connect them."""
HUBER = 2.0
"""Beyond so many standard uncertainties a residual pulls no harder."""
ITERATIONS = 30
CERTAIN = 4.0


@dataclass(frozen=True)
class Pairs:
    """Log ratios of what two photodiodes, `one` and `other`, gave for one direction, with their variances; arrays of one
    length. `together` numbers the pairs of poses, all of which share the monitor's error.
    """

    one: Ints
    other: Ints
    ratio: Floats
    variance: Floats
    together: Ints

    def where(self, chosen: Flags) -> "Pairs":
        """Some of them."""
        return Pairs(*(getattr(self, name)[chosen] for name in ("one", "other", "ratio", "variance", "together")))


@dataclass(frozen=True)
class Factors:
    """By which the values of the `photodiodes` are to be multiplied, each with its standard uncertainty, from so many `pairs`;
    `unconnected` are photodiodes with values that no overlap connects with another: they keep 1. `widened` is by how much the
    scatter of the residuals has widened the uncertainties.
    """

    photodiodes: tuple[int, ...]
    values: tuple[float, ...]
    uncertainties: tuple[float, ...]
    unconnected: tuple[int, ...]
    pairs: int
    widened: float

    @property
    def significant(self) -> list[int]:
        """Photodiodes whose factor differs from 1 by more than four standard uncertainties."""
        found = zip(self.photodiodes, self.values, self.uncertainties, strict=True)
        return [k for k, value, u in found if abs(value - 1.0) > CERTAIN * u]

    def of(self, photodiode: int) -> float:
        """The factor of a photodiode; 1 where it has none."""
        return dict(zip(self.photodiodes, self.values, strict=True)).get(photodiode, 1.0)

    def told(self, applied: bool) -> Iterator[str]:
        """Sentences: what was done, or would be; every factor; and what has none."""
        if not self.photodiodes:
            yield "no overlap is known well enough to calibrate photodiodes against each other; all keep their factor 1"
            return
        done = "have been multiplied by" if applied else "would be multiplied by (overlap.calibrate is false)"
        found = zip(self.photodiodes, self.values, self.uncertainties, strict=True)
        each = ", ".join(f"{k}: {value:.5f} (u {u:.5f})" for k, value, u in found)
        yield f"{self.pairs} overlaps calibrate photodiodes against each other, whose values {done} {each}"
        if self.significant:
            yield f"beyond {CERTAIN:.0f} u from 1: photodiodes {', '.join(str(k) for k in self.significant)}"
        if self.unconnected:
            yield f"not connected by overlaps, factor 1: photodiodes {', '.join(str(k) for k in self.unconnected)}"

    def applied(self, points: BsdfPoints) -> BsdfPoints:
        """The points calibrated; their uncertainties have the factors' in them."""
        factor, u = np.ones(points.bsdf.size), np.zeros(points.bsdf.size)
        for k, value, uncertainty in zip(self.photodiodes, self.values, self.uncertainties, strict=True):
            mine = points.photodiode == k
            factor[mine], u[mine] = value, uncertainty
        bsdf = points.bsdf * factor
        return replace(points, bsdf=bsdf, u_bsdf=np.hypot(points.u_bsdf * factor, points.bsdf * u))

    def as_dict(self) -> dict[str, Any]:
        """For programs; by the photodiodes' numbers."""
        found = zip(self.photodiodes, self.values, self.uncertainties, strict=True)
        each = {str(k): {"factor": value, "u": u} for k, value, u in found}
        return {"factors": each, "unconnected": list(self.unconnected), "pairs": self.pairs, "significant": self.significant}


def calibrated(pairs: Pairs, monitor: float, seen: set[int]) -> Factors:
    """From all pairs; `monitor` is the relative standard uncertainty that the pairs of two poses share, `seen` are all
    photodiodes that have values.
    """
    pairs = pairs.where(_well_known(pairs, monitor))
    photodiodes, values, uncertainties, widened = [], [], [], 1.0
    for members in _components(pairs):
        inside = np.isin(pairs.one, members)
        g, covariance, wider = _solved(pairs.where(inside), members, monitor)
        widened = max(widened, wider)
        photodiodes += members.tolist()
        values += np.exp(-g).tolist()
        uncertainties += (np.exp(-g) * np.sqrt(np.diag(covariance))).tolist()
    order = np.argsort(photodiodes)
    return Factors(
        tuple(photodiodes[k] for k in order),
        tuple(values[k] for k in order),
        tuple(uncertainties[k] for k in order),
        tuple(sorted(seen.difference(photodiodes))),
        int(pairs.one.size),
        widened,
    )


def _well_known(pairs: Pairs, monitor: float) -> Flags:
    """Those of two photodiodes whose mean is known well enough."""
    _, which = np.unique(np.stack([pairs.one, pairs.other], axis=1), axis=0, return_inverse=True)
    which = which.ravel()
    weight = np.bincount(which, weights=1.0 / (pairs.variance + monitor**2)) if which.size else np.zeros(0)
    return np.asarray((weight > KNOWN_TO**-2)[which], dtype=bool)


def _components(pairs: Pairs) -> list[Ints]:
    """The photodiodes of each connected part of the graph of pairs."""
    part = {int(k): int(k) for k in np.union1d(pairs.one, pairs.other)}
    for one, other in np.unique(np.stack([pairs.one, pairs.other], axis=1), axis=0).tolist():
        old, new = part[other], part[one]
        part = {k: new if belongs == old else belongs for k, belongs in part.items()}
    return [np.array([k for k, belongs in part.items() if belongs == each]) for each in sorted(set(part.values()))]


def _solved(pairs: Pairs, members: Ints, monitor: float) -> tuple[Floats, Floats, float]:
    """g of the members, its covariance, and by how much that was widened."""
    one, other = np.searchsorted(members, pairs.one), np.searchsorted(members, pairs.other)
    together = np.unique(pairs.together, return_inverse=True)[1].ravel()
    sigma = np.sqrt(pairs.variance)
    pull = _huber((pairs.ratio - _medians(one, other, pairs.ratio)) / np.hypot(sigma, monitor))
    for _ in range(ITERATIONS):
        weight = pull / pairs.variance
        normal, right, share = _normal_equations(one, other, together, pairs.ratio, weight, members.size, monitor)
        inverse = np.linalg.pinv(normal, hermitian=True)
        g = inverse @ right
        residual = pairs.ratio - (g[one] - g[other])
        shared = share * np.bincount(together, weights=weight * residual)
        before, pull = pull, _huber((residual - shared[together]) / sigma)
        if np.allclose(before, pull, atol=1e-9):
            break
    free = max(pairs.one.size - members.size + 1, 1)
    z2 = ((residual - shared[together]) / sigma) ** 2
    wider = float(np.sqrt(max(1.0, np.sum(pull * z2) / free)))
    weights = np.bincount(one, weights=weight, minlength=members.size) + np.bincount(other, weight, members.size)
    weights = weights / weights.sum()
    gauge = np.eye(members.size) - weights
    g, covariance = gauge @ g, wider**2 * (gauge @ inverse @ gauge.T)
    errors = np.maximum(g**2 - np.diag(covariance), 0.0)  # what of them is not their own uncertainty
    level = float(np.sum(weights**2 * errors)) * members.size / (members.size - 1)
    return g, covariance + level, wider


def _normal_equations(
    one: Ints, other: Ints, together: Ints, ratio: Floats, weight: Floats, size: int, monitor: float
) -> tuple[Floats, Floats, Floats]:
    """Of g, the monitor's errors eliminated; and what of the residuals of each pair of poses is the monitor's."""
    normal, right = np.zeros((size, size)), np.zeros(size)
    for k, m, sign in ((one, one, 1.0), (other, other, 1.0), (one, other, -1.0), (other, one, -1.0)):
        np.add.at(normal, (k, m), sign * weight)
    np.add.at(right, one, weight * ratio)
    np.add.at(right, other, -weight * ratio)
    sums = np.bincount(together, weights=weight)
    share = monitor**2 / (1.0 + monitor**2 * sums)
    along = np.zeros((sums.size, size))
    np.add.at(along, (together, one), weight)
    np.add.at(along, (together, other), -weight)
    normal -= along.T @ (share[:, None] * along)
    right -= along.T @ (share * np.bincount(together, weights=weight * ratio))
    return normal, right, np.asarray(share, dtype=float)


def _medians(one: Ints, other: Ints, ratio: Floats) -> Floats:
    """Of each pair, the median of all pairs of the same two photodiodes."""
    found = np.empty(ratio.size)
    _, which = np.unique(np.stack([one, other], axis=1), axis=0, return_inverse=True)
    for k in range(int(which.max(initial=-1)) + 1):
        mine = which.ravel() == k
        found[mine] = np.median(ratio[mine])
    return found


def _huber(z: Floats) -> Floats:
    return np.asarray(HUBER / np.maximum(np.abs(z), HUBER))
