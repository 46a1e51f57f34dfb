"""The mirror unit: three plane squares that carry the beam from the illumination axis to the sample.

The light comes along y to mirror 1 at (0, -d, 0), goes out along l to mirror 2, runs parallel to y to mirror 3 at d l,
and comes back along -l to the sample: the corners of a square of side d, turned about y by sigma (paper, figure 4).
Which way along y the light comes is not in the paper; here it is from negative y.
"""

import math
from dataclasses import dataclass

import numpy as np

from twin.optics.frames import Floats, light_direction
from twin.optics.instrument import Instrument

ALONG_Y = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, eq=False)
class Mirrors:
    """Three squares in the order in which the light meets them, each array (3, 3): one row a mirror, in mm.

    `normals` face the light, `axes_u` and `axes_v` are unit vectors along the sides.
    """

    centres: Floats
    normals: Floats
    axes_u: Floats
    axes_v: Floats

    @property
    def packed(self) -> Floats:
        """As kernels take them, (3, 4, 3): centre, normal and the two axes of each mirror."""
        return np.ascontiguousarray(np.stack([self.centres, self.normals, self.axes_u, self.axes_v], axis=1))

    def reflect_point(self, mirror: int, point: Floats) -> Floats:
        """Mirror image of a point (3,) in the plane of mirror 0, 1 or 2."""
        image: Floats = reflect(point - self.centres[mirror], self.normals[mirror]) + self.centres[mirror]
        return image


def reflect(vector: Floats, normal: Floats) -> Floats:
    """A vector (3,) as a plane of that unit normal reflects it."""
    image: Floats = vector - 2.0 * float(vector @ normal) * normal
    return image


def mirrors_at(instrument: Instrument, sigma_deg: float) -> Mirrors:
    """The mirrors of the unit turned to `sigma_deg`. Raises ValueError unless that is finite."""
    if not math.isfinite(sigma_deg):
        raise ValueError(f"sigma_deg is {sigma_deg!r}: give the mirror unit's angle in degrees")
    light = light_direction(sigma_deg)
    distance = instrument.mirror_distance_mm
    centres = distance * np.array([-ALONG_Y, light - ALONG_Y, light])
    # A mirror that turns unit direction a into b has its normal along b - a.
    normals = np.array([light - ALONG_Y, ALONG_Y - light, -light - ALONG_Y]) / math.sqrt(2.0)
    across = np.cross(light, ALONG_Y)
    return Mirrors(centres, normals, np.tile(across, (3, 1)), np.cross(normals, across))


def pupil(instrument: Instrument) -> tuple[Floats, Floats, Floats]:
    """Centre (mm) and two unit axes, (3,) each, of the exit pupil itself, before mirror 1."""
    centre = -(instrument.mirror_distance_mm + instrument.pupil_to_mirror_mm) * ALONG_Y
    return centre, np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


def pupil_image(instrument: Instrument, sigma_deg: float) -> tuple[Floats, Floats, Floats]:
    """Centre (mm) and two unit axes, (3,) each, of the exit pupil as the sample sees it in the three mirrors.

    Exact: the pupil is reflected in the three planes, one after the other. The axes turn with sigma, as the beam's
    section does.
    """
    unit = mirrors_at(instrument, sigma_deg)
    centre, axis_u, axis_v = pupil(instrument)
    for mirror in range(3):
        centre = unit.reflect_point(mirror, centre)
        axis_u, axis_v = reflect(axis_u, unit.normals[mirror]), reflect(axis_v, unit.normals[mirror])
    return centre, axis_u, axis_v


def unfolded(instrument: Instrument, sigma_deg: float) -> Mirrors:
    """The mirrors as the sample sees them: each one's image in those that follow, so that the path is straight."""
    unit = mirrors_at(instrument, sigma_deg)
    centres, normals = unit.centres.copy(), unit.normals.copy()
    axes_u, axes_v = unit.axes_u.copy(), unit.axes_v.copy()
    for mirror in range(2):
        for follower in range(mirror + 1, 3):
            centres[mirror] = unit.reflect_point(follower, centres[mirror])
            for vectors in (normals, axes_u, axes_v):
                vectors[mirror] = reflect(vectors[mirror], unit.normals[follower])
    return Mirrors(centres, normals, axes_u, axes_v)
