"""Randomness by counting: a number is a function of (seed, process, how many periods have passed), and of nothing else.

So a process asked twice within one of its periods gives the same number twice, whoever asks, in whatever order and on
whatever number of threads. The mixing function is splitmix64's finaliser (Steele, Lea, Flood 2014), applied twice.
"""

import math
from hashlib import blake2b

import numpy as np

from goniotwin.twin.optics.kernel import kernel

U64 = np.uint64


def process_key(seed: int, process: str) -> np.uint64:
    """The key of a named process under a seed."""
    return U64(int.from_bytes(blake2b(f"{seed}/{process}".encode(), digest_size=8).digest(), "big"))


@kernel()
def mix(key: np.uint64, counter: np.int64) -> np.uint64:
    """64 bits that look random, of a key and a counter."""
    z = key + U64(counter) * U64(0x9E3779B97F4A7C15)
    for _ in range(2):
        z = (z ^ (z >> U64(30))) * U64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> U64(27))) * U64(0x94D049BB133111EB)
        z = z ^ (z >> U64(31))
    return z


@kernel()
def normal(key: np.uint64, counter: np.int64) -> float:
    """A standard normal number (Box and Muller) of a key and a counter."""
    bits = mix(key, counter)
    radius = math.sqrt(-2.0 * math.log((float(bits >> U64(32)) + 0.5) / 4294967296.0))
    return radius * math.cos(2.0 * math.pi * (float(bits & U64(0xFFFFFFFF)) / 4294967296.0))


@kernel()
def wandering(key: np.uint64, t: float, period: float) -> float:
    """A slow standard process: normal numbers each `period`, joined by straight lines."""
    place = t / period
    k = math.floor(place)
    share = place - k
    return (1.0 - share) * normal(key, np.int64(k)) + share * normal(key, np.int64(k) + 1)
