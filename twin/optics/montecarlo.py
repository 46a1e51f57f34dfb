"""Monte Carlo: counter-based random numbers, and estimates in chunks on any number of threads.

A random number is a function of a key and a counter alone. So the numbers of a path do not depend on the thread that traces it.
There are 64-bit numbers for scalar code, and 32-bit numbers for loops over a block of paths, which LLVM vectorises.

Partial sums are added in the order of the chunks, so that the result does not depend on the number of threads.
"""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.kernel import kernel, thread_count

U32 = np.uint32
U64 = np.uint64
F32 = np.float32
HALF_16 = np.float32(2.0**-17)
STEP_16 = np.float32(2.0**-16)
STEP_24 = np.float32(2.0**-24)
CHUNK = 65536
SINE = tuple((-1.0) ** k / math.factorial(2 * k + 1) for k in range(10))
COSINE = tuple((-1.0) ** k / math.factorial(2 * k) for k in range(11))
Result = TypeVar("Result")


class NoLightError(ValueError):
    """No ray arrives: a relative error has no meaning."""


@kernel()
def scramble(bits: np.uint64) -> np.uint64:
    """64 pseudo-random bits: the finaliser of splitmix64 (Steele, Lea, Flood 2014)."""
    # Every constant is cast: with a plain integer numba converts to floats, and the bits are wrong without any error.
    bits = (bits ^ (bits >> U64(30))) * U64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> U64(27))) * U64(0x94D049BB133111EB)
    return bits ^ (bits >> U64(31))


@kernel()
def item_key(key: np.uint64, number: int) -> np.uint64:
    """Key of one of a seed's rays, blocks or paths, by its number."""
    return scramble(key + U64(number) * U64(0xD1342543DE82EF95))


@kernel()
def uniform(key: np.uint64, counter: int) -> float:
    """Number `counter` of a path's key, in [0, 1)."""
    bits = scramble(key + U64(counter + 1) * U64(0x9E3779B97F4A7C15))
    return float(bits >> U64(11)) * 1.1102230246251565e-16


@kernel(forceinline=True)
def _sum_powers(terms: tuple[float, ...], square: float) -> float:
    total = terms[-1]
    for k in range(len(terms) - 1, 0, -1):
        total = terms[k - 1] + square * total
    return total


@kernel(forceinline=True)
def circle_point(share: float) -> tuple[float, float]:
    """Cosine and sine of a share of the whole turn, 0 to 1, to 4e-16: by series, for LLVM does not vectorise calls."""
    half = math.pi * (share - 0.5)
    square = half * half
    sin, cos = half * _sum_powers(SINE, square), _sum_powers(COSINE, square)
    return 2.0 * sin * sin - 1.0, -2.0 * sin * cos


@kernel()
def word_key(key: np.uint64, counter: int) -> np.uint32:
    """Key of a block's 32-bit words number `counter`: see `word`."""
    return U32(scramble(key + U64(counter + 1) * U64(0x9E3779B97F4A7C15)) >> U64(32))


@kernel(inline="always")
def word(key: np.uint32, i: int) -> np.uint32:
    """32 bits of path i of a block, for one of its keys: a mixer of two multiplications (Wellons 2018, "lowbias32").

    The golden ratio first spreads the paths' numbers: without it the mixer makes correlated neighbours of consecutive numbers
    (chi-square 4 standard deviations off for a million). For i below 2^32 no word repeats. Blocks have independent keys for
    each of a path's words, so that two paths with the same words are as rare as with random numbers.
    """
    bits = U32(U32(U32(i) * U32(0x9E3779B9)) + key)
    # numba makes 64 bits of 32 in every operation: cast back each time.
    bits = U32(bits ^ U32(bits >> U32(16)))
    bits = U32(bits * U32(0x7FEB352D))
    bits = U32(bits ^ U32(bits >> U32(15)))
    bits = U32(bits * U32(0x846CA68B))
    return U32(bits ^ U32(bits >> U32(16)))


@kernel(inline="always")
def low_16(bits: np.uint32) -> np.float32:
    """Number within 0 and 1 from the lower half of a word: the middle of one of 65536 intervals."""
    return F32(F32(np.int32(bits & U32(0xFFFF))) * STEP_16 + HALF_16)


@kernel(inline="always")
def high_16(bits: np.uint32) -> np.float32:
    """Number within 0 and 1 from the upper half of a word, as `low_16`."""
    return F32(F32(np.int32(bits >> U32(16))) * STEP_16 + HALF_16)


@kernel(inline="always")
def upper_24(bits: np.uint32) -> np.float32:
    """Number in [0, 1), exact in single precision, from the upper 24 bits of a word."""
    return F32(F32(np.int32(bits >> U32(8))) * STEP_24)


def check_seed(seed: int) -> None:
    """Check a seed. Raises ValueError unless it fits into 64 bits without a sign."""
    if not 0 <= seed < 2**64:
        raise ValueError(f"seed is {seed}: give a whole number from 0 to 2^64 - 1")


def sum_chunks(trace: Callable[[int, int], Floats], first: int, last: int, chunk: int = CHUNK) -> Floats:
    """Sum of `trace` over the rays first..last-1. `trace` must depend on its arguments alone and hold no lock."""
    if last - first <= chunk:
        return trace(first, last)
    starts = range(first, last, chunk)
    with ThreadPoolExecutor(thread_count()) as pool:
        sums = pool.map(lambda start: trace(start, min(start + chunk, last)), starts)
        total = next(sums)
        for chunk_sum in sums:
            total += chunk_sum
    return total


def run_until(
    trace: Callable[[int, int], Floats],
    estimate: Callable[[Floats, int], tuple[float, float, Result]],
    rays: int | None,
    relative_error: float | None,
    first_rays: int,
    dark_rays: int,
    most_rays: int,
    chunk: int = CHUNK,
) -> Result:
    """Result of `estimate` for the sums over `rays` rays, or over as many rays as a relative error needs.

    `estimate` gives a value, its standard error, and the result. Rays already traced are used again: the next ones follow them.
    Raises ValueError unless exactly one of `rays` (at least 2) and `relative_error` (in 0..1) is given, and if the error is out
    of reach: no light after `dark_rays`, or more than `most_rays` needed.
    """
    if (rays is None) == (relative_error is None):
        raise ValueError("give either rays or relative_error")
    if rays is not None:
        if rays < 2:
            raise ValueError(f"rays is {rays}: give at least 2; a standard error needs two")
        return estimate(sum_chunks(trace, 0, rays, chunk), rays)[2]
    assert relative_error is not None
    if not 0.0 < relative_error < 1.0:
        raise ValueError(f"relative_error is {relative_error!r}: give a share between 0 and 1")
    done = first_rays
    sums = sum_chunks(trace, 0, done, chunk)
    while True:
        value, error, result = estimate(sums, done)
        if value <= 0.0:
            needed = 16.0 * done
            if done >= dark_rays:
                raise NoLightError(
                    f"relative_error {relative_error:g} is undefined without light: none of {done} rays arrived; give rays"
                )
        elif error <= relative_error * value:
            return result
        else:
            needed = 1.1 * (error / (relative_error * value)) ** 2 * done
        if needed > most_rays:
            raise ValueError(f"relative_error {relative_error:g} needs {needed:.1e} rays, more than {most_rays:.1e}")
        # The error of few rays is itself uncertain: at most sixteen times as many at once.
        more = math.ceil(min(16.0 * done, max(1.25 * done, needed)) / first_rays) * first_rays
        sums = sums + sum_chunks(trace, done, more, chunk)
        done = more
