"""Scan order: the order of a grid's points that takes the least machine time, and the order of the passes.

All loop orders are estimated: how often each loop steps, and what a step costs. The best ones are then added up move by move:
the best with each loop innermost, and the best with the wavelength outermost. `check` lists these. The fastest is taken, or a
path search improves it. Where wavelengths share filters, there are also loop orders with a loop over the filters, and poses
between it and the loop over the wavelengths of one filter.
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
LARGE_GRID_POINTS, LARGE_GRID_REVERSALS = 20_000, 1
"""Of a grid with many points few ends of loops are candidates, unless the arc keeps clear of the beam in no other way."""


@dataclass(frozen=True)
class ScanOrder:
    """The order of a grid's points.

    `sequence` has their numbers, `seconds` is the moving time without the way to the first point. `loop_order` gives the
    sequence, or the path search started from it. `candidates` are all loop orders that were compared, with their seconds.
    """

    sequence: Ints
    seconds: float
    loop_order: LoopOrder
    candidates: dict[LoopOrder, float]
    alternatives: tuple[tuple[Ints, float], ...] = ()

    @property
    def choices(self) -> list["ScanOrder"]:
        """This one, and others that are slower by themselves and may be faster with what comes before and after."""
        return [
            self,
            *(replace(self, sequence=sequence, seconds=seconds, alternatives=()) for sequence, seconds in self.alternatives),
        ]

    @property
    def improved(self) -> bool:
        """Whether it is better than its loop_order."""
        return self.seconds < self.candidates[self.loop_order]


def fastest_scan_order(grid: ScanGrid, file: ScheduleFile, moves: Moves, clearance: ArcClearance) -> ScanOrder:
    """The order of least time; where the schedule says an `order`, the least within that nesting.

    The pose of the drift checks can be reached from its ends, if that can be.
    """
    ends = drift_point(file)
    order = None
    for most in (
        (LARGE_GRID_REVERSALS, len(grid.varying_columns)) if len(grid) > LARGE_GRID_POINTS else (len(grid.varying_columns),)
    ):
        order = _fastest(grid, file, moves, clearance, ends, most)
        if order.seconds < float("inf"):
            break
    assert order is not None
    return order


def _fastest(
    grid: ScanGrid, file: ScheduleFile, moves: Moves, clearance: ArcClearance, ends: Floats | None, most: int
) -> ScanOrder:
    """The same, of loop_orders of which at most so many loops begin at their other ends."""
    loop_orders = _estimated(grid, file.back_and_forth, moves)
    candidates: dict[LoopOrder, float] = {}
    best: tuple[LoopOrder, Ints] | None = None
    for loop_order in _contenders(loop_orders, _columns_said(grid, file)):
        turned, sequence, tried_s = _begun_well(grid, loop_order, moves, clearance, ends, most)
        candidates[turned] = tried_s
        allowed = file.order == "fastest" or loop_order.columns == _columns_said(grid, file)
        if allowed and (best is None or tried_s < candidates[best[0]]):
            best = turned, sequence
    assert best is not None
    loop_order, sequence = best
    found = [(sequence, candidates[loop_order])]
    if file.order == "fastest" and file.back_and_forth:
        found += search_paths(grid, moves, clearance, sequence, candidates[loop_order], ends)
    found = sorted(found, key=lambda each: each[1])[:MAX_CHOICES]
    return ScanOrder(*found[0], loop_order, candidates, tuple(each for each in found[1:] if each[1] < float("inf")))


def _begun_well(
    grid: ScanGrid, loop_order: LoopOrder, moves: Moves, clearance: ArcClearance, ends: Floats | None, most: int
) -> tuple[LoopOrder, Ints, float]:
    """A loop order with its sequence and seconds; loops start at their other ends where only this keeps the arc clear."""
    for size in range(min(most, len(loop_order.columns)) + 1):
        for begun in combinations(loop_order.columns, size):
            turned = replace(loop_order, reversed_columns=frozenset(begun))
            sequence = loop_sequence(grid, turned, moves)
            seconds = moving_seconds(moves, clearance, grid.points[sequence], ends)
            if seconds < float("inf"):
                return turned, sequence, seconds
    return turned, sequence, seconds


def _columns_said(grid: ScanGrid, file: ScheduleFile) -> tuple[int, ...] | None:
    """The columns of the schedule's own order, the outermost first; None where it leaves that to us."""
    if file.order == "fastest":
        return None
    return tuple(
        column for column in (LOOP_NAMES.index(name) for name in reversed(file.order)) if column in grid.varying_columns
    )


