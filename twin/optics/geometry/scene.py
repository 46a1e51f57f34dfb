"""The instrument at one pose in the sample's own frame, with the mirrors unfolded.

The sample's plane is z = 0. The sides of the hole lie along x and y. The light comes from z > 0: for a mirror unit beyond 90
deg the frame is turned about x, with the sample's back up. Deviations of every element are included.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.coordinates import detector_rows
from goniotwin.twin.optics.geometry.instrument import (
    ARC,
    ARC_RADIUS,
    HALF_MIRROR,
    HALF_SPOT,
    PUPIL_RADIUS,
    SAMPLE,
    SENSOR,
    Instrument,
)
from goniotwin.twin.optics.geometry.mirrors import fill_mirrors, is_moved, place_unit, reflect_rows
from goniotwin.twin.optics.geometry.rotations import fill_rotation
from goniotwin.twin.optics.kernel import kernel

SCENES_KEPT = 64
"""Size of the cache: a campaign has hundreds of poses of the arc for each position of the mirror unit."""


SAME_FRAME = 0.995
"""Cosine of the angle, 6 deg, up to which the axes of a detector on its arc are those by its direction alone.

So much the deviations of arc and photodiode turn them beside the pole, which is of second order in what a sensor is off by.
"""


class SceneArrays(NamedTuple):
    """A scene as an argument of the kernels, lengths in mm.

    `pupil` (4, 3): centre of the exit pupil's image, its two axes as long as its radius, its normal towards the sample's side.
    `mirrors` and `images` (3, 4, 3): centre, normal and axes of each mirror at its place, and unfolded. `to_sample` (3, 3) and
    `origin` (3,): a point X of the rig is at to_sample (X - origin). `missed` (3,) is 1 for a mirror that some ray of the beam
    misses, else 0.
    """

    pupil: Floats
    mirrors: Floats
    images: Floats
    to_sample: Floats
    origin: Floats
    missed: Floats


@dataclass(frozen=True, eq=False)
class Scene:
    """One scene. Cached and shared: do not write to its arrays. `incident` is 1 for light on the front, -1 on the back."""

    sigma_deg: float
    incident: int
    arrays: SceneArrays

    @property
    def pupil(self) -> Floats:
        """See `SceneArrays`; (4, 3)."""
        return self.arrays.pupil

    @property
    def mirrors(self) -> Floats:
        """See `SceneArrays`; (3, 4, 3)."""
        return self.arrays.mirrors

    @property
    def images(self) -> Floats:
        """See `SceneArrays`; (3, 4, 3)."""
        return self.arrays.images

    @property
    def to_sample(self) -> Floats:
        """See `SceneArrays`; (3, 3)."""
        return self.arrays.to_sample

    @property
    def origin(self) -> Floats:
        """See `SceneArrays`; (3,)."""
        return self.arrays.origin

    @property
    def clipped(self) -> bool:
        """Whether some ray of the beam misses a mirror."""
        return bool(self.arrays.missed.any())

    @property
    def mirror_angles_deg(self) -> Floats:
        """Incidence (3,) of the beam's axis on each mirror."""
        return np.array([mirror_angle_deg(self.pupil, self.images, m) for m in range(3)])

    def detectors(self, instrument: Instrument, directions: npt.ArrayLike) -> tuple[Floats, Floats]:
        """Centres (n, 3), mm, and viewing directions (n, 3), away from the sample, of detectors on the arc.

        `directions` (n, 3) are the nominal directions in the rig's frame, or (n, 6) with the axis of each detector's arc after
        them (`arc_axis`): a sensor that is off then has the axes of its arc, on either side of the pole. Raises ValueError for
        a vector without a direction.
        """
        rows = detector_rows(directions)
        centres, axes = np.empty((len(rows), 3)), np.empty((len(rows), 3))
        fill_detectors(instrument.lengths, instrument.deviation_rows, self.to_sample, self.origin, rows, centres, axes)
        return centres, axes


