"""Counting-based estimates in chunks: on any number of threads, and until an error is reached.

Partial sums are added in the order of the chunks, so that the result does not depend on the threads.
"""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numba

from goniotwin.arrays import Floats

CHUNK = 65536
Result = TypeVar("Result")


def check_seed(seed: int) -> None:
    """Raises ValueError unless the kernels can take it."""
    if not 0 <= seed < 2**64:
        raise ValueError(f"seed is {seed}: give a whole number from 0 to 2^64 - 1")


def summed(trace: Callable[[int, int], Floats], first: int, last: int, chunk: int = CHUNK) -> Floats:
    """Sum of what `trace` gives for rays first..last-1. It must be a function of these alone, and hold no lock."""
    if last - first <= chunk:
        return trace(first, last)
    starts = range(first, last, chunk)
    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        parts = pool.map(lambda start: trace(start, min(start + chunk, last)), starts)
        total = next(parts)
        for part in parts:
            total += part
    return total


def until(
    trace: Callable[[int, int], Floats],
    estimate: Callable[[Floats, int], tuple[float, float, Result]],
    rays: int | None,
    relative_error: float | None,
    first_rays: int,
    dark_rays: int,
    most_rays: int,
    chunk: int = CHUNK,
) -> Result:
    """What `estimate` makes of the sums over `rays` rays, or over as many as it takes for the relative error.

    `estimate` gives a value, its standard error, and the result. Rays already traced are kept: the next ones come after
    them. Raises ValueError unless exactly one of `rays` (at least 2) and `relative_error` (in 0..1) is given, and where
    the error is out of reach: no light after `dark_rays`, or more than `most_rays` to come.
    """
    if (rays is None) == (relative_error is None):
        raise ValueError("give either rays or relative_error")
    if rays is not None:
        if rays < 2:
            raise ValueError(f"rays is {rays}: give at least 2, for an error needs two")
        return estimate(summed(trace, 0, rays, chunk), rays)[2]
    assert relative_error is not None
    if not 0.0 < relative_error < 1.0:
        raise ValueError(f"relative_error is {relative_error!r}: give a share between 0 and 1")
    done = first_rays
    sums = summed(trace, 0, done, chunk)
    while True:
        value, error, result = estimate(sums, done)
        if value <= 0.0:
            needed = 16.0 * done
            if done >= dark_rays:
                raise ValueError(
                    f"relative_error {relative_error:g} of no light: none of {done} rays arrived; give rays instead"
                )
        elif error <= relative_error * value:
            return result
        else:
            needed = 1.1 * (error / (relative_error * value)) ** 2 * done
        if needed > most_rays:
            raise ValueError(f"relative_error {relative_error:g} takes {needed:.1e} rays, more than {most_rays:.1e}")
        # Few rays have a poor idea of their error: no more than sixteen times as many at once.
        more = math.ceil(min(16.0 * done, max(1.25 * done, needed)) / first_rays) * first_rays
        sums = sums + summed(trace, done, more, chunk)
        done = more
