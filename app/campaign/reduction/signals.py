"""From raw counts to photocurrents over the monitor's: dark and gain removed, each with its variance.

The noise of a reading is taken from the darks: the scatter of each channel within a row, pooled over all of them, never
less than the converter's step allows; light adds its own shot noise. The dark between two darks is on the line between
them, which follows a drift to first order.

What a virtual rig adds to its readings that no instrument has: the Monte Carlo error of light that was traced.

Formula 1's ratio: a sample's signals over the etalon's, by photodiode, each without the instrument's own light.
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
LEAST_FREEDOM = 3.0
GONE_BELOW = 10.0
"""A dark current that is no more than so many times the noise of one reading cannot be missed."""
QUANTISATION = 1.0 / 12.0
"""Variance of a converter's step, in steps squared."""


@dataclass(frozen=True)
class Signal:
    """A row's photocurrents over the monitor's current, one element a photodiode.

    `variance` is that of the noise; `gain` the number of the gain that was kept, -1 where every one was clipped.
    """

    ratio: Floats
    variance: Floats
    gain: Ints

    @property
    def clipped(self) -> Flags:
        """Which photodiodes were over the range at each gain."""
        return self.gain < 0


class Darks:
    """All darks of a journal at one gain."""

    def __init__(self, readings: list[Reading], settings: PhotodiodeSettings) -> None:
        converter = settings.range
        self._times = np.array([middle(each) for each in readings])
        self._means = np.array([each.counts.mean(axis=0) for each in readings])
        self._monitor_a = np.array([each.monitor_a for each in readings])
        self._readings = np.array([independent(each) for each in readings])
        freedom = float(np.sum([len(each.counts) - 1 for each in readings]))
        if freedom < LEAST_FREEDOM:
            raise UserError(f"its darks have {freedom:.0f} spare readings in all; the noise needs {LEAST_FREEDOM:.0f}")
        scatter = sum((((each.counts - each.counts.mean(axis=0)) ** 2).sum(axis=0) for each in readings), np.float64(0.0))
        # Few readings know their own scatter badly: what they say of it is widened as Student's distribution is.
        pooled = scatter / freedom * freedom / (freedom - 2.0)
        self.variance_v2: Floats = np.maximum(pooled, QUANTISATION) * converter.lsb_v**2
        # A mean does not get better than the converter's step where there is no noise to dither it.
        dither = np.maximum(pooled - QUANTISATION, 0.0)
        self.undithered_v2: Floats = QUANTISATION * np.exp(-4.0 * np.pi**2 * dither) * converter.lsb_v**2

    def at(self, t: float) -> tuple[Floats, float, float]:
        """At a time: mean counts (photodiodes,), the monitor's current, and by what the variance of a reading is divided."""
        later = int(np.searchsorted(self._times, t))
        if later in (0, len(self._times)):
            k = min(later, len(self._times) - 1)
            return self._means[k], float(self._monitor_a[k]), float(self._readings[k])
        k = later - 1
        share = (t - self._times[k]) / (self._times[later] - self._times[k])
        counts = (1.0 - share) * self._means[k] + share * self._means[later]
        monitor = (1.0 - share) * self._monitor_a[k] + share * self._monitor_a[later]
        divided = 1.0 / ((1.0 - share) ** 2 / self._readings[k] + share**2 / self._readings[later])
        return counts, float(monitor), float(divided)


def darks_by_gain(rows: list[CommittedRow], settings: PhotodiodeSettings) -> dict[float, Darks]:
    """The darks of all rows, by gain in V/A."""
    found: dict[float, list[Reading]] = defaultdict(list)
    for each in rows:
        if each.row.kind == "dark":
            for reading in each.data.readings:
                found[reading.gain_v_per_a].append(reading)
    return {gain: Darks(readings, settings) for gain, readings in found.items()}


def signal(data: RowData, darks: dict[float, Darks], settings: PhotodiodeSettings) -> Signal:
    """Each photodiode at its highest unclipped gain. Raises UserError for a gain without a dark."""
    ratio = np.full(settings.count, np.nan)
    variance = np.full(settings.count, np.nan)
    kept = np.full(settings.count, -1)
    bandwidth = 0.5 / settings.period_s
    for reading in data.readings:
        gain = reading.gain_v_per_a
        if gain not in settings.gains_v_per_a:
            raise UserError(f"a reading was made at {gain:g} V/A, a gain that the rig does not have")
        if gain not in darks:
            raise UserError(f"there is no dark at {gain:g} V/A in the journal, so nothing measured there can be reduced")
        dark_counts, dark_monitor, dark_readings = darks[gain].at(middle(reading))
        volts = (reading.counts.mean(axis=0) - dark_counts) * settings.range.lsb_v
        current = volts / gain
        noise = darks[gain].variance_v2 / gain**2
        shot = 2.0 * ELEMENTARY_CHARGE_C * np.abs(current) * bandwidth
        monitor = reading.monitor_a - dark_monitor
        if not monitor > 0.0:
            raise UserError("the monitor saw no light in a row that was measured with the shutter open; is its fibre in?")
        good = ~saturation(reading.counts)
        better = good & (gain > np.where(kept >= 0, np.array(settings.gains_v_per_a)[kept], 0.0))
        ratio[better] = (current / monitor)[better]
        scatter = (noise + shot) / independent(reading) + noise / dark_readings
        steps = 2.0 * darks[gain].undithered_v2 / gain**2
        variance[better] = ((scatter + steps) / monitor**2)[better]
        kept[better] = settings.gains_v_per_a.index(gain)
    return Signal(ratio, variance, kept)


