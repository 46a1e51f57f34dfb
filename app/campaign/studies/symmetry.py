"""`[symmetry_check]`: test of the symmetry that a schedule states for its sample, by mirrored poses.

A direction and its mirror image are measured by the same photodiode at the same incidence, so that the etalon's certificate is
common to both values. Allowed differences are those by noise and gain; by the monitor, one number for all photodiodes of a
row; by the lamp's flicker, because each photodiode is read at its own time (the monitor's uncertainty once more is allowed for
it); and by the angles, because on a steep lobe a small error of an axis makes a difference that the sample does not have. A
large misalignment of an axis or of the sample fails the check as an anisotropic sample does: in both cases a table that
relies on the symmetry would be wrong.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from goniotwin.app.campaign.geometry.symmetry import canonical_poses
from goniotwin.app.campaign.reduction.points import BsdfPoints, plausible, steepness
from goniotwin.app.campaign.schedule.refinement import StatedSymmetry
from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.coordinates import round_deg

Columns = dict[str, Floats]
RESOLVED = 0.05
"""Largest uncertainty of a relative difference that counts for the statement within what a symmetry holds."""
PAIR_KEYS = ("wavelength_nm", "sigma_deg", "shift_deg", "gamma", "beta", "photodiode")


@dataclass(frozen=True)
class SymmetryResult:
    """The differences of `pairs` of a value and the value of its mirror image.

    `chi_square` is about `pairs` where the symmetry holds; `worst` is the largest difference in its standard uncertainties,
    `beyond` the share of differences beyond two. `largest` is a relative difference, with its standard uncertainty, at the
    direction `where`: the largest of the well-known ones, or, where the symmetry does not hold, the worst.
    """

    stated: StatedSymmetry
    pairs: int
    chi_square: float
    worst: float
    beyond: float
    largest: float
    u_largest: float
    where: str

    @property
    def holds(self) -> bool:
        """Whether the pairs differ by no more than their uncertainties allow; False where there are none."""
        return self.pairs > 0 and plausible(self.pairs, self.chi_square, self.worst)

    def __str__(self) -> str:
        symmetry = f"the stated symmetry ({self.stated})"
        if not self.pairs:
            return f"{symmetry} cannot be checked: no direction has a value at its mirror image, too"
        if self.holds:
            within = f"{symmetry} holds within {self.largest:.2%} ({self.pairs} pairs, chi-square {self.chi_square:.1f}"
            return f"{within}, {self.beyond:.1%} beyond 2 u; largest at {self.where}, u {self.u_largest:.2%})"
        return (
            f"{symmetry} does NOT hold: {self.beyond:.1%} of {self.pairs} pairs differ by more than 2 u (chi-square "
            f"{self.chi_square:.1f}), by {self.largest:.2%} ({self.worst:.1f} u) at {self.where}"
        )

    def as_dict(self) -> dict[str, Any]:
        """The result for JSON."""
        values = {name: float(getattr(self, name)) for name in ("chi_square", "worst", "beyond", "largest", "u_largest")}
        holds = self.holds if self.pairs else None
        return {"stated": self.stated, "holds": holds, "pairs": self.pairs, **values, "where": self.where}


class SymmetryCheck:
    """Collects the points of a sample that have a mirror image; they are added in parts of whole half planes.

    `mirrored` (n, 4) are the poses measured for the check. `angle_deg` is the standard uncertainty of the axes, `common` the
    relative uncertainty that all points share, `monitor` the one that all points of a row share.
    """

    def __init__(self, stated: StatedSymmetry, mirrored: Floats, angle_deg: float, *, common: float, monitor: float) -> None:
        self._stated = stated
        self._poses = {tuple(pose) for pose in np.unique(canonical_poses(mirrored, stated), axis=0).tolist()}
        self._angle_deg = angle_deg
        self._common = common
        self._monitor = monitor
        self._kept: list[Columns] = []

    def add(self, points: BsdfPoints) -> None:
        """Take more points."""
        poses = np.stack([points.gamma_deg, points.sigma_deg, points.beta_deg, points.shift_deg], axis=1)
        same = canonical_poses(poses, self._stated)
        rows, which = np.unique(same, axis=0, return_inverse=True)
        checked = np.array([tuple(row) in self._poses for row in rows.tolist()], dtype=bool)[which.ravel()]
        chosen = checked & points.good
        if not chosen.any():
            return
        slope = steepness(points)[chosen]
        here = points.where(chosen)
        own = here.own_variance(self._common) + (slope * self._angle_deg * here.bsdf) ** 2
        columns = {name: np.asarray(getattr(here, name), dtype=float) for name in PAIR_KEYS if name not in ("gamma", "beta")}
        columns |= {"gamma": same[chosen, 0], "beta": same[chosen, 2], "value": here.bsdf, "variance": own}
        columns |= {"zenith": here.zenith_deg, "azimuth": here.azimuth_deg, "mirrored": here.mirrored.astype(float)}
        self._kept.append(columns)

    def result(self) -> SymmetryResult:
        """The differences of all points that were added."""
        empty = SymmetryResult(self._stated, 0, 0.0, 0.0, 0.0, math.nan, math.nan, "")
        if not self._kept:
            return empty
        columns = {name: np.concatenate([each[name] for each in self._kept]) for name in self._kept[0]}
        keys, first, which = np.unique(
            round_deg(np.stack([columns[name] for name in PAIR_KEYS], axis=1)),
            axis=0,
            return_index=True,
            return_inverse=True,
        )
        mirrored = columns["mirrored"] > 0.0
        means = [_means(columns, which.ravel(), len(keys), chosen) for chosen in (~mirrored, mirrored)]
        paired = np.isfinite(means[0][0]) & np.isfinite(means[1][0])
        (one, var_one), (other, var_other) = ((value[paired], variance[paired]) for value, variance in means)
        if not one.size:
            return empty
        row = np.unique(keys[paired][:, :-1], axis=0, return_inverse=True)[1].ravel()
        mean, difference = 0.5 * (one + other), other - one
        variance = np.maximum(var_one + var_other, np.finfo(float).tiny)
        common = 2.0 * self._monitor**2
        u = np.sqrt(variance + common * mean**2)
        worse = np.abs(difference) / u
        # The monitor's error changes all photodiodes of a row together: one degree of freedom for each row.
        plain = np.bincount(row, weights=difference**2 / variance)
        along = np.bincount(row, weights=difference * mean / variance)
        length = np.bincount(row, weights=mean**2 / variance)
        chi_square = float(np.sum(plain - common * along**2 / (1.0 + common * length)))
        result = SymmetryResult(
            self._stated, int(one.size), chi_square, float(worse.max()), float(np.mean(worse > 2.0)), math.nan, math.nan, ""
        )
        safe = np.where(mean == 0.0, np.nan, np.abs(mean))
        relative, u_relative = np.abs(difference) / safe, u / safe
        resolved = u_relative <= RESOLVED
        ranked = np.where(resolved if resolved.any() else np.isfinite(relative), relative, -1.0) if result.holds else worse
        k = int(np.argmax(ranked))
        at = {name: column[first[paired][k]] for name, column in columns.items()}
        where = (
            f"{at['wavelength_nm']:g} nm, sigma {at['sigma_deg']:g}, zenith {at['zenith']:g}, azimuth {at['azimuth']:g} deg "
            f"(photodiode {at['photodiode']:.0f})"
        )
        counts = (result.stated, result.pairs, result.chi_square, result.worst, result.beyond)
        return SymmetryResult(*counts, float(relative[k]), float(u_relative[k]), where)


def _means(columns: Columns, which: np.ndarray, size: int, chosen: np.ndarray) -> tuple[Floats, Floats]:
    """Means and variances of the `chosen` values, by their index `which` below `size`; NaN where there is none.

    The variance is that of one value: repeats share the etalon that scales them.
    """
    counts = np.bincount(which[chosen], minlength=size)
    counts = np.where(counts == 0, np.nan, counts)
    value = np.bincount(which[chosen], weights=columns["value"][chosen], minlength=size) / counts
    variance = np.bincount(which[chosen], weights=columns["variance"][chosen], minlength=size) / counts
    return value, variance
