"""The mirror unit: three plane square mirrors that carry the beam from the illumination axis to the sample.

The light comes along y to mirror 1 at (0, -d, 0), goes out along l to mirror 2, runs parallel to y to mirror 3 at d l, and
comes back along -l to the sample: the corners of a square of side d, turned about y by sigma (paper, figure 4). The paper does
not give the sign of the direction along y; here the light comes from negative y.

Also the intersection of a ray with a mirror.
"""

import math
from dataclasses import dataclass

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.instrument import (
    MIRROR_1,
    MIRROR_DISTANCE,
    MIRROR_UNIT,
    PUPIL,
    PUPIL_TO_MIRROR,
    Instrument,
)
from goniotwin.twin.optics.geometry.nominal import place_mirrors
from goniotwin.twin.optics.geometry.rotations import fill_rotation
from goniotwin.twin.optics.kernel import kernel


@dataclass(frozen=True, eq=False)
class Mirrors:
    """Three squares in the order of the beam: `packed` (3, 4, 3) has the centre, mm, the normal and two axes of each.

    `normals` face the light; `axes_u` and `axes_v` are unit vectors along the sides; each (3, 3), one row per mirror.
    """

    packed: Floats

    @property
    def centres(self) -> Floats:
        """Centres (3, 3), mm."""
        return self.packed[:, 0]

    @property
    def normals(self) -> Floats:
        """Unit normals (3, 3)."""
        return self.packed[:, 1]

    @property
    def axes_u(self) -> Floats:
        """Unit vectors (3, 3) across the plane of the unit."""
        return self.packed[:, 2]

    @property
    def axes_v(self) -> Floats:
        """Unit vectors (3, 3) in the plane of the unit."""
        return self.packed[:, 3]


def reflect(vector: Floats, normal: Floats) -> Floats:
    """Vector (3,) reflected in a plane with the unit normal `normal`."""
    image: Floats = vector - 2.0 * float(vector @ normal) * normal
    return image


def mirrors_at(instrument: Instrument, sigma_deg: float) -> Mirrors:
    """Mirrors of the unit at `sigma_deg`. Raises ValueError unless that is finite."""
    if not math.isfinite(sigma_deg):
        raise ValueError(f"sigma_deg is {sigma_deg!r}: give the mirror unit's angle in degrees")
    packed = np.empty((3, 4, 3))
    fill_mirrors(instrument.lengths, instrument.deviation_rows, sigma_deg, packed)
    return Mirrors(packed)


def pupil(instrument: Instrument) -> tuple[Floats, Floats, Floats]:
    """Centre (mm) and two unit axes, (3,) each, of the exit pupil itself, before mirror 1."""
    rows = np.empty((3, 3))
    place_unit(instrument.lengths, instrument.deviation_rows, instrument.exit_pupil, rows)
    return rows[0], rows[1], rows[2]


def illumination_place(instrument: Instrument) -> tuple[Floats, Floats]:
    """Rotation (3, 3) and origin (3,), mm, of the illumination unit's frame in the rig's: p is at rotation @ p + origin."""
    rows = np.empty((4, 3))
    place_unit(instrument.lengths, instrument.deviation_rows, np.eye(4, 3, -1), rows)
    return np.ascontiguousarray(rows[1:].T), rows[0]


def pupil_image(instrument: Instrument, sigma_deg: float) -> tuple[Floats, Floats, Floats]:
    """Centre (mm) and two unit axes, (3,) each, of the exit pupil's image in the three mirrors, as seen from the sample.

    Exact: the pupil is reflected in the three planes one after the other. The axes turn with sigma, as the beam's section does.
    """
    rows = np.array(pupil(instrument))
    for mirror in mirrors_at(instrument, sigma_deg).packed:
        reflect_rows(rows, mirror)
    return rows[0], rows[1], rows[2]


fill_nominal_mirrors = kernel()(place_mirrors)


