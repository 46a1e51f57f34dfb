"""Lower bounds of the machine time: of the moves of any order of a grid's points, and of a whole plan.

Any order is a path through all points, hence one of their spanning trees, and costs no less than the cheapest spanning tree. A
move between two points takes at least as long as the slowest of its axes alone, and an axis at least as long as the costliest
gap between neighbouring values on its way. A filter change does not follow the order of the wavelengths: a gap between two
filters costs as much as the cheapest move over it. With these underestimates the cost of the cheapest tree is found without
building the tree: at a cost c all points are connected that lie between the same gaps costlier than c, on every axis; this
gives n(c) clusters, and the tree costs the integral of n(c) - 1 over c. See docs/decisions/0013.
"""

import math
from itertools import product

import numpy as np

from goniotwin.app.campaign.planning.durations import TINY, UNKNOWN_STATE, Moves, Timing, shortest_warm_up_s
from goniotwin.app.campaign.planning.mountings import Pass
from goniotwin.app.campaign.planning.scan_grid import WAVELENGTH, ScanGrid
from goniotwin.app.campaign.planning.timeline import DarkReading, RowTemplates
from goniotwin.app.campaign.planning.validation import min_rows
from goniotwin.app.rig import RigFile
from goniotwin.arrays import Floats, Ints

TINY_S = 1e-9
MAX_LEVELS = 200
"""Limit of the number of distinct costs."""


def moving_lower_bound_s(grid: ScanGrid, moves: Moves) -> float:
    """Lower bound of the moving time of any order of a grid's points."""
    gaps = {column: _gap_seconds(grid.values[column], moves, column) for column in grid.varying_columns}
    if not gaps:
        return 0.0
    total, below = 0.0, 0.0
    for level in _levels(np.concatenate(list(gaps.values()))).tolist():
        # Connected by gaps that cost less than `level`: exact if no level in between is omitted, else too few clusters.
        clusters = grid.count_distinct({column: _clusters(costs, level) for column, costs in gaps.items()})
        total += (level - below) * (clusters - 1)
        below = level
    return total


def _gap_seconds(values: Floats, moves: Moves, column: int) -> Floats:
    """For each gap between neighbouring values the least time of a move over it, in the quicker direction."""
    cheaper = _quicker_direction(values[:-1], values[1:], moves, column)
    if column == WAVELENGTH:
        # Between two filters the neighbours need not be the cheapest move: the wheel may be quicker from the filter before to
        # the one after. Any move that changes the filter goes at least from one filter's last wavelength to another's first.
        changes = np.flatnonzero(np.diff(moves.wheel.numbers(values)))
        for k in changes:
            below, above = np.meshgrid(values[changes[changes <= k]], values[changes[changes >= k] + 1])
            cheaper[k] = _quicker_direction(below.ravel(), above.ravel(), moves, column).min()
    return np.asarray(np.floor(cheaper / TINY_S) * TINY_S)


def _quicker_direction(start: Floats, stop: Floats, moves: Moves, column: int) -> Floats:
    seconds = moves.one_step(column)
    return np.minimum(seconds(start, stop), seconds(stop, start))


def _clusters(costs: Floats, level: float) -> Ints:
    """A label for each value: equal for two values if all gaps between them cost less than `level`."""
    return np.concatenate([[0], np.cumsum(costs >= level)]).astype(np.int64)


def _levels(costs: Floats) -> Floats:
    """The distinct costs in ascending order, at most MAX_LEVELS of them."""
    distinct = np.unique(costs)
    if len(distinct) <= MAX_LEVELS:
        return distinct
    return np.asarray(distinct[np.linspace(0, len(distinct) - 1, MAX_LEVELS).astype(int)])


def plan_lower_bound_s(rig: RigFile, templates: RowTemplates, mounted: list[list[Pass]]) -> float:
    """Lower bound of the duration of a plan, for any order of its rows.

    The least readings that each row may need, the least moving, and the dark readings and drift checks that this time takes.
    """
    timing = Timing(rig)
    moving: dict[ScanGrid, float] = {}
    for passes in mounted:
        for each in passes:
            if each.grid not in moving:
                moving[each.grid] = moving_lower_bound_s(each.grid, timing.moves)
    warm_up = templates.file.warm_up
    warm_up_s = 0.0 if warm_up is None else shortest_warm_up_s(warm_up.longest_s)
    return warm_up_s + sum(_mounting_seconds(templates, passes, moving, timing) for passes in mounted)


def _mounting_seconds(templates: RowTemplates, passes: list[Pass], moving: dict[ScanGrid, float], timing: Timing) -> float:
    """Lower bound of all rows of one mounting."""
    file = templates.file
    rows = min_rows([passes], templates, timing)
    reading = timing.least_row_s(templates.measurement(passes[0].sample))
    measuring = (rows["measure"] + rows["drift"]) * reading + sum(moving[each.grid] for each in passes)
    intervals = rows["dark"] - 1
    if _longest_row_seconds(templates, passes, timing) <= file.dark_every_s:
        intervals = max(intervals, math.ceil(measuring / file.dark_every_s - TINY))
    shutter = sum(timing.shutter_s(UNKNOWN_STATE, opened=opened) for opened in (True, False))
    dark = templates.dark(DarkReading("", 0, 0.0))
    return measuring + (intervals + 1) * timing.similar_reading_s(dark) + intervals * shutter


def _longest_row_seconds(templates: RowTemplates, passes: list[Pass], timing: Timing) -> float:
    """Longest duration of a row in any order: the move across all axes, as the first row after a dark reading."""
    drift = templates.file.drift
    columns = [each.grid.values for each in passes]
    if drift is not None:
        pose = (drift.gamma_deg, drift.sigma_deg, drift.beta_deg, drift.shift_deg, drift.wavelength_nm)
        columns.append([np.array([value]) for value in pose])
    ranges = [sorted({float(f(values[k])) for values in columns for f in (np.min, np.max)}) for k in range(WAVELENGTH + 1)]
    corners = np.array(list(product(*((each[0], each[-1]) for each in ranges))))
    moving = timing.moves.seconds(corners, corners[::-1])
    # The longest move along the wavelengths need not go from end to end, but it is between two ends of filters' bands.
    wavelengths = np.unique(np.concatenate([values[WAVELENGTH] for values in columns]))
    filters = timing.moves.wheel.numbers(wavelengths)
    band_ends = np.unique([f(wavelengths[filters == number]) for number in np.unique(filters) for f in (np.min, np.max)])
    slewing = timing.moves.one_step(WAVELENGTH)
    slowest = slewing(np.repeat(band_ends, len(band_ends)), np.tile(band_ends, len(band_ends))).max()
    beyond = slowest - slewing(band_ends[:1], band_ends[-1:])[0]
    row = templates.measurement(passes[0].sample)
    reading = timing.longest_reading_s(row) + timing.read_back_s
    return float(moving.max() + max(0.0, beyond)) + timing.shutter_s(UNKNOWN_STATE, opened=True) + reading
