"""Kernels that shorten a path: pieces are turned round, or taken out and put back where they cost less.

A path is an array (n + 2,) of points' numbers with the number n, which is no point, at both ends; `table` (n + 1, n + 1) says
what each step costs, and what it costs to begin or to end at a point. What is done is cheaper by more than TINY_S each time.

What each step between two points of a grid costs, looked up instead of reckoned: for orders that no nest of loops gives.

A step costs what its costliest column costs alone, and every further column the words of one more move. A step on which the
arc would meet the beam costs BARRED_S besides, so that an order without any is preferred to every other.

An order that no nest of loops gives: where steps are uneven, or poses lie beside the grids, or the arc meets the beam.

Two orders are begun with, the best nest's and that of the islands, and shortened piece by piece. Of a great grid the poses
alone are looked at, with the wavelengths inside or outside. All of it within a fixed amount of work, so that the same
schedule has the same order on every machine.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from goniotwin.app.campaign.geometry.collision import crosses_beam_between
from goniotwin.app.campaign.planning.durations import EXCHANGES_AFTER_MOVE, EXCHANGES_BEFORE_MOVE, Moves
from goniotwin.app.campaign.planning.loop_order import Loop, moving_seconds, nested_sequence
from goniotwin.app.campaign.planning.lower_bound import moving_lower_bound_s
from goniotwin.app.campaign.planning.scan_grid import ScanGrid
from goniotwin.arrays import Floats, Ints
from goniotwin.drivers import ArcClearance
from goniotwin.twin.optics.kernel import kernel

TINY_S = 1e-7
PIECE_LENGTHS = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64])
"""How many points are moved together."""
MIN_REACH = 8


def shorten_path(path: Ints, table: Floats, work: int) -> Ints:
    """An order (n,) of which no piece costs less elsewhere or the other way round, or as far as `work` (steps) goes."""
    ended = np.concatenate([[len(path)], path, [len(path)]])
    reach = max(MIN_REACH, work // (8 * len(path) * (len(PIECE_LENGTHS) + 1)))
    _shorten(ended, table, PIECE_LENGTHS, reach, work)
    return ended[1:-1]


@kernel(error_model="python")
def _shorten(path: Any, table: Any, pieces: Any, reach: int, work: int) -> None:
    n = len(path) - 2
    forth, back = np.zeros(n + 2), np.zeros(n + 2)
    _sums(path, table, forth, back)
    better = True
    while better:
        better = False
        for i in range(1, n):
            far = min(n + 1, i + 1 + reach)
            work -= 4 * (far - i)
            if _reverse_piece(path, table, forth, back, i, far):
                work -= 2 * n
                better = True
            if work <= 0:
                return
        for size in pieces:
            if 2 * size > n:
                break
            for i in range(1, n - size + 2):
                near, far = max(1, i - reach), min(n + 1, i + size + reach)
                work -= 5 * (far - near - size)
                if _move_piece(path, table, forth, back, i, size, near, far):
                    work -= 2 * n
                    better = True
                if work <= 0:
                    return


@kernel(error_model="python")
def _sums(path: Any, table: Any, forth: Any, back: Any) -> None:
    """Seconds from the beginning to each place, and the way back."""
    for k in range(1, len(path)):
        forth[k] = forth[k - 1] + table[path[k - 1], path[k]]
        back[k] = back[k - 1] + table[path[k], path[k - 1]]


@kernel(error_model="python")
def _reverse_piece(path: Any, table: Any, forth: Any, back: Any, i: int, far: int) -> bool:
    """What is from place `i` to the best one before `far`, if that is a gain."""
    before, first = path[i - 1], path[i]
    best, where = -TINY_S, -1
    for j in range(i + 1, far):
        last, after = path[j], path[j + 1]
        was = table[before, first] + table[last, after] + forth[j] - forth[i]
        would = table[before, last] + table[first, after] + back[j] - back[i]
        if would - was < best:
            best, where = would - was, j
    if where < 0:
        return False
    path[i : where + 1] = path[i : where + 1][::-1].copy()
    _sums(path, table, forth, back)
    return True


@kernel(error_model="python")
def _move_piece(path: Any, table: Any, forth: Any, back: Any, i: int, size: int, near: int, far: int) -> bool:
    """The piece of that size at place `i` before the best place from `near` to `far`, either way round, if that is a gain."""
    end = i + size
    before, first, last, after = path[i - 1], path[i], path[end - 1], path[end]
    gain = table[before, first] + table[last, after] - table[before, after]
    turned_s = back[end - 1] - back[i] - forth[end - 1] + forth[i]
    best, where, turned = -TINY_S, -1, False
    for place in range(near, far + 1):
        if i <= place <= end:
            continue
        left, right = path[place - 1], path[place]
        apart = table[left, right] + gain
        straight = table[left, first] + table[last, right] - apart
        other_way = table[left, last] + table[first, right] + turned_s - apart
        if straight < best:
            best, where, turned = straight, place, False
        if other_way < best:
            best, where, turned = other_way, place, True
    if where < 0:
        return False
    piece = path[i:end].copy()
    if turned:
        piece = piece[::-1].copy()
    if where < i:
        path[where + size : end] = path[where:i].copy()
        path[where : where + size] = piece
    else:
        path[i : where - size] = path[end:where].copy()
        path[where - size : where] = piece
    _sums(path, table, forth, back)
    return True


COLLISION_PENALTY_S = 1.0e6
BETA, SHIFT = 2, 3
MAX_PIECES = 60


class StepCosts:
    """Of one grid on a rig. `ends` (5,): a point that is come from, and gone to afterwards."""

    def __init__(self, grid: ScanGrid, moves: Moves, clearance: ArcClearance, ends: Floats | None) -> None:
        self._ranks = grid.ranks
        self._columns = grid.varying_columns
        self._seconds = {column: _seconds(grid.values[column], moves, column) for column in grid.varying_columns}
        self._more_s = (EXCHANGES_BEFORE_MOVE + EXCHANGES_AFTER_MOVE) * moves.exchange_s
        self._barred, self._high = _beam_crossings(grid, clearance)
        self._end_s = np.zeros((len(grid),))
        if ends is not None:
            towards = np.broadcast_to(ends, grid.points.shape)
            self._end_s = np.asarray(COLLISION_PENALTY_S * crosses_beam_between(clearance, grid.points, towards))

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
            taken += COLLISION_PENALTY_S * (
                self._barred[beta[here], beta[there]] & (self._high[shift[here]] | self._high[shift[there]])
            )
        return np.where(here < 0, self._end_s[there], np.where(there < 0, self._end_s[here], taken))

    def table(self) -> Floats:
        """All of them, and in the last row and column what it costs to begin and to end (n + 1, n + 1)."""
        numbers = np.append(np.arange(len(self._end_s)), -1)
        table = self.seconds(numbers[:, None], numbers[None, :])
        table[-1, -1] = 0.0
        return table

    def join_pieces(self, order: Ints) -> Ints:
        """The same points: cut where the arc would meet the beam, the pieces put back, the longest first, where they cost
        least. As it was where there are too many pieces.
        """
        cuts = np.flatnonzero(self.seconds(order[:-1], order[1:]) >= COLLISION_PENALTY_S) + 1
        if len(cuts) >= MAX_PIECES:
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


def _beam_crossings(grid: ScanGrid, clearance: ArcClearance) -> tuple[Ints, Ints]:
    """Between which betas the arc crosses the beam, and at which shifts it may not."""
    betas, shifts = grid.values[BETA].tolist(), grid.values[SHIFT].tolist()
    barred = np.zeros((len(betas), len(betas)), dtype=np.int64)
    if clearance.collision((betas[0], betas[-1]), (shifts[-1],)) is not None:
        for k, beta in enumerate(betas):
            barred[k, k:] = [clearance.collision((beta, other), (shifts[-1],)) is not None for other in betas[k:]]
        barred |= barred.T
    azimuth = clearance.beam_azimuth_deg
    return barred, np.array([clearance.collision((azimuth,), (shift,)) is not None for shift in shifts], dtype=np.int64)


MAX_POINTS = 1500
"""Of so many the order is rearranged; of more that of their poses, if these are no more."""
MAX_VALUES = 500
WORK_LIMIT = 60_000_000
"""Steps looked up: about a tenth of a second."""
CLOSE_TO_BOUND = 1.0005
"""So near to the bound an order is left as it is."""
SAME_LOOP_RATIO = 1.2
"""Gaps whose costs differ by less are one loop."""


def search_paths(
    grid: ScanGrid, moves: Moves, clearance: ArcClearance, nested: Ints, seconds: float, ends: Floats | None
) -> list[tuple[Ints, float]]:
    """Other orders than `nested`, which takes `seconds` of moving, with theirs; none where it is as good as any.

    `ends` (5,), where there is one, is a point from which the first must be reached and that must be reached from the last.
    """
    if seconds <= CLOSE_TO_BOUND * moving_lower_bound_s(grid, moves):
        return []
    orders = _sequences(grid, moves, clearance, nested, ends, clear=seconds < float("inf"))
    return [(order, moving_seconds(moves, clearance, grid.points[order], ends)) for order in orders]


def _sequences(
    grid: ScanGrid, moves: Moves, clearance: ArcClearance, nested: Ints, ends: Floats | None, *, clear: bool
) -> Iterator[Ints]:
    if max(len(values) for values in grid.values) > MAX_VALUES:
        return
    if len(grid) <= MAX_POINTS:
        steps = StepCosts(grid, moves, clearance, ends)
        table = steps.table()
        for begun in (nested, cluster_sequence(grid, moves)):
            yield shorten_path(begun if clear else steps.join_pieces(begun), table, WORK_LIMIT)
        return
    if not clear:
        yield StepCosts(grid, moves, clearance, ends).join_pieces(nested)
    waves = len(grid.wavelengths_nm)
    if waves > 1 and len(grid.poses) <= MAX_POINTS:
        met, first = np.unique(nested // waves, return_index=True)
        single = ScanGrid(grid.poses, grid.wavelengths_nm[:1])
        for poses in _sequences(single, moves, clearance, met[np.argsort(first)], ends, clear=clear):
            yield from _with_wavelengths(grid, poses)


def _with_wavelengths(grid: ScanGrid, poses: Ints) -> Iterator[Ints]:
    """The wavelengths inside of poses in their order, and outside, back and forth."""
    waves = np.argsort(grid.wavelengths_nm)
    numbers = poses[:, None] * len(waves) + waves
    yield np.where((np.arange(len(poses)) % 2 == 1)[:, None], numbers[:, ::-1], numbers).ravel()
    yield np.where((np.arange(len(waves)) % 2 == 1)[:, None], numbers.T[:, ::-1], numbers.T).ravel()


def cluster_sequence(grid: ScanGrid, moves: Moves) -> Ints:
    """The order in which the costliest gaps are crossed least often, whatever their column: a column may be several loops."""
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
