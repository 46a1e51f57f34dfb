"""The least time that a whole plan takes, in whatever order: see docs/decisions/0013."""

import math

from app.campaign.planning.bound import least_moving_seconds
from app.campaign.planning.lattice import Lattice
from app.campaign.planning.passes import Pass
from app.campaign.planning.plan import Plan
from app.campaign.planning.timing import Timing
from app.campaign.row import NOTHING


def least_seconds(plan: Plan) -> float:
    """Readings, the least moving, and as many darks and drift checks as that takes at least."""
    assert plan.made is not None
    timing = Timing(plan.rig.file)
    moving: dict[Lattice, float] = {}
    for passes in plan.made.mountings:
        for each in passes:
            if each.lattice not in moving:
                moving[each.lattice] = least_moving_seconds(each.lattice, timing.moves)
    return sum(_mounted(plan, passes, moving, timing) for passes in plan.made.mountings)


def _mounted(plan: Plan, passes: list[Pass], moving: dict[Lattice, float], timing: Timing) -> float:
    """All that is done with one mounting."""
    file = plan.schedule.file
    assert plan.made is not None
    measuring = plan.made.measuring
    row = measuring.row(passes[0].sample)
    reading = timing.usual_readings(row) + timing.readback_s
    measured = sum(len(each.lattice) * reading + moving[each.lattice] for each in passes)
    drifts = 0
    if file.drift is not None and passes[0].sample != NOTHING:
        drifts = math.ceil(measured / file.drift.every_s) + 1
    measured += drifts * reading
    darks = math.ceil(measured / file.dark_every_s) + 1
    shutters = timing.shutter(opened=True) + timing.shutter(opened=False)
    dark = measuring.dark("", 0)
    return measured + darks * timing.usual_readings(dark) + (darks - 1) * shutters
