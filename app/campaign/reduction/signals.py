"""Signals: photocurrents over the monitor's current, by photodiode, with the dark readings subtracted; each with its variance.

Noise: the scatter of each channel's readings within a dark reading, pooled over all dark readings of a gain, and at least the
variance of the converter's step; the light adds its own shot noise. Between two dark readings the dark counts are interpolated
linearly in time, which follows a drift to first order.

Two further steps: `add_tracing_error` adds the Monte Carlo error of a virtual rig with ray-traced light, which no real
instrument has. `divide_by_etalon` is the quotient of formula 1: a sample's signals over the etalon's, by photodiode, the
instrument signature subtracted from both.
"""

from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.campaign.journal.record import CommittedRow, Reading, RowData
from goniotwin.app.campaign.readout import saturation
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, RigFile
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.drivers import PhotodiodeSettings

ELEMENTARY_CHARGE_C = 1.602176634e-19
MIN_FREEDOM = 3.0
"""Degrees of freedom of the dark readings: with fewer the noise is not known."""
DARK_CURRENT_NOISE = 10.0
"""A dark current is detectable where it is above so many times the noise of one reading; only then can its loss be seen."""
DETECTED = 5.0
"""A photodiode has light where its signal is above so many standard uncertainties."""
QUANTISATION = 1.0 / 12.0
"""Variance of a converter's step, in steps squared."""


@dataclass(frozen=True)
class Signal:
    """A row's photocurrents over the monitor's current, one element for each photodiode.

    `variance` is that of the noise. `gain` is the index of the gain that is used, -1 where all gains are saturated.
    """

    ratio: Floats
    variance: Floats
    gain: Ints

    @property
    def clipped(self) -> Flags:
        """The photodiodes that are saturated at each gain."""
        return self.gain < 0


class DarkReadings:
    """All dark readings of a journal at one gain. Raises UserError if they are too few for the noise."""

    def __init__(self, readings: list[Reading], settings: PhotodiodeSettings) -> None:
        converter = settings.range
        self._times = np.array([middle_s(each) for each in readings])
        self._means = np.array([each.counts.mean(axis=0) for each in readings])
        self._monitor_a = np.array([each.monitor_a for each in readings])
        self._readings = np.array([independent_conversions(each) for each in readings])
        freedom = float(np.sum([len(each.counts) - 1 for each in readings]))
        if freedom < MIN_FREEDOM:
            raise UserError(
                f"the dark readings have {freedom:.0f} degrees of freedom in all; the noise needs {MIN_FREEDOM:.0f}; "
                "increase dark_readings in the schedule"
            )
        scatter = sum((((each.counts - each.counts.mean(axis=0)) ** 2).sum(axis=0) for each in readings), np.float64(0.0))
        # The scatter of few readings is itself uncertain: widen the variance as Student's distribution is wider.
        pooled = scatter / freedom * freedom / (freedom - 2.0)
        self.variance_v2: Floats = np.maximum(pooled, QUANTISATION) * converter.lsb_v**2
        # Without noise as dither, the error of a mean does not fall below that of the converter's step.
        dither = np.maximum(pooled - QUANTISATION, 0.0)
        self.undithered_v2: Floats = QUANTISATION * np.exp(-4.0 * np.pi**2 * dither) * converter.lsb_v**2

    def at(self, t: float) -> tuple[Floats, float, float]:
        """At a time: mean counts (photodiodes,), the monitor's current in A, and the divisor of a reading's variance."""
        later = int(np.searchsorted(self._times, t))
        if later in (0, len(self._times)):
            k = min(later, len(self._times) - 1)
            return self._means[k], float(self._monitor_a[k]), float(self._readings[k])
        k = later - 1
        share = (t - self._times[k]) / (self._times[later] - self._times[k])
        counts = (1.0 - share) * self._means[k] + share * self._means[later]
        monitor = (1.0 - share) * self._monitor_a[k] + share * self._monitor_a[later]
        divisor = 1.0 / ((1.0 - share) ** 2 / self._readings[k] + share**2 / self._readings[later])
        return counts, float(monitor), float(divisor)


