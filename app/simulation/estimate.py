"""Throughputs of etalon and sample and their ratio at one sigma, by either estimator, with the standard error of each ratio.

Both estimators compute the same quantity: the light that the sample scatters once and, if wanted, the stray light. A fixed seed
gives the same numbers; no result depends on the duration of a computation.
"""

import itertools
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
    stray_map,
    stray_throughput,
    without_regular,
)
from goniotwin.twin.optics.bsdf.analytic_samples import Side
from goniotwin.twin.optics.fast.estimator import throughputs_of
from goniotwin.twin.optics.fast.scenes import FINE_RULE, TABLE_KINDS, Pose
from goniotwin.twin.optics.geometry.coordinates import incidence_deg, is_lit_from_behind
from goniotwin.twin.optics.geometry.scene import scene_at

Kind = Literal["fast", "forward"]
MOST_RAYS = 1 << 15
MOST_PATHS = 1 << 34
NODE_RAYS, BUNDLE_RAYS = 7, FINE_RULE[-1]
"""Default number of rays of the fast estimator: for smooth lobes, and for tables and beams that miss a mirror."""
CHECK_RAYS = 4096
"""Rays of the comparison that gives the error: more than the default, so that the two are different."""
STRAY_PATHS = 1 << 20
"""Paths of a map of stray light, whose relative error is then 3 %; in proportion for more rays than `CHECK_RAYS`."""
BATCH = 1 << 20
FEWEST_BATCHES = 2
SIGNIFICANT = 0.01
"""The error is evaluated over the values of at least this fraction of the largest."""
ReportFraction = Callable[[float], None]
"""Receives the finished fraction of the work, 0 to 1."""
DEFAULT_PATHS = 4 * BATCH


@dataclass(frozen=True)
class EstimatorSettings:
    """An estimator and its effort: the number of `rays` per detector, the number of `paths`, or the error in percent.

    The error is the median relative standard error of the ratios, over the directions that have at least a hundredth of
    the largest. Raises UserError for a setting that the estimator does not have.
    """

    kind: Kind = "fast"
    rays: int | None = None
    paths: int | None = None
    error_percent: float | None = None
    seed: int = 1

    def __post_init__(self) -> None:
        """Check the settings."""
        if self.kind == "fast" and self.paths is not None:
            raise UserError("--paths: the fast estimator has rays, not paths; give --rays, or --estimator forward")
        if self.kind == "forward" and self.rays is not None:
            raise UserError("--rays: the forward estimator has paths, not rays; give --paths, or --estimator fast")
        given = [name for name in ("rays", "paths") if getattr(self, name) is not None]
        if given and self.error_percent is not None:
            raise UserError(f"--error and --{given[0]}: give only one of them; the other follows from it")
        if self.rays is not None and not (8 <= self.rays <= MOST_RAYS and self.rays % 8 == 0):
            raise UserError(f"--rays: {self.rays} is not possible; give a multiple of 8, from 8 to {MOST_RAYS}")
        if self.paths is not None and not 1000 <= self.paths <= MOST_PATHS:
            raise UserError(f"--paths: {self.paths} is not possible; give 1000 to {MOST_PATHS}")
        if self.error_percent is not None and not (math.isfinite(self.error_percent) and self.error_percent > 0.0):
            raise UserError(f"--error: {self.error_percent:g} is not possible; give a percentage above 0")
        if not 0 <= self.seed < 2**63:
            raise UserError(f"--seed: {self.seed} is not possible; give a whole number from 0")


@dataclass(frozen=True, eq=False)
class MeasurementSetup:
    """Instrument, light and detectors of a ratio.

    `sigma_deg` is the angle of the mirror unit; above 90 deg the light is on the back of the sample. The detectors are in
    `directions` (n, 3) of the rig; `wavelengths_nm` is (w,), or None for a grey table (w = 1). With `stray` the light of the
    frames, and light that was scattered more than once, counts. A `source` of rays replaces the uniform exit pupil; only the
    forward estimator has it. `gamma_deg` turns the sample unit. Without the `regular` component of a sample only its light that
    is scattered once more counts, as stray light.
    """

    instrument: Instrument
    sigma_deg: float
    directions: Floats
    wavelengths_nm: Floats | None = None
    transmitted: bool = False
    stray: bool = False
    frames: SampleFrames = field(default_factory=SampleFrames)
    source: RaySource | None = None
    gamma_deg: float = 0.0
    regular: bool = True

    @property
    def back(self) -> bool:
        """Whether the light is on the back of the sample."""
        return is_lit_from_behind(self.sigma_deg)

    @property
    def incidence_deg(self) -> float:
        """Angle of incidence on the lit side."""
        return incidence_deg(self.sigma_deg)

    @property
    def etalon(self) -> Scatterer:
        """The ideal diffuser from the lit side to the side of the detectors."""
        side: Side = "back" if self.back else "front"
        return lambertian(0.0, 1.0, side) if self.transmitted else lambertian(side=side)


