"""Counter-based random numbers: a number is a function of seed, process and period index alone.

A process evaluated twice within one period gives the same number twice, in any order and on any number of threads. The mixing
function is the finaliser of splitmix64 (Steele, Lea, Flood 2014), applied twice.
"""

import math

import numpy as np

from goniotwin.twin.optics.kernel import kernel

U64 = np.uint64


@kernel()
def mix(key: np.uint64, counter: np.int64) -> np.uint64:
    """64 pseudo-random bits from a key and a counter."""
    z = key + U64(counter) * U64(0x9E3779B97F4A7C15)
    for _ in range(2):
        z = (z ^ (z >> U64(30))) * U64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> U64(27))) * U64(0x94D049BB133111EB)
        z = z ^ (z >> U64(31))
    return z


@kernel()
def normal(key: np.uint64, counter: np.int64) -> float:
    """Standard normal number (Box and Muller) from a key and a counter."""
    bits = mix(key, counter)
    radius = math.sqrt(-2.0 * math.log((float(bits >> U64(32)) + 0.5) / 4294967296.0))
    return radius * math.cos(2.0 * math.pi * (float(bits & U64(0xFFFFFFFF)) / 4294967296.0))


@kernel()
def wandering(key: np.uint64, t: float, period: float) -> float:
    """Slow random process of unit standard deviation: normal numbers at each `period`, with linear interpolation."""
    place = t / period
    k = math.floor(place)
    share = place - k
    return (1.0 - share) * normal(key, np.int64(k)) + share * normal(key, np.int64(k) + 1)
