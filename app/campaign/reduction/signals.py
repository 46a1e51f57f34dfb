"""Signals of rows, in named steps: dark readings, photocurrent, monitor, choice of the gain; and their mean over repeats.

The steps take the readings of many rows at once, and a row alone as one of many: there is no other formula for it.

Noise: the scatter of each channel's readings within a dark reading, pooled over all dark readings of a gain, and at least the
variance of the converter's step; the light adds its own shot noise. Between two dark readings the dark counts are interpolated
linearly in time, which follows a drift to first order. The components are `noise` of the lit readings, `dark` of the dark
readings, `resolution` of the converter, and for a virtual rig with ray-traced light `ray_tracing`, the Monte Carlo error.
"""

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from goniotwin.app.campaign.measurement_model.quantity import NONE, Quantity
from goniotwin.app.campaign.readout import QUANTISATION_VARIANCE
from goniotwin.app.campaign.reduction.components import Signal
from goniotwin.app.campaign.reduction.reading_inputs import Numbers
from goniotwin.app.campaign.row import CONTRADICTION, CommittedRow, Reading, ReadingTable
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigFile
from goniotwin.app.rig.inputs import CROSSTALK
from goniotwin.arrays import Counts, Flags, Floats, Indices, Ints
from goniotwin.drivers import ConverterDescription

MIN_FREEDOM = 3.0
"""Degrees of freedom of the dark readings: with fewer the noise is not known."""
DARK_CURRENT_NOISE = 10.0
"""A dark current is detectable where it is above so many times the noise of one reading; only then can its loss be seen."""
LATEST_S = 1e12
"""A time on a rig's clock is below: thirty thousand years."""
COPY = "use a copy of the journal, if there is one"
BEYOND_RANGE = 1.5
"""An amplifier on supplies of 15 V gives up to so many times the range of a converter that it saturates."""
LIGHT = 5.0
"""A photodiode has light where its signal is above so many standard uncertainties."""
MOST_VALUES = 1 << 20
"""Counts that are in memory together, as numbers of eight bytes, several times."""


