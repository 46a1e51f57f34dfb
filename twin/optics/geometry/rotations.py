"""Rotations of elements that are off, as kernels."""

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.deviation import turn_by
from goniotwin.twin.optics.kernel import kernel

fill_rotation = kernel()(turn_by)


@kernel()
def rotations(deviations: Floats) -> Floats:
    """Rotation matrices (n, 3, 3) of deviations (n, 6), see `fill_rotation`."""
    turns = np.empty((deviations.shape[0], 3, 3))
    for i in range(deviations.shape[0]):
        fill_rotation(deviations[i], turns[i])
    return turns
