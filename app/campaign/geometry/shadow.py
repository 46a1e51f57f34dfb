"""Shadow of the mirror unit: directions in which it blocks light on the way to a photodiode, by the rig file's geometry.

Most directions are certainly clear, which is found without tracing a ray; rays are traced for the others.
"""

import math
from functools import lru_cache

import numpy as np

from goniotwin.app.rig import RigFile, nominal_instrument
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import Instrument, arc_direction, visible_fraction_of_few
from goniotwin.twin.optics.geometry.coordinates import round_deg
from goniotwin.twin.optics.geometry.nominal import nominal_mirrors

MOST_KEPT = 128
"""Directions, about those of a pose, of which an answer is kept."""
TINY = 1e-9
FULLY_VISIBLE = 1.0 - 1e-9
"""Least visible fraction of a photodiode that is not blocked."""
SQUARE = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
"""Corners."""
RAYS_COARSE, RAYS_FINE = 16, 256
"""Number of rays from the illuminated spot to a photodiode: few find most blocked directions, many examine the rest."""


def blocked_by_mirrors(
    rig: RigFile, sigma_deg: float, zenith_deg: Floats, azimuth_deg: Floats, gamma_deg: float = 0.0
) -> Flags:
    """Whether the mirror unit blocks any light to a photodiode in these directions, or within `shadow_margin_deg` of them.

    Directions of observation in degrees, zenith from the normal of the front (the lower arc is beyond 90); shape as theirs.
    """
    instrument = nominal_instrument(rig)
    angles, index = np.unique(
        round_deg(np.stack([np.ravel(zenith_deg), np.ravel(azimuth_deg)], axis=1)), axis=0, return_inverse=True
    )
    if not angles.size:
        return np.zeros(np.shape(zenith_deg), dtype=bool)
    asked = instrument, rig.geometry.shadow_margin_deg, sigma_deg, gamma_deg, angles.tobytes()
    blocked = _kept_blocked(*asked) if len(angles) <= MOST_KEPT else _blocked(*asked)
    return blocked[index.ravel()].reshape(np.shape(zenith_deg))


def may_be_blocked(rig: RigFile, sigma_deg: float, zenith_deg: Floats, azimuth_deg: Floats) -> Flags:
    """Fast bound of `blocked_by_mirrors` at any gamma: where this is False, nothing is blocked."""
    directions = arc_direction(zenith_deg, azimuth_deg)
    return ~clear_of_mirrors(nominal_instrument(rig), rig.geometry.shadow_margin_deg, sigma_deg, directions)


def _blocked(instrument: Instrument, margin_deg: float, sigma_deg: float, gamma_deg: float, angles: bytes) -> Flags:
    """Flags (n,) of pairs of zenith and azimuth (n, 2), given as bytes so that the cache can use them as a key."""
    zenith, azimuth = np.frombuffer(angles).reshape(-1, 2).T
    blocked = np.zeros(len(zenith), dtype=bool)
    remaining = np.flatnonzero(~clear_of_mirrors(instrument, margin_deg, sigma_deg, arc_direction(zenith, azimuth)))
    for rays in (RAYS_COARSE, RAYS_FINE):
        if remaining.size:
            directions = _around(zenith[remaining], azimuth[remaining], margin_deg)
            visible = visible_fraction_of_few(instrument, sigma_deg, directions.reshape(-1, 3), rays, gamma_deg)
            cut = np.any(visible.reshape(directions.shape[:-1]) < FULLY_VISIBLE, axis=0)
            blocked[remaining[cut]] = True
            remaining = remaining[~cut]
    return blocked


_kept_blocked = lru_cache(maxsize=4096)(_blocked)
"""Kept: the poses of a scan in progress are asked for again and again."""


def _around(zenith_deg: Floats, azimuth_deg: Floats, margin_deg: float) -> Floats:
    """Unit vectors (5, n, 3): each direction, and four directions at `margin_deg` from it."""
    centre = arc_direction(zenith_deg, azimuth_deg)
    along = arc_direction(zenith_deg + 90.0, azimuth_deg)
    across = np.cross(centre, along)
    c, s = math.cos(math.radians(margin_deg)), math.sin(math.radians(margin_deg))
    return np.array([centre, *(c * centre + s * side for side in (along, -along, across, -across))])


def clear_of_mirrors(instrument: Instrument, margin_deg: float, sigma_deg: float, directions: Floats) -> Flags:
    """Which of unit vectors (n, 3) are certainly clear of all mirrors, with a margin of `margin_deg`, at any gamma.

    A photodiode in the plane of the sample sees nothing: such a direction is not clear.
    """
    spot = math.sqrt(0.5) * instrument.spot_side_mm
    disc = 0.5 * instrument.detector_diameter_mm + instrument.arc_radius_mm * math.radians(margin_deg)
    clear = np.abs(directions[:, 2]) > math.sin(math.radians(margin_deg)) + TINY
    for centre, normal, u, v in _mirrors(instrument, sigma_deg):
        # First a sphere around the mirror and a tube around the light: most directions are far from both.
        near = np.flatnonzero(clear & _near(instrument, max(spot, disc), centre, directions))
        frame = normal, u, v
        clear[near] = _passes(instrument, centre, frame, directions[near], spot, disc)
    return np.asarray(clear)


@lru_cache(maxsize=512)
def _mirrors(instrument: Instrument, sigma_deg: float) -> Floats:
    """`nominal_mirrors`, kept."""
    return nominal_mirrors(instrument, sigma_deg)


def _near(instrument: Instrument, light_mm: float, centre: Floats, directions: Floats) -> Flags:
    """Whether a tube of radius `light_mm` around the light meets the sphere around a mirror."""
    along = directions @ centre
    nearest = np.clip(along, 0.0, instrument.arc_radius_mm)
    reach = light_mm + math.sqrt(0.5) * instrument.blocking_side_mm
    return np.asarray(float(centre @ centre) - 2.0 * nearest * along + nearest * nearest <= reach * reach)


def _passes(
    instrument: Instrument, centre: Floats, frame: tuple[Floats, Floats, Floats], directions: Floats, spot: float, disc: float
) -> Flags:
    """Whether all light of each direction passes a mirror on one side, or ends before the mirror.

    Spot and photodiode are convex: the light between them meets the plane of the mirror within the convex hull of the points
    where the lines between the corners of two squares around them meet it. If all these points are beyond one edge of the
    mirror, all of the light passes.
    """
    across = np.cross(directions, np.where(np.abs(directions[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]]))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    beside = np.cross(directions, across)
    starts = spot * np.pad(SQUARE, ((0, 0), (0, 1)))[:, None, None]
    ends = instrument.arc_radius_mm * directions + disc * (SQUARE[:, :1, None] * across + SQUARE[:, 1:, None] * beside)
    axes = np.stack(frame, axis=1)
    along, offset = (ends - starts) @ axes, (centre - starts) @ axes  # (corners, corners, n or 1, normal and two sides)
    with np.errstate(divide="ignore", invalid="ignore"):
        met = offset[..., :1] / along[..., :1] * along - offset
        met[..., 0] = offset[..., 0] / along[..., 0]
    low, high = met.min(axis=(0, 1)).T, met.max(axis=(0, 1)).T
    half = 0.5 * instrument.blocking_side_mm
    beyond_an_edge = (low[1:] > half).any(axis=0) | (high[1:] < -half).any(axis=0)
    between = (low[0] > 0.0) & (high[0] < 1.0)
    return np.asarray((between & beyond_an_edge) | (high[0] < 0.0) | (low[0] > 1.0))
