"""Collision: which moves have the arc meet the incoming beam."""

import numpy as np

from goniotwin.arrays import Flags, Floats
from goniotwin.drivers import ArcClearance
from goniotwin.drivers.motion.clearance import WHOLE_TURN_DEG


def crosses_beam(clearance: ArcClearance, points: Floats) -> Flags:
    """Which of the moves (n - 1,) between points (n, 5) have the arc meet the beam."""
    return crosses_beam_between(clearance, points[:-1], points[1:])


def crosses_beam_between(clearance: ArcClearance, before: Floats, after: Floats) -> Flags:
    """Which moves have the arc meet the beam on its way from points (n, 5) to others: `ArcClearance.collision`, for arrays."""
    high = clearance.top_polar_deg + np.maximum(before[:, 3], after[:, 3]) > clearance.highest_deg
    if not high.any():
        return high
    lowest, highest = np.minimum(before[:, 2], after[:, 2]), np.maximum(before[:, 2], after[:, 2])
    begin = clearance.beam_azimuth_deg - clearance.half_width_deg
    end = clearance.beam_azimuth_deg + clearance.half_width_deg
    turns = np.floor_divide(lowest - end, WHOLE_TURN_DEG) + 1.0
    return np.asarray(high & (begin + turns * WHOLE_TURN_DEG <= highest))