def _contenders(loop_orders: dict[LoopOrder, float], said: tuple[int, ...] | None) -> list[LoopOrder]:
    """Those whose moves are worth adding up: the best by innermost loop, with and without one over the filters, and with the
    wavelength outermost.
    """
    ranked = sorted(loop_orders, key=lambda loop_order: loop_orders[loop_order])
    chosen: dict[object, LoopOrder] = {}
    for loop_order in ranked:
        columns = loop_order.columns
        chosen.setdefault(("inside", columns[-1:], FILTER in columns), loop_order)
        if columns[:1] == (WAVELENGTH,):
            chosen.setdefault("wavelength outside", loop_order)
        if columns == said:
            chosen.setdefault(("said", loop_order.back_and_forth), loop_order)
    return list(dict.fromkeys(chosen.values()))


def _estimated(grid: ScanGrid, back_and_forth: bool, moves: Moves) -> dict[LoopOrder, float]:
    """All loop_orders of the columns that change, with about how long their moves take."""
    by_filters = {grouped: _step_seconds(grid, moves, grouped) for grouped in {False, grid.has_filter_groups}}
    distinct = _distinct_prefixes(grid)
    found = {}
    for loop_order in _nests(grid, back_and_forth, moves):
        there, back, whole = by_filters[FILTER in loop_order.columns]
        seconds, returning = 0.0, 0.0
        for depth in reversed(range(len(loop_order.columns))):
            column, both = loop_order.columns[depth], loop_order.back_and_forth[depth]
            steps = distinct[frozenset(loop_order.columns[: depth + 1])] - distinct[frozenset(loop_order.columns[:depth])]
            step = 0.5 * (there[column] + back[column]) if both else there[column]
            seconds += steps * max(step, returning)
            returning = returning if both else max(returning, whole[column])
        found[loop_order] = seconds
    return found


def _nests(grid: ScanGrid, back_and_forth: bool, moves: Moves) -> Iterator[LoopOrder]:
    """Where backlash does not matter going back and forth is never slower; where it does, either may be."""
    for columns in permutations(grid.varying_columns):
        for nested in (columns, *(_around_the_wavelength(columns) if grid.has_filter_groups else ())):
            ways = [(True, False) if moves.backlash(column) else (True,) for column in nested]
            for both in product(*(way if back_and_forth else (False,) for way in ways)):
                yield LoopOrder(nested, both)