def mean_signal(signals: list[Signal]) -> Signal:
    """Of one pose, measured several times; clipped where it was once. The gain is the first one's."""
    first, n = signals[0], len(signals)
    ratio = np.mean([each.ratio for each in signals], axis=0)
    variance = np.sum([each.variance for each in signals], axis=0) / n**2
    clipped_once = np.any([each.clipped for each in signals], axis=0)
    return first if n == 1 else Signal(ratio, variance, np.where(clipped_once, -1, first.gain))


def dead_since(rows: list[CommittedRow], settings: PhotodiodeSettings) -> Floats:
    """From when on each photodiode (n,) has lost its dark current, and so gives none at all: s on the rig's clock, inf where
    it never has. It is the time of the last dark that still had it; said only where it stands out from the noise.
    """
    since = np.full(settings.count, np.inf)
    darks = [reading for each in rows if each.row.kind == "dark" for reading in each.data.readings]
    if not darks:
        return since
    highest = max(reading.gain_v_per_a for reading in darks)
    taken = [reading for reading in darks if reading.gain_v_per_a == highest]
    zero = -settings.range.low_v / settings.range.lsb_v
    first = taken[0].counts.mean(axis=0) - zero
    shows = np.abs(first) > GONE_BELOW * np.sqrt(np.maximum(taken[0].counts.var(axis=0), 1.0))
    last = middle(taken[0])
    for reading in taken[1:]:
        gone = shows & (np.abs(reading.counts.mean(axis=0) - zero) < 0.5 * np.abs(first))
        since = np.where(gone, np.minimum(since, last), since)
        last = middle(reading)
    return since


def independent(reading: Reading) -> int:
    """How many of its readings are of conversions of their own: one that repeats the one before tells nothing new."""
    return 1 + int(np.any(reading.counts[1:] != reading.counts[:-1], axis=1).sum())


def middle(reading: Reading) -> float:
    """The time in the middle of a reading, s."""
    return reading.first_s + 0.5 * (len(reading.counts) - 1) * reading.period_s


DETECTED = 5.0


def tracing_error(rig: RigFile) -> float | None:
    """Relative standard error to which half of the photodiodes are known; None where nothing is traced, or nobody says so."""
    if rig.twin is None or rig.twin.optics.estimator != "forward":
        return None
    return rig.twin.optics.forward_error


def with_tracing_error(found: Signal, rig: RigFile) -> Signal:
    """A row's signal with the variance of the paths: these are counted as photons are, so it goes as the signal.

    That of the median of the photodiodes that get light is stated in the rig file. Where a lobe is drawn in several ways its
    tails are known better than this says.
    """
    error = tracing_error(rig)
    lit = found.ratio > DETECTED * np.sqrt(found.variance)
    if error is None or not lit.any():
        return found
    paths = error**2 * float(np.median(found.ratio[lit])) * np.abs(found.ratio)
    return replace(found, variance=found.variance + paths)


@dataclass(frozen=True)
class Ratio:
    """Sample over etalon, both without the signature: `value` with the `variance` of noise and what is relative to it."""

    value: Floats
    variance: Floats
    relative_variance: Floats
    sample: Floats
    var_sample: Floats
    etalon: Floats
    var_etalon: Floats
    clipped: Flags
    signature: Floats

    @classmethod
    def of(
        cls, rig: RigDescription, sample: Signal, etalon: Signal, own: Signal | None, at_etalon: Signal | None, *, c: Ints
    ) -> "Ratio":
        """Of the photodiodes `c`."""
        g, var_g, cut_g = _taken(own, c)
        h, var_h, cut_h = _taken(at_etalon, c)
        total = sample.ratio[c]
        # With a sample in its place the instrument's own light is not quite what it is without.
        other = rig.file.sample_unit.signature_uncertainty
        s, var_s = total - g, sample.variance[c] + var_g + (other * g) ** 2
        e, var_e = etalon.ratio[c] - h, etalon.variance[c] + var_h + (other * h) ** 2
        value = s / np.where(e == 0.0, np.nan, e)
        # What is subtracted from both is one and the same error.
        shared = 2.0 * value * var_g if own is at_etalon else 0.0
        variance = (var_s + value**2 * var_e - shared) / e**2
        monitor = 2.0 * rig.file.monitor.relative_uncertainty**2
        other_gain = sample.gain[c] != etalon.gain[c]
        gain = np.where(other_gain, 2.0 * rig.file.photodiodes.gain_uncertainty**2, 0.0)
        clipped = sample.clipped[c] | etalon.clipped[c] | cut_g | cut_h
        share = np.full(len(c), np.nan) if own is None else g / np.where(total == 0.0, np.nan, total)
        return cls(value, variance, monitor + gain, s, var_s, e, var_e, clipped, share)


def _taken(signature: Signal | None, c: Ints) -> tuple[Floats, Floats, Flags]:
    if signature is None:
        return np.zeros(len(c)), np.zeros(len(c)), np.zeros(len(c), dtype=bool)
    return signature.ratio[c], signature.variance[c], signature.clipped[c]
