"""Deviations: position error of an element, as three angles and three shifts."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import astuple, dataclass

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.keys import check_bounds


@dataclass(frozen=True)
class Deviation:
    """Six deviations of an element from its nominal position (paper, figures 9 and 11). The element is turned about the x, then
    the y, then the z axis of the frame in which its position is given. It turns about its own reference point, and is then
    shifted along these axes.

    `rx_deg`: right-handed angle about x. `ry_deg`: right-handed angle about y. `rz_deg`: right-handed angle about z. `x_mm`:
    shift along x. `y_mm`: shift along y. `z_mm`: shift along z.

    Raises ValueError, naming the field, for a value that is not finite.
    """

    rx_deg: float = 0.0
    ry_deg: float = 0.0
    rz_deg: float = 0.0
    x_mm: float = 0.0
    y_mm: float = 0.0
    z_mm: float = 0.0

    def __post_init__(self) -> None:
        check_bounds(self)


NO_DEVIATION = Deviation()


def rotation_and_shift(deviation: Deviation) -> tuple[Floats, Floats]:
    """Rotation matrix R (3, 3) and shift (3,) in mm: a point p of an element about c moves to c + R (p - c) + shift."""
    row, turn = np.array(astuple(deviation)), np.empty((3, 3))
    turn_by(row, turn)
    return turn, row[3:]


def turn_by(deviation: Floats, turn: Floats) -> None:
    """Fill `turn` (3, 3) with the rotation of a deviation (6,): its three angles, deg, and three shifts.

    For Python; the kernel of it is `twin.optics.geometry.rotations.fill_rotation`.
    """
    rx, ry, rz = math.radians(deviation[0]), math.radians(deviation[1]), math.radians(deviation[2])
    cx = cy = cz = 1.0
    sx = sy = sz = 0.0
    if rx != 0.0:
        cx, sx = math.cos(rx), math.sin(rx)
    if ry != 0.0:
        cy, sy = math.cos(ry), math.sin(ry)
    if rz != 0.0:
        cz, sz = math.cos(rz), math.sin(rz)
    turn[0, 0], turn[0, 1], turn[0, 2] = cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx
    turn[1, 0], turn[1, 1], turn[1, 2] = sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx
    turn[2, 0], turn[2, 1], turn[2, 2] = -sy, cy * sx, cy * cx


def check_deviations(
    deviations: Mapping[str, Deviation], known: Iterable[str], table: str = "deviations"
) -> dict[str, Deviation]:
    """Check deviations by name of the element, and copy them; `table` is their name in messages.

    Raises ValueError, listing the known elements, for an unknown name.
    """
    names = tuple(known)
    for name, deviation in deviations.items():
        if name not in names:
            raise ValueError(f"{table} of {name!r}: no such element; known are {', '.join(names)}")
        if not isinstance(deviation, Deviation):
            raise ValueError(f"{table}[{name!r}] is {deviation!r}: give a Deviation")
    return dict(deviations)
