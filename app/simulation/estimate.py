"""Etalon, sample and their ratio at one sigma, by either estimator, with the standard error of each ratio.

A fixed seed gives the same numbers; nothing depends on the time that anything takes. Both estimators are about the same: light
that was scattered once, by the sample; and where stray light is wanted, both have it in.

How much of an estimator's work is wanted.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from goniotwin.app.errors import UserError
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import (
    Instrument,
    RaySource,
    SampleFrames,
    Scatterer,
    forward_throughput,
    lambertian,
    spectral_throughput,
    stray_map,
    stray_throughput,
    throughput,
)
from goniotwin.twin.optics.bsdf.analytic_samples import Side
from goniotwin.twin.optics.fast.lobe_sums import FINE_RULE, TABLE_KINDS
from goniotwin.twin.optics.geometry.scene import scene_at

Kind = Literal["fast", "forward"]
MOST_RAYS = 1 << 15
MOST_PATHS = 1 << 34


@dataclass(frozen=True)
class EstimatorSettings:
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


Told = Callable[[float], None]
"""Told the share of the work that is done."""
NODE_RAYS, BUNDLE_RAYS = 7, FINE_RULE[-1]
"""Rays that the fast estimator takes of its own accord: of smooth lobes, and of tables and beams that miss a mirror."""
CHECK_RAYS = 4096
"""More than the estimator takes of its own accord, so that it is not held against itself."""
STRAY_PATHS = 1 << 20
"""Of a map of stray light, which they tell to 3 %; with more rays than the check's, more in proportion."""
BATCH = 1 << 20
FEWEST_BATCHES = 2
MATTERS = 0.01
"""Errors are asked for over the values of at least this share of the largest."""


@dataclass(frozen=True, eq=False)
class MeasurementSetup:
    """How the light comes, and who looks: `sigma_deg` of the mirror unit (beyond 90 the light is on the back), detectors in
    `directions` (n, 3) of the rig, `wavelengths_nm` (w,) or None for a grey table (w = 1).

    `stray_map` is whether light of the frames, and light that met something else on its way, counts. A `source` of rays takes
    the place of the uniform exit pupil, for the forward estimator alone.
    """

    instrument: Instrument
    sigma_deg: float
    directions: Floats
    wavelengths_nm: Floats | None = None
    transmitted: bool = False
    stray: bool = False
    frames: SampleFrames = field(default_factory=SampleFrames)
    source: RaySource | None = None

    @property
    def back(self) -> bool:
        """Whether the light is on the sample's back."""
        return self.sigma_deg > 90.0

    @property
    def etalon(self) -> Scatterer:
        """The ideal diffuser from the side that is lit to the side that is looked at."""
        side: Side = "back" if self.back else "front"
        return lambertian(0.0, 1.0, side) if self.transmitted else lambertian(side=side)


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


def estimate_ratio(stand: MeasurementSetup, sample: Scatterer, effort: EstimatorSettings, told: Told = lambda _: None) -> Ratio:
    """Etalon first, then the sample (paper, figure 7). Raises UserError."""
    pair = sample, stand.etalon
    if effort.kind == "fast":
        return _fast(stand, pair, effort, told)
    wavelengths = stand.wavelengths_nm
    if wavelengths is None:
        return _forward(stand, pair, None, effort, told)
    if sample.spectrum is None:
        return _stacked([_forward(stand, pair, None, effort, told)] * wavelengths.size)
    count, found = wavelengths.size, []
    for k, wavelength in enumerate(wavelengths.tolist()):

        def of_all(share: float, k: int = k) -> None:
            told((k + share) / count)

        found.append(_forward(stand, pair, wavelength, effort, of_all))
    return _stacked(found)


