"""Collision: moves on which the arc would collide with the incoming beam, for arrays of moves.

Points are rows of five: gamma, sigma, beta, shift in degrees, wavelength in nm. The rule is `ArcClearance.collision`.
"""

import numpy as np

from goniotwin.app.campaign.schedule.grids import TURN_DEG
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.drivers import ArcClearance


def crosses_beam(clearance: ArcClearance, points: Floats) -> Flags:
    """Which of the moves (n - 1,) from each of points (n, 5) to the next collide with the beam."""
    return crosses_beam_between(clearance, points[:-1], points[1:])


def crosses_beam_between(clearance: ArcClearance, before: Floats, after: Floats) -> Flags:
    """Which moves (n,) from points (n, 5) to others collide with the beam."""
    high = clearance.top_polar_deg + np.maximum(before[:, 3], after[:, 3]) > clearance.highest_deg
    if not high.any():
        return high
    lowest, highest = np.minimum(before[:, 2], after[:, 2]), np.maximum(before[:, 2], after[:, 2])
    start = clearance.beam_azimuth_deg - clearance.half_width_deg
    stop = clearance.beam_azimuth_deg + clearance.half_width_deg
    turns = np.floor_divide(lowest - stop, TURN_DEG) + 1.0
    return np.asarray(high & (start + turns * TURN_DEG <= highest))


def beam_crossings(clearance: ArcClearance, beta_deg: Floats, shift_deg: Floats) -> tuple[Ints, Ints]:
    """Between which of ascending betas (n,) the arc crosses the beam (n, n), and at which of ascending shifts (m,) it must not.

    A move collides with the beam where both are 1.
    """
    betas, shifts = beta_deg.tolist(), shift_deg.tolist()
    crossing = np.zeros((len(betas), len(betas)), dtype=np.int64)
    if clearance.collision((betas[0], betas[-1]), (shifts[-1],)) is not None:
        for k, beta in enumerate(betas):
            crossing[k, k:] = [clearance.collision((beta, other), (shifts[-1],)) is not None for other in betas[k:]]
        crossing |= crossing.T
    azimuth = clearance.beam_azimuth_deg
    return crossing, np.array([clearance.collision((azimuth,), (shift,)) is not None for shift in shifts], dtype=np.int64)


def reachable_poses(clearance: ArcClearance, poses: Floats, others: Floats) -> Flags:
    """Which of the `others` (m, 4) the arc reaches from the nearest beta of `poses` (n, 4) without a collision.

    At the highest shift of `poses`.
    """
    betas, shift = np.unique(poses[:, 2]), float(poses[:, 3].max())
    free = {
        beta: clearance.collision((beta, float(betas[np.abs(betas - beta).argmin()])), (shift,)) is None
        for beta in np.unique(others[:, 2]).tolist()
    }
    return np.array([free[beta] for beta in others[:, 2].tolist()], dtype=bool)
