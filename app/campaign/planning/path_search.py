"""Path search: orders of a scan grid that no loop order gives.

They are faster where steps are uneven or poses lie beside the grids, and may avoid collisions of the arc with the beam.

The search starts from two sequences: that of the best loop order, and that of the clusters. Pieces of a sequence are reversed
or moved as long as this saves time (2-opt and or-opt), on a table of the cost of each step. On a large grid only the sequence
of the poses is searched, with the wavelengths inside or outside. The amount of work is limited by number, not by time, so that
a schedule has the same order on every machine. See docs/decisions/0013.

A step costs what its slowest column costs alone, and the exchanges of one more move for each further column. A step on which
the arc would collide with the beam costs COLLISION_PENALTY_S more, so that any order without a collision is preferred.
"""

from collections.abc import Iterator

import numpy as np

from goniotwin.app.campaign.geometry.collision import BETA, SHIFT, beam_crossings, crosses_beam_between
from goniotwin.app.campaign.planning.durations import Moves
from goniotwin.app.campaign.planning.loop_order import Loop, moving_seconds, nested_sequence
from goniotwin.app.campaign.planning.lower_bound import moving_lower_bound_s
from goniotwin.app.campaign.planning.scan_grid import ScanGrid
from goniotwin.arrays import Floats, Ints
from goniotwin.drivers import ArcClearance

COLLISION_PENALTY_S = 1.0e6
MAX_POINTS = 1500
"""Limit of the points whose sequence is searched; on a larger grid the limit of the poses."""
MAX_VALUES = 500
"""Limit of the values of a column."""
MAX_PIECES = 60
"""Limit of the pieces into which collisions may cut a sequence."""
WORK_LIMIT = 60_000_000
"""Number of steps that are looked up in the table: about a tenth of a second."""
CLOSE_TO_BOUND = 1.0005
"""Ratio to the lower bound below which a loop order is not searched further."""
SAME_LOOP_RATIO = 1.2
"""Gaps whose costs differ by less than this ratio belong to one loop."""
PIECE_LENGTHS = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64])
"""Numbers of points that are moved together."""
MIN_REACH = 8
"""Least distance along the sequence over which pieces are moved."""


def search_paths(
    grid: ScanGrid, moves: Moves, clearance: ArcClearance, sequence: Ints, seconds: float, ends: Floats | None
) -> list[tuple[Ints, float]]:
    """Sequences other than that of a loop order, each with its moving time; none if the loop order is close to the bound.

    `seconds` is the moving time of `sequence`. `ends` (5,): a point from which the first point of a sequence must be reached,
    and which must be reached from the last.
    """
    if seconds <= CLOSE_TO_BOUND * moving_lower_bound_s(grid, moves):
        return []
    sequences = _sequences(grid, moves, clearance, sequence, ends, clear=seconds < float("inf"))
    return [(each, moving_seconds(moves, clearance, grid.points[each], ends)) for each in sequences]


