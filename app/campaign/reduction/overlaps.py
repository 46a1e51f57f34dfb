"""Overlaps: directions that two photodiodes measured; a check of formula 1, and a calibration of the photodiodes by them.

The check. In formula 1 each photodiode is divided by itself at the etalon, so that its own sensitivity and gain cancel. Two
photodiodes still differ by noise, dark reading, gain and monitor, which are in the uncertainty; by the errors of the angles,
where the lobe is steep; and by any change between etalon and sample. The two values have to agree within these.

The calibration is optional, for the operator to ask for. If nothing has changed it improves nothing: an overlap has the noise
of two photodiodes at the sample, the etalon that of one photodiode, with enough light. It corrects what the etalon cannot
show: a photodiode or amplifier that has changed since, an etalon that was soiled where one photodiode looked. The model: a
photodiode k gives exp(g_k) times the true value, at all directions and wavelengths of a sample. Each direction that two of
them measured gives g_a - g_b, and the g are the weighted least squares of all, robust against outliers (Huber).

- The variance of a pair contains noise, gain and etalon, the field's component where u_bsdf has one, and the slope of the lobe
  times an angular tolerance. So a steep lobe, where the position on it is uncertain, has little weight. Two photodiodes whose
  overlap is known to no better than 1 % in all are not used.
- All pairs of two poses share the monitor's error, which would add up from photodiode to photodiode along an arc. It is
  therefore estimated together with the g, as one number of known uncertainty for each pair of poses.
- The level of all photodiodes connected by overlaps is that of the etalon: the weighted mean of their g is 0. The errors of
  few photodiodes do not quite cancel in that mean. The remainder, the root of the sum of squares of their shares in the mean,
  is in the uncertainty of each.
- Where the residuals are larger than the weights allow, the uncertainties are widened by as much.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from goniotwin.app.campaign.geometry.directions import direction_keys, scan_plane_deg
from goniotwin.app.campaign.reduction.calibration import CalibrationFactors
from goniotwin.app.campaign.reduction.points import BsdfPoints, plausible, steepness
from goniotwin.app.campaign.reduction.reading_inputs import monitor_variance
from goniotwin.app.campaign.reduction.settings import ReductionSettings
from goniotwin.app.campaign.schedule.refinement import DEFAULT_ANGLE_UNCERTAINTY_DEG
from goniotwin.app.columns import ColumnTable, IntegerColumn, Ratios
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import round_deg

RESOLVED = 0.1
"""Largest relative uncertainty of a value whose ratio is used: the logarithm of a less certain value is that of noise."""
VARIANCE_FLOOR = 1e-12
"""Smallest relative variance of a pair, so that the weights stay finite."""
KNOWN_TO = 0.01
"""Two photodiodes are connected if the mean of their overlaps is known to this relative uncertainty."""
HUBER = 2.0
"""Residuals beyond so many standard uncertainties have a constant pull."""
ITERATIONS = 30


@dataclass(frozen=True)
class OverlapPairs(ColumnTable):
    """Logarithms of the ratios of two photodiodes' values, `one` over `other`, for one direction; arrays of one length.

    `variance` is that of the logarithm, without the monitor's error. `together` numbers the pairs of poses, all of which share
    the monitor's error.
    """

    one: IntegerColumn
    other: IntegerColumn
    ratio: Ratios
    variance: Ratios
    together: IntegerColumn


@dataclass(frozen=True)
class Overlaps:
    """Agreement of the photodiodes: `chi_square` of so many `pairs` of values for one direction.

    It is about `pairs` where the uncertainties are right. `worst` is the largest difference, in its standard uncertainties.
    `factors` are those by which the photodiodes would agree best.
    """

    pairs: int
    chi_square: float
    worst: float
    factors: CalibrationFactors

    def __str__(self) -> str:
        verb = "agree" if self.agree else "do NOT agree"
        return f"{self.pairs} pairs of photodiodes {verb}, chi-square {self.chi_square:.1f}, worst {self.worst:.1f} u"

    def as_dict(self) -> dict[str, Any]:
        """The agreement for JSON."""
        result = {"agree": self.agree, "pairs": self.pairs, "chi_square": self.chi_square, "worst": self.worst}
        return {**result, "calibration": self.factors.as_dict()}

    @property
    def agree(self) -> bool:
        """Whether chi-square and the worst pair are as the uncertainties allow: see `plausible`."""
        return plausible(self.pairs, self.chi_square, self.worst)


class OverlapCheck:
    """Collects the overlaps of a sample's points, which are added in parts of whole pairs of opposite half planes.

    `common` is the relative uncertainty that all points share, the certificate's; `monitor` the one that all points of a row
    share; `angle_deg` the standard uncertainty of a photodiode's direction.
    """

    def __init__(self, common: float, monitor: float = 0.0, angle_deg: float = 0.0) -> None:
        self._common = common
        self._monitor = monitor
        self._angle_deg = angle_deg
        self._differences: list[Floats] = []
        self._pairs: list[OverlapPairs] = []
        self._poses = 0
        self._seen: set[int] = set()

    def add(self, points: BsdfPoints) -> None:
        """Take more points."""
        good = points.where(points.good)
        self._seen.update(np.unique(good.photodiode).tolist())
        # At the horizon the arcs meet: one measures reflected light, the other transmitted.
        light = good.transmitted.astype(float)
        # In the order of blocks, so that sums are the same to the last bit for any size of these.
        settings = [good.sigma_deg, good.gamma_deg, good.wavelength_nm, scan_plane_deg(good.beta_deg)]
        keys = [*settings, *direction_keys(good.zenith_deg, good.azimuth_deg).T, light]
        _, which = np.unique(round_deg(np.stack(keys, axis=1)), axis=0, return_inverse=True)
        order = np.lexsort((good.photodiode, which.ravel()))
        first, second = order[:-1], order[1:]
        same = (which.ravel()[first] == which.ravel()[second]) & (good.photodiode[first] != good.photodiode[second])
        first, second = first[same], second[same]
        angle = (steepness(good) * self._angle_deg * good.bsdf) ** 2
        own = good.own_variance(self._common) + angle
        spread = np.sqrt(own[first] + own[second])
        known = spread > 0.0
        self._differences.append((good.bsdf[first] - good.bsdf[second])[known] / spread[known])
        self._pairs.append(self._ratios(good, own, first, second))

    def result(self) -> Overlaps:
        """The overlaps of all points that were added."""
        z = np.concatenate(self._differences) if self._differences else np.zeros(0)
        none = np.zeros(0, dtype=np.int64)
        kept = self._pairs or [OverlapPairs(none, none, np.zeros(0), np.zeros(0), none)]
        pairs = OverlapPairs.join(kept)
        factors = fit_factors(pairs, np.sqrt(2.0) * self._monitor, self._seen)
        return Overlaps(z.size, float(np.sum(z**2)), float(np.abs(z).max()) if z.size else 0.0, factors)

    def _ratios(self, points: BsdfPoints, own: Floats, first: Ints, second: Ints) -> OverlapPairs:
        """Log ratios of the pairs that are known well enough; their variances are without the monitor's."""
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = np.where(points.bsdf > 0.0, own / points.bsdf**2, np.inf)
        clear = (relative[first] <= RESOLVED**2) & (relative[second] <= RESOLVED**2)
        first, second = first[clear], second[clear]
        pose = [points.sigma_deg, points.gamma_deg, points.wavelength_nm, scan_plane_deg(points.beta_deg)]
        poses = np.stack([*pose, points.beta_deg, points.shift_deg], axis=1)
        both = np.concatenate([poses[first], poses[second][:, 4:]], axis=1)
        kinds, together = np.unique(both, axis=0, return_inverse=True)
        together = together.ravel() + self._poses
        self._poses += len(kinds)
        variance = relative[first] + relative[second] - 2.0 * self._monitor**2
        ratio = np.log(points.bsdf[first] / points.bsdf[second])
        variance = np.maximum(variance, VARIANCE_FLOOR)
        return OverlapPairs(points.photodiode[first], points.photodiode[second], ratio, variance, together)


