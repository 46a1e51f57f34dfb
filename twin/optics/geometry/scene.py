"""The instrument at one pose in the sample's own frame, with the mirrors unfolded.

The sample's plane is z = 0. The sides of the hole lie along x and y. The light comes from z > 0: for a mirror unit beyond 90
deg the frame is turned about x, with the sample's back up. Deviations of every element are included.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.coordinates import direction_rows, turn_about_x
from goniotwin.twin.optics.geometry.deviation import Deviation, rotation_and_shift
from goniotwin.twin.optics.geometry.instrument import Instrument
from goniotwin.twin.optics.geometry.mirrors import distance_to, mirrors_at, pupil, transform_rows, unfolding_maps
from goniotwin.twin.optics.kernel import kernel

SCENES_KEPT = 64
"""Size of the cache: a campaign has hundreds of poses of the arc for each position of the mirror unit."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Arguments of the kernels, lengths in mm. Cached and shared: do not write to the arrays.

    `pupil` (4, 3): centre of the exit pupil's image, its two axes as long as its radius, its normal towards the sample's side.
    `mirrors` and `images` (3, 4, 3): centre, normal and axes of each mirror at its place, and unfolded. `to_sample` (3, 3) and
    `origin` (3,): a point X of the rig is at to_sample (X - origin). `incident` is 1 for light on the front and -1 on the back.
    `clipped`: some ray of the beam misses a mirror.
    """

    sigma_deg: float
    incident: int
    pupil: Floats
    mirrors: Floats
    images: Floats
    to_sample: Floats
    origin: Floats
    clipped: bool

    @property
    def mirror_angles_deg(self) -> Floats:
        """Incidence (3,) of the beam's axis on each mirror."""
        return np.degrees(np.arccos(np.minimum(np.abs(self.images[:, 1] @ self.towards_light), 1.0)))

    @property
    def towards_light(self) -> Floats:
        """Unit vector (3,) from the sample's centre to that of the pupil's image."""
        direction: Floats = self.pupil[0] / np.linalg.norm(self.pupil[0])
        return direction

    def detectors(self, instrument: Instrument, directions: npt.ArrayLike) -> tuple[Floats, Floats]:
        """Centres (n, 3), mm, and viewing directions (n, 3), away from the sample, of detectors on the arc.

        `directions` (n, 3) are the nominal directions in the rig's frame. Raises ValueError for a vector without a direction.
        """
        axes = direction_rows(directions)
        centres = instrument.arc_radius_mm * axes
        arc, sensor = instrument.deviation("arc"), instrument.deviation("sensor")
        if arc != Deviation():
            turn, shift = rotation_and_shift(arc)
            axes, centres = axes @ turn.T, centres @ turn.T + shift
        if sensor != Deviation():
            turn, shift = rotation_and_shift(sensor)
            frames = _detector_frames(axes)  # (n, 3, 3): rows e1, e2, d
            axes = np.einsum("nij,i->nj", frames, turn[:, 2])
            centres = centres + np.einsum("nij,i->nj", frames, shift)
        return (
            np.ascontiguousarray((centres - self.origin) @ self.to_sample.T),
            np.ascontiguousarray(axes @ self.to_sample.T),
        )


@lru_cache(maxsize=SCENES_KEPT)
def scene_at(instrument: Instrument, sigma_deg: float, gamma_deg: float = 0.0) -> Scene:
    """Scene with the mirror unit at `sigma_deg` and the sample unit at `gamma_deg`.

    A mirror unit with a wrongly set axis may be at any angle. Raises ValueError for angles that are not finite.
    """
    if not (math.isfinite(sigma_deg) and math.isfinite(gamma_deg)):
        raise ValueError(f"sigma_deg is {sigma_deg!r}, gamma_deg {gamma_deg!r}: give both in degrees")
    back = math.cos(math.radians(sigma_deg)) < 0.0
    to_sample, origin = _sample_frame(instrument.deviation("sample"), gamma_deg, back)
    own = np.eye(4)
    own[:3, :3], own[:3, 3] = to_sample, -to_sample @ origin
    unit = mirrors_at(instrument, sigma_deg)
    before, each = unfolding_maps(unit)
    centre, axis_u, axis_v = transform_rows(np.array(pupil(instrument)), own @ before)
    normal = np.array(
        [
            axis_u[1] * axis_v[2] - axis_u[2] * axis_v[1],
            axis_u[2] * axis_v[0] - axis_u[0] * axis_v[2],
            axis_u[0] * axis_v[1] - axis_u[1] * axis_v[0],
        ]
    )
    radius, facing = instrument.pupil_radius_mm, 1.0 if normal @ centre > 0.0 else -1.0
    seen_pupil = np.array([centre, radius * axis_u, radius * axis_v, facing * normal])
    mirrors = unit.packed
    images = transform_rows(mirrors, own @ each)
    clipped = clips_beam(images, seen_pupil, 0.5 * instrument.spot_side_mm, 0.5 * instrument.mirror_side_mm)
    return Scene(sigma_deg, -1 if back else 1, seen_pupil, transform_rows(mirrors, own), images, to_sample, origin, clipped)


def _sample_frame(deviation: Deviation, gamma_deg: float, back: bool) -> tuple[Floats, Floats]:
    cos, sin = math.cos(math.radians(gamma_deg)), math.sin(math.radians(gamma_deg))
    unit = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    turn, shift = rotation_and_shift(deviation)
    to_sample = (unit @ turn).T
    if back:
        to_sample = turn_about_x(to_sample.T).T
    return np.ascontiguousarray(to_sample), unit @ shift


def _detector_frames(axes: Floats) -> Floats:
    sine = np.hypot(axes[:, 0], axes[:, 1])
    safe = np.where(sine > 0.0, sine, 1.0)
    cos, sin = np.where(sine > 0.0, axes[:, 0] / safe, 1.0), np.where(sine > 0.0, axes[:, 1] / safe, 0.0)
    away = np.stack([axes[:, 2] * cos, axes[:, 2] * sin, -sine], axis=1)
    level = np.stack([-sin, cos, np.zeros_like(cos)], axis=1)
    return np.stack([away, level, axes], axis=1)


@kernel()
def clips_beam(images: Floats, pupil: Floats, hole: float, mirror: float) -> bool:
    """Whether some ray of the beam misses a mirror; `hole` and `mirror` are half sides, mm.

    Hole and pupil are convex, so the beam's section in a mirror's plane is the hull of the lines between their corners: if
    these 16 lines pass, all do, and the kernels can skip the test.
    """
    for corner in range(16):
        px, py = hole if corner & 1 else -hole, hole if corner & 2 else -hole
        u, v = 1.0 if corner & 4 else -1.0, 1.0 if corner & 8 else -1.0
        wx = pupil[0, 0] + u * pupil[1, 0] + v * pupil[2, 0] - px
        wy = pupil[0, 1] + u * pupil[1, 1] + v * pupil[2, 1] - py
        wz = pupil[0, 2] + u * pupil[1, 2] + v * pupil[2, 2]
        length = math.sqrt(wx * wx + wy * wy + wz * wz)
        for m in range(3):
            if distance_to(images, m, mirror, px, py, 0.0, wx / length, wy / length, wz / length) == math.inf:
                return True
    return False
