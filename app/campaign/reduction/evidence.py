"""What the lit readings of a campaign show about themselves: noise, lamp, gain ratios, and whether a module can be trusted.

One pass over the rows in order of time adds to sums, so that the memory does not grow with the rows. Variances are relative: of
a photocurrent, in its square.

Scatter: a reading varies by s^2 = k e^2 + own V^2 + lamp V^2 in its volts V. e is what the dark readings and the shot noise
explain, k >= 1. `lamp` is what all photodiodes of a row have in common (the mean product of two photodiodes' deviations), `own`
the rest. Both are pooled over the campaign: the scatter of eight readings alone is too uncertain for an interval.

Gains: a row that was read at two unclipped gains gives the ratio of both, for each photodiode. These are adjusted together with
the certificate of the gains. Two gains see one photocurrent: they test amplifier and converter, never the photodiode. What does
not fit is a verdict on the module, for all its channels and rows.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.campaign.measurement_model.quantity import NONE, Quantity
from goniotwin.app.campaign.reduction.components import Signal
from goniotwin.app.campaign.reduction.points import CHANCE, plausible
from goniotwin.app.campaign.reduction.reading_inputs import Numbers, certified_gain
from goniotwin.app.campaign.reduction.signals import (
    LATEST_S,
    MOST_VALUES,
    DarkReadings,
    RowReadings,
    alike,
    middles_s,
    others_volts,
)
from goniotwin.app.campaign.row import CommittedRow, Reading, ReadingTable, reading_table
from goniotwin.app.campaign.wording import number_list
from goniotwin.app.rig import RigFile
from goniotwin.app.rig.inputs import CROSSTALK
from goniotwin.arrays import Counts, Flags, Floats, Ints
from goniotwin.drivers import ConverterDescription

WILD, WILD_NOISE = 25.0, 0.1
"""A mean is wild whose variance is so many times the expected one and that of a relative noise, which no instrument has."""
SELDOM = 0.02
"""Wild means up to this share are accidents of single readings: they have an uncertainty of their own."""
BRIGHT = 20.0
"""A mean of readings takes part in what is relative to it from so many of its standard uncertainties."""
WEIGHT_LIMIT = 1e-3
"""Relative noise below which a photodiode has no more weight: the brightest one alone shall not decide."""
NOISE_BINS = 48
"""Bins of the squared signal-to-noise ratio of a reading, each a factor of two."""
PAIR_LIMIT = 0.03
"""A pair of gains is used where its ratio is known this well, relative."""
SIGNAL_BINS = 10
"""Bins of the volts at the higher gain, each a factor of two, for a trend of a ratio against the signal."""
MOST_CONVERSIONS = 4096
"""Conversions of a reading that take part in the evidence: some copies of them are in memory together."""
CERTAIN = 5.0
"""A finding is beyond so many standard uncertainties."""
TOLERATED = 0.5
"""A finding of a smaller size than this share of the certificate's uncertainty of a gain is none: the budget has it."""
UNSEEN = TOLERATED / math.sqrt(3.0)
"""Standard uncertainty of what the tests tolerate, in the certificate's: a ratio is never better known."""
CLEARED = 0.1
"""A module is cleared of what others have where it certainly has less than this share of it."""
BEYOND = 4.0
"""Cross-talk is more than what is stated beyond so many of its u: chance makes that of one rig in 16 000."""
HELD = 1.25
"""A saturated channel has so many times the range of its converter, within a quarter: see BEYOND_RANGE of the signals."""
IMPLAUSIBLE = 0.1
"""A ratio of gains that is off by more is no gain, but a fault."""
FEWEST_ROWS, FEW_ROWS = 4, 8
"""Rows from which something is concluded, and of which it must be a few times as certain."""
FEW_DEGREES = 20.0
"""Degrees of freedom from which a photodiode's own scatter is used."""
FIT_ROUNDS = 10
MOST_WAITING = 32
"""Rows of a run that wait for the next dark reading: some 30 kB. Beyond, they count with the last one alone."""
NO_CHANGE = -1
SETTLE = "increase settling_s of [photodiodes] in the rig file, and measure again"
Tested = tuple[Floats, Floats, Floats]
"""Sizes of findings, their variances, and the numbers of independent rows."""


@dataclass(frozen=True)
class Verdict:
    """A finding on a module: `photodiodes` are all of its channels, `text` states what was found and what to do."""

    photodiodes: tuple[int, ...]
    text: str


@dataclass(frozen=True)
class LinkedGains:
    """Ratios of gains that rows have compared: logarithms `value` (pairs, photodiodes) of the real over the nominal ones.

    `weight` is an inverse variance, 0 without a ratio; `step` (pairs, gains) the change of a pair for one of each gain.
    """

    value: Floats
    weight: Floats
    step: Floats


@dataclass(frozen=True)
class SignalEvidence:
    """What a campaign's rows show of its signals; without rows what the rig file states.

    The noise of a reading is `factor` (photodiodes,) times (the expected one + `own`), and what its row has in common is
    `lamp`; `slow` is the part of a mean's own variance that its readings do not show. `deviation` (gains, photodiodes) is by
    how much the real gains are above the nominal ones, and `gains` (photodiodes, gains, modes) what the uncorrelated modes of
    their errors do to each of them, relative: the root of their covariance. `crosstalk` (photodiodes,) is the standard
    uncertainty of the share of the volts of its module's other channels: the stated one, or what was found where that is
    certainly more. `ratios` is the number of measured ratios of gains, and `worst_ratio` the largest difference of one from the
    nominal ratio, in its standard uncertainties and those of the certificate. `freedom` are the degrees of freedom of the lit
    readings' scatter, all photodiodes pooled, and `lamp_freedom` those of what a row has in common: of one photodiode. Both are
    infinite where no row has several readings: nothing then is from their scatter. `linked` are the measured
    ratios themselves.
    """

    factor: Floats
    deviation: Floats
    gains: Floats
    crosstalk: Floats
    own: float = 0.0
    lamp: float = 0.0
    slow: float = 0.0
    verdicts: tuple[Verdict, ...] = ()
    notes: tuple[str, ...] = ()
    ratios: int = 0
    worst_ratio: float = 0.0
    freedom: float = math.inf
    lamp_freedom: float = math.inf
    linked: "LinkedGains | None" = None

    @property
    def findings(self) -> tuple[str, ...]:
        """What is wrong with modules and gains, in words."""
        return (*self.notes, *(each.text for each in self.verdicts))

    @property
    def unsound(self) -> Flags:
        """The photodiodes (n,) of the modules with a verdict."""
        flags = np.zeros(self.factor.size, dtype=bool)
        for each in self.verdicts:
            flags[list(each.photodiodes)] = True
        return flags