def overlap_check(settings: ReductionSettings) -> OverlapCheck:
    """The check of the overlaps of a sample, before any of its points is added."""
    table = settings.schedule.overlap
    angle_deg = DEFAULT_ANGLE_UNCERTAINTY_DEG if table is None else table.angle_deg
    return OverlapCheck(settings.certificate.level, math.sqrt(monitor_variance(settings.rig)), angle_deg)


def overlaps(points: BsdfPoints, common: float) -> Overlaps:
    """The overlaps of all points of one sample; `common` as in `OverlapCheck`."""
    check = OverlapCheck(common)
    check.add(points)
    return check.result()


def fit_factors(pairs: OverlapPairs, monitor: float, seen: set[int]) -> CalibrationFactors:
    """Fit the calibration factors to all pairs.

    `monitor` is the relative standard uncertainty that the pairs of two poses share, `seen` are all photodiodes with values.
    """
    pairs = pairs.where(_well_known(pairs, monitor))
    photodiodes, values, uncertainties, widest = [], [], [], 1.0
    for members in _components(pairs):
        inside = np.isin(pairs.one, members)
        g, covariance, widening = _solve(pairs.where(inside), members, monitor)
        widest = max(widest, widening)
        photodiodes += members.tolist()
        values += np.exp(-g).tolist()
        uncertainties += (np.exp(-g) * np.sqrt(np.diag(covariance))).tolist()
    order = np.argsort(photodiodes)
    return CalibrationFactors(
        tuple(photodiodes[k] for k in order),
        tuple(values[k] for k in order),
        tuple(uncertainties[k] for k in order),
        tuple(sorted(seen.difference(photodiodes))),
        int(pairs.one.size),
        widest,
    )