def _sequences(
    grid: ScanGrid, moves: Moves, clearance: ArcClearance, sequence: Ints, ends: Floats | None, *, clear: bool
) -> Iterator[Ints]:
    if max(len(values) for values in grid.values) > MAX_VALUES:
        return
    if len(grid) <= MAX_POINTS:
        costs = StepCosts(grid, moves, clearance, ends)
        table = costs.table()
        for start in (sequence, cluster_sequence(grid, moves)):
            yield shorten_path(start if clear else costs.join_pieces(start), table, WORK_LIMIT)
        return
    if not clear:
        yield StepCosts(grid, moves, clearance, ends).join_pieces(sequence)
    waves = len(grid.wavelengths_nm)
    if waves > 1 and len(grid.poses) <= MAX_POINTS:
        poses, first = np.unique(sequence // waves, return_index=True)
        one_wavelength = ScanGrid(grid.poses, grid.wavelengths_nm[:1])
        for each in _sequences(one_wavelength, moves, clearance, poses[np.argsort(first)], ends, clear=clear):
            yield from _with_wavelengths(grid, each)


def _with_wavelengths(grid: ScanGrid, poses: Ints) -> Iterator[Ints]:
    """Sequences with the poses in their order: wavelengths inside, and wavelengths outside, back and forth."""
    waves = np.argsort(grid.wavelengths_nm)
    numbers = poses[:, None] * len(waves) + waves
    yield np.where((np.arange(len(poses)) % 2 == 1)[:, None], numbers[:, ::-1], numbers).ravel()
    yield np.where((np.arange(len(waves)) % 2 == 1)[:, None], numbers.T[:, ::-1], numbers.T).ravel()


def cluster_sequence(grid: ScanGrid, moves: Moves) -> Ints:
    """The sequence that crosses the costliest gaps least often, whatever their column: a column may have several loops."""
    loops: list[tuple[float, int, Ints]] = []
    for column in grid.varying_columns:
        values, seconds = grid.values[column], moves.one_step(column)
        costs = np.minimum(seconds(values[:-1], values[1:]), seconds(values[1:], values[:-1]))
        below = float("inf")
        for cost in sorted(set(costs.tolist()), reverse=True):
            if cost * SAME_LOOP_RATIO < below:
                below = cost
            labels = np.concatenate([[0], np.cumsum(costs >= cost)]).astype(np.int64)
            if cost == below:
                loops.append((cost, column, labels))
            else:
                loops[-1] = (loops[-1][0], column, labels)
    ordered = sorted(loops, key=lambda loop: -loop[0])
    return nested_sequence(len(grid), [Loop(labels[grid.ranks[k]], int(labels[-1]) + 1) for _, k, labels in ordered])


class StepCosts:
    """Cost in s of each step between two points of a grid on a rig.

    `ends` (5,): the point before the first and after the last point of a sequence.
    """

    def __init__(self, grid: ScanGrid, moves: Moves, clearance: ArcClearance, ends: Floats | None) -> None:
        self._ranks = grid.ranks
        self._columns = grid.varying_columns
        self._seconds = {column: _seconds(grid.values[column], moves, column) for column in grid.varying_columns}
        self._further_s = moves.further_move_s
        self._crossing, self._high = beam_crossings(clearance, grid.values[BETA], grid.values[SHIFT])
        self._end_s = np.zeros((len(grid),))
        if ends is not None:
            towards = np.broadcast_to(ends, grid.points.shape)
            self._end_s = np.asarray(COLLISION_PENALTY_S * crosses_beam_between(clearance, grid.points, towards))

    def seconds(self, start: Ints, stop: Ints) -> Floats:
        """From points to others, given by number, arrays that broadcast; -1 is the end of a sequence."""
        slowest, changed = np.zeros(np.broadcast_shapes(start.shape, stop.shape)), -1
        for column in self._columns:
            i, j = self._ranks[column][start], self._ranks[column][stop]
            slowest = np.maximum(slowest, self._seconds[column][i, j])
            changed = changed + (i != j)
        costs = slowest + self._further_s * np.maximum(changed, 0)
        if self._crossing.any():
            beta, shift = self._ranks[BETA], self._ranks[SHIFT]
            high = self._high[shift[start]] | self._high[shift[stop]]
            costs += COLLISION_PENALTY_S * (self._crossing[beta[start], beta[stop]] & high)
        return np.where(start < 0, self._end_s[stop], np.where(stop < 0, self._end_s[start], costs))

    def table(self) -> Floats:
        """All costs (n + 1, n + 1); the last row and column are the costs of the first and of the last point."""
        numbers = np.append(np.arange(len(self._end_s)), -1)
        table = self.seconds(numbers[:, None], numbers[None, :])
        table[-1, -1] = 0.0
        return table

    def join_pieces(self, sequence: Ints) -> Ints:
        """The sequence cut where the arc would collide with the beam, and its pieces joined where they cost least.

        The longest piece comes first. Unchanged if there are too many pieces.
        """
        cuts = np.flatnonzero(self.seconds(sequence[:-1], sequence[1:]) >= COLLISION_PENALTY_S) + 1
        if len(cuts) >= MAX_PIECES:
            return sequence
        joined, *others = sorted(np.split(sequence, cuts), key=len, reverse=True)
        for piece in others:
            left, right = np.append(-1, joined), np.append(joined, -1)
            costs = [
                self.seconds(left, np.full(len(left), each[0])) + self.seconds(np.full(len(right), each[-1]), right)
                for each in (piece, piece[::-1])
            ]
            increases = np.stack(costs) - self.seconds(left, right)
            reverse, place = np.unravel_index(int(increases.argmin()), increases.shape)
            joined = np.insert(joined, place, piece[::-1] if reverse else piece)
        return joined


def _seconds(values: Floats, moves: Moves, column: int) -> Floats:
    start, stop = np.repeat(values, len(values)), np.tile(values, len(values))
    return moves.one_step(column)(start, stop).reshape(len(values), len(values))


def shorten_path(path: Ints, table: Floats, work: int) -> Ints:
    """A sequence (n,) in which no piece costs less elsewhere or reversed, as far as `work` (number of steps) allows.

    `table` (n + 1, n + 1) has the cost of each step, and in the last row and column the cost of the first and last point.
    """
    # Loads 252 modules, numba among them: 0.2 s, which `check` does without.
    from goniotwin.app.campaign.planning.path_kernels import shorten

    ended = np.concatenate([[len(path)], path, [len(path)]])
    reach = max(MIN_REACH, work // (8 * len(path) * (len(PIECE_LENGTHS) + 1)))
    shorten(ended, table, PIECE_LENGTHS, reach, work)
    return ended[1:-1]
