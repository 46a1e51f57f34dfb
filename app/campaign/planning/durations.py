"""How long each row takes on the rig's clock: moves, conversions, and the bytes on the wires.

How long the rig takes from one pose and wavelength to another: ramps, settling, the grating, the words on the wires.

For arrays of moves at once, so that orders of a million rows can be compared; what the engine does one by one is the same.
"""

import math
from collections.abc import Callable

import numpy as np

from goniotwin.app.campaign.planning.scan_grid import WAVELENGTH
from goniotwin.app.campaign.readout import (
    MIN_AVERAGED_READINGS,
    MIN_SLOPE_READINGS,
    MONITOR_MEAN_S,
    WARM_UP_PERIOD_S,
    gain_order,
)
from goniotwin.app.campaign.row import Row
from goniotwin.app.rig import AXES, RigFile, axis_settings, monochromator_settings, photodiode_settings
from goniotwin.arrays import Floats, Ints
from goniotwin.drivers.monitor.monitor import ANSWER_MARGIN_S
from goniotwin.drivers.monochromator.monochromator import STATUS_MARGIN_S
from goniotwin.drivers.motion.move import ARRIVED_AFTER_S
from goniotwin.drivers.motion.settings import AxisSettings
from goniotwin.protocols.cornerstone import Statement, encode_nm
from goniotwin.protocols.tmcl import FRAME_BYTES

CONTROLLER_LATENCY_S = 3.0e-4
WHEEL_AFTER_POWER_ON = 1
EXCHANGES_BEFORE_MOVE, EXCHANGES_AFTER_MOVE, EXCHANGES_BETWEEN_LEGS = 3, 2, 2
"""Exchanges: where it is, the canary, the move; whether it has arrived, the canary; whether it has arrived, the next leg."""


class Moves:
    """Of one rig. Points are rows of five: gamma, sigma, beta, shift in degrees, wavelength in nm; NaN is not known."""

    def __init__(self, rig: RigFile) -> None:
        settings = axis_settings(rig)
        self._axes = [settings[name] for name in AXES]
        self._monochromator = monochromator_settings(rig)
        self.exchange_s = 2 * FRAME_BYTES * 10.0 / rig.axes.baudrate + CONTROLLER_LATENCY_S
        farthest = encode_nm(self._monochromator.highest_nm)
        told = self._monochromator.statement_seconds(str(Statement("GOWAVE", parameter=farthest)))
        self._words_s = told + STATUS_MARGIN_S + self._monochromator.query_seconds("WAVE?", farthest)
        self._wheel = self._monochromator.wheel
        self._ask_wheel_s = self._monochromator.query_seconds("FILTER?", "1")
        self._tell_wheel_s = self._monochromator.statement_seconds("FILTER 1") + STATUS_MARGIN_S + self._ask_wheel_s

    def seconds(self, before: Floats, after: Floats) -> Floats:
        """Seconds (n,) from points (n, 5) to others, all axes at once, until everything is at rest and has settled.

        From an axis that nobody has moved yet (NaN) as from the origin of its counter, the likeliest place.
        """
        begun, done, settling = (np.zeros(len(after)) for _ in range(3))
        for k, axis in enumerate(self._axes):
            here, there = before[:, k], after[:, k]
            changed = here != there
            if not changed.any():
                continue
            begun += np.where(changed, EXCHANGES_BEFORE_MOVE * self.exchange_s, 0.0)
            known = np.where(np.isnan(here), axis.zero_offset_deg, here)
            arrived = begun + self._turning(axis, known, there)
            done = np.where(changed, np.maximum(done, arrived) + EXCHANGES_AFTER_MOVE * self.exchange_s, done)
            settling = np.where(changed, np.maximum(settling, axis.settling_s), settling)
        slewed = before[:, 4] != after[:, 4]
        if slewed.any():
            way = np.nan_to_num(after[:, 4] - before[:, 4])
            arrived = begun + self._sorting(before[:, 4], after[:, 4]) + self._slewing(way)
            done = np.where(slewed, np.maximum(done, arrived), done)
        return np.asarray(done + settling)

    def filter_changes(self, wavelengths_nm: Floats) -> tuple[int, float]:
        """How often the filter changes over wavelengths (n,) in this order, and how many seconds the wheel takes for it all."""
        if not self._wheel or not len(wavelengths_nm):
            return 0, 0.0
        ways = self._wheels_ways(np.concatenate([[np.nan], wavelengths_nm[:-1]]), wavelengths_nm)
        return int(np.count_nonzero(ways)), float(ways.sum() * self._monochromator.filter_s)

    def filter_numbers(self, wavelengths_nm: Floats) -> Ints:
        """Which of the filters, counted from 0 by ascending wavelength, each of wavelengths (n,) has."""
        return self._wheel.numbers(wavelengths_nm)

    def one_step(self, column: int) -> Callable[[Floats, Floats], Floats]:
        """Seconds from values to others of one column alone, everything else at rest."""

        def seconds(here: Floats, there: Floats) -> Floats:
            before, after = np.zeros((2, len(here), 5))
            before[:, column], after[:, column] = here, there
            return self.seconds(before, after)

        return seconds

    def backlash(self, column: int) -> int:
        """The direction, +1 or -1, from which a column's moves have to arrive; 0 where either will do."""
        if column >= len(AXES) or self._axes[column].backlash_deg == 0.0:
            return 0
        return 1 if self._axes[column].approach_from == "below" else -1

    def _turning(self, axis: AxisSettings, here: Floats, there: Floats) -> Floats:
        """All legs of a move, until the axis is known to be there."""
        direct = ramp_seconds(there - here, axis.speed, axis.acceleration) + ARRIVED_AFTER_S
        far = axis.overshoot_deg
        if far == 0.0:
            return direct
        legs = sum(ramp_seconds(way, axis.speed, axis.acceleration) for way in (there + far - here, np.full(len(here), far)))
        detour = legs + 2 * ARRIVED_AFTER_S + EXCHANGES_BETWEEN_LEGS * self.exchange_s
        return np.asarray(np.where((there - here) * -far >= 0.0, direct, detour))

    def _sorting(self, here_nm: Floats, there_nm: Floats) -> Floats:
        """Of the filter wheel, before the grating turns; where nobody knows its position it is asked twice."""
        if not self._wheel:
            return np.zeros(len(there_nm))
        ways, unknown = self._wheels_ways(here_nm, there_nm), np.isnan(here_nm)
        turned = self._ask_wheel_s + self._tell_wheel_s + ways * self._monochromator.filter_s
        asked = np.where(unknown, self._ask_wheel_s * (1 + (ways == 0)), 0.0)
        return np.asarray(np.where(ways > 0, turned, 0.0) + asked)

    def _wheels_ways(self, here_nm: Floats, there_nm: Floats) -> Ints:
        """How many positions the wheel turns by; where nobody knows its position (NaN), from that after a power-up."""
        here = np.where(np.isnan(here_nm), WHEEL_AFTER_POWER_ON, self._wheel.positions(here_nm))
        return np.abs(self._wheel.positions(there_nm) - here)

    def _slewing(self, way_nm: Floats) -> Floats:
        settings = self._monochromator
        slewing = np.abs(way_nm) / settings.slew_nm_per_s + settings.slew_settle_s
        return np.asarray(np.where(way_nm != 0.0, slewing, 0.0) + self._words_s)


