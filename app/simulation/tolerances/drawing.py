"""Random combinations: the yield of instruments whose deviations are distributed within their tolerances."""

from typing import Literal

import numpy as np

from goniotwin.arrays import Floats

Distribution = Literal["uniform", "normal"]


def draw_deviations(distribution: Distribution, limits: Floats, number: int, seed: int, limit_sigmas: float = 2.0) -> Floats:
    """Random values (number, k) of k deviations.

    Uniform within their limits (k,), or normal with a standard deviation of 1 / `limit_sigmas` of the limit, tails included.
    """
    random = np.random.Generator(np.random.Philox(seed))
    if distribution == "uniform":
        return np.asarray(limits * random.uniform(-1.0, 1.0, (number, limits.size)))
    return np.asarray(limits / limit_sigmas * random.standard_normal((number, limits.size)))
