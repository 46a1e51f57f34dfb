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
from goniotwin.twin.optics.geometry.coordinates import light_direction
from goniotwin.twin.optics.geometry.deviation import NO_DEVIATION, Deviation, rotation_and_shift
from goniotwin.twin.optics.geometry.instrument import Instrument
from goniotwin.twin.optics.kernel import kernel

ALONG_Y = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, eq=False)
class Mirrors:
    """Three squares in the order of the beam, arrays (3, 3) in mm, one row per mirror.

    `normals` face the light; `axes_u` and `axes_v` are unit vectors along the sides.
    """

    centres: Floats
    normals: Floats
    axes_u: Floats
    axes_v: Floats

    @property
    def packed(self) -> Floats:
        """Argument of the kernels, (3, 4, 3): centre, normal and the two axes of each mirror."""
        return np.ascontiguousarray(np.stack([self.centres, self.normals, self.axes_u, self.axes_v], axis=1))


def reflect(vector: Floats, normal: Floats) -> Floats:
    """Vector (3,) reflected in a plane with the unit normal `normal`."""
    image: Floats = vector - 2.0 * float(vector @ normal) * normal
    return image


def mirrors_at(instrument: Instrument, sigma_deg: float) -> Mirrors:
    """Mirrors of the unit at `sigma_deg`. Raises ValueError unless that is finite."""
    if not math.isfinite(sigma_deg):
        raise ValueError(f"sigma_deg is {sigma_deg!r}: give the mirror unit's angle in degrees")
    light = light_direction(sigma_deg)
    distance = instrument.mirror_distance_mm
    centres = distance * np.array([-ALONG_Y, light - ALONG_Y, light])
    # A mirror that turns unit direction a into b has its normal along b - a.
    normals = np.array([light - ALONG_Y, ALONG_Y - light, -light - ALONG_Y]) / math.sqrt(2.0)
    across = np.array([-light[2], 0.0, light[0]])
    axes_u = np.array([across, across, across])
    # normal x across, with the normals as above
    axes_v = np.array([ALONG_Y + light, -ALONG_Y - light, ALONG_Y - light]) / math.sqrt(2.0)
    unit = Mirrors(centres, normals, axes_u, axes_v)
    if any(name.startswith("mirror") for name in instrument.deviations):
        unit = _apply_deviations(instrument, unit, np.array([-across, ALONG_Y, light]))
    return unit


def _apply_deviations(instrument: Instrument, unit: Mirrors, frame: Floats) -> Mirrors:
    centres, normals = unit.centres.copy(), unit.normals.copy()
    axes_u, axes_v = unit.axes_u.copy(), unit.axes_v.copy()
    for k in range(3):
        own = np.array([axes_u[k], axes_v[k], normals[k]])
        turn, shift = _in_rig(instrument.deviation(f"mirror_{k + 1}"), own)
        centres[k] += shift
        axes_u[k], axes_v[k], normals[k] = own @ turn.T
    turn, shift = _in_rig(instrument.deviation("mirror_unit"), frame)
    return Mirrors(centres @ turn.T + shift, normals @ turn.T, axes_u @ turn.T, axes_v @ turn.T)


def _in_rig(deviation: Deviation, axes: Floats) -> tuple[Floats, Floats]:
    """Rotation (3, 3) and shift (3,) in the rig's frame of a deviation given along `axes`, one per row."""
    turn, shift = rotation_and_shift(deviation)
    return axes.T @ turn @ axes, shift @ axes


def illumination_place(instrument: Instrument) -> tuple[Floats, Floats]:
    """Rotation (3, 3) and origin (3,), mm, of the illumination unit's frame in the rig's: p is at rotation @ p + origin."""
    centre = -(instrument.mirror_distance_mm + instrument.pupil_to_mirror_mm) * ALONG_Y
    turn, shift = rotation_and_shift(instrument.deviation("pupil"))
    return turn, centre + shift


def pupil(instrument: Instrument) -> tuple[Floats, Floats, Floats]:
    """Centre (mm) and two unit axes, (3,) each, of the exit pupil itself, before mirror 1."""
    turn, centre = illumination_place(instrument)
    if instrument.illumination:
        # The exit pupil is the opening of the output condenser, which the whole unit carries.
        whole, shift = rotation_and_shift(instrument.illumination.get("unit", NO_DEVIATION))
        own, offset = rotation_and_shift(instrument.illumination.get("output_condenser", NO_DEVIATION))
        centre, turn = centre + turn @ (whole @ offset + shift), turn @ whole @ own
    return centre, turn[:, 0].copy(), turn[:, 2].copy()


def pupil_image(instrument: Instrument, sigma_deg: float) -> tuple[Floats, Floats, Floats]:
    """Centre (mm) and two unit axes, (3,) each, of the exit pupil's image in the three mirrors, as seen from the sample.

    Exact: the pupil is reflected in the three planes one after the other. The axes turn with sigma, as the beam's section does.
    """
    centre, axis_u, axis_v = transform_rows(np.array(pupil(instrument)), unfolding_maps(mirrors_at(instrument, sigma_deg))[0])
    return centre, axis_u, axis_v


def unfolding_maps(unit: Mirrors) -> tuple[Floats, Floats]:
    """Maps (4, 4) of homogeneous columns that unfold the path: one for points before mirror 1, and (3, 4, 4) for the mirrors.

    Each mirror is reflected in those that follow it, so that the path from the sample to the pupil's image is straight.
    """
    maps = np.zeros((3, 4, 4))
    maps[:, :3, :3] = np.eye(3) - 2.0 * unit.normals[:, :, None] * unit.normals[:, None, :]
    maps[:, :3, 3] = 2.0 * np.sum(unit.centres * unit.normals, axis=1)[:, None] * unit.normals
    maps[:, 3, 3] = 1.0
    last_two = maps[2] @ maps[1]
    return last_two @ maps[0], np.array([last_two, maps[2], np.eye(4)])


def transform_rows(rows: Floats, maps: Floats) -> Floats:
    """Rows (..., n, 3), the first a point and the others vectors, transformed by maps (..., 4, 4)."""
    turned = rows @ np.swapaxes(maps[..., :3, :3], -1, -2)
    turned[..., 0, :] += maps[..., :3, 3]
    return np.ascontiguousarray(turned)


def unfold_mirrors(unit: Mirrors) -> Mirrors:
    """Mirrors as seen from the sample: the image of each in those that follow, so that the path is straight."""
    seen = transform_rows(unit.packed, unfolding_maps(unit)[1])
    return Mirrors(seen[:, 0], seen[:, 1], seen[:, 2], seen[:, 3])


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
