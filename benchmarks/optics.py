"""Times and errors of the optical twin: `python -m benchmarks.optics [--rounds 3] [--against FOLDER] [--json]`.

A full grey BSDF is 19 angles of incidence (0 to 85 deg in steps of 5, and 87) with a grid of detectors about the specular
direction: 0.5 deg apart out to 12 deg, then wider, to 5 deg; sample and etalon, with the grid and its look-ups built anew each
time. Its error is the relative difference of the luminance factor from that of 16,384 rays per detector, over a sample of all
readings whose zenith angle is below 85 deg and within four widths of the specular direction (beyond, a Gaussian is below 1e-7
of its peak). Times are the minimum of several runs, warm, on all cores; paths are counted on one core.

With `--against` another version is measured in turns with this one, each by its own benchmarks. Figures are medians of the
rounds; `ratio` is this one's over the other's, of what both measure.
"""

import argparse
import json
import math
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks import forward as forward_costs
from benchmarks import illumination as illumination_costs
from benchmarks.versions import add_options, in_turns, versions_of
from goniotwin.arrays import Floats
from goniotwin.twin.optics import (
    Instrument,
    Pose,
    Poses,
    Scenes,
    arc_direction,
    from_specular,
    gaussian,
    luminance_factors,
    throughput,
)

SIGMA_DEG = (*np.arange(0.0, 86.0, 5.0), 87.0)
OPEN = Instrument(obstruction=False)
ROUNDS = 9
PLACES, ARC_POSES = 5, 19
CHECKED = 4000
"""Number of readings that are compared with many rays."""


def detector_grid() -> tuple[Floats, Floats]:
    """theta and phi (n,) in deg about the specular direction."""
    theta, rings = 0.0, [(0.0, 1)]
    while theta < 90.0:
        step = 0.5 if theta < 12.0 else 1.0 if theta < 25.0 else 2.5 if theta < 50.0 else 5.0
        theta += step
        rings.append((theta, max(6, round(2.0 * math.pi * math.degrees(math.sin(math.radians(theta))) / step))))
    return (
        np.concatenate([np.full(count, each) for each, count in rings]),
        np.concatenate([np.arange(count) * 360.0 / count for _, count in rings]),
    )


def poses() -> list[Pose]:
    """The grid about each specular direction, as far as it is above the horizon."""
    about_the_normal = from_specular(0.0, *detector_grid())
    grids = []
    for sigma in SIGMA_DEG:
        cos, sin = math.cos(math.radians(sigma)), math.sin(math.radians(sigma))
        turned = about_the_normal @ np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
        grids.append(Pose(float(sigma), turned.compress(turned[:, 2] > math.cos(math.radians(89.0)), axis=0)))
    return grids


def least_ms(action: Callable[[], object], rounds: int = ROUNDS) -> float:
    """Minimum time of several rounds, warm, ms."""
    action()
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return 1000.0 * min(times)


