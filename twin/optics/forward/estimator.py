"""The forward estimator: Monte Carlo from the source over real mirrors and the sample to all detectors at once.

It traces every interaction and is the reference for the fast estimator: it uses neither the unfolded path, nor rays from the
detectors, nor moments. Random numbers are counter-based: those of a path are a function of seed and path. Partial sums are
added in the order of the chunks, so results are bit-identical for any number of threads. Geometry is in single precision up to
the first scattering (0.1 micrometres, 1e-7 rad); sums and all later steps are in double precision.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats
from goniotwin.twin.optics.bsdf.scatterer import Scatterer
from goniotwin.twin.optics.forward.blocks import trace
from goniotwin.twin.optics.forward.paths import BLOCK
from goniotwin.twin.optics.forward.setting import Setting, set_up
from goniotwin.twin.optics.geometry.instrument import Instrument, SampleFrames
from goniotwin.twin.optics.illumination.rayset import RaySource
from goniotwin.twin.optics.montecarlo import CHUNK, U64, check_seed, run_until, sum_chunks

FIRST_PATHS = 1 << 18
DARK_PATHS = 1 << 22
MOST_PATHS = 1 << 38


@dataclass(frozen=True, eq=False)
class Estimate:
    """Result of `forward_throughput`, arrays (n,) in m^2 sr with standard errors: total throughput, single and stray component.

    Single is light that the sample scattered once after the three mirrors: this is what the fast estimator computes. Stray is
    the rest: light of the frames, and light that met another surface. `paths` is the number of traced paths. The flux on a
    detector is its throughput times `radiance`: the exit pupil's own, or, for a rayset, that of a uniform exit pupil that gives
    the hole as much light, in `unit` / (m^2 sr).

    The errors take each contribution as independent, and light that is drawn in several strata as drawn at random: they are
    never too small, except where a path meets one detector twice.
    """

    throughput_m2sr: Floats
    standard_error: Floats
    single_m2sr: Floats
    single_error: Floats
    stray_m2sr: Floats
    stray_error: Floats
    paths: int
    radiance: float = 1.0
    unit: str | None = None


def forward_throughput(
    instrument: Instrument,
    sigma_deg: float,
    directions: npt.ArrayLike,
    scatterer: Scatterer | None,
    paths: int | None = None,
    seed: int = 0,
    gamma_deg: float = 0.0,
    wavelength_nm: float | None = None,
    relative_error: float | None = None,
    source: RaySource | None = None,
    max_interactions: int = 8,
    sample_frames: SampleFrames | None = None,
) -> Estimate:
    """Throughput of detectors in `directions` (n, 3): their flux over the radiance of a uniform exit pupil, or of a rayset.

    Without a `scatterer` there is no sample: the open beam. A detector counts a ray that crosses its disc within its acceptance
    cone (or, with the instrument's `sensor`, its lens, and reaches the detector behind it) before it meets something, however
    many detectors it crosses. Give `paths`, which is rounded up to a multiple of 2048, or `relative_error`: paths are then
    added until the median of standard error over throughput, over all detectors that receive light, is below it.

    A `source` replaces the exit pupil: its rays are drawn at random, and stated errors relate to its own mean, not to that of
    all raysets like it. Without `wavelength_nm` it is the mean of the rays' wavelengths. Light that misses a mirror of the beam
    is lost. With the instrument's `obstruction` mirrors block and reflect scattered light; without it scattered light does not
    meet them. A path ends after `max_interactions`, the first scattering included.

    Raises ValueError for vectors without a direction, fewer than 2 paths, an invalid seed, both or neither of paths and
    relative error, an error that needs more than 2^38 paths or is requested without light, fewer than 1 interaction, and for a
    sample with a spectrum without a wavelength.
    """
    check_seed(seed)
    if (paths is None) == (relative_error is None):
        raise ValueError("give either paths or relative_error")
    if paths is not None and paths < 2:
        raise ValueError(f"paths is {paths}: give at least 2; a standard error needs two")
    if max_interactions < 1:
        raise ValueError(f"max_interactions is {max_interactions}: give at least 1, the first scattering")
    if source is not None and wavelength_nm is None:
        wavelength_nm = float(np.average(source.wavelength_nm, weights=source.flux))
    setting = set_up(
        instrument,
        sigma_deg,
        directions,
        scatterer,
        gamma_deg,
        wavelength_nm,
        source,
        max_interactions,
        sample_frames or SampleFrames(),
    )
    return _run(setting, paths, relative_error, seed)


def trace_paths(setting: Setting, seed: int, first: int, last: int) -> Floats:
    """Sums (rows, 4) over paths first..last-1, both multiples of a block: see `trace`."""
    if not setting.strata.ways.size:
        return np.zeros((setting.rows, 4))
    sums: Floats = trace(
        first // BLOCK,
        last // BLOCK,
        U64(seed),
        setting.beam,
        setting.strata,
        setting.lobes,
        setting.surfaces,
        setting.targets,
        setting.spread,
        setting.longest,
        setting.detectors,
    )
    return sums


def run_sums(setting: Setting, paths: int, seed: int) -> tuple[Floats, int]:
    """Sums over a number of paths, and that number, rounded up."""
    rounded = BLOCK * math.ceil(paths / BLOCK)
    return sum_chunks(lambda first, last: trace_paths(setting, seed, first, last), 0, rounded), rounded


def _run(setting: Setting, paths: int | None, relative_error: float | None, seed: int) -> Estimate:
    scale = 1.0 / setting.radiance

    def estimate(sums: Floats, done: int) -> tuple[float, float, Estimate]:
        parts = np.stack([sums[:, 0:2] + sums[:, 2:4], sums[:, 0:2], sums[:, 2:4]])
        mean, square = parts[:, :, 0] / done, parts[:, :, 1] / done
        error = np.sqrt(np.maximum(square - mean**2, 0.0) / (done - 1))
        value, uncertainty = mean * scale, error * scale
        result = Estimate(
            value[0], uncertainty[0], value[1], uncertainty[1], value[2], uncertainty[2], done, setting.radiance, setting.unit
        )
        lit = mean[0] > 0.0
        if not np.any(lit):
            return 0.0, 0.0, result
        return 1.0, float(np.median(error[0][lit] / mean[0][lit])), result

    # Chunks grow with the number of detectors, so that the addition of their sums remains cheap.
    chunk = CHUNK * min(16, max(1, setting.rows // 4096))
    rounded = None if paths is None else BLOCK * math.ceil(paths / BLOCK)
    return run_until(
        lambda first, last: trace_paths(setting, seed, first, last),
        estimate,
        rounded,
        relative_error,
        max(FIRST_PATHS, chunk),
        DARK_PATHS,
        MOST_PATHS,
        chunk,
    )