@lru_cache(maxsize=SCENES_KEPT)
def scene_at(instrument: Instrument, sigma_deg: float, gamma_deg: float = 0.0) -> Scene:
    """`place_scene`; the last scenes are kept."""
    return place_scene(instrument, sigma_deg, gamma_deg)


def place_scene(instrument: Instrument, sigma_deg: float, gamma_deg: float) -> Scene:
    """Scene with the mirror unit at `sigma_deg` and the sample unit at `gamma_deg`.

    A mirror unit with a wrongly set axis may be at any angle. Raises ValueError for angles that are not finite.
    """
    if not (math.isfinite(sigma_deg) and math.isfinite(gamma_deg)):
        raise ValueError(f"sigma_deg is {sigma_deg!r}, gamma_deg {gamma_deg!r}: give both in degrees")
    arrays = empty_scene()
    back = fill_scene(instrument.lengths, instrument.exit_pupil, instrument.deviation_rows, sigma_deg, gamma_deg, arrays)
    return Scene(sigma_deg, -1 if back else 1, arrays)


@kernel()
def empty_scene() -> SceneArrays:
    """Arrays for `fill_scene`."""
    return SceneArrays(np.empty((4, 3)), np.empty((3, 4, 3)), np.empty((3, 4, 3)), np.empty((3, 3)), np.empty(3), np.empty(3))


@kernel()
def fill_scene(
    lengths: Floats, exit_pupil: Floats, deviations: Floats, sigma_deg: float, gamma_deg: float, scene: SceneArrays
) -> bool:
    """Fill a scene; whether the light is on the sample's back.

    `deviations` (elements, 6); `lengths` and `exit_pupil` of the instrument.
    """
    back = fill_sample_frame(deviations[SAMPLE], sigma_deg, gamma_deg, scene.to_sample, scene.origin)
    pupil, mirrors, images = scene.pupil, scene.mirrors, scene.images
    fill_mirrors(lengths, deviations, sigma_deg, mirrors)
    place_unit(lengths, deviations, exit_pupil, pupil)
    for m in range(3):
        reflect_rows(pupil[:3], mirrors[m])
        for row in range(4):
            for c in range(3):
                images[m, row, c] = mirrors[m, row, c]
        for after in range(m + 1, 3):
            reflect_rows(images[m], mirrors[after])
    move_to_sample(scene.to_sample, scene.origin, pupil[:3])
    for m in range(3):
        move_to_sample(scene.to_sample, scene.origin, mirrors[m])
        move_to_sample(scene.to_sample, scene.origin, images[m])
    for c in range(3):
        i, j = (c + 1) % 3, (c + 2) % 3
        pupil[3, c] = pupil[1, i] * pupil[2, j] - pupil[1, j] * pupil[2, i]
    ahead = pupil[0, 0] * pupil[3, 0] + pupil[0, 1] * pupil[3, 1] + pupil[0, 2] * pupil[3, 2]
    for c in range(3):
        pupil[1, c] *= lengths[PUPIL_RADIUS]
        pupil[2, c] *= lengths[PUPIL_RADIUS]
        pupil[3, c] *= 1.0 if ahead > 0.0 else -1.0
    find_missed(images, pupil, lengths[HALF_SPOT], lengths[HALF_MIRROR], scene.missed)
    return back


@kernel()
def fill_sample_frame(deviation: Floats, sigma_deg: float, gamma_deg: float, to_sample: Floats, origin: Floats) -> bool:
    """Fill `to_sample` and `origin` of a scene; whether the light is on the sample's back."""
    cosine, sine = math.cos(math.radians(gamma_deg)), math.sin(math.radians(gamma_deg))
    back, turn = math.cos(math.radians(sigma_deg)) < 0.0, np.empty((3, 3))
    fill_rotation(deviation, turn)
    for c in range(3):
        side = -1.0 if back and c > 0 else 1.0  # with the back up the frame is turned about x
        to_sample[c, 0] = side * (cosine * turn[0, c] - sine * turn[1, c])
        to_sample[c, 1] = side * (sine * turn[0, c] + cosine * turn[1, c])
        to_sample[c, 2] = side * turn[2, c]
    origin[0], origin[1] = cosine * deviation[3] - sine * deviation[4], sine * deviation[3] + cosine * deviation[4]
    origin[2] = deviation[5]
    return back


