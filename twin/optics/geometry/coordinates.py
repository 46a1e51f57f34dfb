"""Directions in the rig's frame and in specular coordinates.

The rig's frame is right-handed. The origin is the sample's centre, z its front normal, y the illumination axis, about which the
mirror unit turns. The paper's formulas 2 to 4 contradict each other (sigma = theta = 0 gives a polar angle of 90 deg). The code
follows their intent, figure 6: theta is the angle from the specular direction; phi is the azimuth about it, zero in the plane
of incidence towards the normal and counter-clockwise about the outgoing specular direction.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats


def _directions(directions: npt.ArrayLike) -> Floats:
    result = np.asarray(directions, dtype=np.float64)
    if result.ndim == 0 or result.shape[-1] != 3:
        raise ValueError(f"directions has the shape {result.shape}: give vectors (x, y, z) along its last axis")
    return result


def direction_rows(directions: npt.ArrayLike) -> Floats:
    """Unit vectors (n, 3), contiguous, of `directions` (n, 3).

    Raises ValueError for a wrong shape or a vector without a direction.
    """
    vectors = _directions(directions)
    if vectors.ndim != 2:
        raise ValueError(f"directions has the shape {vectors.shape}: give (n, 3), one row per detector")
    length = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
    wrong = np.flatnonzero(~(np.isfinite(length) & (length > 0.0)))
    if wrong.size:
        raise ValueError(f"directions[{wrong[0]}] is {vectors[wrong[0]]}: give a finite vector with a length")
    return np.ascontiguousarray(vectors / length[:, None])


def light_direction(sigma_deg: float) -> Floats:
    """Unit vector (3,) from the sample's centre towards the light, for a mirror unit at `sigma_deg`."""
    sigma = np.radians(sigma_deg)
    return np.array([np.sin(sigma), 0.0, np.cos(sigma)])


def specular_direction(sigma_deg: float) -> Floats:
    """Unit vector (3,) of the specular reflection for a mirror unit at `sigma_deg`."""
    sigma = np.radians(sigma_deg)
    return np.array([-np.sin(sigma), 0.0, np.cos(sigma)])


def arc_direction(polar_deg: npt.ArrayLike, azimuth_deg: npt.ArrayLike, lower: bool = False) -> Floats:
    """Viewing directions of photodiodes: unit vectors (..., 3), of the shape of polar and azimuth broadcast.

    `polar_deg` is the photodiode's angle on the arc plus the arc's shift, `azimuth_deg` the arc's beta. The lower arc is the
    upper one mirrored in the sample's plane.
    """
    polar, azimuth = np.broadcast_arrays(np.radians(polar_deg), np.radians(azimuth_deg))
    z = -np.cos(polar) if lower else np.cos(polar)
    return np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), z], axis=-1)


def to_specular(sigma_deg: npt.ArrayLike, directions: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Specular coordinates (theta_deg, phi_deg) of `directions` (..., 3); these need not be unit vectors.

    theta is in 0..180 and phi in [0, 360). phi is 0 where theta is 0 or 180. Raises ValueError for a wrong shape.
    """
    vectors = _directions(directions)
    sigma = np.radians(sigma_deg)
    cos, sin = np.cos(sigma), np.sin(sigma)
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    along: Any = cos * z - sin * x
    inward = cos * x + sin * z
    # The arctangent keeps its digits near the specular direction; the arccosine loses half of them.
    theta = np.degrees(np.arctan2(np.hypot(inward, y), along))
    phi = np.degrees(np.arctan2(y, inward)) % 360.0
    pole = np.hypot(inward, y) == 0.0
    return theta, np.where(pole | (phi >= 360.0), 0.0, phi)


def from_specular(sigma_deg: npt.ArrayLike, theta_deg: npt.ArrayLike, phi_deg: npt.ArrayLike) -> Floats:
    """Unit vectors (..., 3) of specular coordinates, arguments broadcast: the inverse of `to_specular`."""
    sigma, theta, phi = np.broadcast_arrays(np.radians(sigma_deg), np.radians(theta_deg), np.radians(phi_deg))
    inward, y, along = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)
    cos, sin = np.cos(sigma), np.sin(sigma)
    return np.stack([cos * inward - sin * along, y, sin * inward + cos * along], axis=-1)
