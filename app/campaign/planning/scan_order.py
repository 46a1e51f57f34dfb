"""In which order to measure: which loop goes inside which, so that the rig takes the least time.

All nestings are estimated from how often each of their loops steps and what a step costs. Of the best with each loop
innermost, and of the best with the wavelength outermost, every single move is then added up: these are what the words
compare, and the fastest of them is taken, rearranged where that makes it shorter still. Where wavelengths share filters, there
are nests that do one filter after the other, too, with poses between the loop over the filters and that over the wavelengths of
each.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product

import numpy as np

from goniotwin.app.campaign.geometry.collision import swept
from goniotwin.app.campaign.planning.durations import Moves
from goniotwin.app.campaign.planning.loop_order import Nest, moving_seconds, visited
from goniotwin.app.campaign.planning.mountings import Pass, drift_point
from goniotwin.app.campaign.planning.path_search import rearranged
from goniotwin.app.campaign.planning.scan_grid import FILTER, WAVELENGTH, Lattice
from goniotwin.app.campaign.row import NO_SAMPLE
from goniotwin.app.campaign.schedule.file import NESTED, ScheduleFile
from goniotwin.arrays import Floats, Ints
from goniotwin.drivers import ArcClearance

MOST_CHOICES = 3
MANY, FEW_ENDS = 20_000, 1
"""Of a lattice with many points few ends of loops are tried, unless the arc keeps clear of the beam in no other way."""


@dataclass(frozen=True)
class Order:
    """The order of a lattice's points: their numbers, its seconds of moving (without what comes before the first point), the
    nest that gives it or that it was rearranged from, and the seconds of all nests that were tried, this one's among them.
    """

    sequence: Ints
    seconds: float
    nest: Nest
    tried: dict[Nest, float]
    others: tuple[tuple[Ints, float], ...] = ()

    @property
    def choices(self) -> list["Order"]:
        """This one, and others that are slower by themselves and may be faster with what comes before and after."""
        return [self, *(replace(self, sequence=sequence, seconds=seconds, others=()) for sequence, seconds in self.others)]

    @property
    def rearranged(self) -> bool:
        """Whether it is better than its nest."""
        return self.seconds < self.tried[self.nest]


def fastest_order(lattice: Lattice, file: ScheduleFile, moves: Moves, clearance: ArcClearance) -> Order:
    """The order of least time; where the schedule says an `order`, the least within that nesting.

    The pose of the drift checks can be reached from its ends, if that can be.
    """
    ends = drift_point(file)
    order = None
    for most in (FEW_ENDS, len(lattice.active)) if len(lattice) > MANY else (len(lattice.active),):
        order = _fastest(lattice, file, moves, clearance, ends, most)
        if order.seconds < float("inf"):
            break
    assert order is not None
    return order


def _fastest(
    lattice: Lattice, file: ScheduleFile, moves: Moves, clearance: ArcClearance, ends: Floats | None, most: int
) -> Order:
    """The same, of nests of which at most so many loops begin at their other ends."""
    nests = _estimated(lattice, file.back_and_forth, moves)
    tried: dict[Nest, float] = {}
    best: tuple[Nest, Ints] | None = None
    for nest in _contenders(nests, _columns_said(lattice, file)):
        turned, sequence, tried_s = _begun_well(lattice, nest, moves, clearance, ends, most)
        tried[turned] = tried_s
        allowed = file.order == "fastest" or nest.columns == _columns_said(lattice, file)
        if allowed and (best is None or tried_s < tried[best[0]]):
            best = turned, sequence
    assert best is not None
    nest, sequence = best
    found = [(sequence, tried[nest])]
    if file.order == "fastest" and file.back_and_forth:
        found += rearranged(lattice, moves, clearance, sequence, tried[nest], ends)
    found = sorted(found, key=lambda each: each[1])[:MOST_CHOICES]
    return Order(*found[0], nest, tried, tuple(each for each in found[1:] if each[1] < float("inf")))


def _begun_well(
    lattice: Lattice, nest: Nest, moves: Moves, clearance: ArcClearance, ends: Floats | None, most: int
) -> tuple[Nest, Ints, float]:
    """A nest with its order and seconds, begun at other ends of its loops where only then the arc keeps clear of the beam."""
    for size in range(min(most, len(nest.columns)) + 1):
        for begun in combinations(nest.columns, size):
            turned = replace(nest, from_the_end=frozenset(begun))
            sequence = visited(lattice, turned, moves)
            seconds = moving_seconds(moves, clearance, lattice.points[sequence], ends)
            if seconds < float("inf"):
                return turned, sequence, seconds
    return turned, sequence, seconds


def _columns_said(lattice: Lattice, file: ScheduleFile) -> tuple[int, ...] | None:
    """The columns of the schedule's own order, the outermost first; None where it leaves that to us."""
    if file.order == "fastest":
        return None
    return tuple(column for column in (NESTED.index(name) for name in reversed(file.order)) if column in lattice.active)


