"""Values by their decade below the peak of their light, and their relative uncertainty there.

Most directions of a lobe have values below its noise: a median over all of them states the noise. What a campaign is made for
is near the peak, so a summary of u is of the values above 1 % of the peak, and by decade.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.schedule.file import TargetTable
from goniotwin.arrays import Floats, Ints

DECADES = 6
DECADE_NAMES = (*(f"1e{-k:+d} to 1e{-k - 1:+d}" for k in range(DECADES - 1)), f"below 1e{1 - DECADES}")
"""Shares of the peak, by decade."""
UPPER_DECADES = 2
"""So many decades are above 1 % of the peak."""
PERCENTILES = (5, 50, 95)
WELL_KNOWN = 0.1
LEAST_SHARE_MET = 0.95
"""Share of the values of a decade that have the relative u that is asked for, from which on the decade meets the target."""


def decades_below_peak(points: BsdfPoints, value: Floats) -> Ints:
    """The decade (n,) of each value: 0 down to a tenth of the peak, then 1, ...; the last one has all that is below.

    `value` is (n,), measured or true.
    """
    return _decades(peak_shares(points, value))


def peak_shares(points: BsdfPoints, value: Floats) -> Floats:
    """Each value (n,) over its peak: the largest value of the light, which is that of a wavelength, sigma, gamma and side."""
    light = np.stack([points.wavelength_nm, points.sigma_deg, points.gamma_deg, points.transmitted], axis=1)
    _, which = np.unique(light, axis=0, return_inverse=True)
    peak = np.zeros(int(which.max(initial=-1)) + 1)
    np.maximum.at(peak, which.ravel(), value)
    return np.asarray(value / np.maximum(peak[which.ravel()], np.finfo(float).tiny))


def _decades(share: Floats) -> Ints:
    return np.clip(np.floor(-np.log10(np.maximum(share, 10.0**-DECADES))), 0, DECADES - 1).astype(np.int64)


def relative_uncertainty(points: BsdfPoints) -> Floats:
    """Relative standard uncertainties (n,); NaN where the value is not above zero."""
    value = np.where(points.bsdf > 0.0, points.bsdf, np.nan)
    relative: Floats = points.u_bsdf / value
    return relative


@dataclass(frozen=True)
class DecadeSummary:
    """Number and percentiles of the relative uncertainties in a decade below the peak; NaN without a value."""

    of_peak: str
    values: int
    p05: float
    p50: float
    p95: float


@dataclass(frozen=True)
class UncertaintySummary:
    """Number and percentiles of the relative uncertainties above 1 % of the peak, and by decade; NaN without a value.

    `above_zero` is the number of all values above zero, `to_a_tenth` of those that are known to a tenth.
    """

    values: int
    p05: float
    p50: float
    p95: float
    decades: list[DecadeSummary]
    above_zero: int
    to_a_tenth: int


@dataclass(frozen=True)
class TargetInDecade:
    """How many values of a decade below the peak a `[target]` asks about, and how many are `within` its relative u.

    `met`: at least 95 % of them are.
    """

    of_peak: str
    values: int
    within: int
    met: bool


@dataclass
class UncertaintyByDecade:
    """Relative uncertainties of a sample's trusted values above zero, with their shares of the peak.

    Points are added in whole lights.
    """

    relative: list[Floats] = field(default_factory=list)
    share: list[Floats] = field(default_factory=list)

    def add(self, points: BsdfPoints) -> None:
        """Take more points."""
        good = points.where(points.good & (points.bsdf > 0.0))
        self.relative.append(relative_uncertainty(good))
        self.share.append(peak_shares(good, good.bsdf))

    def against(self, target: TargetTable | None) -> list[TargetInDecade]:
        """The values that a target asks about, by decade; none without a target of u."""
        if target is None or target.relative_u is None:
            return []
        share = np.concatenate([np.zeros(0), *self.share])
        asked = share >= target.above_peak_share
        within, decade = np.concatenate([np.zeros(0), *self.relative])[asked] <= target.relative_u, _decades(share[asked])
        found = []
        for k, each in enumerate(DECADE_NAMES):
            if values := int(np.sum(decade == k)):
                good = int(np.sum(within[decade == k]))
                found.append(TargetInDecade(each, values, good, good >= LEAST_SHARE_MET * values))
        return found

    def summary(self) -> UncertaintySummary:
        """The summary of all values that were added."""
        relative = np.concatenate([np.zeros(0), *self.relative])
        decade = _decades(np.concatenate([np.zeros(0), *self.share]))
        upper = relative[decade < UPPER_DECADES]
        return UncertaintySummary(
            upper.size,
            *_percentiles(upper),
            [
                DecadeSummary(each, relative[decade == k].size, *_percentiles(relative[decade == k]))
                for k, each in enumerate(DECADE_NAMES)
            ],
            relative.size,
            int(np.sum(relative <= WELL_KNOWN)),
        )


def _percentiles(relative: Floats) -> tuple[float, float, float]:
    p05, p50, p95 = np.percentile(relative, PERCENTILES).tolist() if relative.size else (math.nan,) * 3
    return p05, p50, p95


def uncertainty_texts(found: UncertaintySummary) -> list[str]:
    """A summary in words: above 1 % of the peak, and by decade. None without a value above zero."""
    by_decade = [f"{_end(each.of_peak)}: {percent(each.p50)} ({each.values})" for each in found.decades if each.values]
    if not by_decade:
        return []
    upper = (
        f"u above 1 % of the peak: median {percent(found.p50)}, 5th to 95th percentile {percent(found.p05)} to "
        f"{percent(found.p95)} ({found.values} values)"
    )
    return [upper, f"median u by share of the peak (values): {', '.join(by_decade)}"]


def target_texts(found: list[TargetInDecade]) -> list[str]:
    """The values against a target in words, by decade: `to 1e-1 of the peak: 12 of 12 values, met`."""
    return [
        f"{_end(each.of_peak)} of the peak: {each.within} of {each.values} values, {'met' if each.met else 'missed'}"
        for each in found
    ]


def _end(of_peak: str) -> str:
    """The lower end of a decade's name."""
    return of_peak if of_peak.startswith("below") else of_peak.partition(" ")[2]


def percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 1.0 else f"{100.0 * share:.0f} %"