def ramp_seconds(way: Floats, speed: float, acceleration: float) -> Floats:
    """Seconds from rest to rest over ways of any sign: `drivers.motion.settings.move_seconds`, for arrays."""
    distance = np.abs(way)
    ramps = speed * speed / acceleration
    short = 2.0 * np.sqrt(distance / acceleration)
    return np.asarray(np.where(distance >= ramps, 2.0 * speed / acceleration + (distance - ramps) / speed, short))


USB_LATENCY_S = 1.0e-3
TINY = 1e-9
TYPICAL_GAINS = 2
UNKNOWN_POINT: Floats = np.full(5, np.nan)
ReadingLots = tuple[int, tuple[int, ...]]
"""A gain, and how many readings are taken at it, one lot after the other."""


def shortest_warm_up_s(longest_s: float) -> float:
    """A warm-up ends no sooner than the monitor has been looked at so often, or its time is up; when it does is the lamp's."""
    looks = min(MIN_SLOPE_READINGS, 1 + math.ceil(max(0.0, longest_s - MONITOR_MEAN_S) / WARM_UP_PERIOD_S))
    return (looks - 1) * WARM_UP_PERIOD_S + MONITOR_MEAN_S


class Timing:
    """Follows the rows of a plan in order, knowing where each left the rig."""

    def __init__(self, rig: RigFile) -> None:
        self.expected_reading_s: dict[str, float] = {}
        """By sample, what its rows take to be read, where that is not known from the schedule alone and was looked at."""
        self.moves = Moves(rig)
        self._monochromator = monochromator_settings(rig)
        self._photodiodes = photodiode_settings(rig)
        encoders = sum(settings.encoder for settings in axis_settings(rig).values())
        self.readback_s = 2 * (len(AXES) + encoders) * self.moves.exchange_s  # each with the canary
        self.here = UNKNOWN_POINT
        self._shutter_open: bool | None = None
        self._gain: int | None = None

    def row_seconds(self, row: Row) -> float:
        """The duration of the next row, s; a person's time at mountings is not in it."""
        if row.kind == "mount":
            return self.switch_shutter(opened=False)
        if row.kind == "dark":
            return self.switch_shutter(opened=False) + self.take_readings(row)
        there = self.here.copy()
        there[:WAVELENGTH] = there[:WAVELENGTH] if row.pose is None else row.pose
        there[WAVELENGTH] = there[WAVELENGTH] if row.wavelength_nm is None else row.wavelength_nm
        # What is not known before and not told either (NaN) does not move.
        before = np.where(np.isnan(there), 0.0, self.here)
        moving = float(self.moves.seconds(before[None], np.nan_to_num(there)[None])[0])
        self.here = there
        opening = moving + self.switch_shutter(opened=True)
        return opening + (
            shortest_warm_up_s(row.longest_s) if row.kind == "warm-up" else self.take_readings(row) + self.readback_s
        )

    def take_readings(self, row: Row) -> float:
        """All gains of a row, from where the rows before have left the amplifiers.

        How many gains are needed where they are automatic, and how many readings where there is a target, is known when the
        row has been read. It is taken to need its two highest gains, and between the fewest and the most readings the
        geometric mean.
        """
        seconds = self.next_reading_s(row)
        self.advance(row, 1)
        return seconds

    def next_reading_s(self, row: Row) -> float:
        """The same for a row that only might come next."""
        if row.sample in self.expected_reading_s and row.kind != "dark":
            return self.expected_reading_s[row.sample]
        return self._reading(self._likely(row, self._gain), self._likely_readings(row), self._gain)

    def typical_reading_s(self, row: Row) -> float:
        """The same for a row that comes after one like it."""
        if row.sample in self.expected_reading_s and row.kind != "dark":
            return self.expected_reading_s[row.sample]
        before = self._likely(row, None)[-1]
        return self._reading(self._likely(row, before), self._likely_readings(row), before)

    def advance(self, row: Row, rows: int) -> None:
        """The amplifiers are where so many such rows leave them."""
        for _ in range(2 - rows % 2 if rows else 0):  # every second one leaves them alike
            self._gain = self._likely(row, self._gain)[-1]

    def reading_range_s(self, row: Row) -> tuple[float, float]:
        """The least and the most that `typical_reading_s` could turn out to be: with automatic gains one may do."""
        gains = gain_order(row, max(row.gains))
        least = gains[:1] if row.automatic else gains
        return self._reading(least, _min_readings(row), gains[0]), self._reading(gains, self._most_readings(row), gains[-1])

    def longest_reading_s(self, row: Row) -> float:
        """The most that a plan takes such a row to need, wherever the amplifiers are before it."""
        likely = self._reading(self._likely(row, None), self._likely_readings(row), None)
        return max(likely, self.expected_reading_s.get(row.sample, 0.0))

    def lots_seconds(self, taken: list[ReadingLots]) -> float:
        """Of a row that is read at these gains, after one like it."""
        seconds, before = 0.0, taken[-1][0]
        for gain, (first, *further) in taken:
            seconds += self._reading((gain,), first, before)
            seconds += sum(self._reading((gain,), lot, gain) for lot in further)
            before = gain
        return seconds

    def _likely(self, row: Row, before: int | None) -> tuple[int, ...]:
        gains = gain_order(row, before)
        return gains[:TYPICAL_GAINS] if row.automatic else gains

    def _likely_readings(self, row: Row) -> int:
        return round(math.sqrt(_min_readings(row) * self._most_readings(row)))

    def _most_readings(self, row: Row) -> int:
        least = _min_readings(row)
        return least if row.target is None else max(least, int(row.longest_s / self._photodiodes.period_s))

    def _reading(self, gains: tuple[int, ...], readings: int, before: int | None) -> float:
        settings = self._photodiodes
        seconds = 0.0
        for gain in gains:
            changed = gain != before
            before = gain
            fetching = max(settings.fetching_seconds(after_change=changed), ANSWER_MARGIN_S + 4 * USB_LATENCY_S)
            seconds += (settings.gain_seconds if changed else 0.0) + settings.wait_s
            seconds += (readings - 1) * settings.period_s + fetching
        return seconds

    def switch_shutter(self, *, opened: bool) -> float:
        """Opening or closing it, where it is not yet."""
        seconds = self.shutter_seconds(opened=opened)
        self._shutter_open = opened
        return seconds

    def shutter_seconds(self, *, opened: bool) -> float:
        """What that would take."""
        if self._shutter_open is opened:
            return 0.0
        asked = self._monochromator.query_seconds("SHUTTER?", "O")
        told = self._monochromator.statement_seconds(f"SHUTTER {'O' if opened else 'C'}")
        return self._monochromator.shutter_s + told + STATUS_MARGIN_S + asked


def _min_readings(row: Row) -> int:
    """At each gain; where their scatter decides, there have to be some to scatter."""
    return row.readings if row.target is None else max(row.readings, MIN_AVERAGED_READINGS)


def min_intervals(rows: int, reading_s: float, every_s: float) -> int:
    """Of rows that each take so long at least: none longer than `every_s`, unless it is a single row that takes longer."""
    return math.ceil(rows / max(1, int(min(rows, every_s / reading_s + TINY))))