@dataclass(frozen=True)
class DarkReadings:
    """All dark readings of a journal at one gain, by their `numbers` (k,): time in the middle, mean counts (k, photodiodes),
    the monitor's current, and the number of readings from different conversions.

    `variance_v2` is that of one reading's noise, from `freedom` degrees of freedom, `undithered_v2` that of the converter's
    step which no mean reduces.
    """

    numbers: Ints
    times: Floats
    means: Floats
    monitor_a: Floats
    readings: Ints
    freedom: float
    variance_v2: Floats
    undithered_v2: Floats

    @classmethod
    def of(cls, numbered: Sequence[tuple[int, Reading]], settings: ConverterDescription) -> Self:
        """Those of readings, of which there is at least one. Raises UserError if they are too few for the noise."""
        converter, readings = settings.range, [each for _, each in numbered]
        freedom = float(np.sum([len(each.counts) - 1 for each in readings]))
        if freedom < MIN_FREEDOM:
            raise UserError(
                f"the dark readings have {freedom:.0f} degrees of freedom in all; the noise needs {MIN_FREEDOM:.0f}; "
                "increase dark_readings in the schedule"
            )
        scatter = sum((((each.counts - each.counts.mean(axis=0)) ** 2).sum(axis=0) for each in readings), np.float64(0.0))
        # The scatter of few readings is itself uncertain: widen the variance as Student's distribution is wider.
        pooled = scatter / freedom * freedom / (freedom - 2.0)
        # Without noise as dither, the error of a mean does not fall below that of the converter's step.
        dither = np.maximum(pooled - QUANTISATION_VARIANCE, 0.0)
        return cls(
            np.array([number for number, _ in numbered]),
            np.array([middle_s(each) for each in readings]),
            np.array([each.counts.mean(axis=0) for each in readings]),
            np.array([each.monitor_a for each in readings]),
            np.array([independent_conversions(each.counts) for each in readings]),
            freedom,
            np.maximum(pooled, QUANTISATION_VARIANCE) * converter.lsb_v**2,
            QUANTISATION_VARIANCE * np.exp(-4.0 * np.pi**2 * dither) * converter.lsb_v**2,
        )

    def interval(self, t: Floats) -> Ints:
        """The number of the dark reading before a time, or of the one before the last; at least 0."""
        return np.clip(np.searchsorted(self.times, t) - 1, 0, max(len(self.times) - 2, 0))

    def at(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """At times (...): mean counts (..., photodiodes), the monitor's current in A, the divisor of a reading's variance."""
        weight, which = self._weights(t)
        counts = np.einsum("...k,...kc->...c", weight, self.means[which])
        monitor = np.einsum("...k,...k->...", weight, self.monitor_a[which])
        return counts, monitor, 1.0 / np.einsum("...k,...k->...", weight, weight / self.readings[which])

    def shares(self, t: Floats) -> tuple[Ints, Floats]:
        """At times (...), of the dark readings before and after: numbers (..., 2), NONE for one that does not count there.

        With them what one of these adds to what is subtracted, for a standard uncertainty of one reading's noise (..., 2).
        """
        weight, which = self._weights(t)
        return np.where(weight > 0.0, self.numbers[which], NONE), weight / np.sqrt(self.readings[which])

    def _weights(self, t: Floats) -> tuple[Floats, Ints]:
        """The weights (..., 2) of the dark readings before and after a time, and which these are."""
        before = self.interval(np.asarray(t))
        after = np.minimum(before + 1, len(self.times) - 1)
        between = self.times[after] - self.times[before]
        share = np.clip((t - self.times[before]) / np.where(between > 0.0, between, np.inf), 0.0, 1.0)
        return np.stack([1.0 - share, share], axis=-1), np.stack([before, after], axis=-1)


def check_reading(reading: Reading, settings: ConverterDescription) -> None:
    """Raise UserError for counts without readings, or of another number of photodiodes than the rig's; for a time or a current
    of the monitor that cannot be.
    """
    readings, channels = reading.counts.shape
    if readings < 1 or channels != settings.count:
        wrong = f"a row has counts of {readings} readings of {channels} photodiodes; the rig has {settings.count} of these"
        raise UserError(f"{wrong}: {COPY}")
    if not abs(middle_s(reading)) < LATEST_S:
        raise UserError(f"a row has readings at the time {reading.first_s:g} s: {COPY}")
    if not math.isfinite(reading.monitor_a):
        raise UserError(f"a row has a monitor current of {reading.monitor_a:g} A: {COPY}")


def dark_readings_by_gain(rows: list[CommittedRow], settings: ConverterDescription) -> dict[float, DarkReadings]:
    """The dark readings of all rows, by gain in V/A, numbered from 1 on. Raises UserError where they cannot be the rig's."""
    by_gain: dict[float, list[tuple[int, Reading]]] = defaultdict(list)
    for number, each in enumerate((each for each in rows if each.row.kind == "dark"), 1):
        for reading in each.data.readings:
            check_reading(reading, settings)
            by_gain[reading.gain_v_per_a].append((number, reading))
    return {gain: DarkReadings.of(readings, settings) for gain, readings in by_gain.items()}


@dataclass(frozen=True)
class RowReadings:
    """Readings of `rows` (k,), by their places in a list, at one gain: counts (k, readings, photodiodes).

    `numbers` (k,) are the rows' numbers in the journal.
    `middle_s` (k,) is the time in the middle of each reading on the rig's clock, `monitor_a` (k,) the monitor's current.
    """

    rows: Ints
    numbers: Ints
    gain_v_per_a: float
    counts: Counts
    middle_s: Floats
    monitor_a: Floats

    def input_numbers(self, rig: RigFile) -> Indices:
        """The numbers (k, 1, 1) of the inputs that all photodiodes of these readings share."""
        gain = np.array(rig.photodiodes.gains_v_per_a.index(self.gain_v_per_a))
        return Numbers.of(rig).row(self.numbers, gain)[:, None, None]

    @cached_property
    def conversions(self) -> Ints:
        """Numbers (k, 1) of readings from different conversions."""
        return independent_conversions(self.counts)[:, None]

    def saturated(self, settings: ConverterDescription) -> Flags:
        """The photodiodes (k, n) that are saturated in any of the readings."""
        return np.asarray(np.any(settings.range.saturated(self.counts), axis=1))


def group_readings(table: ReadingTable, numbers: Ints) -> Iterator[RowReadings]:
    """The readings of rows, of such `numbers` (rows,), those of one gain and of one count together, some rows at a time."""
    times = middles_s(table)
    keys = np.stack([table.gain_v_per_a, table.readings, table.channels])
    for found in alike(keys):
        gain, readings, channels = keys[:, found[0]].tolist()
        at_once = max(1, MOST_VALUES // int(readings * channels))
        for begin in range(0, found.size, at_once):
            here = found[begin : begin + at_once]
            yield RowReadings(
                rows=table.row[here],
                numbers=numbers[table.row[here]],
                gain_v_per_a=gain,
                counts=table.counts_of(here, int(readings)),
                middle_s=times[here],
                monitor_a=table.monitor_a[here],
            )


def alike(keys: Floats | Ints) -> list[Ints]:
    """The indices of equal columns of keys (m, n): a list for each different one, in the order of its first."""
    if not keys.shape[1] or (keys == keys[:, :1]).all():
        return [np.arange(keys.shape[1])] if keys.shape[1] else []
    _, first, which = np.unique(keys, axis=1, return_index=True, return_inverse=True)
    return [np.flatnonzero(which.ravel() == k) for k in np.argsort(first).tolist()]


def middles_s(table: ReadingTable) -> Floats:
    """The times (n,) in the middle of readings, s."""
    with np.errstate(invalid="ignore", over="ignore"):  # of times that cannot be; `check_reading` refuses these
        return np.asarray(table.first_s + 0.5 * (table.readings - 1) * table.period_s)


def check_readings(table: ReadingTable, dark: Mapping[float, DarkReadings], settings: ConverterDescription) -> None:
    """Raise UserError for readings that cannot be reduced: at a gain without a dark reading, or as `check_reading`."""
    sound = bool(np.all(np.abs(middles_s(table)) < LATEST_S) and np.all(np.isfinite(table.monitor_a)))
    sound = sound and bool(np.all(table.readings > 0) and np.all(table.channels == settings.count))
    if sound and all(gain in settings.gains_v_per_a and gain in dark for gain in np.unique(table.gain_v_per_a).tolist()):
        return
    for k in range(table.row.size):
        reading = table.reading(k)
        check_reading(reading, settings)
        if reading.gain_v_per_a not in settings.gains_v_per_a:
            raise UserError(f"a reading was made at {reading.gain_v_per_a:g} V/A, a gain that the rig does not have")
        if reading.gain_v_per_a not in dark:
            gain = f"{reading.gain_v_per_a:g} V/A"
            raise UserError(f"the journal has no dark reading at {gain}, so readings at this gain cannot be reduced")


def subtract_dark(readings: RowReadings, dark: DarkReadings, settings: ConverterDescription) -> Quantity:
    """The mean voltages (k, n) of readings above the dark reading at their time."""
    dark_counts, _, _ = dark.at(readings.middle_s)
    volts = (readings.counts.mean(axis=1) - dark_counts) * settings.range.lsb_v
    number, share = dark.shares(readings.middle_s)
    gain = settings.gains_v_per_a.index(readings.gain_v_per_a)
    member = np.moveaxis(Numbers(settings.count, len(settings.gains_v_per_a)).dark(number, gain), 1, 2)
    known = (number != NONE)[:, None, :]
    resolution = np.broadcast_to(2.0 * dark.undithered_v2, volts.shape)  # of the lit and of the dark reading
    own = {"noise": dark.variance_v2 / readings.conversions, "resolution": resolution}
    effect = -share[:, None, :] * np.sqrt(dark.variance_v2)[:, None]
    return Quantity(volts, own).with_grouped("dark", np.where(known, member, np.int32(NONE)), effect)


def add_crosstalk(volts: Quantity, readings: RowReadings, settings: ConverterDescription, u_crosstalk: Floats) -> Quantity:
    """The voltages with the effect of the input `crosstalk`: the share of what the module's other channels have."""
    return volts.with_common(CROSSTALK.name, u_crosstalk * others_volts(volts.value, readings.saturated(settings), settings))


def others_volts(volts: Floats, clipped: Flags, settings: ConverterDescription) -> Floats:
    """The voltages (..., photodiodes) of the other channels of each one's module together; saturated ones count as more."""
    held = np.where(clipped, BEYOND_RANGE * volts, volts)
    first = np.arange(0, settings.count, settings.module_channels)
    sizes = np.diff(np.append(first, settings.count))
    return np.asarray(np.repeat(np.add.reduceat(held, first, axis=-1), sizes, axis=-1) - held)


def convert_to_photocurrent(volts: Quantity, readings: RowReadings, settings: ConverterDescription) -> Quantity:
    """The photocurrents in A of voltages; with them comes the shot noise of the light."""
    current = volts.scaled(1.0 / readings.gain_v_per_a)
    shot_a2 = settings.shot_variance_a2(current.value)
    return current.with_own("noise", shot_a2 / readings.conversions)


def divide_by_monitor(current: Quantity, readings: RowReadings, dark: DarkReadings, rig: RigFile) -> Quantity:
    """Photocurrents over the monitor's current, with the effect of its reading.

    Raises UserError for a monitor without light.
    """
    _, dark_monitor, _ = dark.at(readings.middle_s)
    monitor = readings.monitor_a - dark_monitor
    if not np.all(monitor > 0.0):
        raise UserError("the monitor has no light in a row measured with the shutter open; check its fibre")
    signal = current.scaled(1.0 / monitor[:, None])
    effect = -rig.monitor.relative_uncertainty * signal.value
    return signal.with_grouped("monitor", readings.input_numbers(rig), effect[..., None])


def choose_gain(at_gains: list[tuple[RowReadings, Quantity]], rows: int, settings: ConverterDescription) -> Signal:
    """Of so many rows, each photodiode's value at its highest gain that is not saturated; NaN where all are."""
    used = np.full((rows, settings.count), -1)
    gains = np.array([*settings.gains_v_per_a, 0.0])  # the last one, at index -1, is no gain
    columns: dict[str, NDArray[Any]] = {}
    for readings, quantity in at_gains:
        at = readings.rows
        better = ~readings.saturated(settings) & (readings.gain_v_per_a > gains[used[at]])
        for name, column in quantity.columns().items():
            if name not in columns:
                none = NONE if column.dtype.kind == "i" else np.nan
                columns[name] = np.full((*used.shape, *column.shape[2:]), none, dtype=column.dtype)
            chosen = better if column.ndim == 2 else better[..., None]
            columns[name][at] = np.where(chosen, column, columns[name][at])
        used[at] = np.where(better, settings.gains_v_per_a.index(readings.gain_v_per_a), used[at])
    found = at_gains[0][1].of_columns(columns) if columns else Quantity(np.full(used.shape, np.nan))
    return Signal.of(found, used)


def signals_of_rows(signals: Signal) -> list[Signal]:
    """The signal of each row, from those (rows, photodiodes) of all."""
    return [signals.each(itemgetter(k)) for k in range(len(signals.value))]


def stack_signals(rows: Sequence[Signal]) -> Signal:
    """The signals (rows, photodiodes) of all rows, of which there is at least one, from that of each."""
    return Signal.join([each.each(lambda array: array[None]) for each in rows])


def mean_signals(signals: Signal, repeats: Ints) -> Signal:
    """Means of repeated measurements of poses: `repeats` (poses, n) are the rows of each pose.

    A photodiode is saturated where it is so in any of them. The gain is that of the first one.
    """
    first, n = signals.where(repeats[:, 0]), repeats.shape[1]
    if n == 1:
        return first
    total = Quantity(signals.value, signals.own, signals.common, signals.grouped).each(lambda array: array[repeats.T]).summed()
    gain = np.where((signals.gain[repeats] < 0).any(axis=1), -1, first.gain)
    return Signal.of(total.scaled(1.0 / n), gain)


def dark_current_loss_s(rows: list[CommittedRow], settings: ConverterDescription) -> Floats:
    """Time at which each photodiode (n,) lost its dark current, s on the rig's clock; inf for those that did not.

    A photodiode without its dark current gives no signal at all. The time is that of the last dark reading that still had the
    dark current. Only a dark current that stands out from the noise is judged.
    """
    since = np.full(settings.count, np.inf)
    readings = [reading for each in rows if each.row.kind == "dark" for reading in each.data.readings]
    if not readings:
        return since
    highest = max(reading.gain_v_per_a for reading in readings)
    taken = [reading for reading in readings if reading.gain_v_per_a == highest]
    zero = settings.range.zero
    first = taken[0].counts.mean(axis=0) - zero
    detectable = np.abs(first) > DARK_CURRENT_NOISE * np.sqrt(np.maximum(taken[0].counts.var(axis=0), 1.0))
    last = middle_s(taken[0])
    for reading in taken[1:]:
        lost = detectable & (np.abs(reading.counts.mean(axis=0) - zero) < 0.5 * np.abs(first))
        since = np.where(lost, np.minimum(since, last), since)
        last = middle_s(reading)
    return since


def contradictory_dark_intervals(rows: list[CommittedRow]) -> list[tuple[float, float]]:
    """Begin and end, s on the rig's clock, of the times in which signals are above a dark reading that contradicts itself.

    A signal is above the dark readings before and after it: so each interval reaches to the neighbours of such a reading.
    """
    dark = [each for each in rows if each.row.kind == "dark" and each.data.readings]
    starts = [-math.inf, *(each.data.started_s for each in dark), math.inf]
    return [(starts[k], starts[k + 2]) for k, each in enumerate(dark) if CONTRADICTION in each.data.flags]


def independent_conversions(counts: Counts) -> Ints:
    """Number (...) of readings (..., readings, photodiodes) from different conversions.

    A reading equal to the one before on all channels is a repeat.
    """
    return np.asarray(1 + np.any(counts[..., 1:, :] != counts[..., :-1, :], axis=-1).sum(axis=-1))


def middle_s(reading: Reading) -> float:
    """The time in the middle of a reading, s."""
    return reading.first_s + 0.5 * (len(reading.counts) - 1) * reading.period_s


def tracing_error(rig: RigFile) -> float | None:
    """Median over the photodiodes of the relative standard error of ray-traced light; None for a rig without it."""
    estimator = None if rig.twin is None else rig.twin.estimator()
    return None if estimator is None or estimator.kind != "forward" else estimator.relative_error


def add_tracing_error(signal: Signal, rig: RigFile) -> Signal:
    """Add the component `ray_tracing`, the variance of the ray paths, to rows' signals; no real instrument has it.

    The paths are counted as photons are, so that their variance is proportional to the signal. The rig file states the error
    of the median of the photodiodes with light. For a lobe that is sampled in several ways the tails are better known than
    this estimate.
    """
    error = tracing_error(rig)
    if error is None:
        return signal
    lit = signal.value > LIGHT * np.sqrt(signal.reading_variance)
    medians = [[float(np.median(value[some])) if some.any() else 0.0] for value, some in zip(signal.value, lit, strict=True)]
    return signal.with_own("ray_tracing", error**2 * np.array(medians) * np.abs(signal.value))
