"""Directions that two photodiodes have seen: a check of formula 1, and what its photodiodes can be calibrated by.

In formula 1 each photodiode is divided by itself at the etalon, so that what it and its amplifier make of light cancels. What
is left of a difference between two is noise, dark, gain and monitor, which are in the uncertainty; the angles, which matter
where the lobe is steep; and whatever has changed between etalon and sample. Two values have to agree within these.

To calibrate by overlaps (app.campaign.reduction.calibration) is for the operator to ask for. Where nothing has changed it makes
nothing better: the overlap has the noise of two photodiodes at the sample, the etalon that of one, where there is light enough.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from goniotwin.app.campaign.reduction.agreement import plausible
from goniotwin.app.campaign.reduction.calibration import Factors, Pairs, calibrated
from goniotwin.app.campaign.reduction.points import BsdfPoints, steepness
from goniotwin.arrays import Floats, Ints

HALF_TURN_DEG = 180.0
RESOLVED = 0.1
"""A pair with a value that is known no better than this says nothing of a ratio: its logarithm would be that of noise."""


@dataclass(frozen=True)
class Overlaps:
    """`chi_square` of `pairs` of values for one direction: about `pairs` where the uncertainties are right;
    `worst` is the greatest difference, in its standard uncertainties. `factors` are by what the photodiodes would agree best.
    """

    pairs: int
    chi_square: float
    worst: float
    factors: Factors

    def __str__(self) -> str:
        said = "agree" if self.agree else "do NOT agree"
        return f"{self.pairs} pairs of photodiodes {said}, chi-square {self.chi_square:.1f}, worst {self.worst:.1f} u"

    def as_dict(self) -> dict[str, Any]:
        """For programs."""
        told = {"agree": self.agree, "pairs": self.pairs, "chi_square": self.chi_square, "worst": self.worst}
        return {**told, "calibration": self.factors.as_dict()}

    @property
    def agree(self) -> bool:
        """Within five standard deviations of the chi-square distribution, and no pair worse than chance allows."""
        return plausible(self.pairs, self.chi_square, self.worst)


class OverlapCheck:
    """Takes a sample's points, in any parts of whole pairs of opposite half planes, and keeps what two photodiodes have seen.

    `common` is the part of the relative uncertainty that all its points share, the certificate's; `monitor` that which all
    points of a row share; `angle_deg` how well it is known where a photodiode looks (standard).
    """

    def __init__(self, common: float, monitor: float = 0.0, angle_deg: float = 0.0) -> None:
        self._common = common
        self._monitor = monitor
        self._angle_deg = angle_deg
        self._differences: list[Floats] = []
        self._pairs: list[Pairs] = []
        self._poses = 0
        self._seen: set[int] = set()

    def add(self, points: BsdfPoints) -> None:
        """Some more points."""
        good = points.where(points.good)
        self._seen.update(np.unique(good.photodiode).tolist())
        azimuth = np.where(good.zenith_deg < 1e-6, 0.0, good.azimuth_deg)
        plane = np.mod(good.beta_deg, HALF_TURN_DEG)
        # At the horizon the arcs meet, and one sees reflected light, the other transmitted.
        light = good.transmitted.astype(float)
        keys = [good.wavelength_nm, good.sigma_deg, good.gamma_deg, plane, good.zenith_deg, azimuth, light]
        _, which = np.unique(np.round(np.stack(keys, axis=1), 6), axis=0, return_inverse=True)
        order = np.lexsort((good.photodiode, which.ravel()))
        first, second = order[:-1], order[1:]
        same = (which.ravel()[first] == which.ravel()[second]) & (good.photodiode[first] != good.photodiode[second])
        first, second = first[same], second[same]
        angle = (steepness(good) * self._angle_deg * good.bsdf) ** 2
        own = np.maximum(good.u_bsdf**2 - (self._common * good.bsdf) ** 2, 0.0) + angle
        spread = np.sqrt(own[first] + own[second])
        known = spread > 0.0
        self._differences.append((good.bsdf[first] - good.bsdf[second])[known] / spread[known])
        self._pairs.append(self._ratios(good, own, first, second))

    def verdict(self) -> Overlaps:
        """Of all points that were added."""
        z = np.concatenate(self._differences) if self._differences else np.zeros(0)
        none = np.zeros(0, dtype=np.int64)
        kept = self._pairs or [Pairs(none, none, np.zeros(0), np.zeros(0), none)]
        names = ("one", "other", "ratio", "variance", "together")
        pairs = Pairs(*(np.concatenate([getattr(each, name) for each in kept]) for name in names))
        factors = calibrated(pairs, np.sqrt(2.0) * self._monitor, self._seen)
        return Overlaps(z.size, float(np.sum(z**2)), float(np.abs(z).max()) if z.size else 0.0, factors)

    def _ratios(self, points: BsdfPoints, own: Floats, first: Ints, second: Ints) -> Pairs:
        """Log ratios of those pairs that are known well enough, the monitor's part not in their variances."""
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = np.where(points.bsdf > 0.0, own / points.bsdf**2, np.inf)
        clear = (relative[first] <= RESOLVED**2) & (relative[second] <= RESOLVED**2)
        first, second = first[clear], second[clear]
        pose = [points.wavelength_nm, points.sigma_deg, points.gamma_deg, np.mod(points.beta_deg, HALF_TURN_DEG)]
        poses = np.stack([*pose, points.beta_deg, points.shift_deg], axis=1)
        both = np.concatenate([poses[first], poses[second][:, 4:]], axis=1)
        kinds, together = np.unique(both, axis=0, return_inverse=True)
        together = together.ravel() + self._poses
        self._poses += len(kinds)
        variance = relative[first] + relative[second] - 2.0 * self._monitor**2
        ratio = np.log(points.bsdf[first] / points.bsdf[second])
        # What is left beside the monitor's part is never quite nothing: a part in a million stands for what nobody has stated.
        return Pairs(points.photodiode[first], points.photodiode[second], ratio, np.maximum(variance, 1e-12), together)


def overlaps(points: BsdfPoints, common: float) -> Overlaps:
    """Of all points of one sample: see `OverlapCheck`."""
    check = OverlapCheck(common)
    check.add(points)
    return check.verdict()
