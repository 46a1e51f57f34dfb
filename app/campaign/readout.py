"""Rules of the readout: auto-range (choice of the gain), averaging, contradictions of readings, and warm-up of the lamp.

No rig and no I/O: planner, engine and reduction apply the same rules. Each decision follows from the recorded counts alone,
so that it can be repeated from the journal, and a resumed campaign decides the same.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from goniotwin.app.campaign.row import Reading, Row
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

LEAST_COMPARED_READINGS = 2
"""Smallest number of readings at a gain: a single one contradicts nothing."""
READING_ATTEMPTS = 3
"""Number of times that readings are taken whose predecessors contradict each other."""
CONTRADICTION_LIMIT, LIMIT_OF_TWO = 6.0, 4.5
"""Difference of a reading from the mean of the others, in its standard deviations, from which it contradicts them.

Of two readings it is smaller: a changed count is half of their mean.
"""
LEAST_VARIANCE = 0.25
"""Smallest variance of a reading, in converter steps squared: that of a mean between two steps, which is either of them."""
FIRST_LIGHT_VARIANCE = 0.005**2
"""Relative variance of a lit reading, which is that of the lamp, before the first lit row."""
REMEMBERED_ROWS = 16
"""Number of lit rows that determine the relative variance of a lit reading."""
LEAST_LIGHT_VARIANCE, MAX_VARIANCE_GROWTH = 1e-4**2, 100.0
"""A row is remembered with at most this many times the variance before it, or the least one: a changed count is no light."""
BRIGHT = 0.25
"""From this share of the brightest photodiode's signal on the scatter of a photodiode is that of the lamp."""
BRIGHT_SIGNAL = 50.0
"""From so many standard deviations of its dark reading on."""
SIGNIFICANT_EXCESS = 4.0
"""Ratio of the variance of the light to that of all other noise from which it is known where it is not expected."""
FEWEST_BRIGHT = 3
"""Number of bright photodiodes from which their median scatter is not that of one of them with a changed count."""

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
    """Least number of readings at each gain: enough to be compared, and with a target uncertainty to estimate the scatter."""
    return max(row.readings, LEAST_COMPARED_READINGS if row.target is None else MIN_AVERAGED_READINGS)


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


def read_row(
    row: Row,
    settings: ConverterDescription,
    current: int | None,
    dark: Callable[[int], Floats],
    take: Callable[[int, int], Counts],
) -> tuple[str, ...]:
    """Read a row at each gain that it needs, as often as it needs; return its flags.

    `take` takes a number of readings at a gain, given by its index, and returns all counts (readings, photodiodes) at this gain
    so far. `dark` is the dark reading (photodiodes,) at a gain; `current` is the gain that the amplifiers have now.
    """
    gains = GainSequence(row, settings, current)
    for gain in gains:
        counts, dark_counts = take(gain, min_readings(row)), dark(gain)
        while further := further_readings(row, counts, dark_counts, gains.saturated, settings):
            counts = take(gain, further)
        gains.add(counts)
    return gains.flags


@dataclass(frozen=True)
class DarkLevel:
    """Mean and variance (photodiodes,) of the counts of one dark reading."""

    mean: Floats
    variance: Floats


def dark_level(counts: Counts) -> DarkLevel:
    """The level of a dark reading of counts (readings, photodiodes).

    The variance of a photodiode is at least that of most, because few readings may agree by chance. Its own is without the
    count that differs most, which may be one that contradicts.
    """
    readings, mean = len(counts), counts.mean(axis=0)
    squares = (counts - mean) ** 2
    typical = _typical(squares.sum(axis=0) / (readings - 1), readings - 1) if readings > 1 else 0.0
    own = squares.sum(axis=0) - squares.max(axis=0) * readings / max(readings - 1, 1)
    return DarkLevel(mean, np.maximum(own / max(readings - 2, 1), max(typical, LEAST_VARIANCE)))


def contradictions(
    counts: Counts, gain_v_per_a: float, dark: DarkLevel, light_variance: float, settings: ConverterDescription
) -> Flags:
    """Flags (readings, photodiodes) of the counts at one gain that contradict the others of their photodiode.

    A count contradicts the mean of the others if it differs by more than CONTRADICTION_LIMIT standard deviations: of the dark
    reading's scatter, of the shot noise, and of the light, whose relative variance is `light_variance`. Of each photodiode the
    count that differs most is flagged. A count that a wire has changed is one of many: so a count does not contradict if most
    photodiodes that would show the same relative change do show at least half of it in the same reading. That is the lamp, or
    amplifiers that settle.

    False alarms: 2e-9 of the counts with normal noise of a known variance, 7e-6 of the pairs where there are two readings (one
    in 10,000 rows of 18 photodiodes); 2e-7 and 9e-5 where the standard deviation of the dark reading is 13 % too low. A false
    alarm costs a repeat. A change that is not found changes the mean of n readings by at most 6 / sqrt(n - 1) of its standard
    deviations, that of two by 4.5.
    """
    readings = len(counts)
    if readings < LEAST_COMPARED_READINGS:
        return np.zeros(counts.shape, dtype=bool)
    values = counts.astype(np.float64)
    difference = (values - values.mean(axis=0)) * readings / (readings - 1)  # from the mean of the others
    typical = _typical_counts(values)
    signal, noise = _signal_and_noise(typical, gain_v_per_a, dark, settings)
    deviations = LIMIT_OF_TWO if readings == LEAST_COMPARED_READINGS else CONTRADICTION_LIMIT
    limit = deviations * np.sqrt((noise + light_variance * signal**2) * readings / (readings - 1))
    # Changes are from the typical count: the mean of a photodiode with a changed count is that of none of its readings.
    changes = np.abs(values - typical)
    result: Flags = (np.abs(difference) > limit) & (changes == changes.max(axis=0))
    for reading, photodiode in np.argwhere(result).tolist():
        change = changes[reading]
        lit = max(abs(values[reading, photodiode] - dark.mean[photodiode]), signal[photodiode])
        expected = signal * (change[photodiode] / lit)
        showing = expected > limit
        showing[photodiode] = False
        if showing.any():
            result[reading, photodiode] = float(np.mean(change[showing] > 0.5 * expected[showing])) <= 0.5
    return result


