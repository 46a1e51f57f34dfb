"""Deviations: position error of an element, as three angles and three shifts."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.keys import check_bounds


@dataclass(frozen=True)
class Deviation:
    """Six deviations of an element from its nominal position, zero by default (paper, figures 9 and 11).

    The element is turned about the x, then the y, then the z axis of the frame in which its position is given, through its own
    reference point, and then shifted along these axes. Angles `rx_deg`, `ry_deg`, `rz_deg` are right-handed; shifts `x_mm`,
    `y_mm`, `z_mm`. Raises ValueError, naming the field, for a value that is not finite.
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
    rx, ry, rz = deviation.rx_deg, deviation.ry_deg, deviation.rz_deg
    shift = np.array([deviation.x_mm, deviation.y_mm, deviation.z_mm])
    if rx == ry == rz == 0.0:
        return np.eye(3), shift
    angles = [math.radians(each) for each in (rx, ry, rz)]
    return np.array(_rotation([math.cos(each) for each in angles], [math.sin(each) for each in angles])), shift


def rotations(angles_deg: Floats) -> Floats:
    """Rotation matrices (..., 3, 3) of angles (..., 3) about x, y and z, as in `rotation_and_shift`."""
    angles = np.moveaxis(np.radians(angles_deg), -1, 0)
    return np.ascontiguousarray(np.moveaxis(np.array(_rotation(np.cos(angles), np.sin(angles))), (0, 1), (-2, -1)))


def _rotation(cosines: Any, sines: Any) -> list[list[Any]]:
    """Rows of the rotation about x, then y, then z: of three numbers each, or of three arrays."""
    (cx, cy, cz), (sx, sy, sz) = cosines, sines
    return [
        [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
        [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
        [-sy, cy * sx, cy * cx],
    ]


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