def _contenders(nests: dict[Nest, float], said: tuple[int, ...] | None) -> list[Nest]:
    """Those whose moves are worth adding up: the best by innermost loop, with and without one over the filters, and with the
    wavelength outermost.
    """
    ranked = sorted(nests, key=lambda nest: nests[nest])
    chosen: dict[object, Nest] = {}
    for nest in ranked:
        columns = nest.columns
        chosen.setdefault(("inside", columns[-1:], FILTER in columns), nest)
        if columns[:1] == (WAVELENGTH,):
            chosen.setdefault("wavelength outside", nest)
        if columns == said:
            chosen.setdefault(("said", nest.back_and_forth), nest)
    return list(dict.fromkeys(chosen.values()))


def _estimated(lattice: Lattice, back_and_forth: bool, moves: Moves) -> dict[Nest, float]:
    """All nests of the columns that change, with about how long their moves take."""
    by_filters = {grouped: _step_seconds(lattice, moves, grouped) for grouped in {False, lattice.grouped}}
    distinct = _distinct_prefixes(lattice)
    found = {}
    for nest in _nests(lattice, back_and_forth, moves):
        there, back, whole = by_filters[FILTER in nest.columns]
        seconds, returning = 0.0, 0.0
        for depth in reversed(range(len(nest.columns))):
            column, both = nest.columns[depth], nest.back_and_forth[depth]
            steps = distinct[frozenset(nest.columns[: depth + 1])] - distinct[frozenset(nest.columns[:depth])]
            step = 0.5 * (there[column] + back[column]) if both else there[column]
            seconds += steps * max(step, returning)
            returning = returning if both else max(returning, whole[column])
        found[nest] = seconds
    return found


def _nests(lattice: Lattice, back_and_forth: bool, moves: Moves) -> Iterator[Nest]:
    """Where backlash does not matter going back and forth is never slower; where it does, either may be."""
    for columns in permutations(lattice.active):
        for nested in (columns, *(_around_the_wavelength(columns) if lattice.grouped else ())):
            ways = [(True, False) if moves.backlash(column) else (True,) for column in nested]
            for both in product(*(way if back_and_forth else (False,) for way in ways)):
                yield Nest(nested, both)


