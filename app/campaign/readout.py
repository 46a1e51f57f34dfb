"""Rules of the readout: auto-range (choice of the gain), averaging, and warm-up of the lamp.

No rig and no I/O: planner, engine and reduction apply the same rules. Each decision follows from the recorded counts alone,
so that it can be repeated from the journal, and a resumed campaign decides the same.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from goniotwin.app.campaign.row import Row
from goniotwin.arrays import Counts, Flags, Floats
from goniotwin.drivers import ConverterDescription, ConverterRange

SATURATED = "saturated"
"""Flag of a row in which a photodiode is saturated at every gain."""
UNDER_RANGE = "under range"
"""Flag of a row in which no photodiode shows light at the highest gain."""
NOT_WARM = "not warm"
"""Flag of a warm-up that reached its time limit before the monitor was steady."""

LIGHT_THRESHOLD_STEPS = 4.0
"""Difference from the dark reading, in converter steps, from which a mean counts as light."""
MIN_AVERAGED_READINGS = 4
"""Smallest number of readings from which the scatter is estimated."""
MAX_GROWTH = 4
"""Largest growth of the number of readings in one request: with few readings, noise may look like a strong signal."""
QUANTISATION_VARIANCE = 1.0 / 12.0
"""Variance of the rounding to one converter step, in steps squared (uniform distribution)."""

MONITOR_MEAN_S = 1.0
"""Integration time of one monitor reading during the warm-up."""
WARM_UP_PERIOD_S = 10.0
"""Time from one monitor reading of the warm-up to the next."""
WARM_UP_WINDOW_S = 600.0
"""Length of the window in which the monitor's slope is fitted."""
MIN_SLOPE_READINGS = 7
"""Smallest number of monitor readings for a slope: one minute."""


def shows_light(counts: Counts, dark: Floats) -> bool:
    """Return whether the mean of `counts` (readings, photodiodes) differs from `dark` (photodiodes,) in any photodiode."""
    return bool(np.any(np.abs(counts.mean(axis=0) - dark) >= LIGHT_THRESHOLD_STEPS))


def saturation(counts: Counts, converter: ConverterRange) -> Flags:
    """Flags of the photodiodes that are saturated in any of the readings (readings, photodiodes) of a converter."""
    return np.asarray(np.logical_or.reduce(converter.saturated(counts), axis=0))


def gain_order(row: Row, current: int | None) -> tuple[int, ...]:
    """The gains of a row in the order of reading; `current` is the gain that the amplifiers have now.

    Every change of gain wears a relay. So the order begins with `current` where that is the highest or the lowest gain of
    the row, and two consecutive rows share a gain. With auto-range or a target uncertainty the order always begins with
    the highest gain, because a photodiode that is done at a higher gain needs no reading at a lower one.
    """
    descending = row.automatic or row.target is not None or (bool(row.gains) and current == max(row.gains))
    return tuple(sorted(row.gains, reverse=descending))


class GainSequence:
    """The gains at which a row is read, in order: all planned ones, or with auto-range those that a photodiode needs.

    A photodiode needs its highest gain without saturation. So auto-range reads from the highest gain downwards until no
    photodiode is saturated or the lowest gain is read. `saturated` (photodiodes,) flags the photodiodes that were saturated
    at every gain so far; before the first reading all are flagged.
    """

    def __init__(self, row: Row, settings: ConverterDescription, current: int | None) -> None:
        self._row = row
        self._gains = gain_order(row, current)
        self.saturated: Flags = np.ones(settings.count, dtype=bool)
        self._converter = settings.range

    def __iter__(self) -> Iterator[int]:
        for gain in self._gains:
            if self._row.automatic and not self.saturated.any():
                return
            yield gain

    def add(self, counts: Counts) -> None:
        """Add the readings (readings, photodiodes) at the gain that was just yielded."""
        self.saturated &= saturation(counts, self._converter)

    @property
    def flags(self) -> tuple[str, ...]:
        """Flags of the row: SATURATED or none."""
        return (SATURATED,) if self._row.gains and self.saturated.any() else ()


def min_readings(row: Row) -> int:
    """Least number of readings at each gain; a target uncertainty needs enough of them to estimate the scatter."""
    return row.readings if row.target is None else max(row.readings, MIN_AVERAGED_READINGS)


def max_readings(row: Row, period_s: float) -> int:
    """Greatest number of readings at each gain, `period_s` apart: with a target uncertainty the time limit decides."""
    least = min_readings(row)
    return least if row.target is None else max(least, int(row.longest_s / period_s))


def readings_needed(counts: Counts, dark: Floats, selected: Flags, target: float, max_readings: int) -> int:
    """Total number of readings after which the mean signal has the relative standard uncertainty `target`.

    The estimate uses the `counts` so far (MIN_AVERAGED_READINGS or more, photodiodes) and the dark reading `dark`
    (photodiodes,). Only the `selected` photodiodes (photodiodes,) count, and of these only the ones that can reach the target
    within `max_readings`: a photodiode without light never reaches a relative target, and the others do not wait for it.
    Returns the number of readings so far where no more are needed. The reduction does not use the scatter of these readings
    as their uncertainty, because the scatter decided when to stop.
    """
    taken = len(counts)
    signal = np.abs(counts.mean(axis=0) - dark)
    variance = np.maximum(counts.var(axis=0, ddof=1), QUANTISATION_VARIANCE)
    with np.errstate(divide="ignore", over="ignore"):
        needed = variance / (target * signal) ** 2
    reachable = needed[selected & (needed <= max_readings)]
    return min(max(taken, math.ceil(float(reachable.max()))), MAX_GROWTH * taken) if reachable.size else taken


def further_readings(row: Row, counts: Counts, dark: Floats, selected: Flags, settings: ConverterDescription) -> int:
    """Number of readings that follow `counts` at one gain of a row; 0 at its end (see `readings_needed`)."""
    if row.target is None:
        return 0
    unsaturated = selected & ~saturation(counts, settings.range)
    return readings_needed(counts, dark, unsaturated, row.target, max_readings(row, settings.period_s)) - len(counts)


@dataclass
class WarmUpTrace:
    """Monitor current in A against time in s, over the last WARM_UP_WINDOW_S."""

    times_s: list[float] = field(default_factory=list)
    currents_a: list[float] = field(default_factory=list)

    def add(self, t: float, current_a: float) -> None:
        """Add a reading and drop the readings that are older than the window."""
        self.times_s.append(t)
        self.currents_a.append(current_a)
        while self.times_s[0] < t - WARM_UP_WINDOW_S:
            del self.times_s[0], self.currents_a[0]

    def slope(self) -> tuple[float, float] | None:
        """Relative change in ten minutes and its standard uncertainty, from a straight line; None with too few readings."""
        if len(self.times_s) < MIN_SLOPE_READINGS:
            return None
        t = np.array(self.times_s) - np.mean(self.times_s)
        current = np.array(self.currents_a)
        rise = float(np.sum(t * current) / np.sum(t**2))
        residual = current - current.mean() - rise * t
        u_rise = float(np.sqrt(np.sum(residual**2) / (len(t) - 2) / np.sum(t**2)))
        per_window = WARM_UP_WINDOW_S / float(current.mean())
        return rise * per_window, u_rise * abs(per_window)

    def is_steady(self, target: float) -> bool:
        """Return whether the relative change in ten minutes plus twice its standard uncertainty is at most `target`."""
        slope = self.slope()
        return slope is not None and abs(slope[0]) + 2.0 * slope[1] <= target
