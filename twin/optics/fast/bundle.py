"""Rays of a detector's bundle, and the sizes of disc, hole and field: numbers alone, for kernels and for numpy."""

import math
from functools import lru_cache

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.instrument import Dimensions

CLOSER = 1.1
"""With deviations a detector may be closer to a part of the hole than the arc's radius, by up to this factor."""
COSINE = 0
"""Row of a bundle with each ray's component along the detector's axis."""
# Offset of the sequence: the best of 120, chosen when rays beyond the disc's edge were still dropped; any other would do.
SHIFT = (0.42, 0.25, 0.22, 0.65, 0.05, 0.24)


def _r_sequence(count: int, shift: tuple[float, ...]) -> Floats:
    """Points (count, len(shift)) in 0..1: additive recurrence with the generalised golden ratio (Roberts 2018)."""
    dimensions = len(shift)
    ratio = 2.0
    for _ in range(64):
        ratio = (1.0 + ratio) ** (1.0 / (dimensions + 1))
    steps = (1.0 / ratio) ** np.arange(1, dimensions + 1)
    return (0.5 + np.array(shift) + np.arange(1, count + 1)[:, None] * steps) % 1.0


def _disc(square: Floats) -> Floats:
    """Map of the square from -1 to 1 (n, 2) to the unit disc that keeps areas (concentric map, Shirley and Chiu 1997)."""
    x, y = square[:, 0], square[:, 1]
    wide = np.abs(x) > np.abs(y)
    radius = np.where(wide, x, y)
    divisor = np.where(radius == 0.0, 1.0, radius)
    angle = np.where(wide, np.pi / 4 * y / divisor, np.pi / 2 - np.pi / 4 * x / divisor)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


@lru_cache(maxsize=16)
def ray_bundle(rays: int, sine: float) -> Floats:
    """Bundle of `rays` rays, as an array (7, rays / 4); `sine` is that of half the field.

    The rows are each ray's component along the detector's axis, its points of the hole and of the pupil from -1 to 1, and its
    slopes, in the order of `Block.tile`. The same for every call. Every ray of the array comes with
    three more: with opposite signs at the detector's end, at the pupil's end, and at both. In the lobe of a Gaussian the terms
    that are odd in a ray's offset from the axis are by far the largest; so they cancel, with the products of the two ends.
    Raises ValueError unless `rays` is a multiple of 4, at least 4.
    """
    if rays < 4 or rays % 4:
        raise ValueError(f"rays is {rays}: give a multiple of 4, at least 4")
    squares = 2.0 * _r_sequence(rays // 4, SHIFT) - 1.0
    slopes = sine * _disc(squares[:, 2:4])
    along = np.sqrt(1.0 - np.sum(slopes**2, axis=1))
    return np.vstack([along[None], squares[:, 0:2].T, _disc(squares[:, 4:6]).T, (slopes / along[:, None]).T])


def aperture_sizes(dimensions: Dimensions) -> Floats:
    """Argument of the kernels: the disc's radius and the hole's half side, mm, and the sine of half the field.

    A field wider than the widest angle between hole and disc is limited to that angle: the result is the same, and costs less.
    """
    radius, half = 0.5 * dimensions.detector_diameter_mm, 0.5 * dimensions.spot_side_mm
    most = math.atan(CLOSER * (radius + math.sqrt(2.0) * half) / dimensions.arc_radius_mm)
    return np.array([radius, half, math.sin(min(math.radians(0.5 * dimensions.field_deg), most))])
