"""Which directions the mirror unit hides from a photodiode, by the geometry that the rig file states."""

import math
from functools import lru_cache

import numpy as np

from goniotwin.app.campaign.planning.clear_view import certainly_clear
from goniotwin.app.rig import RigFile, believed_instrument
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import Instrument, arc_direction, visible_fraction

WHOLE = 1.0 - 1e-9
GLANCE, CLOSELY = 16, 256
"""Rays from the illuminated spot to a photodiode."""


def shadowed(rig: RigFile, sigma_deg: float, zenith_deg: Floats, azimuth_deg: Floats, gamma_deg: float = 0.0) -> Flags:
    """Whether any part of what a photodiode should see is hidden, or would be a `shadow_margin_deg` further on.

    Angles of the directions of observation in degrees, from the front's normal (the lower arc is beyond 90); shape as theirs.
    """
    instrument = believed_instrument(rig)
    angles, where = np.unique(
        np.round(np.stack([np.ravel(zenith_deg), np.ravel(azimuth_deg)], axis=1), 6), axis=0, return_inverse=True
    )
    if not angles.size:
        return np.zeros(np.shape(zenith_deg), dtype=bool)
    hidden = _hidden(instrument, rig.geometry.shadow_margin_deg, sigma_deg, gamma_deg, angles.tobytes())
    return hidden[where.ravel()].reshape(np.shape(zenith_deg))


def may_be_shadowed(rig: RigFile, sigma_deg: float, zenith_deg: Floats, azimuth_deg: Floats) -> Flags:
    """The same at a glance: where this is False nothing is hidden."""
    directions = arc_direction(zenith_deg, azimuth_deg)
    return ~certainly_clear(believed_instrument(rig), rig.geometry.shadow_margin_deg, sigma_deg, directions)


@lru_cache(maxsize=4096)
def _hidden(instrument: Instrument, margin_deg: float, sigma_deg: float, gamma_deg: float, angles: bytes) -> Flags:
    """For pairs of zenith and azimuth, as bytes so that they can be remembered.

    A few rays find most of what is hidden; only what they leave free is looked at closely.
    """
    zenith, azimuth = np.frombuffer(angles).reshape(-1, 2).T
    hidden = np.zeros(len(zenith), dtype=bool)
    left = np.flatnonzero(~certainly_clear(instrument, margin_deg, sigma_deg, arc_direction(zenith, azimuth)))
    for rays in (GLANCE, CLOSELY):
        if left.size:
            directions = _around(zenith[left], azimuth[left], margin_deg)
            visible = visible_fraction(instrument, sigma_deg, directions.reshape(-1, 3), rays, gamma_deg)
            cut = np.any(visible.reshape(directions.shape[:-1]) < WHOLE, axis=0)
            hidden[left[cut]] = True
            left = left[~cut]
    return hidden


def _around(zenith_deg: Floats, azimuth_deg: Floats, margin_deg: float) -> Floats:
    """Shape (5, n, 3): each direction and four at `margin_deg` from it."""
    centre = arc_direction(zenith_deg, azimuth_deg)
    along = arc_direction(zenith_deg + 90.0, azimuth_deg)
    across = np.cross(centre, along)
    c, s = math.cos(math.radians(margin_deg)), math.sin(math.radians(margin_deg))
    return np.array([centre, *(c * centre + s * side for side in (along, -along, across, -across))])
