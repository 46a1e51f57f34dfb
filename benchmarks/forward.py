"""Number of paths that the forward estimator traces per second: `python -m benchmarks.forward`."""

import json
import math
import time
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
GEOMETRY_BLOCKS, SCORED_BLOCKS, REPEATS = 16384, 4096, 5


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


def geometry_rate(scatterer: Scatterer) -> float:
    """Paths per second on one core: pupil, three mirrors, hole, direction and weight, without detectors; the
    fastest of five.
    """
    setting = _setting(scatterer, np.zeros((0, 3)), SampleFrames(lit=1.0))
    arguments = U64(1), setting.beam, setting.strata, setting.lobes
    trace_geometry(1, *arguments)
    seconds = []
    for _ in range(REPEATS):
        start = time.process_time()
        trace_geometry(GEOMETRY_BLOCKS, *arguments)
        seconds.append(time.process_time() - start)
    return GEOMETRY_BLOCKS * BLOCK / min(seconds)


def scored_rate(scatterer: Scatterer, threads: int = 1) -> float:
    """Paths per second with detectors, obstruction, frames and stray light; the fastest of five.

    On one core the time is the process time, on more cores the elapsed time.
    """
    setting = _setting(scatterer, detector_grid(), SampleFrames())

    def trace_blocks(first: int) -> None:
        trace(
            first, first + SCORED_BLOCKS, U64(1), setting.beam, setting.strata, setting.lobes, setting.surfaces,
            setting.targets, setting.spread, setting.longest, setting.detectors,
        )  # fmt: skip

    trace_blocks(0)
    seconds = []
    for _ in range(REPEATS):
        start, elapsed_start = time.process_time(), time.perf_counter()
        if threads == 1:
            trace_blocks(0)
            seconds.append(time.process_time() - start)
        else:
            with ThreadPoolExecutor(threads) as pool:
                list(pool.map(trace_blocks, range(0, threads * SCORED_BLOCKS, SCORED_BLOCKS)))
            seconds.append(time.perf_counter() - elapsed_start)
    return threads * SCORED_BLOCKS * BLOCK / min(seconds)


def measure() -> dict[str, float]:
    """Millions of paths per second, warm: the slower of a Lambertian sample and a Gaussian of 5 deg, and each of them."""
    figures: dict[str, float] = {"forward_detectors": float(len(detector_grid()))}
    for kind, rate in (
        ("geometry", geometry_rate),
        ("scored", scored_rate),
        ("scored_threads", lambda sample: scored_rate(sample, numba.get_num_threads())),
    ):
        rates = {name: 1e-6 * rate(sample) for name, sample in SAMPLES.items()}
        key = "forward_scored_{}mpaths_per_s_all_threads" if kind == "scored_threads" else f"forward_{kind}_{{}}mpaths_per_s"
        figures[key.format("")] = min(rates.values())
        figures |= {key.format(f"{name}_"): each for name, each in rates.items()}
    return figures


if __name__ == "__main__":
    print(json.dumps(measure(), indent=2))