def add_scatter(current: Quantity, readings: RowReadings, rig: RigFile, evidence: SignalEvidence) -> Quantity:
    """Photocurrents with the noise that the lit readings show, beyond what was expected: `noise`, and `lamp` of the row.

    Readings that scatter as wildly as by a count that was changed on a wire have the uncertainty that follows from these alone.
    """
    square, conversions = current.value**2, readings.conversions
    own = evidence.factor * (current.own["noise"] + evidence.own * square / conversions) + evidence.slow * square
    if readings.counts.shape[1] > 1:
        lsb_a = rig.photodiodes.range.lsb_v / readings.gain_v_per_a
        scatter = readings.counts.var(axis=1, ddof=1) * lsb_a**2 / conversions
        wild = scatter > WILD * (own + evidence.lamp * square / conversions)
        own = np.where(wild & (conversions > 1), scatter, own)
    widened = replace(current, own={**current.own, "noise": own})
    effect = current.value * np.sqrt(evidence.lamp / conversions)
    return widened.with_grouped("lamp", readings.input_numbers(rig), effect[..., None])


def correct_gain(
    current: Quantity, readings: RowReadings, settings: ConverterDescription, evidence: SignalEvidence
) -> Quantity:
    """Photocurrents over the gain that the evidence gives in place of the nominal one."""
    return current.scaled(1.0 / (1.0 + evidence.deviation[settings.gains_v_per_a.index(readings.gain_v_per_a)]))


def add_gains(signal: Signal, rig: RigFile, evidence: SignalEvidence) -> Signal:
    """The signals of rows with the effects of the gains that were used."""
    photodiode, numbers = np.arange(signal.gain.shape[1]), Numbers.of(rig)
    some = np.count_nonzero(evidence.gains, axis=-1).max()  # of one that no row has compared its own alone
    mode = np.argsort(evidence.gains == 0.0, axis=-1, kind="stable")[..., :some]
    effect = np.take_along_axis(evidence.gains, mode, axis=-1)
    member = np.where(effect != 0.0, numbers.gain(photodiode[:, None, None], mode), np.int32(NONE))
    at = photodiode, signal.gain
    return signal.with_grouped("gain", member[at], -signal.value[..., None] * effect[at])


def stated(rig: RigFile) -> SignalEvidence:
    """The rig file's statement alone: nothing beyond the dark readings' scatter, and the certificate of the gains."""
    settings = rig.photodiodes
    gains = len(settings.gains_v_per_a)
    return SignalEvidence(
        np.ones(settings.count),
        np.zeros((gains, settings.count)),
        np.broadcast_to(settings.gain_uncertainty * np.eye(gains), (settings.count, gains, gains)),
        np.full(settings.count, rig.uncertainty.u(CROSSTALK)),
    )


@dataclass
class _Block:
    """Rows of a block (rows, gains, photodiodes): volts above the dark ones, NaN where clipped or not read; and their noise.

    `others` are the volts of their module's other channels.
    """

    volts: Floats
    noise: Floats
    dark: Floats
    resolution: Floats
    others: Floats
    monitor: Floats
    middle: Floats
    conversions: Floats
    interval: Ints


@dataclass(frozen=True)
class _LitReadings:
    """Readings of one gain and one number (k,): the rows in a block, the gain that was read before in the row, and what was
    read: counts (k, readings, photodiodes), time in the middle, the monitor's current.
    """

    rows: Ints
    before: Ints
    counts: Counts
    middle_s: Floats
    monitor_a: Floats


