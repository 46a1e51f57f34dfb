"""Conversions of angles: incidence and sigma of the rig, direction of observation of a photodiode, azimuths.

Sigma of a schedule is the incidence on the lit side, from the normal of that side. For the back the mirror unit turns to
180 deg - sigma, so that sigma of the rig is above 90 deg. Upper and lower arc are mirror images of each other in the plane of
the sample, and so are its two sides: about its own normal the geometry of the back equals that of the front.
"""

from typing import Literal

import numpy as np

from goniotwin.app.campaign.schedule.grids import DECIMALS, HALF_TURN_DEG, TURN_DEG
from goniotwin.arrays import Floats

LitSide = Literal["front", "back"]
Arc = Literal["upper", "lower"]
PoseAngles = tuple[float, float, float, float]
"""gamma, sigma, beta, shift of the rig in degrees."""


def opposite_sigma_deg(rig_sigma_deg: float) -> float:
    """Sigma of the rig with the same incidence on the other side."""
    return round(HALF_TURN_DEG - rig_sigma_deg, DECIMALS)


def rig_sigma_deg(sigma_deg: float, side: LitSide) -> float:
    """Sigma of the rig for an incidence on a side."""
    return sigma_deg if side == "front" else opposite_sigma_deg(sigma_deg)


def incidence_deg(rig_sigma_deg: float) -> float:
    """Incidence, from the normal of the lit side."""
    return min(rig_sigma_deg, opposite_sigma_deg(rig_sigma_deg))


def is_lit_from_behind(rig_sigma_deg: float) -> bool:
    """Whether the back is the lit side."""
    return rig_sigma_deg > 0.5 * HALF_TURN_DEG


def polar_and_azimuth(signed_polar_deg: Floats, beta_deg: Floats | float) -> tuple[Floats, Floats]:
    """Polar angle from the arc's own pole, and azimuth from 0 to below 360 deg, of photodiodes on the arc.

    Below 0 (beyond the pole) a photodiode looks from the other side of the normal. Not rounded.
    """
    azimuth = np.where(signed_polar_deg < 0.0, beta_deg + HALF_TURN_DEG, beta_deg)
    return np.abs(signed_polar_deg), np.mod(azimuth, TURN_DEG)


def zenith_deg(polar_deg: Floats, arc: Arc) -> Floats:
    """Zenith angle from the normal of the front, of polar angles from the arc's own pole: beyond 90 deg on the lower arc."""
    return polar_deg if arc == "upper" else HALF_TURN_DEG - polar_deg


def wrap_azimuth(angles_deg: Floats) -> Floats:
    """The same directions from 0 to below 360 deg, rounded to DECIMALS."""
    wrapped = np.round(np.mod(angles_deg, TURN_DEG), DECIMALS)
    return np.asarray(np.where(wrapped == TURN_DEG, 0.0, wrapped))
