"""What no order can beat: the least time that moving takes, and the least that a whole plan takes.

Any order is a path through all points, so it is one of the trees that connect them, and costs no less than the cheapest of
these. A move from one point to another takes no less than the slowest of its axes alone does, and an axis no less than the
costliest gap between neighbouring values on its way; a change of filter, whose price is not that of a way along the wavelength,
counts as much as the cheapest that leads over the gap. With these underestimates the cheapest tree is found without building
it: at a cost c all points are connected that lie between the same gaps costlier than c, on every axis; that leaves n(c)
islands, and the tree costs the integral of n(c) - 1 over c. See docs/decisions/0013.
"""

import numpy as np

from goniotwin.app.campaign.planning.durations import Moves
from goniotwin.app.campaign.planning.scan_grid import WAVELENGTH, Lattice
from goniotwin.arrays import Floats, Ints

TINY_S = 1e-9
LEVELS = 200
"""So many different costs are told apart."""


def least_moving_seconds(lattice: Lattice, moves: Moves) -> float:
    """Less than this no order of a lattice's points takes for its moves."""
    gaps = {column: _gap_seconds(lattice.values[column], moves, column) for column in lattice.active}
    if not gaps:
        return 0.0
    levels = _levels(np.concatenate(list(gaps.values())))
    total, below = 0.0, 0.0
    for level in levels.tolist():
        # Joined by gaps that cost less than `level`: exact where no level between was left out, too few islands else.
        islands = lattice.distinct({column: _islands(costs, level) for column, costs in gaps.items()})
        total += (level - below) * (islands - 1)
        below = level
    return total


def _gap_seconds(values: Floats, moves: Moves, column: int) -> Floats:
    """Of each gap between neighbouring values, whichever way is quicker: what a move over the gap takes at least."""
    cheaper = _either_way(values[:-1], values[1:], moves, column)
    if column == WAVELENGTH:
        # Between two filters the neighbours need not be the cheapest: the wheel may be quicker from the filter before to the
        # one after. Whatever changes the filter goes at least from one filter's last wavelength to the other's first.
        changes = np.flatnonzero(np.diff(moves.filter_numbers(values)))
        for k in changes:
            below, above = np.meshgrid(values[changes[changes <= k]], values[changes[changes >= k] + 1])
            cheaper[k] = _either_way(below.ravel(), above.ravel(), moves, column).min()
    return np.asarray(np.floor(cheaper / TINY_S) * TINY_S)


def _either_way(here: Floats, there: Floats, moves: Moves, column: int) -> Floats:
    seconds = moves.one_step(column)
    return np.minimum(seconds(here, there), seconds(there, here))


def _islands(costs: Floats, level: float) -> Ints:
    """A label for each value: the same where all gaps between two of them cost less than `level`."""
    return np.concatenate([[0], np.cumsum(costs >= level)]).astype(np.int64)


def _levels(costs: Floats) -> Floats:
    """The distinct costs, in order; of too many only some."""
    found = np.unique(costs)
    return found if len(found) <= LEVELS else found[np.linspace(0, len(found) - 1, LEVELS).astype(int)]