@kernel()
def move_to_sample(to_sample: Floats, origin: Floats, rows: Floats) -> None:
    """Transform `rows` (n, 3), the first a point and the others vectors, into the sample's frame."""
    for i in range(rows.shape[0]):
        x, y, z = rows[i, 0], rows[i, 1], rows[i, 2]
        if i == 0:
            x, y, z = x - origin[0], y - origin[1], z - origin[2]
        for c in range(3):
            rows[i, c] = to_sample[c, 0] * x + to_sample[c, 1] * y + to_sample[c, 2] * z


@kernel()
def fill_detectors(
    lengths: Floats, deviations: Floats, to_sample: Floats, origin: Floats, directions: Floats, centres: Floats, axes: Floats
) -> None:
    """Fill `centres` and `axes` (n, 3) as in `Scene.detectors`, of `directions` (n, 6) as in `detector_rows`."""
    arc, sensor, radius = deviations[ARC], deviations[SENSOR], lengths[ARC_RADIUS]
    turn, own = np.empty((3, 3)), np.empty((3, 3))
    fill_rotation(arc, turn)
    fill_rotation(sensor, own)
    of_arc, of_sensor = is_moved(arc), is_moved(sensor)
    for k in range(directions.shape[0]):
        dx, dy, dz = directions[k, 0], directions[k, 1], directions[k, 2]
        ax, ay, az = directions[k, 3], directions[k, 4], directions[k, 5]
        if of_arc:
            dx, dy, dz = turned(turn, dx, dy, dz)
            ax, ay, az = turned(turn, ax, ay, az)
        x, y, z = radius * dx + arc[3], radius * dy + arc[4], radius * dz + arc[5]
        if of_sensor:  # in its own frame: e1 away from the normal, e2 level, d along the view
            (e1x, e1y, e1z), (e2x, e2y, e2z) = arc_frame(dx, dy, dz, ax, ay, az)
            x += sensor[3] * e1x + sensor[4] * e2x + sensor[5] * dx
            y += sensor[3] * e1y + sensor[4] * e2y + sensor[5] * dy
            z += sensor[3] * e1z + sensor[4] * e2z + sensor[5] * dz
            away, level, along = own[0, 2], own[1, 2], own[2, 2]
            dx, dy = away * e1x + level * e2x + along * dx, away * e1y + level * e2y + along * dy
            dz = away * e1z + level * e2z + along * dz
        x, y, z = x - origin[0], y - origin[1], z - origin[2]
        for c in range(3):
            centres[k, c] = to_sample[c, 0] * x + to_sample[c, 1] * y + to_sample[c, 2] * z
            axes[k, c] = to_sample[c, 0] * dx + to_sample[c, 1] * dy + to_sample[c, 2] * dz