def _signal_and_noise(
    typical: Floats, gain_v_per_a: float, dark: DarkLevel, settings: ConverterDescription
) -> tuple[Floats, Floats]:
    """The signal (photodiodes,) of typical counts, in steps, and the variance of a reading without that of the light."""
    signal: Floats = np.abs(typical - dark.mean)
    ampere = settings.range.lsb_v / gain_v_per_a
    return signal, dark.variance + settings.shot_variance_a2(signal * ampere) / ampere**2


class ReadingComparison:
    """Comparison of the readings of each row with each other, and with the noise that the rows before have shown.

    `dark_levels` is the last dark reading by gain in V/A. The relative variance of the light is that of some lit rows before
    (REMEMBERED_ROWS), or what most bright photodiodes of the row itself have, where that is more: a lamp may begin to flicker.
    """

    def __init__(self, settings: ConverterDescription) -> None:
        self._settings = settings
        self.dark_levels: dict[float, DarkLevel] = {}
        self._light_variance, self._lit_rows = FIRST_LIGHT_VARIANCE, 0

    def contradictions(self, reading: Reading, *, lit: bool) -> Flags:
        """Flags (readings, photodiodes) of the counts that contradict the others: see the function of this name."""
        counts, gain = reading.counts, reading.gain_v_per_a
        dark = self.dark_levels.get(gain)
        if not lit or dark is None:
            dark = self._level_of(counts, dark, lit=lit)
        if not lit:
            return contradictions(counts, gain, dark, 0.0, self._settings)
        found = contradictions(counts, gain, dark, self._light_variance, self._settings)
        if found.any():
            of_row, _, bright = self._light_variance_of(reading, dark)
            if bright >= FEWEST_BRIGHT and of_row > self._light_variance:
                found = contradictions(counts, gain, dark, of_row, self._settings)
        return found

    def _level_of(self, counts: Counts, before: DarkLevel | None, *, lit: bool) -> DarkLevel:
        """The level with which a dark reading, or one before any, is compared: its scatter is that of most photodiodes."""
        scatter = _typical(counts.var(axis=0, ddof=1), len(counts) - 1) if len(counts) > 1 else 0.0
        least = np.full(self._settings.count, max(scatter, LEAST_VARIANCE))
        mean = np.full(self._settings.count, self._settings.range.zero) if lit else _typical_counts(counts)
        return DarkLevel(mean, least if before is None else np.maximum(before.variance, least))

    def remember(self, readings: Iterable[Reading], *, lit: bool) -> None:
        """Remember the noise of a row's readings. Not those of another number of photodiodes."""
        for each in readings:
            if each.counts.shape[1] != self._settings.count:
                continue
            if not lit:
                self.dark_levels[each.gain_v_per_a] = dark_level(each.counts)
            elif each.gain_v_per_a in self.dark_levels and len(each.counts) > 1:
                of_row, resolution, bright = self._light_variance_of(each, self.dark_levels[each.gain_v_per_a])
                if bright and (resolution <= self._light_variance or of_row > SIGNIFICANT_EXCESS * resolution):
                    self._lit_rows = min(self._lit_rows + 1, REMEMBERED_ROWS)
                    most = MAX_VARIANCE_GROWTH * max(self._light_variance, LEAST_LIGHT_VARIANCE)
                    self._light_variance += (min(max(of_row, resolution), most) - self._light_variance) / self._lit_rows

    def _light_variance_of(self, reading: Reading, dark: DarkLevel) -> tuple[float, float, int]:
        """The typical relative variance of the light, that of all other noise, and the number of bright photodiodes."""
        values = reading.counts.astype(np.float64)
        signal, noise = _signal_and_noise(_typical_counts(values), reading.gain_v_per_a, dark, self._settings)
        bright = (signal >= BRIGHT * signal.max()) & (signal >= BRIGHT_SIGNAL * np.sqrt(noise))
        bright &= ~saturation(reading.counts, self._settings.range)  # these do not scatter
        if not bright.any():
            return 0.0, 0.0, 0
        other = noise[bright] / signal[bright] ** 2
        scatter = np.maximum(values[:, bright].var(axis=0, ddof=1) / signal[bright] ** 2 - other, 0.0)
        return _typical(scatter, len(values) - 1), float(other.mean()), int(bright.sum())


def _typical_counts(counts: Counts | Floats) -> Floats:
    """The lower median (photodiodes,) of counts (readings, photodiodes): one of them, and not the only wrong one of three."""
    typical: Floats = np.sort(counts, axis=0)[(len(counts) - 1) // 2].astype(np.float64)
    return typical


def _typical(variances: Floats, degrees: int) -> float:
    """The variance that most of estimates (n,) with some degrees of freedom have; the mean where they are too few for that.

    The median of chi-square is below its mean (approximation of Wilson and Hilferty).
    """
    if variances.size < FEWEST_BRIGHT:
        return float(variances.mean())
    lower_median = float(np.sort(variances)[(variances.size - 1) // 2])
    return lower_median / (1.0 - 2.0 / (9.0 * degrees)) ** 3


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
