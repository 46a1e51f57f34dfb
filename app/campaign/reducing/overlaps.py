"""Directions that two photodiodes have seen: a check of formula 1.

They do not calibrate anything. In formula 1 each photodiode is divided by itself at the etalon, so that what it and its
amplifier make of light cancels, and what is left of a difference between two photodiodes is noise, dark, gain and monitor,
which are in the uncertainty. A ratio of responsivities from an overlap has the noise of two photodiodes at the sample; the
one that formula 1 uses has that of one at the sample and one at the etalon, where there is light enough. So the overlap
never knows it better. But the two values have to agree; a photodiode that moved, or took another's light, shows here.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from app.campaign.reducing.agreement import plausible
from app.campaign.reducing.points import BsdfPoints, Floats

HALF_TURN_DEG = 180.0


@dataclass(frozen=True)
class Overlaps:
    """`chi_square` of `pairs` of values for one direction: about `pairs` where the uncertainties are right;
    `worst` is the greatest difference, in its standard uncertainties.
    """

    pairs: int
    chi_square: float
    worst: float

    def __str__(self) -> str:
        said = "agree" if self.agree else "do NOT agree"
        return f"{self.pairs} pairs of photodiodes {said}, chi-square {self.chi_square:.1f}, worst {self.worst:.1f} u"

    def as_dict(self) -> dict[str, Any]:
        """For programs."""
        return {"agree": self.agree, "pairs": self.pairs, "chi_square": self.chi_square, "worst": self.worst}

    @property
    def agree(self) -> bool:
        """Within five standard deviations of the chi-square distribution, and no pair worse than chance allows."""
        return plausible(self.pairs, self.chi_square, self.worst)


class OverlapCheck:
    """Takes a sample's points, in any parts of whole pairs of opposite half planes, and keeps what two photodiodes have seen.

    `common` is the part of the relative uncertainty that all its points share, the certificate's.
    """

    def __init__(self, common: float) -> None:
        self._common = common
        self._kept: list[Floats] = []

    def add(self, points: BsdfPoints) -> None:
        """Some more points."""
        good = points.where(points.good)
        own: Floats = np.sqrt(np.maximum(good.u_bsdf**2 - (self._common * good.bsdf) ** 2, 0.0))
        azimuth = np.where(good.zenith_deg < 1e-6, 0.0, good.azimuth_deg)
        plane = np.mod(good.beta_deg, HALF_TURN_DEG)
        keys = [good.wavelength_nm, good.sigma_deg, good.gamma_deg, plane, good.zenith_deg, azimuth]
        _, which = np.unique(np.round(np.stack(keys, axis=1), 6), axis=0, return_inverse=True)
        order = np.lexsort((good.photodiode, which.ravel()))
        first, second = order[:-1], order[1:]
        same = (which.ravel()[first] == which.ravel()[second]) & (good.photodiode[first] != good.photodiode[second])
        first, second = first[same], second[same]
        spread = np.hypot(own[first], own[second])
        known = spread > 0.0
        self._kept.append((good.bsdf[first] - good.bsdf[second])[known] / spread[known])

    def verdict(self) -> Overlaps:
        """Of all points that were added."""
        z = np.concatenate(self._kept) if self._kept else np.zeros(0)
        return Overlaps(z.size, float(np.sum(z**2)), float(np.abs(z).max()) if z.size else 0.0)


def overlaps(points: BsdfPoints, common: float) -> Overlaps:
    """Of all points of one sample: see `OverlapCheck`."""
    check = OverlapCheck(common)
    check.add(points)
    return check.verdict()
