"""Directions in which a photodiode certainly sees the whole spot, found without tracing a ray.

Which directions the mirror unit hides from a photodiode, by the geometry that the rig file states.
"""

import math
from functools import lru_cache
from itertools import product

import numpy as np

from goniotwin.app.rig import RigFile, nominal_instrument
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import Instrument, arc_direction, visible_fraction
from goniotwin.twin.optics.geometry.mirrors import mirrors_at

TINY = 1e-9


def clear_of_mirrors(instrument: Instrument, margin_deg: float, sigma_deg: float, directions: Floats) -> Flags:
    """Of unit vectors (n, 3): no mirror is in the way, nor would be a `margin_deg` further on, however the sample is turned.

    In the sample's own plane a photodiode sees nothing, so that it is not clear there.
    """
    spot = math.sqrt(0.5) * instrument.spot_side_mm
    disc = 0.5 * instrument.detector_diameter_mm + instrument.arc_radius_mm * math.radians(margin_deg)
    mirrors = mirrors_at(instrument, sigma_deg)
    clear = np.abs(directions[:, 2]) > math.sin(math.radians(margin_deg)) + TINY
    for centre, normal, u, v in mirrors.packed:
        # A sphere round the mirror and a tube round the light first: most directions are far from both.
        near = np.flatnonzero(clear & _near(instrument, max(spot, disc), centre, directions))
        frame = normal, u, v
        clear[near] = _passes(instrument, centre, frame, directions[near], spot, disc)
    return np.asarray(clear)


def _near(instrument: Instrument, light_mm: float, centre: Floats, directions: Floats) -> Flags:
    along = directions @ centre
    nearest = np.clip(along, 0.0, instrument.arc_radius_mm)
    reach = light_mm + math.sqrt(0.5) * instrument.blocking_side_mm
    return np.asarray(float(centre @ centre) - 2.0 * nearest * along + nearest * nearest <= reach * reach)


def _passes(
    instrument: Instrument, centre: Floats, frame: tuple[Floats, Floats, Floats], directions: Floats, spot: float, disc: float
) -> Flags:
    """Whether all light of each direction passes a mirror on one side, or ends before it.

    Spot and photodiode are convex: what passes between them meets the mirror's plane within the hull of where the lines
    between the corners of squares round both meet it. All of these beyond one edge of the mirror means all of the light.
    """
    normal, u, v = frame
    across = np.cross(directions, np.where(np.abs(directions[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]]))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    beside = np.cross(directions, across)
    low, high = np.full((3, len(directions)), np.inf), np.full((3, len(directions)), -np.inf)
    for px, py, s, t in product((-1.0, 1.0), repeat=4):
        begin = np.array([spot * px, spot * py, 0.0])
        way = instrument.arc_radius_mm * directions + disc * (s * across + t * beside) - begin
        with np.errstate(divide="ignore", invalid="ignore"):
            share = float((centre - begin) @ normal) / (way @ normal)
            met = np.stack(
                [share, share * (way @ u) - float((centre - begin) @ u), share * (way @ v) - float((centre - begin) @ v)]
            )
        low, high = np.minimum(low, met), np.maximum(high, met)
    half = 0.5 * instrument.blocking_side_mm
    beyond_an_edge = (low[1:] > half).any(axis=0) | (high[1:] < -half).any(axis=0)
    between = (low[0] > 0.0) & (high[0] < 1.0)
    return np.asarray((between & beyond_an_edge) | (high[0] < 0.0) | (low[0] > 1.0))


FULLY_VISIBLE = 1.0 - 1e-9
RAYS_COARSE, RAYS_FINE = 16, 256
"""Rays from the illuminated spot to a photodiode."""


def blocked_by_mirrors(
    rig: RigFile, sigma_deg: float, zenith_deg: Floats, azimuth_deg: Floats, gamma_deg: float = 0.0
) -> Flags:
    """Whether any part of what a photodiode should see is hidden, or would be a `shadow_margin_deg` further on.

    Angles of the directions of observation in degrees, from the front's normal (the lower arc is beyond 90); shape as theirs.
    """
    instrument = nominal_instrument(rig)
    angles, where = np.unique(
        np.round(np.stack([np.ravel(zenith_deg), np.ravel(azimuth_deg)], axis=1), 6), axis=0, return_inverse=True
    )
    if not angles.size:
        return np.zeros(np.shape(zenith_deg), dtype=bool)
    hidden = _blocked(instrument, rig.geometry.shadow_margin_deg, sigma_deg, gamma_deg, angles.tobytes())
    return hidden[where.ravel()].reshape(np.shape(zenith_deg))


def may_be_blocked(rig: RigFile, sigma_deg: float, zenith_deg: Floats, azimuth_deg: Floats) -> Flags:
    """The same at a glance: where this is False nothing is hidden."""
    directions = arc_direction(zenith_deg, azimuth_deg)
    return ~clear_of_mirrors(nominal_instrument(rig), rig.geometry.shadow_margin_deg, sigma_deg, directions)


@lru_cache(maxsize=4096)
def _blocked(instrument: Instrument, margin_deg: float, sigma_deg: float, gamma_deg: float, angles: bytes) -> Flags:
    """For pairs of zenith and azimuth, as bytes so that they can be remembered.

    A few rays find most of what is hidden; only what they leave free is looked at closely.
    """
    zenith, azimuth = np.frombuffer(angles).reshape(-1, 2).T
    hidden = np.zeros(len(zenith), dtype=bool)
    left = np.flatnonzero(~clear_of_mirrors(instrument, margin_deg, sigma_deg, arc_direction(zenith, azimuth)))
    for rays in (RAYS_COARSE, RAYS_FINE):
        if left.size:
            directions = _around(zenith[left], azimuth[left], margin_deg)
            visible = visible_fraction(instrument, sigma_deg, directions.reshape(-1, 3), rays, gamma_deg)
            cut = np.any(visible.reshape(directions.shape[:-1]) < FULLY_VISIBLE, axis=0)
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
