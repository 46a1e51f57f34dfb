"""All combinations of twelve deviations, exact and by the surrogate: `python -m benchmarks.tolerances [--json]`.

The twelve tilts of the paper's Table 2 and figure 11, each at -0.05, 0 and 0.05 deg, are 531,441 rigs. For each the criterion
is the relative RMS (formula 5) of a Gaussian of 5 deg at sigma 30 deg: in the plane of incidence (41 detectors) or over the
lobe (1,448 detectors; exact that takes minutes, and `--without-lobe` omits it). Two beams: the instrument's, with its exit
pupil at 800 mm, and a collimated one.

Times are wall times in s, `_cpu_s` those of the processor, on all cores, warm; judge a shared machine by the latter over the
number of cores. The surrogate's times include its fit. `surrogate_error_points` is its largest error, in percentage points of
the RMS, for 50 random combinations (1,000 where the tilts are 0.2 deg: some of these beams miss a mirror) and the worst corner,
in plane, at widths of 5 and 2 deg.
"""

import argparse
import json
import os
import time
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import numba
import numpy as np

from benchmarks.optics import SIGMA_DEG, detector_grid
from goniotwin.app.simulation.paper.table3 import collimated
from goniotwin.app.simulation.paper.worst_corner import TILT_DEG
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Instrument, factor_blocks
from tests.twin.optics.fast.combinations import COUNT, LARGE_DEG, Lobe, deviations_of, surrogate_error, tilt_parts

SIGMA, WIDTH, LIMIT_PERCENT = 30.0, 5.0, 5.0
LOBE_DEG = 10.5
Result = TypeVar("Result")


def timed(action: Callable[[], Result]) -> tuple[Result, float, float]:
    """Result, wall time and processor time in s."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = action()
    return result, time.perf_counter() - wall, time.process_time() - cpu


def measure(*, with_lobe: bool) -> dict[str, Any]:
    """All figures, as in the JSON."""
    blocks = list(factor_blocks(COUNT))
    instrument = Instrument(obstruction=False, lit_everywhere=True)
    beams = {"pupil_800_mm": instrument, "collimated": collimated(instrument)}
    result: dict[str, Any] = {
        "load": os.getloadavg()[0],
        "threads": numba.get_num_threads(),
        "rigs": sum(map(len, blocks)),
        "worst_rms_percent": {},
        "median_rms_percent": {},
        "passed_percent": {},
        "surrogate_error_points": {},
    }

    def add(name: str, action: Callable[[], Result]) -> Result:
        found, result[f"{name}_s"], result[f"{name}_cpu_s"] = timed(action)
        return found

    theta, phi = detector_grid()
    around = theta[theta <= LOBE_DEG + 1e-9], phi[theta <= LOBE_DEG + 1e-9]
    plane, lobe = Lobe(instrument, SIGMA, WIDTH), Lobe(instrument, SIGMA, WIDTH, *around)
    parts = tilt_parts(instrument)
    warm = [blocks[0][:COUNT]]
    for each in (plane, lobe):
        each.exact_percent(deviations_of(parts, warm))
        each.surrogate_percent(parts, warm)
    result["in_plane_detectors"], result["lobe_detectors"] = plane.theory.size, lobe.theory.size

    def exact(own: Lobe, moved: Floats) -> Floats:
        return own.exact_percent(deviations_of(moved, blocks))

    for beam, one in beams.items():
        own, moved = Lobe(one, SIGMA, WIDTH), tilt_parts(one)
        name = "exact_in_plane" if one is instrument else "exact_in_plane_collimated"
        percent = add(name, partial(exact, own, moved))  # with the time that its deviations take
        result["worst_rms_percent"][beam] = float(percent.max())
        result["median_rms_percent"][beam] = float(np.median(percent))
        result["passed_percent"][beam] = float(100.0 * np.mean(percent <= LIMIT_PERCENT))
    add("in_plane", lambda: plane.surrogate_percent(parts, blocks))
    add("lobe", lambda: lobe.surrogate_percent(parts, blocks))
    sigmas = [Lobe(instrument, float(sigma), WIDTH, *around) for sigma in SIGMA_DEG]
    add("all_sigma", lambda: [each.surrogate_percent(parts, blocks) for each in sigmas if each.theory.size])
    for width in (5.0, 2.0):
        for tilt in (TILT_DEG, LARGE_DEG):
            result["surrogate_error_points"][f"alpha_{width:g}_deg_tilt_{tilt:g}_deg"] = surrogate_error(
                instrument, width, tilt
            )
    if with_lobe:
        percent = add("exact_lobe", lambda: lobe.exact_percent(deviations_of(parts, blocks)))
        result["lobe_worst_rms_percent"] = float(percent.max())
        result["lobe_surrogate_error_points"] = float(np.max(np.abs(percent - lobe.surrogate_percent(parts, blocks))))
    return result


def main() -> None:
    """Print a line for each figure, or with --json one object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    parser.add_argument("--without-lobe", action="store_true", help="omit the exact lobe")
    chosen = parser.parse_args()
    result = measure(with_lobe=not chosen.without_lobe)
    if chosen.json:
        print(json.dumps(result, indent=2))
        return
    for name, value in result.items():
        for part, number in value.items() if isinstance(value, dict) else [("", value)]:
            print(f"{name:28} {part:28} {number:12.6g}")


if __name__ == "__main__":
    main()
