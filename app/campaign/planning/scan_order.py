"""Scan order: the order of a grid's points that takes the least machine time, and the order of the passes.

All loop orders are estimated: how often each loop steps, and what a step costs. The moves of the best ones are then added up
one by one: the best with each loop innermost, and the best with the wavelength outermost. `check` lists these. The fastest is
taken; where a path search improves it, its result is taken. Where wavelengths share filters, there are also loop orders with a
loop over the filters, and poses between it and the loop over the wavelengths of one filter.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product

import numpy as np

from goniotwin.app.campaign.geometry.collision import crosses_beam
from goniotwin.app.campaign.planning.durations import Moves
from goniotwin.app.campaign.planning.loop_order import LoopOrder, loop_sequence, moving_seconds
from goniotwin.app.campaign.planning.mountings import Pass, drift_point
from goniotwin.app.campaign.planning.path_search import search_paths
from goniotwin.app.campaign.planning.scan_grid import FILTER, WAVELENGTH, ScanGrid
from goniotwin.app.campaign.row import NO_SAMPLE
from goniotwin.app.campaign.schedule.file import LOOP_NAMES, ScheduleFile
from goniotwin.arrays import Floats, Ints
from goniotwin.drivers import ArcClearance

MAX_CHOICES = 3
"""Number of scan orders of a grid from which the order of the passes chooses."""
LARGE_GRID_POINTS, LARGE_GRID_REVERSALS = 20_000, 1
"""On a grid with more points at most so many loops are reversed, unless every such order collides with the beam."""


@dataclass(frozen=True)
class ScanOrder:
    """The order of a grid's points.

    `sequence` has their numbers; `seconds` is the moving time without the move to the first point. `loop_order` gives the
    sequence, or the path search started from it. `candidates` are all loop orders that were compared, with their seconds.
    """

    sequence: Ints
    seconds: float
    loop_order: LoopOrder
    candidates: dict[LoopOrder, float]
    alternatives: tuple[tuple[Ints, float], ...] = ()

    @property
    def choices(self) -> list["ScanOrder"]:
        """This order, and slower ones that may be faster together with the moves before and after the pass."""
        others = [replace(self, sequence=sequence, seconds=seconds, alternatives=()) for sequence, seconds in self.alternatives]
        return [self, *others]

    @property
    def improved(self) -> bool:
        """Whether the path search has improved the loop order."""
        return self.seconds < self.candidates[self.loop_order]


def fastest_scan_order(grid: ScanGrid, file: ScheduleFile, moves: Moves, clearance: ArcClearance) -> ScanOrder:
    """The order of least time; with an `order` in the schedule, the fastest sequence of that loop order.

    The pose of the drift checks can be reached from both ends of the sequence, if any order allows it.
    """
    ends = drift_point(file)
    all_loops = len(grid.varying_columns)
    order = None
    for reversals in (LARGE_GRID_REVERSALS, all_loops) if len(grid) > LARGE_GRID_POINTS else (all_loops,):
        order = _fastest(grid, file, moves, clearance, ends, reversals)
        if order.seconds < float("inf"):
            break
    assert order is not None
    return order


def _fastest(
    grid: ScanGrid, file: ScheduleFile, moves: Moves, clearance: ArcClearance, ends: Floats | None, reversals: int
) -> ScanOrder:
    """The order of least time, with at most this number of reversed loops."""
    prescribed = _prescribed_columns(grid, file)
    candidates: dict[LoopOrder, float] = {}
    best: tuple[LoopOrder, Ints] | None = None
    for estimated in _candidates(_estimate_seconds(grid, file.back_and_forth, moves), prescribed):
        loop_order, sequence, seconds = _clear_of_beam(grid, estimated, moves, clearance, ends, reversals)
        candidates[loop_order] = seconds
        allowed = file.order == "fastest" or loop_order.columns == prescribed
        if allowed and (best is None or seconds < candidates[best[0]]):
            best = loop_order, sequence
    assert best is not None
    loop_order, sequence = best
    choices = [(sequence, candidates[loop_order])]
    if file.order == "fastest" and file.back_and_forth:
        choices += search_paths(grid, moves, clearance, sequence, candidates[loop_order], ends)
    choices = sorted(choices, key=lambda choice: choice[1])[:MAX_CHOICES]
    alternatives = tuple(choice for choice in choices[1:] if choice[1] < float("inf"))
    return ScanOrder(*choices[0], loop_order, candidates, alternatives)


def _clear_of_beam(
    grid: ScanGrid, loop_order: LoopOrder, moves: Moves, clearance: ArcClearance, ends: Floats | None, reversals: int
) -> tuple[LoopOrder, Ints, float]:
    """A loop order with its sequence and seconds; loops are reversed only where this keeps the arc clear of the beam."""
    for size in range(min(reversals, len(loop_order.columns)) + 1):
        for columns in combinations(loop_order.columns, size):
            changed = replace(loop_order, reversed_columns=frozenset(columns))
            sequence = loop_sequence(grid, changed, moves)
            seconds = moving_seconds(moves, clearance, grid.points[sequence], ends)
            if seconds < float("inf"):
                return changed, sequence, seconds
    return changed, sequence, seconds


def _prescribed_columns(grid: ScanGrid, file: ScheduleFile) -> tuple[int, ...] | None:
    """The columns of the schedule's own order, the outermost first; None with "fastest"."""
    if file.order == "fastest":
        return None
    columns = (LOOP_NAMES.index(name) for name in reversed(file.order))
    return tuple(column for column in columns if column in grid.varying_columns)


