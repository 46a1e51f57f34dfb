"""What each step between two points of a lattice costs, looked up instead of reckoned: for orders that no nest of loops gives.

A step costs what its costliest column costs alone, and every further column the words of one more move. A step on which the
arc would meet the beam costs BARRED_S besides, so that an order without any is preferred to every other.
"""

import numpy as np

from goniotwin.app.campaign.planning.lattice import Lattice
from goniotwin.app.campaign.planning.moves import AFTER_A_MOVE, BEFORE_A_MOVE, Moves
from goniotwin.app.campaign.planning.nesting import swept_ways
from goniotwin.arrays import Floats, Ints
from goniotwin.drivers import ArcClearance

BARRED_S = 1.0e6
BETA, SHIFT = 2, 3
MOST_PIECES = 60


class Steps:
    """Of one lattice on a rig. `ends` (5,): a point that is come from, and gone to afterwards."""

    def __init__(self, lattice: Lattice, moves: Moves, clearance: ArcClearance, ends: Floats | None) -> None:
        self._ranks = lattice.ranks
        self._columns = lattice.active
        self._seconds = {column: _seconds(lattice.values[column], moves, column) for column in lattice.active}
        self._more_s = (BEFORE_A_MOVE + AFTER_A_MOVE) * moves.exchange_s
        self._barred, self._high = _barred(lattice, clearance)
        self._end_s = np.zeros((len(lattice),))
        if ends is not None:
            towards = np.broadcast_to(ends, lattice.points.shape)
            self._end_s = np.asarray(BARRED_S * swept_ways(clearance, lattice.points, towards))

    def seconds(self, here: Ints, there: Ints) -> Floats:
        """From points to others by their numbers, arrays that fit each other; -1 is beyond the end of an order."""
        longest, changed = np.zeros(np.broadcast_shapes(here.shape, there.shape)), -1
        for column in self._columns:
            i, j = self._ranks[column][here], self._ranks[column][there]
            longest = np.maximum(longest, self._seconds[column][i, j])
            changed = changed + (i != j)
        taken = longest + self._more_s * np.maximum(changed, 0)
        if self._barred.any():
            beta, shift = self._ranks[BETA], self._ranks[SHIFT]
            taken += BARRED_S * (self._barred[beta[here], beta[there]] & (self._high[shift[here]] | self._high[shift[there]]))
        return np.where(here < 0, self._end_s[there], np.where(there < 0, self._end_s[here], taken))

    def table(self) -> Floats:
        """All of them, and in the last row and column what it costs to begin and to end (n + 1, n + 1)."""
        numbers = np.append(np.arange(len(self._end_s)), -1)
        table = self.seconds(numbers[:, None], numbers[None, :])
        table[-1, -1] = 0.0
        return table

    def joined(self, order: Ints) -> Ints:
        """The same points: cut where the arc would meet the beam, the pieces put back, the longest first, where they cost
        least. As it was where there are too many pieces.
        """
        cuts = np.flatnonzero(self.seconds(order[:-1], order[1:]) >= BARRED_S) + 1
        if len(cuts) >= MOST_PIECES:
            return order
        longest, *others = sorted(np.split(order, cuts), key=len, reverse=True)
        found = longest
        for piece in others:
            left, right = np.append(-1, found), np.append(found, -1)
            costs = [
                self.seconds(left, np.full(len(left), way[0])) + self.seconds(np.full(len(right), way[-1]), right)
                for way in (piece, piece[::-1])
            ]
            gains = np.stack(costs) - self.seconds(left, right)
            turned, place = np.unravel_index(int(gains.argmin()), gains.shape)
            found = np.insert(found, place, piece[::-1] if turned else piece)
        return found


def _seconds(values: Floats, moves: Moves, column: int) -> Floats:
    here, there = np.repeat(values, len(values)), np.tile(values, len(values))
    return moves.one_step(column)(here, there).reshape(len(values), len(values))


def _barred(lattice: Lattice, clearance: ArcClearance) -> tuple[Ints, Ints]:
    """Between which betas the arc crosses the beam, and at which shifts it may not."""
    betas, shifts = lattice.values[BETA].tolist(), lattice.values[SHIFT].tolist()
    barred = np.zeros((len(betas), len(betas)), dtype=np.int64)
    if clearance.veto((betas[0], betas[-1]), (shifts[-1],)) is not None:
        for k, beta in enumerate(betas):
            barred[k, k:] = [clearance.veto((beta, other), (shifts[-1],)) is not None for other in betas[k:]]
        barred |= barred.T
    azimuth = clearance.beam_azimuth_deg
    return barred, np.array([clearance.veto((azimuth,), (shift,)) is not None for shift in shifts], dtype=np.int64)
