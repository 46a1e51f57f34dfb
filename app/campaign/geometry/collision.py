"""Collision: moves on which the arc would collide with the incoming beam, for arrays of moves.

Points are rows of five: gamma, sigma, beta, shift in degrees, wavelength in nm. The rule is `ArcClearance.collides`.
"""

import numpy as np

from goniotwin.arrays import Flags, Floats
from goniotwin.drivers import ArcClearance

BETA, SHIFT = 2, 3
"""Columns of beta and shift."""


def crosses_beam(clearance: ArcClearance, points: Floats) -> Flags:
    """Which of the moves (n - 1,) from each of points (n, 5) to the next collide with the beam."""
    return crosses_beam_between(clearance, points[:-1], points[1:])


def crosses_beam_between(clearance: ArcClearance, before: Floats, after: Floats) -> Flags:
    """Which moves (n,) from points (n, 5) to others collide with the beam."""
    return clearance.collides(before[:, BETA], after[:, BETA], np.maximum(before[:, SHIFT], after[:, SHIFT]))


def beam_crossings(clearance: ArcClearance, beta_deg: Floats, shift_deg: Floats) -> tuple[Flags, Flags]:
    """Between which of betas (n,) the arc crosses the beam at the greatest shift (n, n), and at which shifts (m,) it must not.

    A move collides with the beam where both are true.
    """
    crossing = clearance.collides(beta_deg[:, None], beta_deg, shift_deg.max())
    return crossing, clearance.collides(clearance.beam_azimuth_deg, clearance.beam_azimuth_deg, shift_deg)


def reachable_poses(clearance: ArcClearance, poses: Floats, others: Floats) -> Flags:
    """Which of the `others` (m, 4) the arc reaches from the nearest beta of `poses` (n, 4) without a collision.

    At the highest shift of `poses`.
    """
    near, (beta, which) = np.unique(poses[:, BETA]), np.unique(others[:, BETA], return_inverse=True)
    nearest = near[np.abs(near - beta[:, None]).argmin(axis=1)]
    return ~clearance.collides(beta, nearest, poses[:, SHIFT].max())[which.ravel()]