def _candidates(estimates: dict[LoopOrder, float], prescribed: tuple[int, ...] | None) -> list[LoopOrder]:
    """The loop orders whose moves are added up.

    The best with each loop innermost, with and without a loop over the filters; the best with the wavelength outermost; and
    those with the `prescribed` columns.
    """
    chosen: dict[object, LoopOrder] = {}
    for loop_order in sorted(estimates, key=lambda each: estimates[each]):
        columns = loop_order.columns
        chosen.setdefault(("inside", columns[-1:], FILTER in columns), loop_order)
        if columns[:1] == (WAVELENGTH,):
            chosen.setdefault("wavelength outside", loop_order)
        if columns == prescribed:
            chosen.setdefault(("prescribed", loop_order.back_and_forth), loop_order)
    return list(dict.fromkeys(chosen.values()))


def _estimate_seconds(grid: ScanGrid, back_and_forth: bool, moves: Moves) -> dict[LoopOrder, float]:
    """All loop orders of the columns that vary, with an estimate of their moving time."""
    by_filters = {grouped: _step_seconds(grid, moves, grouped) for grouped in {False, grid.has_filter_groups}}
    distinct = _distinct_prefixes(grid)
    estimates = {}
    for loop_order in _loop_orders(grid, back_and_forth, moves):
        columns = loop_order.columns
        forward, backward, whole = by_filters[FILTER in columns]
        seconds, returning = 0.0, 0.0
        for depth in reversed(range(len(columns))):
            column, both = columns[depth], loop_order.back_and_forth[depth]
            steps = distinct[frozenset(columns[: depth + 1])] - distinct[frozenset(columns[:depth])]
            step = 0.5 * (forward[column] + backward[column]) if both else forward[column]
            seconds += steps * max(step, returning)
            returning = returning if both else max(returning, whole[column])
        estimates[loop_order] = seconds
    return estimates


def _loop_orders(grid: ScanGrid, back_and_forth: bool, moves: Moves) -> Iterator[LoopOrder]:
    """All loop orders. Without backlash, back and forth is never slower; with backlash either may be faster."""
    for outer in permutations(grid.varying_columns):
        for columns in (outer, *(_with_filter_loop(outer) if grid.has_filter_groups else ())):
            directions = [(True, False) if moves.approach(column) else (True,) for column in columns]
            for both in product(*(each if back_and_forth else (False,) for each in directions)):
                yield LoopOrder(columns, both)


