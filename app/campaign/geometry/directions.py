"""Directions of a campaign: sides and arcs, the plane that an arc scans, and which directions are equal.

Sigma of a schedule is the incidence on the lit side, from the normal of that side. For the back the mirror unit turns to
180 deg - sigma, so that sigma of the rig is above 90 deg. Upper and lower arc are mirror images of each other in the plane of
the sample, and so are its two sides: about its own normal the geometry of the back equals that of the front.

Conversions that need neither side nor arc are in `twin.optics.geometry.coordinates`, with the rule of equal angles.
"""

from typing import Literal

import numpy as np

from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics.geometry.coordinates import HALF_TURN_DEG, TURN_DEG, opposite_sigma_deg, round_deg

LitSide = Literal["front", "back"]
Arc = Literal["upper", "lower"]
ARCS: tuple[Arc, ...] = ("upper", "lower")
PoseAngles = tuple[float, float, float, float]
"""gamma, sigma, beta, shift of the rig in degrees."""


def rig_sigma_deg(sigma_deg: float, side: LitSide) -> float:
    """Sigma of the rig for an incidence on a side."""
    return sigma_deg if side == "front" else opposite_sigma_deg(sigma_deg)


def zenith_deg(polar_deg: Floats, arc: Arc) -> Floats:
    """Zenith angle from the normal of the front, of polar angles from the arc's own pole: beyond 90 deg on the lower arc."""
    return polar_deg if arc == "upper" else HALF_TURN_DEG - polar_deg


def is_lower(zenith_deg: Floats) -> Flags:
    """Whether directions are on the side of the lower arc."""
    return np.asarray(zenith_deg > 0.5 * HALF_TURN_DEG)


def polar_from_zenith(zenith_deg: Floats) -> Floats:
    """Polar angle from the pole of the direction's own arc: the inverse of `zenith_deg`."""
    return np.where(is_lower(zenith_deg), HALF_TURN_DEG - zenith_deg, zenith_deg)


def round_azimuth(azimuth_deg: Floats, turn_deg: float = TURN_DEG) -> Floats:
    """The same azimuths from 0 to below 360 deg (or another turn), rounded."""
    wrapped = round_deg(np.mod(azimuth_deg, turn_deg))
    return np.asarray(np.where(wrapped == turn_deg, 0.0, wrapped))


def scan_plane_deg(beta_deg: Floats) -> Floats:
    """Azimuth from 0 to below 180 deg, rounded, of the plane that an arc at beta scans: two opposite half planes."""
    return round_azimuth(beta_deg, HALF_TURN_DEG)


def direction_keys(zenith_deg: Floats, azimuth_deg: Floats) -> Floats:
    """Rounded zenith and azimuth (n, 2), equal for equal directions: at the poles all azimuths are 0."""
    zenith, azimuth = round_deg(zenith_deg), round_azimuth(azimuth_deg)
    return np.stack([zenith, np.where(polar_from_zenith(zenith) == 0.0, 0.0, azimuth)], axis=-1)


def in_plane_of_incidence(zenith_deg: Floats, azimuth_deg: Floats) -> Flags:
    """Whether directions are in the plane of incidence, as all directions at a pole are."""
    return np.asarray(scan_plane_deg(direction_keys(zenith_deg, azimuth_deg)[..., 1]) == 0.0)
