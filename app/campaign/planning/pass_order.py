"""Passes one after the other: which of its orders each lattice is measured in, and which way round in each pass."""

from dataclasses import dataclass
from itertools import product

import numpy as np

from goniotwin.app.campaign.planning.durations import Moves
from goniotwin.app.campaign.planning.loop_order import moving_seconds, swept
from goniotwin.app.campaign.planning.mountings import Pass, drift_point
from goniotwin.app.campaign.planning.scan_grid import Lattice
from goniotwin.app.campaign.planning.scan_order import Order
from goniotwin.app.campaign.row import NO_SAMPLE
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.arrays import Floats, Ints
from goniotwin.drivers import ArcClearance


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