@kernel(forceinline=True)
def turned(turn: Floats, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A vector after the rotation `turn` (3, 3)."""
    return (
        turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z,
        turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z,
        turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z,
    )


@kernel(forceinline=True)
def arc_frame(
    dx: float, dy: float, dz: float, ax: float, ay: float, az: float
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Frame of a detector with the viewing direction d on an arc that is bent about a: e1 along the arc, e2 across it.

    Without an arc (a = 0) that of `detector_frame`. It has the same axes but at the pole and, with the other sign, beyond it.
    """
    e1x, e1y, e1z, e2x, e2y = detector_frame(dx, dy, dz)
    if ax == 0.0 and ay == 0.0 and az == 0.0:
        return (e1x, e1y, e1z), (e2x, e2y, 0.0)
    cosine = ax * e2x + ay * e2y
    if cosine > SAME_FRAME:
        return (e1x, e1y, e1z), (e2x, e2y, 0.0)
    if cosine < -SAME_FRAME:
        return (-e1x, -e1y, -e1z), (-e2x, -e2y, 0.0)
    along = ax * dx + ay * dy + az * dz  # of a photodiode that is off across its arc
    ax, ay, az = ax - along * dx, ay - along * dy, az - along * dz
    length = math.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / length, ay / length, az / length
    return (ay * dz - az * dy, az * dx - ax * dz, ax * dy - ay * dx), (ax, ay, az)


@kernel(forceinline=True)
def detector_frame(dx: float, dy: float, dz: float) -> tuple[float, float, float, float, float]:
    """Frame of a detector with the viewing direction d: e1 = (a, b, c), away from the normal, and e2 = (f, g, 0), level.

    At the pole itself e1 is along x.
    """
    sine = math.sqrt(dx * dx + dy * dy)
    cos, sin = (dx / sine, dy / sine) if sine > 0.0 else (1.0, 0.0)
    return dz * cos, dz * sin, -sine, -sin, cos


@kernel(forceinline=True)
def mirror_angle_deg(pupil: Floats, images: Floats, m: int) -> float:
    """Incidence of the beam's axis on mirror m."""
    along = pupil[0, 0] * images[m, 1, 0] + pupil[0, 1] * images[m, 1, 1] + pupil[0, 2] * images[m, 1, 2]
    length = math.sqrt(pupil[0, 0] ** 2 + pupil[0, 1] ** 2 + pupil[0, 2] ** 2)
    return math.degrees(math.acos(min(abs(along) / length, 1.0)))


@kernel()
def find_missed(images: Floats, pupil: Floats, hole: float, half: float, missed: Floats) -> None:
    """Fill `missed` (3,) of a scene; `hole` and `half` are half sides of hole and mirrors, mm.

    Hole and pupil are convex, so the beam's section in a mirror's plane is the hull of the lines between their corners: if
    these 16 lines pass, all do, and the kernels can skip the test.
    """
    for m in range(3):
        missed[m] = 0.0
        for corner in range(4):
            px, py = hole if corner & 1 else -hole, hole if corner & 2 else -hole
            near = image_coordinates(images[m], px, py, 0.0)
            for other in range(4):
                u, v = 1.0 if other & 1 else -1.0, 1.0 if other & 2 else -1.0
                x = pupil[0, 0] + u * pupil[1, 0] + v * pupil[2, 0]
                y = pupil[0, 1] + u * pupil[1, 1] + v * pupil[2, 1]
                z = pupil[0, 2] + u * pupil[1, 2] + v * pupil[2, 2]
                if not reaches_over(near, image_coordinates(images[m], x, y, z), half):
                    missed[m] = 1.0


@kernel(forceinline=True)
def image_coordinates(image: Floats, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Coordinates of a point along the normal and the two axes of an unfolded mirror (4, 3), from its centre."""
    x, y, z = x - image[0, 0], y - image[0, 1], z - image[0, 2]
    return (
        x * image[1, 0] + y * image[1, 1] + z * image[1, 2],
        x * image[2, 0] + y * image[2, 1] + z * image[2, 2],
        x * image[3, 0] + y * image[3, 1] + z * image[3, 2],
    )


@kernel(forceinline=True)
def reaches_over(near: tuple[float, float, float], far: tuple[float, float, float], half: float) -> bool:
    """Whether the ray from the point `near` through the point `far` meets the square of half side `half`.

    Both are `image_coordinates`. No division: the ray is in the mirror's plane where the distances of the two from it, as
    weights, balance.
    """
    apart = near[0] - far[0]
    u, v, limit = near[0] * far[1] - far[0] * near[1], near[0] * far[2] - far[0] * near[2], half * abs(apart)
    return (near[0] * apart > 0.0) & (abs(u) <= limit) & (abs(v) <= limit)