@dataclass(frozen=True, eq=False)
class Ratio:
    """Results of n detectors at one sigma and w wavelengths, (w, n) each.

    Throughputs of `sample` and `etalon` in m^2 sr, their ratio `factor` (formula 1: the luminance factor, because the etalon
    is an ideal diffuser), and its standard error. A factor is NaN where the etalon gives no light, an error where it is
    unknown (no path arrived at the detector). `count` is the number of rays per detector, or of paths.
    """

    sample_m2sr: Floats
    etalon_m2sr: Floats
    factor: Floats
    standard_error: Floats
    count: int

    def mask(self, obstructed: Flags) -> "Ratio":
        """The same results, with NaN as factor and error of the detectors in `obstructed` (n,)."""
        factor, error = (np.where(obstructed, np.nan, each) for each in (self.factor, self.standard_error))
        return replace(self, factor=factor, standard_error=error)

    @property
    def relative_error(self) -> Floats:
        """Relative standard errors of the significant values, a flat list; empty if none is known."""
        known = np.isfinite(self.factor) & np.isfinite(self.standard_error) & (self.factor > 0.0)
        if not known.any():
            return np.empty(0)
        known &= self.factor >= SIGNIFICANT * self.factor[known].max()
        relative: Floats = self.standard_error[known] / self.factor[known]
        return relative

    @property
    def median_percent(self) -> float:
        """Median of `relative_error`, in percent; infinite if none is known."""
        relative = self.relative_error
        return 100.0 * float(np.median(relative)) if relative.size else math.inf


@dataclass(frozen=True, eq=False)
class Batch:
    """Throughputs (2, n) in m^2 sr of sample and etalon by the forward estimator, their standard errors, and their paths."""

    mean: Floats
    error: Floats
    paths: int


TraceBatch = Callable[[MeasurementSetup, Scatterer, float | None, EstimatorSettings, int, int], Batch]
"""See `trace_batch`."""


def trace_batch(
    setup: MeasurementSetup, sample: Scatterer, wavelength_nm: float | None, settings: EstimatorSettings, batch: int, size: int
) -> Batch:
    """Trace `size` paths of sample and etalon each at one wavelength. Raises UserError.

    Their random numbers are those of the settings' seed and the number of the batch.
    """
    results = []
    for k, each in enumerate((sample if setup.regular else without_regular(sample), setup.etalon)):
        seed = settings.seed * 2**20 + 2 * batch + k
        try:
            result = forward_throughput(
                setup.instrument,
                setup.sigma_deg,
                setup.directions,
                each,
                size,
                seed % 2**64,
                setup.gamma_deg,
                wavelength_nm=wavelength_nm,
                source=setup.source,
                sample_frames=setup.frames,
            )
        except ValueError as error:
            raise UserError(f"--estimator forward: {error}") from None
        results.append(result)
    if setup.stray:
        means, errors = [each.throughput_m2sr for each in results], [each.standard_error for each in results]
    else:
        means, errors = [each.single_m2sr for each in results], [each.single_error for each in results]
    return Batch(np.array(means), np.array(errors), results[0].paths)


