"""Why a plan measures in the order that it does, in words."""

from app.campaign.planning.lattice import WAVELENGTH, Lattice
from app.campaign.planning.nesting import Nest
from app.campaign.planning.order import Order
from app.campaign.planning.plan import Made, Plan
from app.campaign.schedule.file import NESTED
from app.campaign.spoken import clock_time

REARRANGED = "rearranged where steps are uneven"


def sample_order(made: Made) -> tuple[Lattice, Order]:
    """Of the samples' own poses: the etalon's may be others, and those of the open beam are few."""
    lattice = made.mountings[1][0].lattice
    return lattice, made.orders[lattice]


def loops(order: Order) -> list[str]:
    """The loops, the innermost first."""
    return [NESTED[column] for column in reversed(order.nest.columns)]


def why(plan: Plan, made: Made) -> str:
    """The nestings that were compared, the one taken first, with about how long the whole campaign takes in each."""
    lattice, order = sample_order(made)
    passes = sum(each.lattice is lattice for mounted in made.mountings for each in mounted)
    seconds = {REARRANGED: plan.seconds} if order.rearranged else {}
    for nest in sorted(order.tried, key=lambda nest: (nest != order.nest, order.tried[nest])):
        if order.tried[nest] < float("inf"):
            whole = plan.seconds + (order.tried[nest] - order.seconds) * passes
            for words in _called(nest):
                seconds.setdefault(words, whole)
    told = "; ".join(f"{words}: {clock_time(whole)}" for words, whole in seconds.items())
    if plan.schedule.file.order != "fastest":
        return f"as the schedule says. {told}"
    return told if len(seconds) > 1 else "there is one loop only"


def _called(nest: Nest) -> list[str]:
    """What tells a nest from the others."""
    if len(nest.columns) < 2:
        return ["one loop"]
    outside = ["wavelength outside"] if nest.columns[0] == WAVELENGTH else []
    return [f"{NESTED[nest.columns[-1]]} inside", *outside]
