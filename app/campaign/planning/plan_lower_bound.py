"""The least time that a whole plan takes, in whatever order: see docs/decisions/0013."""

import math
from itertools import product

import numpy as np

from goniotwin.app.campaign.planning.durations import TINY, Timing, fewest_stretches, least_warm_up_seconds
from goniotwin.app.campaign.planning.lower_bound import least_moving_seconds
from goniotwin.app.campaign.planning.mountings import Pass
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.planning.scan_grid import WAVELENGTH, Lattice
from goniotwin.app.campaign.row import NO_SAMPLE


def least_seconds(plan: Plan) -> float:
    """The least readings that each row can do with, the least moving, and as many darks and drift checks as that takes."""
    assert plan.made is not None
    timing = Timing(plan.rig.file)
    moving: dict[Lattice, float] = {}
    for passes in plan.made.mountings:
        for each in passes:
            if each.lattice not in moving:
                moving[each.lattice] = least_moving_seconds(each.lattice, timing.moves)
    warm_up = plan.schedule.file.warm_up
    waited = 0.0 if warm_up is None else least_warm_up_seconds(warm_up.longest_s)
    return waited + sum(_mounted(plan, passes, moving, timing) for passes in plan.made.mountings)


def _mounted(plan: Plan, passes: list[Pass], moving: dict[Lattice, float], timing: Timing) -> float:
    """All that is done with one mounting."""
    file = plan.schedule.file
    assert plan.made is not None
    measuring = plan.made.measuring
    row = measuring.row(passes[0].sample)
    reading = timing.readings_range(row)[0] + timing.readback_s
    rows = sum(len(each.lattice) for each in passes)
    if file.drift is not None and passes[0].sample != NO_SAMPLE:
        rows += 1 + fewest_stretches(rows, reading, file.drift.every_s)
    measured = rows * reading + sum(moving[each.lattice] for each in passes)
    stretches = fewest_stretches(rows, reading, file.dark_every_s)
    if _longest_row_seconds(plan, passes, timing) <= file.dark_every_s:
        stretches = max(stretches, math.ceil(measured / file.dark_every_s - TINY))
    shutters = timing.shutter(opened=True) + timing.shutter(opened=False)
    dark = measuring.dark("", 0)
    return measured + (stretches + 1) * timing.usual_readings(dark) + stretches * shutters


def _longest_row_seconds(plan: Plan, passes: list[Pass], timing: Timing) -> float:
    """The most that a row takes in any order: right across all axes, with what only the first one after a dark needs."""
    assert plan.made is not None
    drift = plan.schedule.file.drift
    ends = [each.lattice.values for each in passes]
    if drift is not None:
        pose = (drift.gamma_deg, drift.sigma_deg, drift.beta_deg, drift.shift_deg, drift.wavelength_nm)
        ends.append([np.array([value]) for value in pose])
    both = [sorted({float(f(values[k])) for values in ends for f in (np.min, np.max)}) for k in range(WAVELENGTH + 1)]
    corners = np.array(list(product(*((each[0], each[-1]) for each in both))))
    moving = timing.moves.seconds(corners, corners[::-1])
    # The way along the wavelengths that takes longest need not be that from end to end, but is from an end of some filter's.
    every = np.unique(np.concatenate([values[WAVELENGTH] for values in ends]))
    filters = timing.moves.filter_numbers(every)
    waves = np.unique([f(every[filters == number]) for number in np.unique(filters) for f in (np.min, np.max)])
    slewing = timing.moves.one_step(WAVELENGTH)
    beyond = slewing(np.repeat(waves, len(waves)), np.tile(waves, len(waves))).max() - slewing(waves[:1], waves[-1:])[0]
    row = plan.made.measuring.row(passes[0].sample)
    reading = timing.longest_readings(row) + timing.readback_s
    return float(moving.max() + max(0.0, beyond)) + timing.shutter_seconds(opened=True) + reading
