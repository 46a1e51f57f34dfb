"""Nested loops: in which order they visit the points of a lattice, and how long that takes on a rig."""

from dataclasses import dataclass

import numpy as np

from goniotwin.app.campaign.geometry.collision import swept
from goniotwin.app.campaign.planning.durations import Moves
from goniotwin.app.campaign.planning.scan_grid import Lattice, numbered
from goniotwin.arrays import Floats, Ints
from goniotwin.drivers import ArcClearance


@dataclass(frozen=True)
class Nest:
    """Loops over the columns of a lattice, the outermost first: each goes back and forth, or always the same way.

    Those of the columns `from_the_end` begin there, of the ones that go back and forth.
    """

    columns: tuple[int, ...]
    back_and_forth: tuple[bool, ...]
    from_the_end: frozenset[int] = frozenset()


def visited(lattice: Lattice, nest: Nest, moves: Moves) -> Ints:
    """The numbers of the points (n,) in the order in which a nest visits them.

    A loop that goes back and forth turns round where it was within the loop around it, and only where it has moved.
    """
    loops = []
    for column, both in zip(nest.columns, nest.back_and_forth, strict=True):
        size = len(lattice.values[column])
        ranks = lattice.ranks[column] if moves.backlash(column) >= 0 else size - 1 - lattice.ranks[column]
        loops.append(Loop(ranks, size, both, column in nest.from_the_end))
    return looped(len(lattice), loops)


@dataclass(frozen=True)
class Loop:
    """Which turn of a loop each point belongs to, (n,), of how many, and how it goes: back and forth, and from which end."""

    turns: Ints
    size: int
    back_and_forth: bool = True
    from_the_end: bool = False


def looped(points: int, loops: list[Loop]) -> Ints:
    """The numbers of so many points in the order in which nested loops, the outermost first, come to them."""
    place, places = np.zeros(points, dtype=np.int64), 1
    for loop in loops:
        found, inner = numbered(place * loop.size + loop.turns, places * loop.size)
        turns = np.bincount(found // loop.size, minlength=places)
        first = np.cumsum(turns) - turns
        if loop.back_and_forth:
            moved = (turns > 1).astype(np.int64)
            back = np.mod(np.cumsum(moved) - moved + loop.from_the_end, 2).astype(bool)
            inner = np.where(back[place], (2 * first + turns - 1)[place] - inner, inner)
        place, places = inner, len(found)
    order = np.empty(points, dtype=np.int64)
    order[place] = np.arange(points)
    return order


def moving_seconds(moves: Moves, clearance: ArcClearance, points: Floats, ends: Floats | None = None) -> float:
    """All moves from each of points (n, 5) to the next; infinite where the arc would meet the beam on its way.

    Or on its way from `ends` (5,) to the first of them, or from the last to there.
    """
    way = points if ends is None else np.concatenate([ends[None], points, ends[None]])
    if swept(clearance, way).any():
        return float("inf")
    return float(moves.seconds(points[:-1], points[1:]).sum())
