"""Block of detectors that are computed together: a record whose rows have a lane for each detector, or for each ray of one.

The type of the record states the shape of every field. So LLVM can prove that no two rows overlap, and vectorises each loop
over the lanes. A record is one pointer, without a count of references; it belongs to the Python function that makes it.

Everything is in the sample's frame (optics.md, section 2): the hole's sides lie along x and y, its plane is z = 0. Lengths are
in mm.
"""

from typing import Any

import numpy as np

from goniotwin.twin.optics.kernel import kernel

LANES = 64
X, Y, Z = range(3)
AWAY, LEVEL, VIEW = range(3)
"""Axes of a detector: away from the normal and level, in its disc, and its viewing direction, away from the sample."""
ONE, HOLE_U, HOLE_V, PUPIL_A, PUPIL_B, SLOPE_P, SLOPE_Q = range(7)
"""What the moments of rays are taken of: 1, the point of the hole, that of the pupil's unit disc, the slopes to the axis.

The slopes p and q are those towards AWAY and LEVEL.
"""
ALONG, ACROSS = range(2)
"""Offsets of a ray's value: along the great circle between observer and mirrored light, and across it."""
WEIGHT, LIGHT, OBSERVER = 0, 1, 4
"""Rows of a ray: its weight, and where the directions (3) to the light and to the observer start."""
CLIPPED, TERMS = 6, 15
"""Moments of what mirrors leave of the pupil, and terms of the polynomial of each over the hole."""

_FIELDS: dict[str, tuple[int, ...]] = {
    # The detectors, and their centres along their own axes.
    "position": (3, LANES),
    "axes": (3, 3, LANES),
    "centre": (3, LANES),
    # Over all accepted rays; from the first row on the upper half is filled.
    "moments": (7, 7, LANES),
    # For one slope, over v along the hole: ends along u of the strip of the hole within the disc, by a chord's middle and its
    # distance from the disc's centre (constant and slope), the square of the disc's radius; and the sums over it.
    "foot": (2, LANES),
    "beside": (2, LANES),
    "reach_square": (LANES,),
    "middle": (LANES,),
    "half": (LANES,),
    "share": (LANES,),
    "sums": (7, 7, LANES),
    # A point of a chord of the strip, u, v and weight; moments of the pupil there.
    "chord_point": (3, LANES),
    "clip_moments": (CLIPPED, LANES),
    # Of the accepted rays: mean (its first row has 1 / total) and covariance; slopes of the two offsets over each number, and
    # covariances of these with each number; inverse root of the offsets' covariance; radius and weight of the outer nodes.
    "mean": (7, LANES),
    "covariance": (7, 7, LANES),
    "slope": (2, 7, LANES),
    "shift": (2, 7, LANES),
    "inverse": (2, LANES),
    "mixed": (LANES,),
    "radius": (LANES,),
    "outer_weight": (LANES,),
    # One ray of each detector, or a tile of one detector's rays: WEIGHT, LIGHT and OBSERVER; points of hole and pupil; value.
    "ray": (7, LANES),
    "point": (5, LANES),
    "value": (LANES,),
    # A tile of a bundle, the ends of its chords, and the ends of its rays at the detector.
    "tile": (7, LANES),
    "low": (LANES,),
    "high": (LANES,),
    "end_weight": (LANES,),
    "length": (LANES,),
    # The aperture's share that the seven rays have taken; what mirrors leave of the pupil.
    "taken": (LANES,),
    "clip": (CLIPPED, TERMS),
}
BLOCK = np.dtype([(name, np.float64, shape) for name, shape in _FIELDS.items()], align=True)
Block = Any
"""A record of BLOCK."""


def empty_block() -> Block:
    """Block without content, for the kernels."""
    return np.empty(1, BLOCK)[0]


@kernel(forceinline=True)
def whole_lanes(count: int) -> int:
    """Number of lanes up to which loops run: a multiple of 8, so that none of them is computed by itself.

    Rows have the room. What is computed beyond `count` is of no meaning.
    """
    return (count + 7) & -8