def _fast(stand: MeasurementSetup, pair: tuple[Scatterer, Scatterer], effort: EstimatorSettings, told: Told) -> Ratio:
    """The standard error is what other sets of rays, and of stray light's paths, differ by: two of them, for one alone may come
    to nearly the same by chance. It tells the size of the error; for lobes much narrower than the aperture it may be several
    times too small.
    """

    def with_rays(rays: int | None, other: int = 0) -> tuple[Floats, Floats]:
        paths = STRAY_PATHS * max(1, (rays or 0) // CHECK_RAYS)
        seed = effort.seed * 2**20 + other
        try:
            flux = [_throughputs(stand, each, rays, paths, (seed + k) % 2**64) for k, each in enumerate(pair)]
        except ValueError as error:
            raise UserError(f"--estimator fast: {error}") from None
        return flux[0], flux[1]

    rays = effort.rays
    first = CHECK_RAYS if rays is None else rays // 2
    checks = [_over(*with_rays(first, other=2)), _over(*with_rays(first // 2, other=4))]
    while True:
        told(0.5)
        flux = with_rays(rays)
        factor = _over(*flux)
        error = np.hypot(*(factor - each for each in checks))
        found = Ratio(*flux, factor, error, _own_rays(stand, pair[0]) if rays is None else rays)
        wanted = effort.error_percent
        if wanted is None or found.median_percent <= wanted:
            told(1.0)
            return found
        rays = 2 * CHECK_RAYS if rays is None else 2 * rays
        checks = checks if rays == 2 * CHECK_RAYS else [factor, checks[0]]
        if rays > MOST_RAYS:
            wrong = f"--error: {wanted:g} % takes more than {MOST_RAYS} rays a detector at sigma {_incidence(stand):g}"
            raise UserError(f"{wrong}; ask for a larger one")


def _throughputs(stand: MeasurementSetup, scatterer: Scatterer, rays: int | None, paths: int, seed: int) -> Floats:
    """(w, n) in m^2 sr."""
    instrument, sigma, directions, wavelengths = stand.instrument, stand.sigma_deg, stand.directions, stand.wavelengths_nm
    if wavelengths is None:
        flux = throughput(instrument, sigma, directions, scatterer, rays)[None]
    else:
        flux = spectral_throughput(instrument, sigma, directions, scatterer, wavelengths, rays)
    if not stand.stray:
        return flux
    # A grey sample in a grey instrument has one map for all wavelengths.
    grey = wavelengths is None or (scatterer.spectrum is None and instrument.grey)
    maps = [
        stray_map(instrument, sigma, scatterer, paths, seed, wavelength_nm=each, sample_frames=stand.frames)
        for each in ([None] if grey or wavelengths is None else wavelengths.tolist())
    ]
    added: Floats = flux + np.array([stray_throughput(each, directions, instrument) for each in maps])
    return added


def _own_rays(stand: MeasurementSetup, sample: Scatterer) -> int:
    """Of each detector, where nothing else is wanted: see `throughput`; not counted are those that a mirror cuts."""
    scene = scene_at(stand.instrument, stand.sigma_deg)
    acting = (lobe for lobe in sample.lobes if lobe.incident == scene.incident and lobe.transmits == stand.transmitted)
    return BUNDLE_RAYS if scene.clipped or any(lobe.kind in TABLE_KINDS for lobe in acting) else NODE_RAYS


def _over(sample: Floats, white: Floats) -> Floats:
    ratio: Floats = np.divide(sample, white, out=np.full_like(sample, np.nan), where=white > 0.0)
    return ratio


def _incidence(stand: MeasurementSetup) -> float:
    return 180.0 - stand.sigma_deg if stand.back else stand.sigma_deg


def _forward(
    stand: MeasurementSetup,
    pair: tuple[Scatterer, Scatterer],
    wavelength_nm: float | None,
    effort: EstimatorSettings,
    told: Told,
) -> Ratio:
    """Batches of paths, sample and etalon each its own, until there are enough of them or the error is small enough."""
    wanted = effort.error_percent
    paths = 4 * BATCH if effort.paths is None else effort.paths
    count = stand.directions.shape[0]
    tallies = _Tally(count), _Tally(count)
    batch = 0
    while True:
        size = BATCH if wanted is not None else min(BATCH, paths - tallies[0].paths)
        for k, (each, tally) in enumerate(zip(pair, tallies, strict=True)):
            seed = effort.seed * 2**20 + 2 * batch + k
            try:
                done = forward_throughput(
                    stand.instrument, stand.sigma_deg, stand.directions, each, size, seed % 2**64,
                    wavelength_nm=wavelength_nm, source=stand.source, sample_frames=stand.frames,
                )  # fmt: skip
            except ValueError as error:
                raise UserError(f"--estimator forward: {error}") from None
            if stand.stray:
                tally.add(done.throughput_m2sr, done.standard_error, done.paths)
            else:
                tally.add(done.single_m2sr, done.single_error, done.paths)
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
                f"--error: {wanted:g} % at sigma {_incidence(stand):g} would take about {needed:.2g} paths, more than "
                f"{MOST_PATHS}; ask for a larger one, or use the fast estimator"
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
