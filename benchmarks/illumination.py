"""Duration of the illumination estimators: `python -m benchmarks.illumination`."""

import json
import os
import statistics
import time
from collections.abc import Callable
from dataclasses import replace

import numba
import numpy as np

from goniotwin.twin.optics.geometry.deviation import Deviation
from goniotwin.twin.optics.illumination.adjoint import adjoint_illumination
from goniotwin.twin.optics.illumination.field_flux import field_fluxes
from goniotwin.twin.optics.illumination.forward import forward_illumination
from goniotwin.twin.optics.illumination.unit import IlluminationUnit

RELATIVE_ERROR = 0.01
REPEATS = 101
RAYS, SETS = 4096, 256


def _seconds(run: Callable[[], object], repeats: int, clock: Callable[[], float] = time.perf_counter) -> float:
    """Median duration, after one run that compiles."""
    run()
    times = []
    for _ in range(repeats):
        start = clock()
        run()
        times.append(clock() - start)
    return statistics.median(times)


def measure() -> dict[str, float]:
    """Durations, warm, on one core; `_cpu_` is processor time, `illumination_load` the machine's load before.

    4,096 adjoint rays, and what of it is Python about the kernel (a call with 50 rays); a set of deviations of Table 1 by
    the quadrature. Then to 1 % in the flux on the 5 x 5 mm: the adjoint estimator in ms; the same for a new unit each time (as
    tolerances need it); the forward one in ms; their ratio.
    """
    unit = IlluminationUnit()
    awry = {"unit": Deviation(rx_deg=0.05), "arc": Deviation(x_mm=0.025)}
    sets = np.random.default_rng(1).uniform(-1.0, 1.0, (SETS, 6, 6)) * np.repeat([0.05, 0.025], 3)
    threads = numba.get_num_threads()
    figures = {"illumination_load": os.getloadavg()[0]}
    try:
        numba.set_num_threads(1)
        for clock, name in ((time.perf_counter, ""), (time.process_time, "cpu_")):
            figures[f"adjoint_{name}ms"] = 1e3 * _seconds(lambda: adjoint_illumination(unit, rays=RAYS), REPEATS, clock)
            figures[f"adjoint_overhead_{name}ms"] = 1e3 * _seconds(lambda: adjoint_illumination(unit, rays=50), REPEATS, clock)
            figures[f"field_flux_{name}us"] = 1e6 / SETS * _seconds(lambda: field_fluxes(unit, sets), 5, clock)
        adjoint = _seconds(lambda: adjoint_illumination(unit, relative_error=RELATIVE_ERROR), REPEATS)
        anew = _seconds(
            lambda: adjoint_illumination(replace(unit, deviations=awry), relative_error=RELATIVE_ERROR, cells=1), REPEATS
        )
        forward = _seconds(lambda: forward_illumination(unit, relative_error=RELATIVE_ERROR), 1)
    finally:
        numba.set_num_threads(threads)
    return figures | {
        "illumination_adjoint_ms": 1e3 * adjoint,
        "illumination_adjoint_new_unit_ms": 1e3 * anew,
        "illumination_forward_ms": 1e3 * forward,
        "illumination_forward_over_adjoint": forward / adjoint,
    }


if __name__ == "__main__":
    print(json.dumps(measure(), indent=2))