class EvidenceSums:
    """The sums over the rows so far. `dark` are the dark readings by gain; rows that cannot be reduced do not count."""

    def __init__(self, dark: Mapping[float, DarkReadings], rig: RigFile) -> None:
        settings = rig.photodiodes
        self._dark, self._rig, self._settings = dark, rig, settings
        self._gains = np.array(settings.gains_v_per_a)
        n, gains = settings.count, self._gains.size
        self._first_of_module = np.arange(0, n, settings.module_channels)
        modules = self._first_of_module.size
        # Of the scatter, by bin of the signal-to-noise ratio: degrees of freedom, and with these the ratio of the observed to
        # the expected variance and the squared signal-to-noise ratio; the last one is of what is wild.
        self._scatter = np.zeros((4, NOISE_BINS, n))
        self._wild = np.zeros((2, n))  # numbers of means, and of wild ones
        self._common = np.zeros(2)
        # Of the difference of a first reading from the later ones, by gain, the gain before it (the last: none) and module.
        self._trend = np.zeros((6, gains, gains + 1, modules))
        self._pairs = [(low, high) for high in range(gains) for low in range(high)]
        shape = (len(self._pairs), 2, SIGNAL_BINS)
        # Of pairs, by pair, order (1: the higher gain was read last), volts and photodiode: number, weight, weighted ratio and
        # its square, squared weights, weighted resolution, weighted inverse numbers of conversions, weighted cross-talk of
        # a share of 1, and the dark readings' part, squared.
        self._linked = np.zeros((9, *shape, n))
        self._of_interval = np.zeros((*shape, n))
        self._intervals = [NO_CHANGE] * len(self._pairs)
        self._row_weights = np.zeros((2, len(self._pairs), 2, SIGNAL_BINS + 1, modules))  # the last bin: all
        self._crosstalk = _CrosstalkSums(len(self._pairs), n, settings.module_channels)

    def add(self, table: ReadingTable) -> None:
        """Add the readings of measured rows, in order of time."""
        n, gains = self._settings.count, self._gains.size
        known = {gain: k for k, gain in enumerate(self._settings.gains_v_per_a) if gain in self._dark}
        middles = middles_s(table)
        different, which = np.unique(table.gain_v_per_a, return_inverse=True)
        index = np.array([known.get(gain, NO_CHANGE) for gain in different.tolist()], dtype=np.int64)[which.ravel()]
        usable = (np.abs(middles) < LATEST_S) & (index != NO_CHANGE) & (table.readings > 0) & (table.channels == n)
        order = np.lexsort([table.first_s, table.row])
        order = order[usable[order]]  # without what cannot be reduced
        row, index = table.row[order], index[order]
        if (table.readings[order] == 1).all() and (row[1:] != row[:-1]).all():
            return  # neither a scatter nor a ratio of gains
        before = np.where(np.diff(row, prepend=-1) != 0, NO_CHANGE, np.roll(index, 1))
        shape = (table.rows, gains)
        volts, noise, dark, resolution, others = np.full((5, *shape, n), np.nan)
        interval = np.zeros(table.rows, dtype=np.int64)
        block = _Block(
            volts, noise, dark, resolution, others, np.full(shape, np.nan), np.zeros(shape), np.ones(shape), interval
        )
        counts = np.minimum(table.readings[order], MOST_CONVERSIONS)
        for found in alike(np.stack([index, counts])):
            gain, count = int(index[found[0]]), int(counts[found[0]])
            at_once = max(1, MOST_VALUES // (count * n))
            for begin in range(0, found.size, at_once):
                here = found[begin : begin + at_once]
                chosen = order[here]
                some = _LitReadings(
                    row[here], before[here], table.counts_of(chosen, count), middles[chosen], table.monitor_a[chosen]
                )
                self._add_readings(gain, some, block)
        for p, (low, high) in enumerate(self._pairs):
            between = np.isfinite(block.monitor[:, low + 1 : high]).any(axis=1)
            both = np.isfinite(block.monitor[:, low]) & np.isfinite(block.monitor[:, high]) & ~between
            if both.any():
                self._add_pairs(p, np.flatnonzero(both), block)
                self._add_crosstalk(p, np.flatnonzero(both), block)

    def _add_readings(self, gain: int, readings: _LitReadings, block: _Block) -> None:
        """Add readings of one gain and one number, and fill in the block."""
        dark, converter = self._dark[float(self._gains[gain])], self._settings.range
        counts, times, rows = readings.counts, readings.middle_s, readings.rows
        raw = counts.astype(np.float64)
        dark_counts, dark_monitor, divisor = dark.at(times)
        clipped = np.any(converter.saturated(counts), axis=1)
        volts = (raw.mean(axis=1) - dark_counts) * converter.lsb_v
        shot = self._settings.shot_variance_a2(volts / self._gains[gain]) * self._gains[gain] ** 2
        expected = dark.variance_v2 + shot
        # A reading equal to the one before on all channels is a repeat of its conversion.
        new = np.any(raw[:, 1:] != raw[:, :-1], axis=2)
        new = np.concatenate([np.ones((len(raw), 1), dtype=bool), new], axis=1)
        conversions = new.sum(axis=1)
        own_mean = np.einsum("kjc,kj->kc", raw, new) / conversions[:, None]
        deviations = (raw - own_mean[:, None]) * (converter.lsb_v * new[:, :, None])
        monitor = readings.monitor_a - dark_monitor
        block.volts[rows, gain] = np.where(clipped, np.nan, volts)
        block.noise[rows, gain] = expected / conversions[:, None]
        block.dark[rows, gain] = dark.variance_v2 / divisor[:, None]
        block.resolution[rows, gain] = 2.0 * dark.undithered_v2
        block.others[rows, gain] = others_volts(volts, clipped, self._settings)
        block.monitor[rows, gain] = np.where(monitor > 0.0, monitor, np.nan)
        block.middle[rows, gain] = times
        block.conversions[rows, gain] = conversions
        block.interval[rows] = dark.interval(times)
        if raw.shape[1] > 1:
            self._add_scatter(deviations, volts, expected, ~clipped, conversions - 1)
            self._add_trend(gain, readings.before, raw, volts, expected, clipped)

    def _add_scatter(self, deviations: Floats, volts: Floats, expected: Floats, usable: Flags, degrees: Ints) -> None:
        """Add the scatter about the mean: `deviations` (k, readings, photodiodes) in V, 0 for a repeated conversion."""
        signal = np.maximum(volts, 0.0) ** 2 / expected
        bins = np.clip(np.log2(np.maximum(signal, 1.0)).astype(np.int64), 0, NOISE_BINS - 1)
        place = (bins * volts.shape[1] + np.arange(volts.shape[1]))[usable]
        freedom = np.broadcast_to(degrees[:, None], volts.shape)
        observed = (deviations**2).sum(axis=1) / expected
        # One count that was changed on a wire is no noise of the others.
        wild = usable & (observed > WILD * freedom * (1.0 + WILD_NOISE**2 * signal))
        self._wild += usable.sum(axis=0), wild.sum(axis=0)
        tame = np.where(wild, freedom * 1.0, observed)
        for k, each in enumerate((freedom, tame, freedom * signal, observed - tame)):
            sums = np.bincount(place, weights=each[usable], minlength=NOISE_BINS * volts.shape[1])
            self._scatter[k] += sums.reshape(NOISE_BINS, -1)
        weight = _weights(volts, expected, usable & ~wild & (signal * (degrees + 1)[:, None] > BRIGHT**2))
        relative = deviations * (weight / np.where(weight > 0.0, volts, 1.0))[:, None]
        # The mean product of two photodiodes' deviations, in whatever way these are weighted.
        together = (relative.sum(axis=2) ** 2).sum() - (relative**2).sum()
        self._common += together, (degrees * (weight.sum(axis=1) ** 2 - (weight**2).sum(axis=1))).sum()

    def _add_trend(self, gain: int, before: Ints, raw: Floats, volts: Floats, expected: Floats, clipped: Flags) -> None:
        """Add the difference of the first reading from the mean of the later ones, relative: one value a module."""
        lit = ~clipped & (np.maximum(volts, 0.0) ** 2 * raw.shape[1] > BRIGHT**2 * expected)
        weight = _weights(volts, expected, lit)
        step = (raw[:, 0] - raw[:, 1:].mean(axis=1)) * self._settings.range.lsb_v / np.where(lit, volts, 1.0)
        weights = np.add.reduceat(weight, self._first_of_module, axis=1)
        steps = np.add.reduceat(weight * step, self._first_of_module, axis=1) / np.where(weights > 0.0, weights, 1.0)
        count = raw.shape[1]
        of_noise = weight**2 * expected / np.where(lit, volts, 1.0) ** 2 * (count / (count - 1))
        known = np.add.reduceat(of_noise, self._first_of_module, axis=1)
        for each in np.unique(before).tolist():
            here = before == each
            w, t = weights[here], steps[here]
            self._trend[:, gain, each] += [part.sum(axis=0) for part in (w, w * t, w**2, w**2 * t, w**2 * t**2, known[here])]

    def _add_pairs(self, p: int, rows: Ints, block: _Block) -> None:
        """Add the ratios of rows read at a pair of gains."""
        low, high = self._pairs[p]
        n = self._settings.count
        one, other = block.volts[rows, low], block.volts[rows, high]
        with np.errstate(invalid="ignore", divide="ignore"):
            # What the lower gain should give is better known from the higher one: noise does not choose.
            predicted = other * (self._gains[low] / self._gains[high])
            noise = block.noise[rows, low] / predicted**2 + block.noise[rows, high] / other**2
            dark = block.dark[rows, low] / predicted**2 + block.dark[rows, high] / other**2
            resolution = block.resolution[rows, low] / predicted**2 + block.resolution[rows, high] / other**2
            # Of both gains alike where no channel is saturated.
            crosstalk = np.abs(block.others[rows, high] / other - block.others[rows, low] / predicted)
            variance = noise + dark + resolution + (self._rig.uncertainty.u(CROSSTALK) * crosstalk) ** 2
            known = np.isfinite(one) & (one > 0.0) & (other > 0.0) & (variance < PAIR_LIMIT**2)
            ratio = np.log(predicted / one) - np.log(block.monitor[rows, high] / block.monitor[rows, low])[:, None]
            parts = (dark, resolution, crosstalk, variance, ratio)
            dark, resolution, crosstalk, variance, ratio = (np.where(known, each, 0.0) for each in parts)
        if not known.any():
            return
        full_scale = self._full_scale_v
        volts = np.maximum(np.where(known, other, full_scale), full_scale * 2.0 ** (1 - SIGNAL_BINS))
        bins = np.clip(-np.ceil(np.log2(volts / full_scale)).astype(np.int64), 0, SIGNAL_BINS - 1)
        order = (block.middle[rows, high] > block.middle[rows, low]).astype(np.int64)[:, None]
        weight = np.where(known, 1.0 / np.where(known, variance + 2.0 * self._rig.monitor.relative_uncertainty**2, 1.0), 0.0)
        place = (order * SIGNAL_BINS + bins) * n + np.arange(n)
        length = 2 * SIGNAL_BINS * n

        def summed(values: Floats, chosen: Flags = known) -> Floats:
            sums = np.bincount(place[chosen], weights=values[chosen], minlength=length)
            return np.asarray(sums, dtype=np.float64).reshape(2, SIGNAL_BINS, n)

        ones = np.ones(weight.shape)
        inverse = (1.0 / block.conversions[rows, low] + 1.0 / block.conversions[rows, high])[:, None]
        weighted = (weight * each for each in (ones, ratio, ratio**2, weight, resolution, inverse, crosstalk))
        for k, each in enumerate((ones, *weighted)):
            self._linked[k, p] += summed(each)
        # The error of a dark reading is one for all rows between two of them; of the next ones it is half the same.
        for interval in np.unique(block.interval[rows]).tolist():
            self._begin_interval(p, interval)
            here = known & (block.interval[rows] == interval)[:, None]
            self._of_interval[p] += summed(weight * np.sqrt(2.0 * dark), here)
        modules = np.arange(n) // self._settings.module_channels
        of_row = np.zeros((len(rows), SIGNAL_BINS + 1, self._first_of_module.size))
        np.add.at(of_row, (np.arange(len(rows))[:, None], bins, modules), weight)
        of_row[:, -1] = of_row.sum(axis=1)
        for each in (0, 1):
            chosen = of_row[order[:, 0] == each]
            self._row_weights[0, p, each] += chosen.sum(axis=0)
            self._row_weights[1, p, each] += (chosen**2).sum(axis=0)

    def _add_crosstalk(self, p: int, rows: Ints, block: _Block) -> None:
        """Add what the lower gain should give by the higher one, less what it gives, where a neighbour is saturated.

        Where none is, cross-talk is the same share at both gains. A saturated one gives less at the higher gain than in
        proportion: what its neighbours have of it is missing there, whatever light they have themselves.
        """
        low, high = self._pairs[p]
        to_low = float(self._gains[low] / self._gains[high])
        one, other = block.volts[rows, low], block.volts[rows, high]
        clipped = np.stack([~np.isfinite(one), ~np.isfinite(other)])
        lower = np.where(clipped[0], HELD * self._full_scale_v, one)
        higher = np.where(clipped[1], np.clip(lower / to_low, self._full_scale_v, HELD * self._full_scale_v), other)
        sums = self._crosstalk
        missing = to_low * sums.of_others(higher) - sums.of_others(lower)
        chosen = ~clipped.any(axis=0) & (sums.of_others(clipped[1] * 1.0) > 0.0)
        light = (block.monitor[rows, low] / block.monitor[rows, high])[:, None]
        seen = np.where(chosen, other, 0.0) * to_low * light
        difference = np.where(chosen, seen - one, 0.0)
        fixed = block.dark[rows, low] + block.resolution[rows, low] + (block.dark + block.resolution)[rows, high] * to_low**2
        # What is relative to a signal (noise of the light, linearity) shall not be taken for cross-talk.
        variance = block.noise[rows, low] + block.noise[rows, high] * to_low**2 + fixed + (WEIGHT_LIMIT * seen) ** 2
        weight = np.where(chosen, 1.0 / np.where(chosen, variance, 1.0), 0.0)
        fixed_v = np.sqrt(np.where(chosen, fixed, 0.0))
        for interval in np.unique(block.interval[rows]).tolist():
            here = block.interval[rows] == interval
            sums.add(p, interval, weight[here], seen[here], missing[here], difference[here], fixed_v[here])

    @property
    def _full_scale_v(self) -> float:
        converter = self._settings.range
        return (converter.highest - converter.zero) * converter.lsb_v

    def _begin_interval(self, p: int, interval: int) -> None:
        if interval != self._intervals[p]:
            self._linked[8, p] += self._of_interval[p] ** 2
            self._of_interval[p] = 0.0
            self._intervals[p] = interval

    def renew(self, dark: Mapping[float, DarkReadings]) -> None:
        """Go on with more dark readings."""
        self._dark = dark

    # What follows from the sums.

    def result(self) -> SignalEvidence:
        """What the rows so far show."""
        for p in range(len(self._pairs)):
            self._begin_interval(p, NO_CHANGE)
        # Many wild means are no accidents, but noise.
        often = self._wild[1] > SELDOM * self._wild[0]
        scatter = self._scatter[:3] + np.where(often, self._scatter[3], 0.0) * np.array([0.0, 1.0, 0.0])[:, None, None]
        factor, total = _noise_of(scatter, min((each.freedom for each in self._dark.values()), default=math.inf))
        together, weights = self._common.tolist()
        lamp = min(max(0.0, together / weights), total) if weights > 0.0 else 0.0
        of_row = 2.0 * (self._rig.monitor.relative_uncertainty**2 + lamp)
        plain = stated(self._rig)
        crosstalk, crosstalk_notes = self._found_crosstalk(of_row)
        ratios = [
            _Ratios(self._linked[:, p], self._row_weights[:, p], of_row, self._settings.module_channels, crosstalk)
            for p in range(len(self._pairs))
        ]
        verdicts = tuple(self._verdict(modules, text) for modules, text in self._findings(ratios))
        sound = ~replace(plain, verdicts=verdicts).unsound
        own = total - lamp
        slow = max([0.0, *(each.excess(own + lamp) for each in ratios)])
        noise = SignalEvidence(factor, plain.deviation, plain.gains, crosstalk, own, lamp, slow, verdicts, crosstalk_notes)
        if (degrees := scatter[0].sum(axis=0)).any():
            noise = replace(noise, freedom=float(degrees.sum()), lamp_freedom=float(degrees.max()))
        return self._adjusted(noise, ratios, sound)

    def _found_crosstalk(self, of_row: float) -> tuple[Floats, tuple[str, ...]]:
        """The uncertainty of cross-talk (photodiodes,), and a note where it is certainly more than what is stated."""
        stated_u = self._rig.uncertainty.u(CROSSTALK)
        share, u = self._crosstalk.fit(of_row)  # of each module, and of all
        with np.errstate(invalid="ignore"):
            beyond = np.abs(share) > np.hypot(BEYOND * stated_u, CERTAIN * u)
            if not beyond.any():
                return np.full(self._settings.count, stated_u), ()
            worst = float(np.max(np.abs(share[beyond])))
            # Modules of one make share what one of them has, unless their own readings show that they do not.
            cleared = np.abs(share) + CERTAIN * u < worst
        of_module = np.where(beyond, np.hypot(share, u), np.where(cleared, stated_u, worst))[:-1]
        found = np.flatnonzero(beyond[:-1]).tolist()
        some = f" (photodiodes module{'s' if len(found) > 1 else ''} {number_list(found)})" if found else ""
        text = (
            f"a channel has up to {worst:.1e} of the volts of its module's other channels{some}, where [uncertainty] states a "
            f"crosstalk of {stated_u:.1e}: u has what was found; state crosstalk in [uncertainty]"
        )
        return of_module[np.arange(self._settings.count) // self._settings.module_channels], (text,)

    def _findings(self, ratios: Sequence["_Ratios"]) -> Iterator[tuple[Flags, str]]:
        """The modules (m,) that did not pass a test, and what was found. What follows from settling is not named again."""
        unsettled = np.zeros(self._first_of_module.size, dtype=bool)
        for modules, what in self._unsettled(ratios):
            unsettled |= modules
            yield modules, f"{what}: the amplifiers are not at rest; {SETTLE}"
        for (low, high), each in zip(self._pairs, ratios, strict=True):
            wrong, worst = self._tested(each.by_signal())
            if (wrong & ~unsettled).any():
                cause = "amplifier or converter is not linear; have the modules checked, and measure again"
                yield wrong & ~unsettled, f"{self._named(low, high)} changes with the signal by up to {worst}: {cause}"
            far = np.abs(np.nan_to_num(each.value)) - CERTAIN * np.sqrt(np.nan_to_num(each.variance)) > IMPLAUSIBLE
            if (of_modules := self._of_modules(far) & ~unsettled).any():
                cause = "no error of a gain; check gains_v_per_a in the rig file, and the wiring of the modules' outputs"
                yield of_modules, f"{self._named(low, high)} is off by up to {_percent(each.value[far])}: {cause}"

    def _unsettled(self, ratios: Sequence["_Ratios"]) -> Iterator[tuple[Flags, str]]:
        w, wt, ww, wwt, wwtt, noise = self._trend
        with np.errstate(invalid="ignore", divide="ignore"):
            step = wt / w
            variance = np.maximum(wwtt - 2.0 * step * wwt + step**2 * ww, noise) / w**2  # by the rows' scatter, or the noise
            wrong, worst = self._tested([(step, variance, w**2 / ww)], also=True)
        if wrong.any():
            yield wrong, f"the readings of a row change by up to {worst} from the first to the later ones"
        for (low, high), each in zip(self._pairs, ratios, strict=True):
            wrong, worst = self._tested(each.by_order(), also=True)
            if wrong.any():
                yield wrong, f"{self._named(low, high)} depends by up to {worst} on which is read first"

    def _named(self, low: int, high: int) -> str:
        return f"the ratio of the gains {self._gains[low]:g} and {self._gains[high]:g} V/A"

    def _tested(self, tests: Iterable[Tested], *, also: bool = False) -> tuple[Flags, str]:
        """The modules (m,) with a certain finding, and the largest one.

        With `also`, those too that have too little light for a test of their own: modules of one make share what one of them
        has. A module with light is cleared by a test that finds nothing, or a tenth.
        """
        wrong, sizes = np.zeros(self._first_of_module.size, dtype=bool), [np.zeros(1)]
        for size, variance, rows in tests:
            beyond = self._beyond(size, variance, rows)
            wrong |= self._of_modules(beyond)
            sizes.append(size[beyond])
            if also and beyond.any() and size.shape[-1] == wrong.size:
                with np.errstate(invalid="ignore"):
                    cleared = np.abs(size) + CERTAIN * np.sqrt(variance) < CLEARED * np.max(np.abs(size[beyond]))
                wrong |= ~cleared.reshape(-1, wrong.size)[beyond.reshape(-1, wrong.size).any(axis=1)].all(axis=0)
        return wrong, _percent(np.concatenate(sizes))

    def _beyond(self, size: Floats, variance: Floats, rows: Floats) -> Flags:
        """Which findings are certain, with `rows` independent values each, and larger than what the budget has."""
        tested = np.isfinite(size) & np.isfinite(variance) & (rows >= FEWEST_ROWS)
        limit = max(CERTAIN, math.sqrt(2.0 * math.log(max(1, int(tested.sum())) / CHANCE)))
        with np.errstate(invalid="ignore", divide="ignore"):
            # A variance from few rows is itself uncertain: Student's distribution has wide tails.
            u = np.sqrt(variance) * (1.0 + (FEW_ROWS / rows) ** 2)
            large = np.abs(size) > np.maximum(limit * u, TOLERATED * self._certified)
        return np.asarray(tested & large)

    def _of_modules(self, flags: Flags) -> Flags:
        """Flags (..., photodiodes) or (..., modules) as flags of the modules (m,)."""
        of_last: Flags = np.logical_or.reduce(flags.reshape(-1, flags.shape[-1]), axis=0)
        modules = self._first_of_module.size
        return of_last if of_last.size == modules else np.logical_or.reduceat(of_last, self._first_of_module)

    def _verdict(self, modules: Flags, text: str) -> Verdict:
        numbers = np.flatnonzero(modules)
        photodiodes = np.flatnonzero(np.isin(np.arange(self._settings.count) // self._settings.module_channels, numbers))
        some = f"module{'s' if numbers.size > 1 else ''} {number_list(numbers.tolist())}"
        return Verdict(tuple(photodiodes.tolist()), f"photodiodes {some}: {text}")

    @property
    def _certified(self) -> float:
        return certified_gain(self._rig)

    def _adjusted(self, evidence: SignalEvidence, ratios: Sequence["_Ratios"], sound: Flags) -> SignalEvidence:
        """The evidence with the gains' deviations and their errors' modes, adjusted with the certificate.

        Least squares for each photodiode: the certificate of each gain is one observation, the mean of a pair's ratio another.
        Where the ratios contradict the certificate, it counts as much as the differences allow.
        """
        gains = self._gains.size
        known = [np.isfinite(each.value) & (each.number >= FEWEST_ROWS) & sound for each in ratios]
        if not any(each.any() for each in known):
            return evidence
        value = np.array([np.where(here, each.value, 0.0) for each, here in zip(ratios, known, strict=True)])
        weight = np.array([np.where(here, 1.0 / each.variance, 0.0) for each, here in zip(ratios, known, strict=True)])
        certified = np.full(self._settings.count, self._certified**2)
        chi = value**2 / (2.0 * certified + np.where(weight > 0.0, 1.0 / np.where(weight > 0.0, weight, 1.0), 0.0))
        count = int((weight > 0.0).sum())
        notes = evidence.notes
        if not plausible(count, float(chi.sum()), math.sqrt(float(chi.max()))):
            certified *= np.maximum(max(1.0, float(chi.sum()) / count), chi.max(axis=0))
            # Where the ratios are off together and none alone, the worst one is named.
            off = np.flatnonzero(chi.max(axis=0) >= min(CERTAIN**2, float(chi.max())))
            notes = (
                *notes,
                f"the gains are not those of the rig file within its gain_uncertainty of {_percent(self._certified)}: their "
                f"ratios are off by up to {_percent(value)} (most certainly of photodiodes {number_list(off.tolist())}); the "
                "measured ratios are applied; correct gain_uncertainty of [photodiodes]",
            )
        step = np.zeros((len(self._pairs), gains))
        for p, (low, high) in enumerate(self._pairs):
            step[p, low], step[p, high] = -1.0, 1.0
        matrix = np.eye(gains) / certified[:, None, None] + np.einsum("pc,pi,pj->cij", weight, step, step)
        covariance = np.linalg.inv(matrix)
        deviation = np.einsum("cij,pc,pc,pj->ic", covariance, weight, value, step)
        # A ratio is never better known than what the tests do not see; a gain is never less known than by its certificate.
        own = np.einsum("cii->ci", covariance)
        unseen = np.minimum(0.5 * (UNSEEN * self._certified) ** 2, np.maximum(certified[:, None] - own, 0.0))
        modes = np.linalg.cholesky(covariance + unseen[:, :, None] * np.eye(gains))
        return replace(
            evidence,
            deviation=deviation,
            gains=modes,
            notes=notes,
            ratios=count,
            worst_ratio=math.sqrt(float(chi.max())),
            linked=LinkedGains(value, weight, step),
        )


class RunningEvidence:
    """The evidence during a run, brought up to date where a dark reading or a drift check is new.

    A row counts as the dark readings were then: at the end of a run the whole is computed anew from all rows.
    """

    def __init__(self, rig: RigFile) -> None:
        self._rig = rig
        self._sums: EvidenceSums | None = None
        self._waiting: list[tuple[Reading, ...]] = []

    def add(self, row: CommittedRow) -> None:
        """Add a row; the last rows wait for a dark reading after them."""
        if row.row.kind in ("measure", "drift") and row.data.readings:
            self._waiting.append(row.data.readings)

    def count(self, dark: Mapping[float, DarkReadings]) -> EvidenceSums:
        """Count the rows that wait, with all dark readings so far."""
        if self._sums is None:
            self._sums = EvidenceSums(dark, self._rig)
        self._sums.renew(dark)
        self._sums.add(reading_table(self._waiting))
        self._waiting = []
        return self._sums

    def renewed(self, dark: Mapping[float, DarkReadings]) -> SignalEvidence:
        """What all rows so far show, with all dark readings so far."""
        return self.count(dark).result()

    @property
    def full(self) -> bool:
        """Whether so many rows wait that they take memory."""
        return len(self._waiting) >= MOST_WAITING


class _CrosstalkSums:
    """Sums for the share of the volts of a module's other channels that a channel has, from rows at two gains.

    The differences of what the lower gain should give from what it gives are d V + k x, of each pair of gains and photodiode:
    V are its volts, x what is missing of the other channels' volts, d the deviation of the gains' ratio, k the share.
    """

    def __init__(self, pairs: int, count: int, module_channels: int) -> None:
        self._first = np.arange(0, count, module_channels)
        self._sizes = np.diff(np.append(self._first, count))
        self._sums = np.zeros((7, pairs, count))
        self._of_rows = np.zeros(self._first.size + 1)
        self._fixed = np.zeros((pairs, count))
        self._of_interval = np.zeros((pairs, count))
        self._intervals = [NO_CHANGE] * pairs

    def of_others(self, values: Floats) -> Floats:
        """The sums (rows, photodiodes) over the other channels of each one's module."""
        return np.asarray(np.repeat(np.add.reduceat(values, self._first, axis=-1), self._sizes, axis=-1) - values)

    def add(
        self, pair: int, interval: int, weight: Floats, volts: Floats, missing: Floats, difference: Floats, fixed: Floats
    ) -> None:
        """Add rows (rows, photodiodes) between two dark readings; `fixed` is the uncertainty of the error they share, V."""
        if interval != self._intervals[pair]:
            self._fixed[pair] += self._of_interval[pair] ** 2
            self._of_interval[pair] = 0.0
            self._intervals[pair] = interval
        v, x, y = volts, missing, difference
        products = (v * v, v * x, x * x, v * y, x * y, y * y)
        self._sums[0, pair] += (weight > 0.0).sum(axis=0)
        for k, each in enumerate(products, 1):
            self._sums[k, pair] += (weight * each).sum(axis=0)
        self._of_interval[pair] += (weight * x * fixed).sum(axis=0)
        of_row = np.add.reduceat(weight * x * v, self._first, axis=1)
        self._of_rows += (np.column_stack([of_row, of_row.sum(axis=1)]) ** 2).sum(axis=0)

    def fit(self, of_row: float) -> tuple[Floats, Floats]:
        """The shares and their standard uncertainties (modules + 1,), of each module and of all together; NaN without light.

        `of_row` is the relative variance that all photodiodes of a row have in common.
        """
        number, vv, vx, xx, vy, xy, yy = self._sums
        gain = vv + 1.0 / IMPLAUSIBLE**2
        fixed = self._fixed + self._of_interval**2
        each = np.stack([number, xx - vx**2 / gain, xy - vx * vy / gain, yy - vy**2 / gain, fixed]).sum(axis=1)
        number, xx, xy, yy, fixed = np.concatenate(
            [np.add.reduceat(each, self._first, axis=1), each.sum(axis=1, keepdims=True)], axis=1
        )
        known = (number >= FEWEST_ROWS) & (xx > 0.0)
        xx = np.where(known, xx, np.nan)
        scatter = np.maximum((yy - xy**2 / xx) / np.maximum(number - 1.0, 1.0), 1.0)
        u = np.sqrt(scatter / xx + (fixed + of_row * self._of_rows) / xx**2) * (1.0 + (FEW_ROWS / np.maximum(number, 1.0)) ** 2)
        return xy / xx, u


class _Ratios:
    """The ratios of one pair of gains: logarithms of the real over the nominal one, from the sums of `EvidenceSums`.

    `of_row` is the variance that all photodiodes of a row have in common, `crosstalk` (photodiodes,) the uncertainty of its
    share. `value`, `variance` and `number` (photodiodes,).
    """

    def __init__(self, sums: Floats, row_weights: Floats, of_row: float, module_channels: int, crosstalk: Floats) -> None:
        self._sums, self._row_weights, self._of_row, self._channels = sums, row_weights, of_row, module_channels
        self._crosstalk = crosstalk
        number, weight, first, second = sums[0], sums[1], sums[2], sums[3]
        with np.errstate(invalid="ignore", divide="ignore"):
            about = np.where(number > 1.0, second - first**2 / weight, 0.0)
        freedom = np.maximum(number - 1.0, 0.0)
        self._chi, self._freedom = float(about.sum()), float(freedom.sum())
        # Ratios that scatter more than was expected are less certain: each photodiode's by its own scatter, if there is enough.
        pooled = self._chi / self._freedom if self._freedom else 1.0
        of_each, degrees = about.sum(axis=(0, 1)), freedom.sum(axis=(0, 1))
        own = np.where(degrees >= FEW_DEGREES, of_each / np.maximum(degrees, 1.0), pooled)
        self._widened = np.maximum(own, 1.0)
        self.value, variance, common, _ = self._mean((0, 1))
        self.variance = variance + common**2
        self.number = number.sum(axis=(0, 1))

    def _mean(self, axes: tuple[int, ...]) -> tuple[Floats, Floats, Floats, Floats]:
        """The mean over order (0) or volts (1), its variance, the uncertainty that its photodiodes share, and the effective
        number of rows.
        """
        _, weight, first, _, squared, resolution, _, missing, _ = (each.sum(axis=axes) for each in self._sums)
        dark = np.sqrt(self._sums[8]).sum(axis=axes)
        with np.errstate(invalid="ignore", divide="ignore"):
            variance = self._widened / weight + resolution / weight + (dark / weight) ** 2
            return first / weight, variance, self._crosstalk * missing / weight, weight**2 / squared

    def by_order(self) -> Iterator[Tested]:
        """Differences of the ratios where the higher gain was read last from the others, of photodiodes and of modules."""
        value, variance, common, rows = self._mean((1,))
        common = common.max(axis=0)  # of both orders alike, but for the volts
        yield value[1] - value[0], variance.sum(axis=0) + common**2, rows.min(axis=0)
        weights, squared = self._row_weights[:, :, -1]
        with np.errstate(invalid="ignore", divide="ignore"):
            effective = weights**2 / squared
            shared = (self._of_row / effective).sum(axis=0)
        size, own = self._of_modules(value[1] - value[0], variance.sum(axis=0), common)
        yield size, own + shared, effective.min(axis=0)

    def by_signal(self) -> Iterator[Tested]:
        """Differences of the ratios at some volts from the mean ratio, of photodiodes and of modules."""
        value, variance, common, rows = self._mean((0,))
        yield value - self.value, variance + common**2, rows
        weights, squared = self._row_weights[:, :, :-1].sum(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            effective = weights**2 / squared
            shared = self._of_row / effective
        size, own = self._of_modules(value - self.value, variance, common)
        yield size, own + shared, effective

    def _of_modules(self, size: Floats, variance: Floats, common: Floats) -> tuple[Floats, Floats]:
        """Weighted means over the photodiodes (last axis) of each module, and their variances; of `common` they share all."""
        known = np.isfinite(size) & np.isfinite(variance)
        weight = np.where(known, 1.0 / np.where(known, variance + common**2, 1.0), 0.0)
        first = np.arange(0, size.shape[-1], self._channels)
        total = np.add.reduceat(weight, first, axis=-1)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean, shared, own = (
                np.add.reduceat(np.where(known, each, 0.0), first, axis=-1) / total**power
                for each, power in ((weight * size, 1), (weight * common, 1), (weight**2 * variance, 2))
            )
            return mean, own + shared**2

    def excess(self, of_scatter: float) -> float:
        """Relative variance of a mean that its readings do not show: of what the ratios scatter more than was expected.

        `of_scatter` is the variance of one reading that was not expected, but is known from its scatter.
        """
        if self._chi - self._freedom <= CERTAIN * math.sqrt(2.0 * self._freedom):
            return 0.0
        _, weight, _, _, squared, _, inverse, _, _ = self._sums
        some = weight > 0.0
        effective = float(weight.sum() - (squared[some] / weight[some]).sum())
        if effective <= 0.0:
            return 0.0
        return 0.5 * ((self._chi - self._freedom) / effective - of_scatter * float(inverse.sum() / weight.sum()))


def _weights(volts: Floats, expected: Floats, chosen: Flags) -> Floats:
    """Weights of relative deviations of readings; 0 of those that are not chosen."""
    signal = np.where(chosen, volts, 1.0) ** 2
    return np.where(chosen, 1.0 / (expected / signal + WEIGHT_LIMIT**2), 0.0)


def _percent(relative: Floats | float) -> str:
    return f"{100.0 * float(np.max(np.abs(relative))):.2g} %"


def _noise_of(sums: Floats, dark_freedom: float) -> tuple[Floats, float]:
    """The factor (photodiodes,) and the relative variance that make the observed scatter of readings.

    `sums` (3, bins, photodiodes): degrees of freedom, and times these the ratio of observed to expected variance, and the
    squared signal-to-noise ratio. A photodiode that is certainly noisier than the others has a factor of its own, and does not
    count in theirs.
    """
    freedom = sums[0]
    usual = np.ones(freedom.shape[1], dtype=bool)
    own = np.ones(freedom.shape[1])
    for _ in range(2):
        constant, relative = _fit_noise(*(each[:, usual].sum(axis=1) for each in sums))
        model = constant + relative * sums[2] / np.where(freedom > 0.0, freedom, 1.0)
        degrees = freedom.sum(axis=0)
        ratio = (sums[1] / model).sum(axis=0) / np.where(degrees > 0.0, degrees, 1.0)
        # What is expected is from dark readings, and no better known than these allow.
        limit = 1.0 + CERTAIN * np.sqrt(2.0 / np.maximum(degrees, 1.0) + 2.0 / dark_freedom)
        own = np.where(ratio > limit, ratio, 1.0)
        if not (own > 1.0).any() or (own > 1.0).sum() > own.size // 2:
            break
        usual = own == 1.0
    return constant * own, relative / constant


def _fit_noise(freedom: Floats, observed: Floats, signal: Floats) -> tuple[float, float]:
    """Fit the ratio of observed to expected variance by k + relative * squared signal-to-noise ratio, with k at least 1."""
    some = freedom > 0.0
    if not some.any():
        return 1.0, 0.0
    freedom, ratio, signal = (
        freedom[some],
        (observed / np.where(freedom > 0.0, freedom, 1.0))[some],
        signal[some] / freedom[some],
    )
    constant, relative = 1.0, max(0.0, float(np.sum(freedom * (ratio - 1.0)) / np.sum(freedom * signal + 1e-300)))
    for _ in range(FIT_ROUNDS):
        weight = freedom / (constant + relative * signal) ** 2  # a variance from n degrees of freedom is known to 2/n
        design = np.stack([np.ones(signal.size), signal])
        normal = (design * weight) @ design.T
        right = (design * weight) @ ratio
        fitted = np.linalg.lstsq(normal, right, rcond=None)[0]
        constant, relative = (float(each) for each in fitted)
        if constant < 1.0:
            constant, relative = 1.0, float((right[1] - normal[0, 1]) / normal[1, 1]) if normal[1, 1] > 0.0 else 0.0
        if relative < 0.0:
            constant, relative = max(1.0, float(right[0] / normal[0, 0])), 0.0
    return constant, relative
