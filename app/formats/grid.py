"""The grids of BSDF tables: lists of angles that ascend, and finite values of the shape that the lists say."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from goniotwin.arrays import Floats


def ascending(name: str, values: ArrayLike, low: float, high: float) -> Floats:
    """`values` as a copy in float64; raises ValueError unless a list that ascends strictly within low..high."""
    array = np.array(values, dtype=np.float64)
    if array.ndim != 1 or array.size == 0:
        raise ValueError(f"{name} has the shape {array.shape}; give a list of one number or more")
    if not bool(np.all((array >= low) & (array <= high))):
        raise ValueError(f"{name} has numbers outside {low:g} to {high:g}; correct them")
    if not bool(np.all(np.diff(array) > 0)):
        raise ValueError(f"{name} does not ascend; sort it and give each number once")
    return array


def finite(name: str, values: ArrayLike, shape: Sequence[int]) -> Floats:
    """`values` as a copy in float64; raises ValueError unless all finite and of this shape."""
    array = np.array(values, dtype=np.float64)
    if array.shape != tuple(shape):
        raise ValueError(f"{name} has the shape {array.shape}; the lists of angles say {tuple(shape)}")
    missing = int(np.count_nonzero(~np.isfinite(array)))
    if missing:
        raise ValueError(f"{name} has {missing} of {array.size} that are not finite; fill or leave out these nodes")
    return array