def percentile_95_error(width_deg: float) -> float:
    """95th percentile of the relative error of the luminance factor, percent, over a sample of the readings."""
    sample, random = gaussian(width_deg), np.random.Generator(np.random.Philox(1))
    few, many = [], []
    for pose, factors in zip(poses(), luminance_factors(OPEN, poses(), sample), strict=True):
        directions = np.asarray(pose.directions)
        specular = from_specular(pose.sigma_deg, 0.0, 0.0)
        near = directions @ specular > math.cos(math.radians(min(90.0, 4.0 * width_deg)))
        chosen = np.flatnonzero(near & (directions[:, 2] > math.cos(math.radians(85.0))))
        if not chosen.size:
            continue
        chosen = random.choice(chosen, min(chosen.size, CHECKED // len(SIGMA_DEG)), replace=False)
        few.append(factors[chosen])
        many.extend(luminance_factors(OPEN, [Pose(pose.sigma_deg, directions[chosen])], sample, rays=1 << 14))
    return float(100.0 * np.percentile(np.abs(np.concatenate(few) / np.concatenate(many) - 1.0), 95.0))


def photodiodes_at_poses() -> None:
    """All 36 photodiodes as in a plant: the arc turns at each position of the mirror unit."""
    polar_deg, sample, instrument = np.arange(0.0, 86.0, 5.0), gaussian(5.0), Instrument()
    for sigma_deg in np.linspace(5.0, 80.0, PLACES):
        for beta_deg in np.linspace(0.0, 180.0, ARC_POSES):
            arcs = [arc_direction(polar_deg, beta_deg, lower=lower) for lower in (False, True)]
            throughput(instrument, float(sigma_deg), np.concatenate(arcs), sample)


def costs(action: Callable[[], object], rounds: int = ROUNDS) -> tuple[float, float]:
    """Minimum wall time and minimum processor time of several rounds, warm, s."""
    action()
    wall, cpu = [], []
    for _ in range(rounds):
        start, used = time.perf_counter(), time.process_time()
        action()
        wall.append(time.perf_counter() - start)
        cpu.append(time.process_time() - used)
    return min(wall), min(cpu)


def scene_costs() -> dict[str, float]:
    """A full BSDF; 36 photodiodes at each of 120 poses in one call; a reading of a beam that a mirror clips over an open one.

    `_cpu_` are processor times of all threads, and the ratio is of these; `load` is that of the machine before.
    """
    load = os.getloadavg()[0]
    polar_deg, betas_deg, sample = np.arange(0.0, 86.0, 5.0), np.linspace(0.0, 180.0, 15), gaussian(5.0)
    arcs = [np.concatenate([arc_direction(polar_deg, b, lower=lower) for lower in (False, True)]) for b in betas_deg]
    planned = Poses(np.repeat(np.linspace(5.0, 80.0, 8), len(arcs)), np.tile(arcs, (8, 1, 1)))
    count = np.asarray(planned.sigma_deg).size
    full, full_cpu = costs(lambda: luminance_factors(OPEN, poses(), sample))
    ahead, ahead_cpu = costs(lambda: Scenes(Instrument(), planned, [sample]).throughputs())
    lobe = Pose(30.0, from_specular(30.0, np.tile(np.arange(0.0, 16.0, 0.25), 4), np.repeat(np.arange(4.0) * 90.0, 64)))
    readings = [
        costs(Scenes(each, [lobe] * 16, [sample]).throughputs)[1]
        for each in (OPEN, Instrument(obstruction=False, mirror_side_mm=15.0))
    ]
    return {
        "load": load,
        "full_bsdf_ms": 1e3 * full,
        "full_bsdf_cpu_ms": 1e3 * full_cpu,
        "photodiodes_us": 1e6 * ahead / count,
        "photodiodes_cpu_us": 1e6 * ahead_cpu / count,
        "clipped_ratio": readings[1] / readings[0],
    }


FIRST_CALLS = """
import time
from goniotwin.twin.optics import Instrument, forward_throughput, gaussian, luminance_factor

def forward(*arguments):
    return forward_throughput(*arguments, paths=2)

for name, call in (("fast", luminance_factor), ("forward", forward)):
    start = time.perf_counter()
    call(Instrument(), 30.0, [[0.0, 0.0, 1.0]], gaussian(5.0))
    print(f"compilation_{name}_s", time.perf_counter() - start)
"""


def compilation() -> dict[str, float]:
    """Times of the first calls of both estimators without any compiled kernel, s, in a process of their own."""
    with tempfile.TemporaryDirectory() as folder:
        output = subprocess.run(
            [sys.executable, "-c", FIRST_CALLS],
            env=os.environ | {"NUMBA_CACHE_DIR": folder},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
    return {name: float(seconds) for name, seconds in (line.split() for line in output.splitlines())}


def measure() -> dict[str, Any]:
    """All figures, as in the JSON."""
    return {
        "detector_readings": sum(len(np.asarray(pose.directions)) for pose in poses()),
        "full_bsdf_alpha5_ms": least_ms(lambda: luminance_factors(OPEN, poses(), gaussian(5.0))),
        "full_bsdf_alpha5_p95_error_percent": percentile_95_error(5.0),
        "full_bsdf_alpha2_ms": least_ms(lambda: luminance_factors(OPEN, poses(), gaussian(2.0))),
        "full_bsdf_alpha2_p95_error_percent": percentile_95_error(2.0),
        "photodiodes_at_pose_ms": least_ms(photodiodes_at_poses, 20) / (PLACES * ARC_POSES),
        **scene_costs(),
        **forward_costs.measure(),
        **illumination_costs.measure(),
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3),
    }


def main() -> None:
    """Print a line for each figure, or with --json one object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    add_options(parser, rounds=3)
    chosen = parser.parse_args()
    if chosen.against is None:
        result = {**compilation(), **measure()}
    else:
        program = "import json\nfrom benchmarks.optics import measure\nprint(json.dumps(measure()))"
        result = {}
        for name, rounds in in_turns(versions_of(chosen.against), chosen.rounds, program, own=True).items():
            result |= {f"{name} {key}": statistics.median(each[key] for each in rounds) for key in rounds[0]}
        for key in [key.removeprefix("here ") for key in result if key.startswith("here ")]:
            if result.get(f"against {key}"):
                result[f"ratio {key}"] = result[f"here {key}"] / result[f"against {key}"]
    if chosen.json:
        print(json.dumps(result, indent=2))
    else:
        for name, value in result.items():
            print(f"{name:42} {value:12.4g}")


if __name__ == "__main__":
    main()