def _with_filter_loop(columns: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    """The columns with a loop over the filters, and at least one loop between it and the loop over the wavelengths."""
    for place in range(columns.index(WAVELENGTH)):
        yield (*columns[:place], FILTER, *columns[place:])


def _step_seconds(grid: ScanGrid, moves: Moves, grouped: bool) -> tuple[dict[int, float], dict[int, float], dict[int, float]]:
    """By column, in seconds: the mean step forward, the mean step backward, and the whole way back.

    If wavelengths are `grouped` by their filters, steps between two filters belong to the loop over the filters.
    """
    forward, backward, whole = {}, {}, {}
    changes = np.diff(moves.wheel.numbers(grid.values[WAVELENGTH])) != 0
    for column in (*grid.varying_columns, *((FILTER,) if grouped else ())):
        own = min(column, WAVELENGTH)
        values = grid.values[own] if moves.approach(column) >= 0 else grid.values[own][::-1]
        steps = np.full(len(values) - 1, True) if not grouped or own != WAVELENGTH else changes == (column == FILTER)
        seconds = moves.one_step(own)
        forward[column] = float(seconds(values[:-1][steps], values[1:][steps]).mean())
        backward[column] = float(seconds(values[1:][steps], values[:-1][steps]).mean())
        whole[column] = float(seconds(values[-1:], values[:1])[0])
    return forward, backward, whole


def _distinct_prefixes(grid: ScanGrid) -> dict[frozenset[int], int]:
    """Number of points that differ in a set of columns, for every set of columns."""
    columns = (*grid.varying_columns, FILTER) if grid.has_filter_groups else grid.varying_columns
    labels = {column: np.arange(len(grid.values[column])) for column in columns}
    sets = (some for size in range(len(labels) + 1) for some in combinations(labels, size))
    return {frozenset(some): grid.count_distinct({column: labels[column] for column in some}) for some in sets}


@dataclass(frozen=True)
class _Traversal:
    """A scan order in one direction: its first and last point, and its moving time."""

    sequence: Ints
    first: Floats
    last: Floats
    seconds: float


class PassOrder:
    """The passes of a plan one after the other on a rig: for each grid one of its scan orders, for each pass a direction."""

    def __init__(self, mounted: list[list[Pass]], file: ScheduleFile, moves: Moves, clearance: ArcClearance) -> None:
        self._passes = [each for passes in mounted for each in passes]
        self._opening = [k == 0 for passes in mounted for k in range(len(passes))]
        self._closing = [*self._opening[1:], True]
        self._drift = drift_point(file)
        self._file = file
        self._moves = moves
        self._clearance = clearance
        self._between: dict[bytes, float] = {}

    def fastest(self, orders: dict[ScanGrid, ScanOrder], start: Floats) -> tuple[dict[ScanGrid, ScanOrder], list[Ints]]:
        """Scan order of each grid and sequence of each pass with the least time for all passes, from the point `start` (5,)."""
        grids = list(orders)
        traversals = {grid: [self._traversals(grid, choice) for choice in orders[grid].choices] for grid in grids}
        best: tuple[float, tuple[int, ...], list[Ints]] | None = None
        for chosen in product(*(range(len(traversals[grid])) for grid in grids)):
            selected = {grid: traversals[grid][k] for grid, k in zip(grids, chosen, strict=True)}
            seconds, sequences = self._directions(selected, start)
            if best is None or seconds < best[0]:
                best = seconds, chosen, sequences
        assert best is not None
        return {grid: orders[grid].choices[k] for grid, k in zip(grids, best[1], strict=True)}, best[2]

    def _traversals(self, grid: ScanGrid, order: ScanOrder) -> list[_Traversal]:
        sequences = [order.sequence, order.sequence[::-1]] if self._file.back_and_forth else [order.sequence]
        traversals = []
        for sequence in sequences:
            points = grid.points[sequence]
            traversals.append(_Traversal(sequence, points[0], points[-1], moving_seconds(self._moves, self._clearance, points)))
        return traversals

    def _directions(self, traversals: dict[ScanGrid, list[_Traversal]], start: Floats) -> tuple[float, list[Ints]]:
        """The seconds of all passes, and the sequence of each pass in its fastest direction.

        Dynamic programming: of the passes before, only the point at which they end matters.
        """
        ends: list[tuple[float, Floats]] = [(0.0, start)]
        predecessors: list[list[int]] = []
        for each, opening, closing in zip(self._passes, self._opening, self._closing, strict=True):
            check = None if each.sample == NO_SAMPLE else self._drift
            reached = []
            steps = []
            for traversal in traversals[each.grid]:
                arrivals = [seconds + self._moving(last, check if opening else None, traversal.first) for seconds, last in ends]
                k = int(np.argmin(arrivals))
                steps.append(k)
                end = traversal.last if check is None or not closing else check
                reached.append((arrivals[k] + traversal.seconds + self._moving(traversal.last, None, end), end))
            ends = reached
            predecessors.append(steps)
        k = int(np.argmin([seconds for seconds, _ in ends]))
        total = ends[k][0]
        sequences = []
        for each, steps in zip(reversed(self._passes), reversed(predecessors), strict=True):
            sequences.append(traversals[each.grid][k].sequence)
            k = steps[k]
        return total, sequences[::-1]

    def _moving(self, start: Floats, via: Floats | None, stop: Floats) -> float:
        """Seconds from a point to another, directly or `via` that of the drift checks; infinite with a collision."""
        if via is not None:
            return self._moving(start, None, via) + self._moving(via, None, stop)
        key = start.tobytes() + stop.tobytes()
        if key not in self._between:
            known = np.where(np.isnan(start), stop, start)
            collides = crosses_beam(self._clearance, np.stack([known, stop])).any()
            self._between[key] = float("inf") if collides else float(self._moves.seconds(start[None], stop[None])[0])
        return self._between[key]
