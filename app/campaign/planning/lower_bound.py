"""What no order can beat: the least time that moving takes, and the least that a whole plan takes.

Any order is a path through all points, so it is one of the trees that connect them, and costs no less than the cheapest of
these. A move from one point to another takes no less than the slowest of its axes alone does, and an axis no less than the
costliest gap between neighbouring values on its way; a change of filter, whose price is not that of a way along the wavelength,
counts as much as the cheapest that leads over the gap. With these underestimates the cheapest tree is found without building
it: at a cost c all points are connected that lie between the same gaps costlier than c, on every axis; that leaves n(c)
islands, and the tree costs the integral of n(c) - 1 over c. See docs/decisions/0013.
"""

import math
from itertools import product

import numpy as np

from goniotwin.app.campaign.planning.durations import TINY, Moves, Timing, min_intervals, shortest_warm_up_s
from goniotwin.app.campaign.planning.mountings import Pass
from goniotwin.app.campaign.planning.scan_grid import WAVELENGTH, ScanGrid
from goniotwin.app.campaign.planning.timeline import RowTemplates
from goniotwin.app.campaign.row import NO_SAMPLE
from goniotwin.app.rig import RigFile
from goniotwin.arrays import Floats, Ints

TINY_S = 1e-9
LEVELS = 200
"""So many different costs are told apart."""


def moving_lower_bound_s(grid: ScanGrid, moves: Moves) -> float:
    """Less than this no order of a grid's points takes for its moves."""
    gaps = {column: _gap_seconds(grid.values[column], moves, column) for column in grid.varying_columns}
    if not gaps:
        return 0.0
    levels = _levels(np.concatenate(list(gaps.values())))
    total, below = 0.0, 0.0
    for level in levels.tolist():
        # Joined by gaps that cost less than `level`: exact where no level between was left out, too few islands else.
        islands = grid.count_distinct({column: _clusters(costs, level) for column, costs in gaps.items()})
        total += (level - below) * (islands - 1)
        below = level
    return total


def _gap_seconds(values: Floats, moves: Moves, column: int) -> Floats:
    """Of each gap between neighbouring values, whichever way is quicker: what a move over the gap takes at least."""
    cheaper = _either_way(values[:-1], values[1:], moves, column)
    if column == WAVELENGTH:
        # Between two filters the neighbours need not be the cheapest: the wheel may be quicker from the filter before to the
        # one after. Whatever changes the filter goes at least from one filter's last wavelength to the other's first.
        changes = np.flatnonzero(np.diff(moves.filter_numbers(values)))
        for k in changes:
            below, above = np.meshgrid(values[changes[changes <= k]], values[changes[changes >= k] + 1])
            cheaper[k] = _either_way(below.ravel(), above.ravel(), moves, column).min()
    return np.asarray(np.floor(cheaper / TINY_S) * TINY_S)


def _either_way(here: Floats, there: Floats, moves: Moves, column: int) -> Floats:
    seconds = moves.one_step(column)
    return np.minimum(seconds(here, there), seconds(there, here))


def _clusters(costs: Floats, level: float) -> Ints:
    """A label for each value: the same where all gaps between two of them cost less than `level`."""
    return np.concatenate([[0], np.cumsum(costs >= level)]).astype(np.int64)


def _levels(costs: Floats) -> Floats:
    """The distinct costs, in order; of too many only some."""
    found = np.unique(costs)
    return found if len(found) <= LEVELS else found[np.linspace(0, len(found) - 1, LEVELS).astype(int)]


def plan_lower_bound_s(rig: RigFile, templates: RowTemplates, mounted: list[list[Pass]]) -> float:
    """The least readings that each row can do with, the least moving, and as many darks and drift checks as that takes."""
    timing = Timing(rig)
    moving: dict[ScanGrid, float] = {}
    for passes in mounted:
        for each in passes:
            if each.grid not in moving:
                moving[each.grid] = moving_lower_bound_s(each.grid, timing.moves)
    warm_up = templates.file.warm_up
    waited = 0.0 if warm_up is None else shortest_warm_up_s(warm_up.longest_s)
    return waited + sum(_mounted(templates, passes, moving, timing) for passes in mounted)


def _mounted(templates: RowTemplates, passes: list[Pass], moving: dict[ScanGrid, float], timing: Timing) -> float:
    """All that is done with one mounting."""
    file = templates.file
    row = templates.measurement(passes[0].sample)
    reading = timing.reading_range_s(row)[0] + timing.readback_s
    rows = sum(len(each.grid) for each in passes)
    if file.drift is not None and passes[0].sample != NO_SAMPLE:
        rows += 1 + min_intervals(rows, reading, file.drift.every_s)
    measured = rows * reading + sum(moving[each.grid] for each in passes)
    stretches = min_intervals(rows, reading, file.dark_every_s)
    if _longest_row_seconds(templates, passes, timing) <= file.dark_every_s:
        stretches = max(stretches, math.ceil(measured / file.dark_every_s - TINY))
    shutters = timing.switch_shutter(opened=True) + timing.switch_shutter(opened=False)
    dark = templates.dark("", 0)
    return measured + (stretches + 1) * timing.typical_reading_s(dark) + stretches * shutters


def _longest_row_seconds(templates: RowTemplates, passes: list[Pass], timing: Timing) -> float:
    """The most that a row takes in any order: right across all axes, with what only the first one after a dark needs."""
    drift = templates.file.drift
    ends = [each.grid.values for each in passes]
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
    row = templates.measurement(passes[0].sample)
    reading = timing.longest_reading_s(row) + timing.readback_s
    return float(moving.max() + max(0.0, beyond)) + timing.shutter_seconds(opened=True) + reading
