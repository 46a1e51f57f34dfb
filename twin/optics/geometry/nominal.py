"""Mirrors and detectors where nothing is off, for Python without numba: see `twin.optics.geometry.scene` for all else."""

import math

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.coordinates import detector_rows
from goniotwin.twin.optics.geometry.instrument import Dimensions


def place_mirrors(distance: float, sigma_deg: float, mirrors: Floats) -> None:
    """Fill `mirrors` (3, 4, 3) as in `Mirrors.packed`, `distance` mm from each other and from the sample.

    For Python; the kernel of it is `twin.optics.geometry.mirrors.fill_nominal_mirrors`.
    """
    sine, cosine = math.sin(math.radians(sigma_deg)), math.cos(math.radians(sigma_deg))
    for m in range(3):
        # Along l and y: the centre; the normal, which is along b - a for a mirror that turns unit direction a into b.
        out, down = 0.0 if m == 0 else distance, 0.0 if m == 2 else -distance
        facing = math.sqrt(0.5) if m == 0 else -math.sqrt(0.5)
        level = math.sqrt(0.5) if m == 1 else -math.sqrt(0.5)
        mirrors[m, 0, 0], mirrors[m, 0, 1], mirrors[m, 0, 2] = out * sine, down, out * cosine
        mirrors[m, 1, 0], mirrors[m, 1, 1], mirrors[m, 1, 2] = facing * sine, level, facing * cosine
        mirrors[m, 2, 0], mirrors[m, 2, 1], mirrors[m, 2, 2] = -cosine, 0.0, sine
        mirrors[m, 3, 0], mirrors[m, 3, 1], mirrors[m, 3, 2] = facing * sine, -level, facing * cosine


def nominal_mirrors(dimensions: Dimensions, sigma_deg: float) -> Floats:
    """The three mirrors (3, 4, 3) in the rig's frame, as in `Mirrors.packed`."""
    mirrors = np.empty((3, 4, 3))
    place_mirrors(dimensions.mirror_distance_mm, sigma_deg, mirrors)
    return mirrors


def nominal_scene(
    dimensions: Dimensions, sigma_deg: float, gamma_deg: float, directions: npt.ArrayLike
) -> tuple[Floats, Floats]:
    """Mirrors (3, 4, 3), and unit vectors (n, 3) towards detectors in `directions` (n, 3), in the sample's frame of a `Scene`.

    Raises ValueError for a wrong shape or a vector of length zero.
    """
    c, s = math.cos(math.radians(gamma_deg)), math.sin(math.radians(gamma_deg))
    side = -1.0 if math.cos(math.radians(sigma_deg)) < 0.0 else 1.0  # with the back up the frame is turned about x
    to_sample = np.array([[c, s, 0.0], [-side * s, side * c, 0.0], [0.0, 0.0, side]])
    return nominal_mirrors(dimensions, sigma_deg) @ to_sample.T, detector_rows(directions)[:, :3] @ to_sample.T
