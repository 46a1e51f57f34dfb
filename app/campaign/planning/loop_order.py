"""Nested loops: in which order they visit the points of a grid, and how long that takes on a rig."""

from dataclasses import dataclass

import numpy as np

from goniotwin.app.campaign.geometry.collision import crosses_beam
from goniotwin.app.campaign.planning.durations import Moves
from goniotwin.app.campaign.planning.scan_grid import ScanGrid, unique_ranks
from goniotwin.arrays import Floats, Ints
from goniotwin.drivers import ArcClearance


@dataclass(frozen=True)
class LoopOrder:
    """Loops over the columns of a grid, the outermost first: each goes back and forth, or always the same way.

    Those of the columns `reversed_columns` begin there, of the ones that go back and forth.
    """

    columns: tuple[int, ...]
    back_and_forth: tuple[bool, ...]
    reversed_columns: frozenset[int] = frozenset()


def loop_sequence(grid: ScanGrid, nest: LoopOrder, moves: Moves) -> Ints:
    """The numbers of the points (n,) in the order in which a nest visits them.

    A loop that goes back and forth turns round where it was within the loop around it, and only where it has moved.
    """
    loops = []
    for column, both in zip(nest.columns, nest.back_and_forth, strict=True):
        size = len(grid.values[column])
        ranks = grid.ranks[column] if moves.backlash(column) >= 0 else size - 1 - grid.ranks[column]
        loops.append(Loop(ranks, size, both, column in nest.reversed_columns))
    return nested_sequence(len(grid), loops)


@dataclass(frozen=True)
class Loop:
    """Which turn of a loop each point belongs to, (n,), of how many, and how it goes: back and forth, and from which end."""

    turns: Ints
    size: int
    back_and_forth: bool = True
    reversed_columns: bool = False


def nested_sequence(points: int, loops: list[Loop]) -> Ints:
    """The numbers of so many points in the order in which nested loops, the outermost first, come to them."""
    place, places = np.zeros(points, dtype=np.int64), 1
    for loop in loops:
        found, inner = unique_ranks(place * loop.size + loop.turns, places * loop.size)
        turns = np.bincount(found // loop.size, minlength=places)
        first = np.cumsum(turns) - turns
        if loop.back_and_forth:
            moved = (turns > 1).astype(np.int64)
            back = np.mod(np.cumsum(moved) - moved + loop.reversed_columns, 2).astype(bool)
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
    if crosses_beam(clearance, way).any():
        return float("inf")
    return float(moves.seconds(points[:-1], points[1:]).sum())
