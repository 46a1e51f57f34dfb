"""Nested loops: in which order they visit the points of a lattice, and how long that takes on a rig."""

from dataclasses import dataclass

import numpy as np

from app.campaign.planning.lattice import Floats, Ints, Lattice, numbered
from app.campaign.planning.moves import Moves
from drivers import ArcClearance


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
    place, places = np.zeros(len(lattice), dtype=np.int64), 1
    for column, both in zip(nest.columns, nest.back_and_forth, strict=True):
        size = len(lattice.values[column])
        ranks = lattice.ranks[column] if moves.backlash(column) >= 0 else size - 1 - lattice.ranks[column]
        found, inner = numbered(place * size + ranks, places * size)
        turns = np.bincount(found // size, minlength=places)
        first = np.cumsum(turns) - turns
        if both:
            moved = (turns > 1).astype(np.int64)
            back = np.mod(np.cumsum(moved) - moved + (column in nest.from_the_end), 2).astype(bool)
            inner = np.where(back[place], (2 * first + turns - 1)[place] - inner, inner)
        place, places = inner, len(found)
    order = np.empty(len(lattice), dtype=np.int64)
    order[place] = np.arange(len(lattice))
    return order


def moving_seconds(moves: Moves, clearance: ArcClearance, points: Floats) -> float:
    """All moves from each of points (n, 5) to the next; infinite where the arc would meet the beam on its way."""
    if swept(clearance, points).any():
        return float("inf")
    return float(moves.seconds(points[:-1], points[1:]).sum())


def swept(clearance: ArcClearance, points: Floats) -> Ints:
    """The numbers (n - 1,) of the moves between points (n, 5) on which the arc would meet the beam: 1 where it would."""
    none = np.zeros(max(len(points) - 1, 0), dtype=np.int64)
    beta, shift = points[:, 2], points[:, 3]
    if len(points) == 0 or clearance.veto((beta.min(), beta.max()), (shift.max(),)) is None:
        return none
    ways = np.round(np.stack([beta[:-1], beta[1:], shift[:-1], shift[1:]], axis=1), 9)
    key = np.zeros(len(ways), dtype=np.int64)
    for column in ways.T:
        found, ranks = np.unique(column, return_inverse=True)
        key = key * len(found) + ranks
    _, first, back = np.unique(key, return_index=True, return_inverse=True)
    hit = [clearance.veto(tuple(way[:2]), tuple(way[2:])) is not None for way in ways[first].tolist()]
    return np.asarray(hit, dtype=np.int64)[back]
