"""Number of paths that the forward estimator traces per second: `python -m benchmarks.forward`."""

import json
import math
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.bsdf.analytic_samples import gaussian, lambertian
from goniotwin.twin.optics.bsdf.scatterer import Scatterer
from goniotwin.twin.optics.forward.blocks import trace, trace_geometry
from goniotwin.twin.optics.forward.paths import BLOCK
from goniotwin.twin.optics.forward.setting import Setting, set_up
from goniotwin.twin.optics.geometry.coordinates import from_specular
from goniotwin.twin.optics.geometry.instrument import Instrument, SampleFrames
from goniotwin.twin.optics.montecarlo import U64

SIGMA_DEG = 30.0
SAMPLES = {"lambertian": lambertian(), "gaussian": gaussian(5.0)}
GEOMETRY_BLOCKS, SCORED_BLOCKS, REPEATS = 2048, 2048, 20


def detector_grid(sigma_deg: float = SIGMA_DEG) -> Floats:
    """Directions (4449, 3), down to 85 deg: 0.5 deg apart to 15 deg from the specular one, then 2 deg, beyond 40 deg 5 deg."""
    rings = []
    for theta, step in [
        *((t, 0.5) for t in np.arange(0.0, 15.1, 0.5)),
        *((t, 2.0) for t in np.arange(17.0, 40.0, 2.0)),
        *((t, 5.0) for t in np.arange(45.0, 120.0, 5.0)),
    ]:
        count = max(1, round(2.0 * math.pi * math.sin(math.radians(theta)) / math.radians(step)))
        rings.append(from_specular(sigma_deg, np.full(count, theta), np.arange(count) * 360.0 / count))
    directions = np.vstack(rings)
    return directions[directions[:, 2] > math.cos(math.radians(85.0))]


def _setting(scatterer: Scatterer, directions: Floats, frames: SampleFrames) -> Setting:
    return set_up(Instrument(), SIGMA_DEG, directions, scatterer, 0.0, None, None, 8, frames)


def _seconds(action: Callable[[], object]) -> tuple[float, float]:
    """Minimum processor time and minimum elapsed time of several calls, after one that compiles."""
    action()
    used, elapsed = [], []
    for _ in range(REPEATS):
        start, clock = time.process_time(), time.perf_counter()
        action()
        used.append(time.process_time() - start)
        elapsed.append(time.perf_counter() - clock)
    return min(used), min(elapsed)


def geometry_rates(scatterer: Scatterer) -> tuple[float, float]:
    """Paths per second of processor time and elapsed, one thread: pupil, three mirrors, hole, direction and weight alone."""
    setting = _setting(scatterer, np.zeros((0, 3)), SampleFrames(lit=1.0))
    arguments = U64(1), setting.beam, setting.strata, setting.lobes
    used, elapsed = _seconds(lambda: trace_geometry(GEOMETRY_BLOCKS, *arguments))
    return GEOMETRY_BLOCKS * BLOCK / used, GEOMETRY_BLOCKS * BLOCK / elapsed


def scored_rates(scatterer: Scatterer, threads: int = 1) -> tuple[float, float]:
    """Paths per second of processor time and elapsed, with detectors, obstruction, frames and stray light."""
    setting = _setting(scatterer, detector_grid(), SampleFrames())

    def trace_blocks(first: int) -> None:
        trace(
            first,
            first + SCORED_BLOCKS,
            U64(1),
            setting.beam,
            setting.strata,
            setting.lobes,
            setting.surfaces,
            setting.targets,
            setting.spread,
            setting.longest,
            setting.detectors,
        )

    def trace_all() -> None:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(trace_blocks, range(0, threads * SCORED_BLOCKS, SCORED_BLOCKS)))

    used, elapsed = _seconds(trace_all if threads > 1 else lambda: trace_blocks(0))
    return threads * SCORED_BLOCKS * BLOCK / used, threads * SCORED_BLOCKS * BLOCK / elapsed


def measure() -> dict[str, float]:
    """Millions of paths per second, warm, the fastest of several runs, for a Lambertian sample and a Gaussian of 5 deg.

    One thread: scored, and geometry alone, per second of processor time, and elapsed (`_wall_`); then all threads. `load` is
    that of the machine before: a busy neighbour of a core slows both times.
    """
    figures: dict[str, float] = {"forward_load": os.getloadavg()[0], "forward_detectors": float(len(detector_grid()))}
    for name, sample in SAMPLES.items():
        for kind, rates in (("", scored_rates(sample)), ("geometry_", geometry_rates(sample))):
            for clock, rate in zip(("", "wall_"), rates, strict=True):
                figures[f"forward_{name}_{kind}{clock}mpaths"] = 1e-6 * rate
        figures[f"forward_{name}_all_threads_wall_mpaths"] = 1e-6 * scored_rates(sample, numba.get_num_threads())[1]
    return figures


if __name__ == "__main__":
    print(json.dumps(measure(), indent=2))