def _well_known(pairs: OverlapPairs, monitor: float) -> Flags:
    """The pairs of two photodiodes whose mean is known well enough."""
    _, which = np.unique(np.stack([pairs.one, pairs.other], axis=1), axis=0, return_inverse=True)
    which = which.ravel()
    weight = np.bincount(which, weights=1.0 / (pairs.variance + monitor**2)) if which.size else np.zeros(0)
    return np.asarray((weight > KNOWN_TO**-2)[which], dtype=bool)


def _components(pairs: OverlapPairs) -> list[Ints]:
    """The photodiodes of each connected part of the graph of pairs."""
    part = {int(k): int(k) for k in np.union1d(pairs.one, pairs.other)}
    for one, other in np.unique(np.stack([pairs.one, pairs.other], axis=1), axis=0).tolist():
        old, new = part[other], part[one]
        part = {k: new if belongs == old else belongs for k, belongs in part.items()}
    return [np.array([k for k, belongs in part.items() if belongs == each]) for each in sorted(set(part.values()))]


def _solve(pairs: OverlapPairs, members: Ints, monitor: float) -> tuple[Floats, Floats, float]:
    """g of the members, its covariance, and the factor by which the uncertainties are widened."""
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
    widening = float(np.sqrt(max(1.0, np.sum(pull * z2) / free)))
    weights = np.bincount(one, weights=weight, minlength=members.size) + np.bincount(other, weight, members.size)
    weights = weights / weights.sum()
    gauge = np.eye(members.size) - weights
    g, covariance = gauge @ g, widening**2 * (gauge @ inverse @ gauge.T)
    errors = np.maximum(g**2 - np.diag(covariance), 0.0)  # without their own uncertainty
    level = float(np.sum(weights**2 * errors)) * members.size / (members.size - 1)
    return g, covariance + level, widening


def _normal_equations(
    one: Ints, other: Ints, together: Ints, ratio: Floats, weight: Floats, size: int, monitor: float
) -> tuple[Floats, Floats, Floats]:
    """The normal equations of g, with the monitor's errors eliminated; and the monitor's share of the residuals of each pair of
    poses.
    """
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
    """For each pair, the median of all pairs of the same two photodiodes."""
    medians = np.empty(ratio.size)
    _, which = np.unique(np.stack([one, other], axis=1), axis=0, return_inverse=True)
    for k in range(int(which.max(initial=-1)) + 1):
        same = which.ravel() == k
        medians[same] = np.median(ratio[same])
    return medians


def _huber(z: Floats) -> Floats:
    return np.asarray(HUBER / np.maximum(np.abs(z), HUBER))
