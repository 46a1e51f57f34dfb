"""Why a plan measures in the order that it does, in words."""

import numpy as np

from goniotwin.app.campaign.planning.lattice import FILTER, WAVELENGTH, Lattice
from goniotwin.app.campaign.planning.moves import Moves
from goniotwin.app.campaign.planning.nesting import Nest
from goniotwin.app.campaign.planning.order import Order
from goniotwin.app.campaign.planning.plan import Made, Plan
from goniotwin.app.campaign.planning.planned_rows import PlannedRows
from goniotwin.app.campaign.planning.timeline import Run
from goniotwin.app.campaign.schedule.file import NESTED
from goniotwin.app.campaign.spoken import clock_time

LOOPS = (*NESTED, "filter")
REARRANGED = "rearranged where steps are uneven"


def sample_order(made: Made) -> tuple[Lattice, Order]:
    """Of the samples' own poses: the etalon's may be others, and those of the open beam are few."""
    lattice = made.mountings[1][0].lattice
    return lattice, made.orders[lattice]


def loops(order: Order) -> list[str]:
    """The loops, the innermost first."""
    return [LOOPS[column] for column in reversed(order.nest.columns)]


def why(plan: Plan, made: Made) -> str:
    """The nestings that were compared, the one taken first, with about how long the whole campaign takes in each; and how often
    the filter changes.
    """
    lattice, order = sample_order(made)
    passes = sum(each.lattice is lattice for mounted in made.mountings for each in mounted)
    seconds = {REARRANGED: plan.seconds} if order.rearranged else {}
    for nest in sorted(order.tried, key=lambda nest: (nest != order.nest, order.tried[nest])):
        if order.tried[nest] < float("inf"):
            whole = plan.seconds + (order.tried[nest] - order.seconds) * passes
            for words in _called(nest, order.nest):
                seconds.setdefault(words, whole)
    count, wheel_s = filter_changes(plan)
    filters = f"; filter changes: {count}, {clock_time(wheel_s)}" if count else ""
    told = "; ".join(f"{words}: {clock_time(whole)}" for words, whole in seconds.items())
    if plan.schedule.file.order != "fastest":
        return f"as the schedule says. {told}{filters}"
    return f"{told if len(seconds) > 1 else 'there is one loop only'}{filters}"


def filter_changes(plan: Plan) -> tuple[int, float]:
    """How often a plan that was just made changes the filter, and how many seconds the wheel turns for it."""
    assert isinstance(plan.rows, PlannedRows)
    moves, wavelengths = Moves(plan.rig.file), []
    for piece in plan.rows.pieces:
        if isinstance(piece, Run):
            known = piece.of.lattice.wavelengths_nm
            wavelengths.append(known[piece.points % len(known)])
        elif piece.wavelength_nm is not None:
            wavelengths.append(np.array([piece.wavelength_nm]))
    return moves.filter_changes(np.concatenate(wavelengths))


def _called(nest: Nest, taken: Nest) -> list[str]:
    """What tells a nest from the others; only of one with the innermost loop of the `taken` also whether it goes by filters."""
    if len(nest.columns) < 2:
        return ["one loop"]
    outside = ["wavelength outside"] if nest.columns[0] == WAVELENGTH else []
    by_filter = ", filter by filter" if FILTER in nest.columns and nest.columns[-1] == taken.columns[-1] else ""
    return [f"{LOOPS[nest.columns[-1]]} inside{by_filter}", *outside]