@kernel()
def fill_mirrors(lengths: Floats, deviations: Floats, sigma_deg: float, mirrors: Floats) -> None:
    """Fill `mirrors` (3, 4, 3) as in `Mirrors`, at any sigma, with the deviations (elements, 6) of mirrors and unit."""
    sine, cosine = math.sin(math.radians(sigma_deg)), math.cos(math.radians(sigma_deg))
    turn, own = np.empty((3, 3)), np.empty((3, 3))
    fill_nominal_mirrors(lengths[MIRROR_DISTANCE], sigma_deg, mirrors)
    for m in range(3):
        deviation = deviations[MIRROR_1 + m]
        if is_moved(deviation):
            fill_rotation(deviation, turn)
            for c in range(3):
                own[0, c], own[1, c], own[2, c] = mirrors[m, 2, c], mirrors[m, 3, c], mirrors[m, 1, c]
            for c in range(3):
                mirrors[m, 0, c] += deviation[3] * own[0, c] + deviation[4] * own[1, c] + deviation[5] * own[2, c]
                mirrors[m, 2, c] = turn[0, 0] * own[0, c] + turn[1, 0] * own[1, c] + turn[2, 0] * own[2, c]
                mirrors[m, 3, c] = turn[0, 1] * own[0, c] + turn[1, 1] * own[1, c] + turn[2, 1] * own[2, c]
                mirrors[m, 1, c] = turn[0, 2] * own[0, c] + turn[1, 2] * own[1, c] + turn[2, 2] * own[2, c]
    deviation = deviations[MIRROR_UNIT]
    if is_moved(deviation):
        fill_rotation(deviation, turn)
        for m in range(3):
            for row in range(4):
                # In the unit's frame: across, along y, towards the light.
                x, y, z = mirrors[m, row, 0], mirrors[m, row, 1], mirrors[m, row, 2]
                a, b, c = cosine * x - sine * z, y, sine * x + cosine * z
                p = turn[0, 0] * a + turn[0, 1] * b + turn[0, 2] * c
                q = turn[1, 0] * a + turn[1, 1] * b + turn[1, 2] * c
                r = turn[2, 0] * a + turn[2, 1] * b + turn[2, 2] * c
                if row == 0:
                    p, q, r = p + deviation[3], q + deviation[4], r + deviation[5]
                mirrors[m, row, 0], mirrors[m, row, 1], mirrors[m, row, 2] = cosine * p + sine * r, q, cosine * r - sine * p


@kernel()
def place_unit(lengths: Floats, deviations: Floats, own: Floats, rows: Floats) -> None:
    """Fill the first of `rows` (at least n, 3) with `own` (n, 3), a point and vectors of the illumination unit's frame.

    In the rig's frame, before mirror 1: for `Instrument.exit_pupil`, see `pupil`.
    """
    turn = np.empty((3, 3))
    fill_rotation(deviations[PUPIL], turn)
    for row in range(own.shape[0]):
        for c in range(3):
            rows[row, c] = turn[c, 0] * own[row, 0] + turn[c, 1] * own[row, 1] + turn[c, 2] * own[row, 2]
    for c in range(3):
        rows[0, c] += deviations[PUPIL, 3 + c]
    rows[0, 1] -= lengths[MIRROR_DISTANCE] + lengths[PUPIL_TO_MIRROR]


@kernel(forceinline=True)
def is_moved(deviation: Floats) -> bool:
    """Whether one of the six components of a deviation is not zero."""
    for c in range(6):  # noqa: SIM110 - a generator in numba is slower
        if deviation[c] != 0.0:
            return True
    return False


@kernel()
def reflect_rows(rows: Floats, mirror: Floats) -> None:
    """Reflect `rows` (n, 3), the first a point and the others vectors, in the plane of `mirror` (4, 3)."""
    nx, ny, nz = mirror[1, 0], mirror[1, 1], mirror[1, 2]
    offset = mirror[0, 0] * nx + mirror[0, 1] * ny + mirror[0, 2] * nz
    for i in range(rows.shape[0]):
        twice = 2.0 * (rows[i, 0] * nx + rows[i, 1] * ny + rows[i, 2] * nz - (offset if i == 0 else 0.0))
        rows[i, 0] -= twice * nx
        rows[i, 1] -= twice * ny
        rows[i, 2] -= twice * nz


@kernel(forceinline=True)
def distance_to(
    mirrors: Floats, m: int, half: float, px: float, py: float, pz: float, wx: float, wy: float, wz: float
) -> float:
    """Distance from p along the unit vector w to the square m of half side `half`; infinite where the ray misses it."""
    cx, cy, cz = mirrors[m, 0, 0] - px, mirrors[m, 0, 1] - py, mirrors[m, 0, 2] - pz
    slope = wx * mirrors[m, 1, 0] + wy * mirrors[m, 1, 1] + wz * mirrors[m, 1, 2]
    # A ray within the mirror's plane divides by zero: the result is inf or NaN, and the last condition is false.
    distance = (cx * mirrors[m, 1, 0] + cy * mirrors[m, 1, 1] + cz * mirrors[m, 1, 2]) / slope
    x, y, z = distance * wx - cx, distance * wy - cy, distance * wz - cz
    u = x * mirrors[m, 2, 0] + y * mirrors[m, 2, 1] + z * mirrors[m, 2, 2]
    v = x * mirrors[m, 3, 0] + y * mirrors[m, 3, 1] + z * mirrors[m, 3, 2]
    if distance > 0.0 and abs(u) <= half and abs(v) <= half:
        return distance  # type: ignore[no-any-return]
    return math.inf
