"""Values by their decade below the peak of their light, and their relative uncertainty there.

Most directions of a lobe have values below its noise: a median over all of them states the noise. What a campaign is made for
is near the peak, so a summary of u is of the values above 1 % of the peak, and by decade.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.arrays import Floats, Ints

DECADES = 6
DECADE_NAMES = (*(f"1e{-k:+d} to 1e{-k - 1:+d}" for k in range(DECADES - 1)), f"below 1e{1 - DECADES}")
"""Shares of the peak, by decade."""
UPPER_DECADES = 2
"""So many decades are above 1 % of the peak."""
PERCENTILES = (5, 50, 95)
WELL_KNOWN = 0.1


def decades_below_peak(points: BsdfPoints, value: Floats) -> Ints:
    """The decade (n,) of each value: 0 down to a tenth of the peak, then 1, ...; the last one has all that is below.

    The peak is the largest value of the light: of a wavelength, sigma, gamma and side. `value` is (n,), measured or true.
    """
    light = np.stack([points.wavelength_nm, points.sigma_deg, points.gamma_deg, points.transmitted], axis=1)
    _, which = np.unique(light, axis=0, return_inverse=True)
    peak = np.zeros(int(which.max(initial=-1)) + 1)
    np.maximum.at(peak, which.ravel(), value)
    share = value / np.maximum(peak[which.ravel()], np.finfo(float).tiny)
    return np.clip(np.floor(-np.log10(np.maximum(share, 10.0**-DECADES))), 0, DECADES - 1).astype(np.int64)


def relative_uncertainty(points: BsdfPoints) -> Floats:
    """Relative standard uncertainties (n,); NaN where the value is not above zero."""
    value = np.where(points.bsdf > 0.0, points.bsdf, np.nan)
    relative: Floats = points.u_bsdf / value
    return relative


@dataclass
class UncertaintyByDecade:
    """Relative uncertainties of a sample's trusted values above zero, with their decades; points are added in whole lights."""

    relative: list[Floats] = field(default_factory=list)
    decade: list[Ints] = field(default_factory=list)

    def add(self, points: BsdfPoints) -> None:
        """Take more points."""
        good = points.where(points.good & (points.bsdf > 0.0))
        self.relative.append(relative_uncertainty(good))
        self.decade.append(decades_below_peak(good, good.bsdf))

    def as_dict(self) -> dict[str, Any]:
        """Percentiles of the values above 1 % of the peak and by decade; how many values are known to a tenth."""
        relative = np.concatenate([np.zeros(0), *self.relative])
        decade = np.concatenate([np.zeros(0, dtype=np.int64), *self.decade])
        return {
            **_percentiles(relative[decade < UPPER_DECADES]),
            "decades": [{"of_peak": each, **_percentiles(relative[decade == k])} for k, each in enumerate(DECADE_NAMES)],
            "above_zero": relative.size,
            "to_a_tenth": int(np.sum(relative <= WELL_KNOWN)),
        }


def _percentiles(relative: Floats) -> dict[str, Any]:
    found: Sequence[float | None] = [None] * len(PERCENTILES)
    if relative.size:
        found = np.percentile(relative, PERCENTILES).tolist()
    return {"values": relative.size, **{f"p{each:02d}": value for each, value in zip(PERCENTILES, found, strict=True)}}


def uncertainty_texts(found: Mapping[str, Any]) -> list[str]:
    """The result of `UncertaintyByDecade` in words: above 1 % of the peak, and by decade. None without a value above zero."""
    by_decade = [
        f"{each['of_peak'].removeprefix(f'1e{-k:+d} ')}: {_percent(each['p50'])} ({each['values']})"
        for k, each in enumerate(found["decades"])
        if each["values"]
    ]
    if not by_decade:
        return []
    upper = (
        f"u above 1 % of the peak: median {_percent(found['p50'])}, 5th to 95th percentile {_percent(found['p05'])} to "
        f"{_percent(found['p95'])} ({found['values']} values)"
    )
    return [upper, f"median u by share of the peak (values): {', '.join(by_decade)}"]


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %" if share < 1.0 else f"{100.0 * share:.0f} %"
