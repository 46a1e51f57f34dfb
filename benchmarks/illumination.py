"""Duration of the illumination estimators: `python -m benchmarks.illumination`."""

import json
import statistics
import time
from collections.abc import Callable
from dataclasses import replace

import numba

from goniotwin.twin.optics.geometry.deviation import Deviation
from goniotwin.twin.optics.illumination.adjoint import adjoint_illumination
from goniotwin.twin.optics.illumination.forward import forward_illumination
from goniotwin.twin.optics.illumination.unit import IlluminationUnit

RELATIVE_ERROR = 0.01
REPEATS = 101


def _seconds(run: Callable[[], object], repeats: int) -> float:
    """Median duration, after one run that compiles."""
    run()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def measure() -> dict[str, float]:
    """Durations to 1 % in the flux on the 5 x 5 mm, warm, on one core.

    The adjoint estimator in ms; the same for a new unit each time (as tolerances need it); the forward one in ms; their ratio.
    """
    unit = IlluminationUnit()
    awry = {"unit": Deviation(rx_deg=0.05), "arc": Deviation(x_mm=0.025)}
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        adjoint = _seconds(lambda: adjoint_illumination(unit, relative_error=RELATIVE_ERROR), REPEATS)
        anew = _seconds(
            lambda: adjoint_illumination(replace(unit, deviations=awry), relative_error=RELATIVE_ERROR, cells=1), REPEATS
        )
        forward = _seconds(lambda: forward_illumination(unit, relative_error=RELATIVE_ERROR), 1)
    finally:
        numba.set_num_threads(threads)
    return {
        "illumination_adjoint_ms": 1e3 * adjoint,
        "illumination_adjoint_new_unit_ms": 1e3 * anew,
        "illumination_forward_ms": 1e3 * forward,
        "illumination_forward_over_adjoint": forward / adjoint,
    }


if __name__ == "__main__":
    print(json.dumps(measure(), indent=2))