def dark_readings_by_gain(rows: list[CommittedRow], settings: PhotodiodeSettings) -> dict[float, DarkReadings]:
    """The dark readings of all rows, by gain in V/A."""
    by_gain: dict[float, list[Reading]] = defaultdict(list)
    for each in rows:
        if each.row.kind == "dark":
            for reading in each.data.readings:
                by_gain[reading.gain_v_per_a].append(reading)
    return {gain: DarkReadings(readings, settings) for gain, readings in by_gain.items()}


def signal(data: RowData, dark: dict[float, DarkReadings], settings: PhotodiodeSettings) -> Signal:
    """The signal of a row: each photodiode at its highest gain that is not saturated.

    The dark readings are subtracted, and the photocurrents divided by the monitor's current. Raises UserError for a gain
    without a dark reading, for a gain that the rig does not have, and for a monitor without light.
    """
    ratio = np.full(settings.count, np.nan)
    variance = np.full(settings.count, np.nan)
    used = np.full(settings.count, -1)
    bandwidth = 0.5 / settings.period_s
    for reading in data.readings:
        gain = reading.gain_v_per_a
        if gain not in settings.gains_v_per_a:
            raise UserError(f"a reading was made at {gain:g} V/A, a gain that the rig does not have")
        if gain not in dark:
            raise UserError(f"the journal has no dark reading at {gain:g} V/A, so readings at this gain cannot be reduced")
        dark_counts, dark_monitor, dark_divisor = dark[gain].at(middle_s(reading))
        volts = (reading.counts.mean(axis=0) - dark_counts) * settings.range.lsb_v
        current = volts / gain
        noise = dark[gain].variance_v2 / gain**2
        shot = 2.0 * ELEMENTARY_CHARGE_C * np.abs(current) * bandwidth
        monitor = reading.monitor_a - dark_monitor
        if not monitor > 0.0:
            raise UserError("the monitor has no light in a row measured with the shutter open; check its fibre")
        usable = ~saturation(reading.counts)
        better = usable & (gain > np.where(used >= 0, np.array(settings.gains_v_per_a)[used], 0.0))
        ratio[better] = (current / monitor)[better]
        scatter = (noise + shot) / independent_conversions(reading) + noise / dark_divisor
        steps = 2.0 * dark[gain].undithered_v2 / gain**2
        variance[better] = ((scatter + steps) / monitor**2)[better]
        used[better] = settings.gains_v_per_a.index(gain)
    return Signal(ratio, variance, used)


def mean_signal(signals: list[Signal]) -> Signal:
    """Mean of repeated measurements of one pose; saturated where any of them is. The gain is that of the first one."""
    first, n = signals[0], len(signals)
    ratio = np.mean([each.ratio for each in signals], axis=0)
    variance = np.sum([each.variance for each in signals], axis=0) / n**2
    clipped_once = np.any([each.clipped for each in signals], axis=0)
    return first if n == 1 else Signal(ratio, variance, np.where(clipped_once, -1, first.gain))


def dark_current_loss_s(rows: list[CommittedRow], settings: PhotodiodeSettings) -> Floats:
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
    zero = -settings.range.low_v / settings.range.lsb_v
    first = taken[0].counts.mean(axis=0) - zero
    detectable = np.abs(first) > DARK_CURRENT_NOISE * np.sqrt(np.maximum(taken[0].counts.var(axis=0), 1.0))
    last = middle_s(taken[0])
    for reading in taken[1:]:
        lost = detectable & (np.abs(reading.counts.mean(axis=0) - zero) < 0.5 * np.abs(first))
        since = np.where(lost, np.minimum(since, last), since)
        last = middle_s(reading)
    return since


def independent_conversions(reading: Reading) -> int:
    """Number of readings from different conversions: a reading equal to the one before on all channels is a repeat."""
    return 1 + int(np.any(reading.counts[1:] != reading.counts[:-1], axis=1).sum())


