"""Directions in the rig's frame and in specular coordinates.

The rig's frame is right-handed. The origin is the sample's centre, z its front normal, y the illumination axis, about which the
mirror unit turns. The paper's formulas 2 to 4 contradict each other (sigma = theta = 0 gives a polar angle of 90 deg). The code
follows their intent, figure 6: theta is the angle from the specular direction; phi is the azimuth about it, zero in the plane
of incidence towards the normal and counter-clockwise about the outgoing specular direction.

Every conversion of angles that is no more than this geometry is here, and so is the rule of equal angles.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats

HALF_TURN_DEG = 180.0
TURN_DEG = 360.0
SPECULAR_AZIMUTH_DEG = HALF_TURN_DEG
"""Azimuth of the specular direction, and of the direction straight through, from the half plane of the incident light."""
DECIMALS = 6
"""Angles (and wavelengths, in nm) that agree to this number of decimals are equal.

The same angle on two ways (a grid's start + k step, polar angle + shift, 180 deg - sigma) differs by some 1e-13 deg, and a
microstep of the examples' axes is 8e-5 deg or more: six decimals are far from both.
"""
TOLERANCE_DEG = 10.0**-DECIMALS
"""An angle beyond a limit by no more than this is within it."""


def _directions(directions: npt.ArrayLike) -> Floats:
    result = np.asarray(directions, dtype=np.float64)
    if result.ndim == 0 or result.shape[-1] != 3:
        raise ValueError(f"directions has the shape {result.shape}: give vectors (x, y, z) along its last axis")
    return result


def detector_rows(directions: npt.ArrayLike) -> Floats:
    """Rows (n, 6), contiguous, of `directions` (n, 3) or (n, 6): a unit vector, and the axis of the detector's arc.

    Raises ValueError for a wrong shape or a vector without a direction.
    """
    vectors = direction_table(directions)
    result = np.empty((len(vectors), 6))
    fill_detector_rows(vectors, result)
    return result


def direction_table(directions: npt.ArrayLike) -> Floats:
    """`directions` as an array (n, 3) or (n, 6). Raises ValueError for a wrong shape."""
    vectors = np.asarray(directions, dtype=np.float64)
    if vectors.ndim != 2 or vectors.shape[1] not in (3, 6):
        raise ValueError(f"directions has the shape {vectors.shape}: give (n, 3), one row per detector")
    return vectors


def fill_detector_rows(directions: Floats, result: Floats) -> None:
    """Fill `result` (n, 6) with unit vectors, and axes of arcs, of `directions` (n, 3), where no arc is known, or (n, 6).

    An axis is 0 where no arc is known. Raises ValueError for a vector without a direction.
    """
    vectors = directions[:, :3]
    result[:, 3:] = directions[:, 3:] if directions.shape[1] > 3 else 0.0
    length = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
    # A vector that is not finite has a length that is not: two reductions are quicker than three masks.
    if length.size and not (length.min() > 0.0 and length.max() < np.inf):
        wrong = int(np.argmin((length > 0.0) & (length < np.inf)))
        raise ValueError(f"directions[{wrong}] is {vectors[wrong]}: give a finite vector with a length")
    np.divide(vectors, length[:, None], out=result[:, :3])


def round_deg(angles_deg: npt.ArrayLike) -> Floats:
    """Angles rounded to DECIMALS, so that equal angles are equal numbers. Python's `round` takes other numbers for ties."""
    angles: Floats = np.asarray(angles_deg, dtype=np.float64)
    return np.round(angles, DECIMALS)


def wrap_azimuth(azimuth_deg: npt.ArrayLike) -> Floats:
    """The same azimuths in [0, 360). Not rounded."""
    wrapped: Floats = np.mod(azimuth_deg, TURN_DEG)
    return np.where(wrapped >= TURN_DEG, 0.0, wrapped)  # the remainder of a tiny negative angle is the whole turn


def fold_azimuth(azimuth_deg: npt.ArrayLike) -> Floats:
    """Azimuths in [0, 180]: the two sides of the plane of incidence count as one. Not rounded."""
    wrapped: Floats = np.mod(azimuth_deg, TURN_DEG)
    return np.asarray(np.minimum(wrapped, TURN_DEG - wrapped))


def polar_and_azimuth(signed_deg: npt.ArrayLike, plane_deg: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Polar angle, and azimuth in [0, 360), of signed polar angles in a plane through the pole. Not rounded.

    A positive angle is in the half plane at the azimuth `plane_deg`, a negative one in the opposite half plane. The pole is
    that of the angles: the normal, or, for theta and phi, the specular direction.
    """
    signed, plane = np.asarray(signed_deg, dtype=np.float64), np.asarray(plane_deg, dtype=np.float64)
    return np.abs(signed), wrap_azimuth(np.where(signed < 0.0, plane + HALF_TURN_DEG, plane))


def signed_polar(polar_deg: npt.ArrayLike, azimuth_deg: npt.ArrayLike, plane_deg: npt.ArrayLike) -> Floats:
    """Signed polar angles: positive on the side of the half plane at `plane_deg`, negative on the opposite side.

    The inverse of `polar_and_azimuth` in that plane.
    """
    opposite = np.cos(np.radians(np.subtract(azimuth_deg, plane_deg))) < 0.0
    return np.where(opposite, np.negative(polar_deg), polar_deg)


def aspecular_deg(theta_deg: npt.ArrayLike, phi_deg: npt.ArrayLike) -> Floats:
    """Aspecular angles: theta, positive towards the normal (phi = 0) and negative towards grazing."""
    return signed_polar(theta_deg, phi_deg, 0.0)


def opposite_sigma_deg(sigma_deg: float) -> float:
    """Sigma of the mirror unit with the same incidence on the other side of the sample, rounded to DECIMALS."""
    return float(round_deg(HALF_TURN_DEG - sigma_deg))


def is_lit_from_behind(sigma_deg: float) -> bool:
    """Whether the back is the lit side, for a mirror unit at `sigma_deg`, 0 to 180."""
    return sigma_deg > 0.5 * HALF_TURN_DEG


def incidence_deg(sigma_deg: float) -> float:
    """Incidence, from the normal of the lit side, for a mirror unit at `sigma_deg`, 0 to 180."""
    return opposite_sigma_deg(sigma_deg) if is_lit_from_behind(sigma_deg) else sigma_deg


def light_direction(sigma_deg: float) -> Floats:
    """Unit vector (3,) from the sample's centre towards the light, for a mirror unit at `sigma_deg`."""
    sigma = np.radians(sigma_deg)
    return np.array([np.sin(sigma), 0.0, np.cos(sigma)])


def specular_direction(sigma_deg: float) -> Floats:
    """Unit vector (3,) of the specular reflection for a mirror unit at `sigma_deg`."""
    sigma = np.radians(sigma_deg)
    return np.array([-np.sin(sigma), 0.0, np.cos(sigma)])


def arc_direction(polar_deg: npt.ArrayLike, azimuth_deg: npt.ArrayLike, lower: npt.ArrayLike = False) -> Floats:
    """Viewing directions of photodiodes: unit vectors (..., 3), of the shape of polar and azimuth broadcast.

    `polar_deg` is the photodiode's angle on the arc plus the arc's shift, `azimuth_deg` the arc's beta. The lower arc is the
    upper one mirrored in the sample's plane; `lower` is of a shape that broadcasts with theirs.
    """
    polar, azimuth = np.radians(polar_deg), np.radians(azimuth_deg)
    sine, z = np.sin(polar), np.cos(polar)  # of each angle once, before they are broadcast
    x, y, z = np.broadcast_arrays(sine * np.cos(azimuth), sine * np.sin(azimuth), np.where(lower, -z, z))
    return np.stack([x, y, z], axis=-1)


def arc_axis(azimuth_deg: npt.ArrayLike) -> Floats:
    """Axes (..., 3) about which arcs at `azimuth_deg` are bent: level, towards growing azimuth."""
    azimuth = np.radians(azimuth_deg)
    return np.stack([-np.sin(azimuth), np.cos(azimuth), np.zeros_like(azimuth)], axis=-1)


def zenith_and_azimuth(directions: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Zenith angle from the front normal, and azimuth in [0, 360), of `directions` (..., 3): the inverse of `arc_direction`.

    The vectors need not be unit vectors. Raises ValueError for a wrong shape.
    """
    vectors = _directions(directions)
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return np.degrees(np.arctan2(np.hypot(x, y), z)), wrap_azimuth(np.degrees(np.arctan2(y, x)))


def turn_about_x(directions: npt.ArrayLike) -> Floats:
    """Directions (..., 3) for a sample turned about the x axis, so that its back is in front."""
    return np.asarray(_directions(directions) * [1.0, -1.0, -1.0])


def mirror_in_sample_plane(directions: npt.ArrayLike) -> Floats:
    """Mirror images (..., 3) of directions in the plane of the sample: of one arc on the other."""
    return np.asarray(_directions(directions) * [1.0, 1.0, -1.0])


def mirror_in_plane_of_incidence(directions: npt.ArrayLike) -> Floats:
    """Mirror images (..., 3) of directions in the plane of incidence: the same azimuths with the other sign."""
    return np.asarray(_directions(directions) * [1.0, -1.0, 1.0])


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
    return theta, np.where(np.hypot(inward, y) == 0.0, 0.0, wrap_azimuth(np.degrees(np.arctan2(y, inward))))


def from_specular(sigma_deg: npt.ArrayLike, theta_deg: npt.ArrayLike, phi_deg: npt.ArrayLike) -> Floats:
    """Unit vectors (..., 3) of specular coordinates, arguments broadcast: the inverse of `to_specular`."""
    sigma, theta, phi = np.radians(sigma_deg), np.radians(theta_deg), np.radians(phi_deg)
    sine, along, cos, sin = np.sin(theta), np.cos(theta), np.cos(sigma), np.sin(sigma)  # of each angle once, see above
    inward = sine * np.cos(phi)
    return np.stack(np.broadcast_arrays(cos * inward - sin * along, sine * np.sin(phi), sin * inward + cos * along), axis=-1)
