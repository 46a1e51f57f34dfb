"""An order that no nest of loops gives: where steps are uneven, or poses lie beside the grids, or the arc meets the beam.

Two orders are begun with, the best nest's and that of the islands, and shortened piece by piece. Of a great lattice the poses
alone are looked at, with the wavelengths inside or outside. All of it within a fixed amount of work, so that the same
schedule has the same order on every machine.
"""

from collections.abc import Iterator

import numpy as np

from goniotwin.app.campaign.planning.bound import least_moving_seconds
from goniotwin.app.campaign.planning.lattice import Lattice
from goniotwin.app.campaign.planning.moves import Moves
from goniotwin.app.campaign.planning.nesting import Loop, looped, moving_seconds
from goniotwin.app.campaign.planning.shortening import shortened
from goniotwin.app.campaign.planning.steps import Steps
from goniotwin.arrays import Floats, Ints
from goniotwin.drivers import ArcClearance

MOST_POINTS = 1500
"""Of so many the order is rearranged; of more that of their poses, if these are no more."""
MOST_VALUES = 500
WORK = 60_000_000
"""Steps looked up: about a tenth of a second."""
CLOSE = 1.0005
"""So near to the bound an order is left as it is."""
ALIKE = 1.2
"""Gaps whose costs differ by less are one loop."""


def rearranged(
    lattice: Lattice, moves: Moves, clearance: ArcClearance, nested: Ints, seconds: float, ends: Floats | None
) -> list[tuple[Ints, float]]:
    """Other orders than `nested`, which takes `seconds` of moving, with theirs; none where it is as good as any.

    `ends` (5,), where there is one, is a point from which the first must be reached and that must be reached from the last.
    """
    if seconds <= CLOSE * least_moving_seconds(lattice, moves):
        return []
    orders = _orders(lattice, moves, clearance, nested, ends, clear=seconds < float("inf"))
    return [(order, moving_seconds(moves, clearance, lattice.points[order], ends)) for order in orders]


def _orders(
    lattice: Lattice, moves: Moves, clearance: ArcClearance, nested: Ints, ends: Floats | None, *, clear: bool
) -> Iterator[Ints]:
    if max(len(values) for values in lattice.values) > MOST_VALUES:
        return
    if len(lattice) <= MOST_POINTS:
        steps = Steps(lattice, moves, clearance, ends)
        table = steps.table()
        for begun in (nested, islands(lattice, moves)):
            yield shortened(begun if clear else steps.joined(begun), table, WORK)
        return
    if not clear:
        yield Steps(lattice, moves, clearance, ends).joined(nested)
    waves = len(lattice.wavelengths_nm)
    if waves > 1 and len(lattice.poses) <= MOST_POINTS:
        met, first = np.unique(nested // waves, return_index=True)
        single = Lattice(lattice.poses, lattice.wavelengths_nm[:1])
        for poses in _orders(single, moves, clearance, met[np.argsort(first)], ends, clear=clear):
            yield from _with_wavelengths(lattice, poses)


def _with_wavelengths(lattice: Lattice, poses: Ints) -> Iterator[Ints]:
    """The wavelengths inside of poses in their order, and outside, back and forth."""
    waves = np.argsort(lattice.wavelengths_nm)
    numbers = poses[:, None] * len(waves) + waves
    yield np.where((np.arange(len(poses)) % 2 == 1)[:, None], numbers[:, ::-1], numbers).ravel()
    yield np.where((np.arange(len(waves)) % 2 == 1)[:, None], numbers.T[:, ::-1], numbers.T).ravel()


def islands(lattice: Lattice, moves: Moves) -> Ints:
    """The order in which the costliest gaps are crossed least often, whatever their column: a column may be several loops."""
    loops: list[tuple[float, int, Ints]] = []
    for column in lattice.active:
        values, seconds = lattice.values[column], moves.one_step(column)
        costs = np.minimum(seconds(values[:-1], values[1:]), seconds(values[1:], values[:-1]))
        below = float("inf")
        for cost in sorted(set(costs.tolist()), reverse=True):
            if cost * ALIKE < below:
                below = cost
            labels = np.concatenate([[0], np.cumsum(costs >= cost)]).astype(np.int64)
            if cost == below:
                loops.append((cost, column, labels))
            else:
                loops[-1] = (loops[-1][0], column, labels)
    ordered = sorted(loops, key=lambda loop: -loop[0])
    return looped(len(lattice), [Loop(labels[lattice.ranks[k]], int(labels[-1]) + 1) for _, k, labels in ordered])