def middle_s(reading: Reading) -> float:
    """The time in the middle of a reading, s."""
    return reading.first_s + 0.5 * (len(reading.counts) - 1) * reading.period_s


def tracing_error(rig: RigFile) -> float | None:
    """Median over the photodiodes of the relative standard error of ray-traced light; None for a rig without it."""
    if rig.twin is None or rig.twin.optics.estimator != "forward":
        return None
    return rig.twin.optics.forward_error


def add_tracing_error(signal: Signal, rig: RigFile) -> Signal:
    """Add the variance of the ray paths to a row's signal.

    The paths are counted as photons are, so that their variance is proportional to the signal. The rig file states the error
    of the median of the photodiodes with light. For a lobe that is sampled in several ways the tails are better known than
    this estimate.
    """
    error = tracing_error(rig)
    lit = signal.ratio > DETECTED * np.sqrt(signal.variance)
    if error is None or not lit.any():
        return signal
    paths = error**2 * float(np.median(signal.ratio[lit])) * np.abs(signal.ratio)
    return replace(signal, variance=signal.variance + paths)


@dataclass(frozen=True)
class EtalonRatio:
    """Sample over etalon, by photodiode (n,), the instrument signature subtracted from both.

    `value`, with its `variance` from noise and a further `relative_variance` from monitor and gain; `sample` and `etalon` are
    the two signals, with the variances `var_sample` and `var_etalon`. `signature` is the signature's share of the sample's
    signal, NaN where it was not measured.
    """

    value: Floats
    variance: Floats
    relative_variance: Floats
    sample: Floats
    var_sample: Floats
    etalon: Floats
    var_etalon: Floats
    clipped: Flags
    signature: Floats


def divide_by_etalon(
    rig: RigDescription,
    sample: Signal,
    etalon: Signal,
    signature: Signal | None,
    signature_at_etalon: Signal | None,
    *,
    channels: Ints,
) -> EtalonRatio:
    """Divide a sample's signals by the etalon's, for the photodiodes `channels`; subtract the signature of either pose first.

    `signature` and `signature_at_etalon` are None where they were not measured; nothing is subtracted then.
    """
    c = channels
    g, var_g, clipped_g = _at_channels(signature, c)
    h, var_h, clipped_h = _at_channels(signature_at_etalon, c)
    total = sample.ratio[c]
    # With a sample mounted the signature is not quite what it is without one.
    u_signature = rig.file.sample_unit.signature_uncertainty
    s, var_s = total - g, sample.variance[c] + var_g + (u_signature * g) ** 2
    e, var_e = etalon.ratio[c] - h, etalon.variance[c] + var_h + (u_signature * h) ** 2
    value = s / np.where(e == 0.0, np.nan, e)
    # The same signature subtracted from both has one common error.
    shared = 2.0 * value * var_g if signature is signature_at_etalon else 0.0
    variance = (var_s + value**2 * var_e - shared) / e**2
    monitor = 2.0 * rig.file.monitor.relative_uncertainty**2
    other_gain = sample.gain[c] != etalon.gain[c]
    gain = np.where(other_gain, 2.0 * rig.file.photodiodes.gain_uncertainty**2, 0.0)
    saturated = sample.clipped[c] | etalon.clipped[c] | clipped_g | clipped_h
    share = np.full(len(c), np.nan) if signature is None else g / np.where(total == 0.0, np.nan, total)
    return EtalonRatio(value, variance, monitor + gain, s, var_s, e, var_e, saturated, share)


def _at_channels(signature: Signal | None, channels: Ints) -> tuple[Floats, Floats, Flags]:
    """Signal, variance and saturation of the photodiodes `channels`; zeros without a signature."""
    if signature is None:
        return np.zeros(len(channels)), np.zeros(len(channels)), np.zeros(len(channels), dtype=bool)
    return signature.ratio[channels], signature.variance[channels], signature.clipped[channels]
