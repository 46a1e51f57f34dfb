"""Durations on the rig's clock: moves from point to point, and rows with their readings and the bytes on the wires.

`Moves` takes arrays of moves, so that orders of a million rows can be compared; the engine does the same moves one by one.
`Timing` follows the rows of a plan in order.
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
USB_LATENCY_S = 1.0e-3
WHEEL_AFTER_POWER_ON = 1
"""Position of the filter wheel after a power-up."""
EXCHANGES_BEFORE_MOVE, EXCHANGES_AFTER_MOVE, EXCHANGES_BETWEEN_LEGS = 3, 2, 2
"""Exchanges with the controller: position, canary, move; arrived, canary; arrived, next leg."""
TYPICAL_GAINS = 2
"""Number of gains that a row with auto-range is assumed to need."""
TINY = 1e-9
UNKNOWN_POINT: Floats = np.full(5, np.nan)
ReadingLots = tuple[int, tuple[int, ...]]
"""A gain, and the numbers of readings in each lot that is taken at it."""


class Moves:
    """Durations of moves on one rig.

    Points are rows of five: gamma, sigma, beta, shift in degrees, wavelength in nm; NaN where a value is unknown.
    """

    def __init__(self, rig: RigFile) -> None:
        settings = axis_settings(rig)
        self._axes = [settings[name] for name in AXES]
        self._monochromator = monochromator_settings(rig)
        self.exchange_s = 2 * FRAME_BYTES * 10.0 / rig.axes.baudrate + CONTROLLER_LATENCY_S
        farthest = encode_nm(self._monochromator.highest_nm)
        go_wave_s = self._monochromator.statement_seconds(str(Statement("GOWAVE", parameter=farthest)))
        self._set_wavelength_s = go_wave_s + STATUS_MARGIN_S + self._monochromator.query_seconds("WAVE?", farthest)
        self._wheel = self._monochromator.wheel
        self._query_wheel_s = self._monochromator.query_seconds("FILTER?", "1")
        self._set_wheel_s = self._monochromator.statement_seconds("FILTER 1") + STATUS_MARGIN_S + self._query_wheel_s

    def seconds(self, before: Floats, after: Floats) -> Floats:
        """Seconds (n,) from points (n, 5) to others, all axes at once, until everything is at rest and has settled.

        An axis at an unknown position (NaN) is assumed to be at the origin of its counter, the most probable position.
        """
        started, done, settling = (np.zeros(len(after)) for _ in range(3))
        for k, axis in enumerate(self._axes):
            start, stop = before[:, k], after[:, k]
            changed = start != stop
            if not changed.any():
                continue
            started += np.where(changed, EXCHANGES_BEFORE_MOVE * self.exchange_s, 0.0)
            known = np.where(np.isnan(start), axis.zero_offset_deg, start)
            arrived = started + self._axis_seconds(axis, known, stop)
            done = np.where(changed, np.maximum(done, arrived) + EXCHANGES_AFTER_MOVE * self.exchange_s, done)
            settling = np.where(changed, np.maximum(settling, axis.settling_s), settling)
        slewed = before[:, 4] != after[:, 4]
        if slewed.any():
            change_nm = np.nan_to_num(after[:, 4] - before[:, 4])
            arrived = started + self._wheel_seconds(before[:, 4], after[:, 4]) + self._grating_seconds(change_nm)
            done = np.where(slewed, np.maximum(done, arrived), done)
        return np.asarray(done + settling)

    def filter_changes(self, wavelengths_nm: Floats) -> tuple[int, float]:
        """Number of filter changes over wavelengths (n,) in this order, and the seconds that the wheel turns for them."""
        if not self._wheel or not len(wavelengths_nm):
            return 0, 0.0
        steps = self._wheel_steps(np.concatenate([[np.nan], wavelengths_nm[:-1]]), wavelengths_nm)
        return int(np.count_nonzero(steps)), float(steps.sum() * self._monochromator.filter_s)

    def filter_numbers(self, wavelengths_nm: Floats) -> Ints:
        """Number of the filter of each of wavelengths (n,), counted from 0 by ascending wavelength."""
        return self._wheel.numbers(wavelengths_nm)

    def one_step(self, column: int) -> Callable[[Floats, Floats], Floats]:
        """Function for the seconds from values to others in one column, with all other columns at rest."""

        def seconds(start: Floats, stop: Floats) -> Floats:
            before, after = np.zeros((2, len(start), 5))
            before[:, column], after[:, column] = start, stop
            return self.seconds(before, after)

        return seconds

    def backlash(self, column: int) -> int:
        """Direction of approach of a column, +1 or -1, to cancel backlash; 0 where the direction does not matter."""
        if column >= len(AXES) or self._axes[column].backlash_deg == 0.0:
            return 0
        return 1 if self._axes[column].approach_from == "below" else -1

    def _axis_seconds(self, axis: AxisSettings, start: Floats, stop: Floats) -> Floats:
        """All legs of a move, until the axis has confirmed its arrival."""
        direct = ramp_seconds(stop - start, axis.speed, axis.acceleration) + ARRIVED_AFTER_S
        overshoot = axis.overshoot_deg
        if overshoot == 0.0:
            return direct
        legs = sum(
            ramp_seconds(way, axis.speed, axis.acceleration)
            for way in (stop + overshoot - start, np.full(len(start), overshoot))
        )
        detour = legs + 2 * ARRIVED_AFTER_S + EXCHANGES_BETWEEN_LEGS * self.exchange_s
        return np.asarray(np.where((stop - start) * -overshoot >= 0.0, direct, detour))

    def _wheel_seconds(self, start_nm: Floats, stop_nm: Floats) -> Floats:
        """The filter wheel, before the grating turns; an unknown position is queried twice."""
        if not self._wheel:
            return np.zeros(len(stop_nm))
        steps, unknown = self._wheel_steps(start_nm, stop_nm), np.isnan(start_nm)
        turned = self._query_wheel_s + self._set_wheel_s + steps * self._monochromator.filter_s
        queried = np.where(unknown, self._query_wheel_s * (1 + (steps == 0)), 0.0)
        return np.asarray(np.where(steps > 0, turned, 0.0) + queried)

    def _wheel_steps(self, start_nm: Floats, stop_nm: Floats) -> Ints:
        """Number of positions that the wheel turns by; an unknown position (NaN) is assumed to be that after a power-up."""
        start = np.where(np.isnan(start_nm), WHEEL_AFTER_POWER_ON, self._wheel.positions(start_nm))
        return np.abs(self._wheel.positions(stop_nm) - start)

    def _grating_seconds(self, change_nm: Floats) -> Floats:
        settings = self._monochromator
        slewing = np.abs(change_nm) / settings.slew_nm_per_s + settings.slew_settle_s
        return np.asarray(np.where(change_nm != 0.0, slewing, 0.0) + self._set_wavelength_s)


def ramp_seconds(way_deg: Floats, speed: float, acceleration: float) -> Floats:
    """Seconds from rest to rest over distances of either sign: `drivers.motion.settings.move_seconds`, for arrays."""
    distance = np.abs(way_deg)
    ramps = speed * speed / acceleration
    short = 2.0 * np.sqrt(distance / acceleration)
    return np.asarray(np.where(distance >= ramps, 2.0 * speed / acceleration + (distance - ramps) / speed, short))


def shortest_warm_up_s(longest_s: float) -> float:
    """Shortest duration of a warm-up: until there are enough monitor readings for a slope, or its time limit."""
    readings = min(MIN_SLOPE_READINGS, 1 + math.ceil(max(0.0, longest_s - MONITOR_MEAN_S) / WARM_UP_PERIOD_S))
    return (readings - 1) * WARM_UP_PERIOD_S + MONITOR_MEAN_S


class Timing:
    """Duration of each row of a plan, in order: the state in which each row leaves the rig is tracked."""

    def __init__(self, rig: RigFile) -> None:
        self.expected_reading_s: dict[str, float] = {}
        """By sample, the time to read a row in s, where the schedule alone does not determine it and a twin gave the signal."""
        self.moves = Moves(rig)
        self._monochromator = monochromator_settings(rig)
        self._photodiodes = photodiode_settings(rig)
        encoders = sum(settings.encoder for settings in axis_settings(rig).values())
        self.readback_s = 2 * (len(AXES) + encoders) * self.moves.exchange_s  # each with the canary
        self.position = UNKNOWN_POINT
        self._shutter_open: bool | None = None
        self._gain: int | None = None

    def row_seconds(self, row: Row) -> float:
        """Duration of the next row in s, without the time that the operator takes to mount a sample."""
        if row.kind == "mount":
            return self.switch_shutter(opened=False)
        if row.kind == "dark":
            return self.switch_shutter(opened=False) + self.take_readings(row)
        target = self.position.copy()
        target[:WAVELENGTH] = target[:WAVELENGTH] if row.pose is None else row.pose
        target[WAVELENGTH] = target[WAVELENGTH] if row.wavelength_nm is None else row.wavelength_nm
        # An unknown position without a target (NaN) does not move.
        before = np.where(np.isnan(target), 0.0, self.position)
        moving = float(self.moves.seconds(before[None], np.nan_to_num(target)[None])[0])
        self.position = target
        opening = moving + self.switch_shutter(opened=True)
        return opening + (
            shortest_warm_up_s(row.longest_s) if row.kind == "warm-up" else self.take_readings(row) + self.readback_s
        )

    def take_readings(self, row: Row) -> float:
        """Seconds to read the next row at all its gains, from the present gain of the amplifiers.

        How many gains auto-range needs, and how many readings a target uncertainty needs, is known only after the row. The
        row is assumed to need its TYPICAL_GAINS highest gains, and the geometric mean of the fewest and the most readings.
        """
        seconds = self.next_reading_s(row)
        self.advance(row, 1)
        return seconds

    def next_reading_s(self, row: Row) -> float:
        """Seconds to read a row if it were the next one."""
        if row.sample in self.expected_reading_s and row.kind != "dark":
            return self.expected_reading_s[row.sample]
        return self._reading(self._typical_gains(row, self._gain), self._typical_readings(row), self._gain)

    def typical_reading_s(self, row: Row) -> float:
        """Seconds to read a row after a similar row."""
        if row.sample in self.expected_reading_s and row.kind != "dark":
            return self.expected_reading_s[row.sample]
        before = self._typical_gains(row, None)[-1]
        return self._reading(self._typical_gains(row, before), self._typical_readings(row), before)

    def advance(self, row: Row, rows: int) -> None:
        """Set the gain of the amplifiers to that after this number of similar rows."""
        for _ in range(2 - rows % 2 if rows else 0):  # every second row leaves the same gain
            self._gain = self._typical_gains(row, self._gain)[-1]

    def reading_range_s(self, row: Row) -> tuple[float, float]:
        """Shortest and longest time to read a row after a similar row; auto-range may need a single gain."""
        gains = gain_order(row, max(row.gains))
        least = gains[:1] if row.automatic else gains
        return self._reading(least, _min_readings(row), gains[0]), self._reading(gains, self._max_readings(row), gains[-1])

    def longest_reading_s(self, row: Row) -> float:
        """Longest time that a plan assumes for reading a row, from any gain of the amplifiers."""
        typical = self._reading(self._typical_gains(row, None), self._typical_readings(row), None)
        return max(typical, self.expected_reading_s.get(row.sample, 0.0))

    def lots_seconds(self, lots: list[ReadingLots]) -> float:
        """Seconds to read a row with these lots, after a similar row."""
        seconds, before = 0.0, lots[-1][0]
        for gain, (first, *further) in lots:
            seconds += self._reading((gain,), first, before)
            seconds += sum(self._reading((gain,), lot, gain) for lot in further)
            before = gain
        return seconds

    def _typical_gains(self, row: Row, before: int | None) -> tuple[int, ...]:
        gains = gain_order(row, before)
        return gains[:TYPICAL_GAINS] if row.automatic else gains

    def _typical_readings(self, row: Row) -> int:
        return round(math.sqrt(_min_readings(row) * self._max_readings(row)))

    def _max_readings(self, row: Row) -> int:
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
        """Open or close the shutter; the seconds that it takes, 0 where it is already so."""
        seconds = self.shutter_seconds(opened=opened)
        self._shutter_open = opened
        return seconds

    def shutter_seconds(self, *, opened: bool) -> float:
        """Seconds to open or close the shutter, 0 where it is already so."""
        if self._shutter_open is opened:
            return 0.0
        query_s = self._monochromator.query_seconds("SHUTTER?", "O")
        command_s = self._monochromator.statement_seconds(f"SHUTTER {'O' if opened else 'C'}")
        return self._monochromator.shutter_s + command_s + STATUS_MARGIN_S + query_s


def _min_readings(row: Row) -> int:
    """Least number of readings at each gain; a target uncertainty needs enough of them to estimate the scatter."""
    return row.readings if row.target is None else max(row.readings, MIN_AVERAGED_READINGS)


def min_intervals(rows: int, reading_s: float, every_s: float) -> int:
    """Least number of intervals for rows of at least `reading_s` each, none longer than `every_s` unless it is a single row."""
    return math.ceil(rows / max(1, int(min(rows, every_s / reading_s + TINY))))