def _around_the_wavelength(columns: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    """With a loop over the filters, and at least another between it and that over the wavelengths."""
    for place in range(columns.index(WAVELENGTH)):
        yield (*columns[:place], FILTER, *columns[place:])


def _step_seconds(lattice: Lattice, moves: Moves, grouped: bool) -> tuple[dict[int, float], dict[int, float], dict[int, float]]:
    """By column: a step in the direction of going, one back, and the whole way back; on average, in seconds.

    Where wavelengths are `grouped` by their filters, steps between two filters are those of the loop over the filters.
    """
    there, back, whole = {}, {}, {}
    changes = np.diff(moves.filter_numbers(lattice.values[WAVELENGTH])) != 0
    for column in (*lattice.active, *((FILTER,) if grouped else ())):
        own = min(column, WAVELENGTH)
        values = lattice.values[own] if moves.backlash(column) >= 0 else lattice.values[own][::-1]
        steps = np.full(len(values) - 1, True) if not grouped or own != WAVELENGTH else changes == (column == FILTER)
        seconds = moves.one_step(own)
        there[column] = float(seconds(values[:-1][steps], values[1:][steps]).mean())
        back[column] = float(seconds(values[1:][steps], values[:-1][steps]).mean())
        whole[column] = float(seconds(values[-1:], values[:1])[0])
    return there, back, whole


def _distinct_prefixes(lattice: Lattice) -> dict[frozenset[int], int]:
    """How many points differ in some of the columns, for every set of columns."""
    columns = (*lattice.active, FILTER) if lattice.grouped else lattice.active
    labels = {column: np.arange(len(lattice.values[column])) for column in columns}
    sets = (some for size in range(len(labels) + 1) for some in combinations(labels, size))
    return {frozenset(some): lattice.distinct({column: labels[column] for column in some}) for some in sets}


@dataclass(frozen=True)
class _Way:
    """An order gone through one way: where it begins and ends, and its seconds of moving."""

    sequence: Ints
    first: Floats
    last: Floats
    seconds: float


class Chain:
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

    def fastest(self, orders: dict[Lattice, Order], here: Floats) -> tuple[dict[Lattice, Order], list[Ints]]:
        """The orders taken, and the sequence of each pass, that take the least time from `here` on, all passes together."""
        lattices = list(orders)
        ways = {lattice: [self._ways(lattice, taken) for taken in orders[lattice].choices] for lattice in lattices}
        best: tuple[float, tuple[int, ...], list[Ints]] | None = None
        for chosen in product(*(range(len(ways[lattice])) for lattice in lattices)):
            taken = {lattice: ways[lattice][k] for lattice, k in zip(lattices, chosen, strict=True)}
            seconds, sequences = self._turned(taken, here)
            if best is None or seconds < best[0]:
                best = seconds, chosen, sequences
        assert best is not None
        picked = {lattice: orders[lattice].choices[k] for lattice, k in zip(lattices, best[1], strict=True)}
        return picked, best[2]

    def _ways(self, lattice: Lattice, order: Order) -> list[_Way]:
        turns = [order.sequence, order.sequence[::-1]] if self._file.back_and_forth else [order.sequence]
        found = []
        for sequence in turns:
            points = lattice.points[sequence]
            found.append(_Way(sequence, points[0], points[-1], moving_seconds(self._moves, self._clearance, points)))
        return found

    def _turned(self, ways: dict[Lattice, list[_Way]], here: Floats) -> tuple[float, list[Ints]]:
        """The fastest way round in each pass, found pass by pass: what came before matters only by where it ended."""
        ends: list[tuple[float, Floats]] = [(0.0, here)]
        came_from: list[list[int]] = []
        for each, opening, closing in zip(self._passes, self._opening, self._closing, strict=True):
            check = None if each.sample == NO_SAMPLE else self._drift
            reached = []
            steps = []
            for way in ways[each.lattice]:
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
            sequences.append(ways[each.lattice][k].sequence)
            k = steps[k]
        return total, sequences[::-1]

    def _moving(self, here: Floats, by: Floats | None, there: Floats) -> float:
        """From a point to another, `by` that of the drift checks or directly; infinite where the arc would meet the beam."""
        if by is not None:
            return self._moving(here, None, by) + self._moving(by, None, there)
        key = here.tobytes() + there.tobytes()
        if key not in self._between:
            known = np.where(np.isnan(here), there, here)
            barred = swept(self._clearance, np.stack([known, there])).any()
            self._between[key] = float("inf") if barred else float(self._moves.seconds(here[None], there[None])[0])
        return self._between[key]