def batch_sizes(paths: int) -> list[int]:
    """The paths of each batch of so many in all; a rest of one path, which has no standard error, is not traced."""
    sizes = [BATCH] * (paths // BATCH)
    return sizes if paths % BATCH < 2 else [*sizes, paths % BATCH]


def traced_wavelengths(setup: MeasurementSetup, sample: Scatterer) -> list[float | None]:
    """The wavelengths that the forward estimator traces: a grey sample is the same at all of them."""
    return [None] if setup.wavelengths_nm is None or sample.spectrum is None else list(setup.wavelengths_nm.tolist())


def estimate_ratio(
    setup: MeasurementSetup,
    sample: Scatterer,
    settings: EstimatorSettings,
    report: ReportFraction = lambda _: None,
    trace: TraceBatch = trace_batch,
) -> Ratio:
    """Estimate the throughputs of etalon and sample, and their ratio (paper, figure 7). Raises UserError.

    `trace` gives the batches of the forward estimator, which may have been traced before.
    """
    if settings.kind == "fast":
        return _fast_ratio(setup, (sample, setup.etalon), settings, report)
    traced, ratios = traced_wavelengths(setup, sample), []
    for k, wavelength in enumerate(traced):

        def report_all(fraction: float, k: int = k) -> None:
            report((k + fraction) / len(traced))

        def batch_of(batch: int, size: int, wavelength: float | None = wavelength) -> Batch:
            return trace(setup, sample, wavelength, settings, batch, size)

        ratios.append(_forward_ratio(setup, batch_of, settings, report_all))
    if setup.wavelengths_nm is None:
        return ratios[0]
    return _stack(ratios * (setup.wavelengths_nm.size // len(ratios)))


def _fast_ratio(
    setup: MeasurementSetup, pair: tuple[Scatterer, Scatterer], settings: EstimatorSettings, report: ReportFraction
) -> Ratio:
    """The ratio by the fast estimator.

    The standard error is the difference from two other sets of rays, and of paths of the stray light; from one set alone it
    could be nearly zero by chance. It shows the size of the error; for lobes much narrower than the aperture it can be several
    times too small.
    """

    def throughputs(rays: int | None, stream: int = 0) -> tuple[Floats, Floats]:
        paths = STRAY_PATHS * max(1, (rays or 0) // CHECK_RAYS)
        try:
            flux = _throughputs(setup, pair, rays, paths, settings.seed * 2**20 + stream)
        except ValueError as error:
            raise UserError(f"--estimator fast: {error}") from None
        return flux[0], flux[1]

    rays = settings.rays
    first = CHECK_RAYS if rays is None else rays // 2
    checks = [_divide(*throughputs(first, stream=2)), _divide(*throughputs(first // 2, stream=4))]
    while True:
        report(0.5)
        flux = throughputs(rays)
        factor = _divide(*flux)
        error = np.hypot(*(factor - each for each in checks))
        ratio = Ratio(*flux, factor, error, _default_rays(setup, pair[0]) if rays is None else rays)
        wanted = settings.error_percent
        if wanted is None or ratio.median_percent <= wanted:
            report(1.0)
            return ratio
        rays = 2 * CHECK_RAYS if rays is None else 2 * rays
        checks = checks if rays == 2 * CHECK_RAYS else [factor, checks[0]]
        if rays > MOST_RAYS:
            wrong = f"--error: {wanted:g} % takes more than {MOST_RAYS} rays a detector at sigma {setup.incidence_deg:g}"
            raise UserError(f"{wrong}; give a larger error")


def _throughputs(
    setup: MeasurementSetup, pair: tuple[Scatterer, Scatterer], rays: int | None, paths: int, seed: int
) -> list[Floats]:
    """Throughputs (w, n) in m^2 sr of sample and etalon, with the same rays; with stray light if the setup has it."""
    pose = Pose(setup.sigma_deg, setup.directions, setup.gamma_deg)
    seen = (pair[0] if setup.regular else without_regular(pair[0]), pair[1])
    flux = throughputs_of(setup.instrument, pose, seen, rays, setup.wavelengths_nm)
    if not setup.stray:
        return flux
    return [
        each + _stray_throughput(setup, scatterer, paths, (seed + k) % 2**64)
        for k, (each, scatterer) in enumerate(zip(flux, pair, strict=True))
    ]


def _stray_throughput(setup: MeasurementSetup, scatterer: Scatterer, paths: int, seed: int) -> Floats:
    """Stray throughput (w, n) or (1, n) in m^2 sr: a grey sample in a grey instrument has one map for all wavelengths."""
    instrument, wavelengths = setup.instrument, setup.wavelengths_nm
    grey = wavelengths is None or (scatterer.spectrum is None and instrument.grey)
    maps = [
        stray_map(
            instrument, setup.sigma_deg, scatterer, paths, seed, setup.gamma_deg, wavelength_nm=each, sample_frames=setup.frames
        )
        for each in ([None] if grey or wavelengths is None else wavelengths.tolist())
    ]
    return np.array([stray_throughput(each, setup.directions, instrument) for each in maps])


def _default_rays(setup: MeasurementSetup, sample: Scatterer) -> int:
    """Default number of rays per detector: see `throughput`; the rays that a mirror blocks are not counted."""
    scene = scene_at(setup.instrument, setup.sigma_deg)
    acting = (lobe for lobe in sample.lobes if lobe.incident == scene.incident and lobe.transmits == setup.transmitted)
    return BUNDLE_RAYS if scene.clipped or any(lobe.kind in TABLE_KINDS for lobe in acting) else NODE_RAYS


def _divide(sample: Floats, etalon: Floats) -> Floats:
    ratio: Floats = np.divide(sample, etalon, out=np.full_like(sample, np.nan), where=etalon > 0.0)
    return ratio


def _forward_ratio(
    setup: MeasurementSetup, batch_of: Callable[[int, int], Batch], settings: EstimatorSettings, report: ReportFraction
) -> Ratio:
    """The ratio by the forward estimator, in batches of paths until the wanted number of paths or error is reached.

    Sample and etalon have different paths.
    """
    tallies = _Tally(setup.directions.shape[0]), _Tally(setup.directions.shape[0])

    def add(batch: int, size: int) -> Ratio:
        traced = batch_of(batch, size)
        for k, tally in enumerate(tallies):
            tally.add(traced.mean[k], traced.error[k], traced.paths)
        return _tally_ratio(*tallies)

    wanted = settings.error_percent
    if wanted is None:
        sizes = batch_sizes(DEFAULT_PATHS if settings.paths is None else settings.paths)
        for batch, size in enumerate(sizes):
            ratio = add(batch, size)
            report((batch + 1) / len(sizes))
        return ratio
    for batch in itertools.count():
        ratio, reached = add(batch, BATCH), tallies[0].paths
        median = ratio.median_percent
        if batch + 1 >= FEWEST_BATCHES and median <= wanted:
            break
        needed = reached * (median / wanted) ** 2
        if math.isfinite(needed):
            report(min(0.99, reached / needed))
        if (math.isfinite(needed) and needed > MOST_PATHS) or reached >= MOST_PATHS:
            raise UserError(
                f"--error: {wanted:g} % at sigma {setup.incidence_deg:g} would take about {needed:.2g} paths, more than "
                f"{MOST_PATHS}; give a larger error, or use the fast estimator"
            )
    return ratio


class _Tally:
    """Mean over batches, weighted by their paths, and its variance."""

    def __init__(self, count: int) -> None:
        self.paths = 0
        self._sum, self._variance = np.zeros(count), np.zeros(count)

    def add(self, mean: Floats, error: Floats, paths: int) -> None:
        """Add a batch: mean (n,), its standard error (n,), number of paths."""
        self.paths += paths
        self._sum += paths * mean
        self._variance += (paths * error) ** 2

    @property
    def mean(self) -> Floats:
        """Mean over all paths, (n,)."""
        mean: Floats = self._sum / self.paths
        return mean

    @property
    def variance(self) -> Floats:
        """Variance of the mean, (n,)."""
        variance: Floats = self._variance / self.paths**2
        return variance


def _tally_ratio(sample: _Tally, etalon: _Tally) -> Ratio:
    factor = _divide(sample.mean, etalon.mean)
    with np.errstate(invalid="ignore", divide="ignore"):
        relative2 = sample.variance / sample.mean**2 + etalon.variance / etalon.mean**2
        error = np.where(sample.mean > 0.0, factor * np.sqrt(relative2), np.nan)
    return Ratio(sample.mean[None], etalon.mean[None], factor[None], error[None], sample.paths)


def _stack(ratios: Sequence[Ratio]) -> Ratio:
    """Ratios of one wavelength each as one."""
    names = ("sample_m2sr", "etalon_m2sr", "factor", "standard_error")
    rows = [np.concatenate([getattr(ratio, name) for ratio in ratios]) for name in names]
    return Ratio(rows[0], rows[1], rows[2], rows[3], max(ratio.count for ratio in ratios))
