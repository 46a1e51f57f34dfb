"""Etalon, sample and their ratio at one sigma, by either estimator, with the standard error of each ratio.

A fixed seed gives the same numbers; nothing depends on the time that anything takes.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from app.errors import UserError
from twin.optics import Instrument, Scatterer, forward, lambertian, spectral_throughput, throughput

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Kind = Literal["fast", "forward"]
Told = Callable[[float], None]
"""Told the share of the work that is done."""
NODES = 7
CHECK_RAYS = 1024
MOST_RAYS = 1 << 15
BATCH = 1 << 20
FEWEST_BATCHES = 2
MOST_PATHS = 1 << 34
MATTERS = 0.01
"""Errors are asked for over the values of at least this share of the largest."""


@dataclass(frozen=True)
class Effort:
    """How an estimator is to be run: with so many `rays` a detector, so many `paths`, or to an error in percent.

    The error is the median relative standard error of the ratios, over the directions that have at least a hundredth of
    the largest. Raises UserError for what does not belong to the estimator.
    """

    kind: Kind = "fast"
    rays: int | None = None
    paths: int | None = None
    error_percent: float | None = None
    seed: int = 1

    def __post_init__(self) -> None:
        """Checks."""
        if self.kind == "fast" and self.paths is not None:
            raise UserError("--paths: the fast estimator has rays; give --rays, or --estimator forward")
        if self.kind == "forward" and self.rays is not None:
            raise UserError("--rays: the forward estimator has paths; give --paths, or --estimator fast")
        given = [name for name in ("rays", "paths") if getattr(self, name) is not None]
        if given and self.error_percent is not None:
            raise UserError(f"--error and --{given[0]}: give one of them; the other follows from it")
        if self.rays is not None and not (8 <= self.rays <= MOST_RAYS and self.rays % 8 == 0):
            raise UserError(f"--rays: {self.rays} will not do; give a multiple of 8, from 8 to {MOST_RAYS}")
        if self.paths is not None and not 1000 <= self.paths <= MOST_PATHS:
            raise UserError(f"--paths: {self.paths} will not do; give 1000 to {MOST_PATHS}")
        if self.error_percent is not None and not (math.isfinite(self.error_percent) and self.error_percent > 0.0):
            raise UserError(f"--error: {self.error_percent:g} will not do; give a percentage above 0")
        if not 0 <= self.seed < 2**63:
            raise UserError(f"--seed: {self.seed} will not do; give a whole number from 0")


@dataclass(frozen=True, eq=False)
class Ratio:
    """At one sigma and w wavelengths, for n detectors, (w, n) each.

    Throughputs of `sample` and `etalon` in m^2 sr, their ratio `factor` (formula 1: the luminance factor, for the etalon
    is an ideal diffuser), and its standard error. NaN: of a factor where the etalon gives nothing, of an error where
    nothing is known of it (no path has met the detector). `count` is the rays a detector, or the paths.
    """

    sample_m2sr: Floats
    etalon_m2sr: Floats
    factor: Floats
    standard_error: Floats
    count: int

    def without(self, hidden: Flags) -> "Ratio":
        """The same with no value where `hidden` (n,); the throughputs stay as they are."""
        factor, error = (np.where(hidden, np.nan, each) for each in (self.factor, self.standard_error))
        return replace(self, factor=factor, standard_error=error)

    @property
    def relative_error(self) -> Floats:
        """Relative standard errors, a flat list, of the values that matter; empty where none is known."""
        known = np.isfinite(self.factor) & np.isfinite(self.standard_error) & (self.factor > 0.0)
        if not known.any():
            return np.empty(0)
        known &= self.factor >= MATTERS * self.factor[known].max()
        relative: Floats = self.standard_error[known] / self.factor[known]
        return relative

    @property
    def median_percent(self) -> float:
        """Median of `relative_error`, in percent; infinite where none is known."""
        relative = self.relative_error
        return 100.0 * float(np.median(relative)) if relative.size else math.inf


def etalon(transmitted: bool) -> Scatterer:
    """The ideal diffuser to the side that is looked at."""
    return lambertian(0.0, 1.0) if transmitted else lambertian()


def ratio_at(
    instrument: Instrument,
    sigma_deg: float,
    directions: Floats,
    sample: Scatterer,
    wavelengths_nm: Floats | None,
    transmitted: bool,
    effort: Effort,
    told: Told = lambda _: None,
) -> Ratio:
    """Etalon first, then the sample (paper, figure 7), at `directions` (n, 3). Raises UserError.

    Without wavelengths the sample is grey and w = 1.
    """
    white = etalon(transmitted)
    if effort.kind == "fast":
        return _fast(instrument, sigma_deg, directions, (sample, white), wavelengths_nm, effort, told)
    if wavelengths_nm is None:
        return _forward(instrument, sigma_deg, directions, (sample, white), None, effort, told)
    if sample.spectrum is None:
        return _stacked(
            [_forward(instrument, sigma_deg, directions, (sample, white), None, effort, told)] * wavelengths_nm.size
        )
    count, found = wavelengths_nm.size, []
    for k, wavelength in enumerate(wavelengths_nm.tolist()):

        def of_all(share: float, k: int = k) -> None:
            told((k + share) / count)

        found.append(_forward(instrument, sigma_deg, directions, (sample, white), wavelength, effort, of_all))
    return _stacked(found)


def _fast(
    instrument: Instrument,
    sigma_deg: float,
    directions: Floats,
    pair: tuple[Scatterer, Scatterer],
    wavelengths_nm: Floats | None,
    effort: Effort,
    told: Told,
) -> Ratio:
    """The standard error is the difference to another set of rays: it is a bound more than a standard deviation."""

    def with_rays(rays: int | None) -> tuple[Floats, Floats]:
        flux = [
            throughput(instrument, sigma_deg, directions, each, rays)[None]
            if wavelengths_nm is None
            else spectral_throughput(instrument, sigma_deg, directions, each, wavelengths_nm, rays)
            for each in pair
        ]
        return flux[0], flux[1]

    rays = effort.rays
    check = with_rays(CHECK_RAYS if rays is None else rays // 2)
    while True:
        told(0.5)
        flux = with_rays(rays)
        factor = _over(*flux)
        found = Ratio(*flux, factor, np.abs(factor - _over(*check)), NODES if rays is None else rays)
        wanted = effort.error_percent
        if wanted is None or found.median_percent <= wanted:
            told(1.0)
            return found
        rays = 2 * CHECK_RAYS if rays is None else 2 * rays
        check = check if rays == 2 * CHECK_RAYS else flux
        if rays > MOST_RAYS:
            wrong = f"--error: {wanted:g} % takes more than {MOST_RAYS} rays a detector at sigma {sigma_deg:g}"
            raise UserError(f"{wrong}; ask for a larger one")


def _over(sample: Floats, white: Floats) -> Floats:
    ratio: Floats = np.divide(sample, white, out=np.full_like(sample, np.nan), where=white > 0.0)
    return ratio


def _forward(
    instrument: Instrument,
    sigma_deg: float,
    directions: Floats,
    pair: tuple[Scatterer, Scatterer],
    wavelength_nm: float | None,
    effort: Effort,
    told: Told,
) -> Ratio:
    """Batches of paths, sample and etalon each its own, until there are enough of them or the error is small enough."""
    wanted = effort.error_percent
    paths = 4 * BATCH if effort.paths is None else effort.paths
    tallies = _Tally(directions.shape[0]), _Tally(directions.shape[0])
    batch = 0
    while True:
        size = BATCH if wanted is not None else min(BATCH, paths - tallies[0].paths)
        for k, (each, tally) in enumerate(zip(pair, tallies, strict=True)):
            seed = effort.seed * 2**20 + 2 * batch + k
            try:
                done = forward(instrument, sigma_deg, directions, each, size, seed % 2**64, wavelength_nm=wavelength_nm)
            except ValueError as error:
                raise UserError(f"--estimator forward: {error}") from None
            tally.add(done.throughput_m2sr, done.standard_error, done.paths)
        batch += 1
        found = _counted(tallies[0], tallies[1])
        reached = tallies[0].paths
        if wanted is None:
            told(min(1.0, reached / paths))
            if paths - reached < 2:
                return found
            continue
        median = found.median_percent
        if batch >= FEWEST_BATCHES and median <= wanted:
            return found
        needed = reached * (median / wanted) ** 2
        if math.isfinite(needed):
            told(min(0.99, reached / needed))
        if (math.isfinite(needed) and needed > MOST_PATHS) or reached >= MOST_PATHS:
            raise UserError(
                f"--error: {wanted:g} % at sigma {sigma_deg:g} would take about {needed:.2g} paths, more than {MOST_PATHS}; "
                "ask for a larger one, or use the fast estimator"
            )


class _Tally:
    """Means of batches, weighted by their paths, and their variance."""

    def __init__(self, count: int) -> None:
        self.paths = 0
        self._sum, self._variance = np.zeros(count), np.zeros(count)

    def add(self, mean: Floats, error: Floats, paths: int) -> None:
        """One more batch."""
        self.paths += paths
        self._sum += paths * mean
        self._variance += (paths * error) ** 2

    @property
    def mean(self) -> Floats:
        """Of all paths, (n,)."""
        mean: Floats = self._sum / self.paths
        return mean

    @property
    def variance(self) -> Floats:
        """Of the mean, (n,)."""
        variance: Floats = self._variance / self.paths**2
        return variance


def _counted(sample: _Tally, white: _Tally) -> Ratio:
    factor = _over(sample.mean, white.mean)
    with np.errstate(invalid="ignore", divide="ignore"):
        relative2 = sample.variance / sample.mean**2 + white.variance / white.mean**2
        error = np.where(sample.mean > 0.0, factor * np.sqrt(relative2), np.nan)
    return Ratio(sample.mean[None], white.mean[None], factor[None], error[None], sample.paths)


def _stacked(ratios: Sequence[Ratio]) -> Ratio:
    """One for each wavelength, as one."""
    names = ("sample_m2sr", "etalon_m2sr", "factor", "standard_error")
    rows = [np.concatenate([getattr(ratio, name) for ratio in ratios]) for name in names]
    return Ratio(rows[0], rows[1], rows[2], rows[3], max(ratio.count for ratio in ratios))
