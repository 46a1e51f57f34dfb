"""Loop orders: nested loops over the columns of a scan grid, the sequence of points that they give, and its moving time."""

from dataclasses import dataclass

import numpy as np

from goniotwin.app.campaign.geometry.collision import crosses_beam
from goniotwin.app.campaign.planning.durations import Moves
from goniotwin.app.campaign.planning.scan_grid import ScanGrid, unique_ranks
from goniotwin.arrays import Floats, Ints
from goniotwin.drivers import ArcClearance


@dataclass(frozen=True)
class LoopOrder:
    """Loops over columns of a grid, the outermost first.

    Each loop goes back and forth, or always in the same direction. A loop over one of `reversed_columns` that goes back and
    forth starts at its other end.
    """

    columns: tuple[int, ...]
    back_and_forth: tuple[bool, ...]
    reversed_columns: frozenset[int] = frozenset()


def loop_sequence(grid: ScanGrid, loop_order: LoopOrder, moves: Moves) -> Ints:
    """The numbers of the points (n,) in the sequence of a loop order.

    A loop that goes back and forth turns round only where it has moved within the loop around it.
    """
    loops = []
    for column, back_and_forth in zip(loop_order.columns, loop_order.back_and_forth, strict=True):
        size = len(grid.values[column])
        ranks = grid.ranks[column] if moves.approach(column) >= 0 else size - 1 - grid.ranks[column]
        loops.append(Loop(ranks, size, back_and_forth, column in loop_order.reversed_columns))
    return nested_sequence(len(grid), loops)


@dataclass(frozen=True)
class Loop:
    """One loop: the step (n,) at which it comes to each point, and the number of steps.

    It goes back and forth, or always in the same direction; `from_end`: it starts at its last step.
    """

    steps: Ints
    size: int
    back_and_forth: bool = True
    from_end: bool = False


def nested_sequence(points: int, loops: list[Loop]) -> Ints:
    """The numbers of this many points in the sequence of nested loops, the outermost first."""
    place, places = np.zeros(points, dtype=np.int64), 1
    for loop in loops:
        distinct, inner = unique_ranks(place * loop.size + loop.steps, places * loop.size)
        steps = np.bincount(distinct // loop.size, minlength=places)
        first = np.cumsum(steps) - steps
        if loop.back_and_forth:
            moved = (steps > 1).astype(np.int64)
            back = np.mod(np.cumsum(moved) - moved + loop.from_end, 2).astype(bool)
            inner = np.where(back[place], (2 * first + steps - 1)[place] - inner, inner)
        place, places = inner, len(distinct)
    sequence = np.empty(points, dtype=np.int64)
    sequence[place] = np.arange(points)
    return sequence


def moving_seconds(moves: Moves, clearance: ArcClearance, points: Floats, ends: Floats | None = None) -> float:
    """Seconds of all moves from each of points (n, 5) to the next; infinite if the arc would collide with the beam.

    With `ends` (5,), the point of the drift checks, the moves from there to the first point and from the last point to there
    must be free as well; their seconds do not count.
    """
    path = points if ends is None else np.concatenate([ends[None], points, ends[None]])
    if crosses_beam(clearance, path).any():
        return float("inf")
    return float(moves.seconds(points[:-1], points[1:]).sum())