def _around_the_wavelength(columns: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    """With a loop over the filters, and at least another between it and that over the wavelengths."""
    for place in range(columns.index(WAVELENGTH)):
        yield (*columns[:place], FILTER, *columns[place:])


def _step_seconds(grid: ScanGrid, moves: Moves, grouped: bool) -> tuple[dict[int, float], dict[int, float], dict[int, float]]:
    """By column: a step in the direction of going, one back, and the whole way back; on average, in seconds.

    Where wavelengths are `grouped` by their filters, steps between two filters are those of the loop over the filters.
    """
    there, back, whole = {}, {}, {}
    changes = np.diff(moves.filter_numbers(grid.values[WAVELENGTH])) != 0
    for column in (*grid.varying_columns, *((FILTER,) if grouped else ())):
        own = min(column, WAVELENGTH)
        values = grid.values[own] if moves.backlash(column) >= 0 else grid.values[own][::-1]
        steps = np.full(len(values) - 1, True) if not grouped or own != WAVELENGTH else changes == (column == FILTER)
        seconds = moves.one_step(own)
        there[column] = float(seconds(values[:-1][steps], values[1:][steps]).mean())
        back[column] = float(seconds(values[1:][steps], values[:-1][steps]).mean())
        whole[column] = float(seconds(values[-1:], values[:1])[0])
    return there, back, whole


def _distinct_prefixes(grid: ScanGrid) -> dict[frozenset[int], int]:
    """How many points differ in some of the columns, for every set of columns."""
    columns = (*grid.varying_columns, FILTER) if grid.has_filter_groups else grid.varying_columns
    labels = {column: np.arange(len(grid.values[column])) for column in columns}
    sets = (some for size in range(len(labels) + 1) for some in combinations(labels, size))
    return {frozenset(some): grid.count_distinct({column: labels[column] for column in some}) for some in sets}


@dataclass(frozen=True)
class _Traversal:
    """An order gone through one way: where it begins and ends, and its seconds of moving."""

    sequence: Ints
    first: Floats
    last: Floats
    seconds: float


class PassOrder:
    """Of all passes of a plan, on a rig."""

    def __init__(self, mounted: list[list[Pass]], file: ScheduleFile, moves: Moves, clearance: ArcClearance) -> None:
        self._passes = [each for passes in mounted for each in passes]
        self._opening = [k == 0 for passes in mounted for k in range(len(passes))]
        self._closing = [*self._opening[1:], True]
        self._drift = drift_point(file)
        self._file = file
        self._moves = moves
        self._clearance = clearance
        self._between: dict[bytes, float] = {}

    def fastest(self, orders: dict[ScanGrid, ScanOrder], here: Floats) -> tuple[dict[ScanGrid, ScanOrder], list[Ints]]:
        """The orders taken, and the sequence of each pass, that take the least time from `here` on, all passes together."""
        grids = list(orders)
        ways = {grid: [self._ways(grid, taken) for taken in orders[grid].choices] for grid in grids}
        best: tuple[float, tuple[int, ...], list[Ints]] | None = None
        for chosen in product(*(range(len(ways[grid])) for grid in grids)):
            taken = {grid: ways[grid][k] for grid, k in zip(grids, chosen, strict=True)}
            seconds, sequences = self._turned(taken, here)
            if best is None or seconds < best[0]:
                best = seconds, chosen, sequences
        assert best is not None
        picked = {grid: orders[grid].choices[k] for grid, k in zip(grids, best[1], strict=True)}
        return picked, best[2]

    def _ways(self, grid: ScanGrid, order: ScanOrder) -> list[_Traversal]:
        turns = [order.sequence, order.sequence[::-1]] if self._file.back_and_forth else [order.sequence]
        found = []
        for sequence in turns:
            points = grid.points[sequence]
            found.append(_Traversal(sequence, points[0], points[-1], moving_seconds(self._moves, self._clearance, points)))
        return found

    def _turned(self, ways: dict[ScanGrid, list[_Traversal]], here: Floats) -> tuple[float, list[Ints]]:
        """The fastest way round in each pass, found pass by pass: what came before matters only by where it ended."""
        ends: list[tuple[float, Floats]] = [(0.0, here)]
        came_from: list[list[int]] = []
        for each, opening, closing in zip(self._passes, self._opening, self._closing, strict=True):
            check = None if each.sample == NO_SAMPLE else self._drift
            reached = []
            steps = []
            for way in ways[each.grid]:
                begun = [(seconds + self._moving(last, check if opening else None, way.first)) for seconds, last in ends]
                k = int(np.argmin(begun))
                steps.append(k)
                left = way.last if check is None or not closing else check
                reached.append((begun[k] + way.seconds + self._moving(way.last, None, left), left))
            ends = reached
            came_from.append(steps)
        k = int(np.argmin([seconds for seconds, _ in ends]))
        total = ends[k][0]
        sequences = []
        for each, steps in zip(reversed(self._passes), reversed(came_from), strict=True):
            sequences.append(ways[each.grid][k].sequence)
            k = steps[k]
        return total, sequences[::-1]

    def _moving(self, here: Floats, by: Floats | None, there: Floats) -> float:
        """From a point to another, `by` that of the drift checks or directly; infinite where the arc would meet the beam."""
        if by is not None:
            return self._moving(here, None, by) + self._moving(by, None, there)
        key = here.tobytes() + there.tobytes()
        if key not in self._between:
            known = np.where(np.isnan(here), there, here)
            barred = crosses_beam(self._clearance, np.stack([known, there])).any()
            self._between[key] = float("inf") if barred else float(self._moves.seconds(here[None], there[None])[0])
        return self._between[key]
