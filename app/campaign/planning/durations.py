"""Durations on the rig's clock: moves from point to point, and rows with their readings.

The drivers' descriptions give the durations of single actions. Here they are put together as the engine does it: all axes and
the monochromator at once, then the shutter, the readings, and the positions. `Moves` takes arrays of moves, so that orders of a
million rows can be compared; `Timing` takes rows one after the other.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from goniotwin.app.campaign.planning.scan_grid import WAVELENGTH
from goniotwin.app.campaign.readout import (
    MIN_SLOPE_READINGS,
    MONITOR_MEAN_S,
    WARM_UP_PERIOD_S,
    gain_order,
    max_readings,
    min_readings,
)
from goniotwin.app.campaign.row import Row
from goniotwin.app.rig import RigFile, axis_timings
from goniotwin.arrays import Floats, Ints

TYPICAL_GAINS = 2
"""Number of gains that a row with auto-range is assumed to need."""
SAMPLED_ROWS = 40
"""Number of rows of each sample and grid at which the expected signal is calculated."""
TINY = 1e-9
UNKNOWN_POINT: Floats = np.full(5, np.nan)
ReadingLots = tuple[int, tuple[int, ...]]
"""A gain, and the numbers of readings in each lot that is taken at it."""


class Moves:
    """Durations of moves on one rig.

    Points are rows of five: gamma, sigma, beta, shift in degrees, wavelength in nm; NaN where a value is unknown. `axes` has
    the timing of each axis in this order, `wheel` the filters. `further_move_s` is the longest time by which the exchanges of
    one more moving axis prolong a move.
    """

    def __init__(self, rig: RigFile) -> None:
        self.axes = list(axis_timings(rig).values())
        self._monochromator = rig.monochromator
        self.wheel = self._monochromator.wheel
        self.further_move_s = max(axis.starting_s + axis.ending_s for axis in self.axes)

    def seconds(self, before: Floats, after: Floats) -> Floats:
        """Seconds (n,) from points (n, 5) to others, all axes at once, until everything is at rest and has settled."""
        started, done, settling = (np.zeros(len(after)) for _ in range(3))
        for k, axis in enumerate(self.axes):
            if (moved := _moved(before[:, k], after[:, k])) is not None:
                started[moved] += axis.starting_s
                arrived = started[moved] + axis.travel_seconds(before[moved, k], after[moved, k])
                done[moved] = np.maximum(done[moved], arrived) + axis.ending_s
                settling[moved] = np.maximum(settling[moved], axis.settling_s)
        if (moved := _moved(before[:, WAVELENGTH], after[:, WAVELENGTH])) is not None:
            changing = self._monochromator.wavelength_seconds(before[moved, WAVELENGTH], after[moved, WAVELENGTH])
            done[moved] = np.maximum(done[moved], started[moved] + changing)
        return done + settling

    def one_step(self, column: int) -> Callable[[Floats, Floats], Floats]:
        """Function for the seconds from values to others in one column, with all other columns at rest."""

        def seconds(start: Floats, stop: Floats) -> Floats:
            before, after = np.zeros((2, len(start), 5))
            before[:, column], after[:, column] = start, stop
            return self.seconds(before, after)

        return seconds

    def approach(self, column: int) -> int:
        """Direction of approach of a column, +1 or -1, to cancel backlash; 0 where the direction does not matter."""
        return self.axes[column].approach if column < len(self.axes) else 0


def _moved(before: Floats, after: Floats) -> Ints | slice | None:
    """Index of the elements (n,) that change: their numbers; a slice, which copies nothing, where all do; None without any."""
    changed = before != after
    if not changed.any():
        return None
    return slice(None) if changed.all() else np.flatnonzero(changed)


def shortest_warm_up_s(longest_s: float) -> float:
    """Shortest duration of a warm-up: until there are enough monitor readings for a slope, or its time limit."""
    readings = min(MIN_SLOPE_READINGS, 1 + math.ceil(max(0.0, longest_s - MONITOR_MEAN_S) / WARM_UP_PERIOD_S))
    return (readings - 1) * WARM_UP_PERIOD_S + MONITOR_MEAN_S


class RigState(NamedTuple):
    """State in which a row leaves the rig: point (5,), shutter, gain of the amplifiers; NaN and None where unknown."""

    point: Floats
    shutter_open: bool | None = None
    gain: int | None = None


UNKNOWN_STATE = RigState(UNKNOWN_POINT)


class Timing:
    """Durations of rows on one rig.

    `expected_reading_s` is, by sample, the time to read a row in s, where the schedule alone does not determine it and a twin
    gave the signal.
    """

    def __init__(self, rig: RigFile, expected_reading_s: Mapping[str, float] | None = None) -> None:
        self.expected_reading_s = dict(expected_reading_s or {})
        self.moves = Moves(rig)
        self._monochromator = rig.monochromator
        self._photodiodes = rig.photodiodes
        self._monitor = rig.monitor
        self.read_back_s = sum(axis.read_back_s for axis in self.moves.axes)
        # A plan asks for the same few durations at each of its rows.
        self._shutter_s = {opened: self._monochromator.shutter_seconds(opened=opened) for opened in (False, True)}
        self._typical_s: dict[tuple[object, ...], float] = {}
        self._gains_after: dict[tuple[object, ...], int | None] = {}

    def row(self, state: RigState, row: Row) -> tuple[float, RigState]:
        """Duration of a row in s, without the time that the operator takes to mount a sample, and the state after it."""
        lit = row.kind not in ("mount", "dark")
        seconds = self.shutter_s(state, opened=lit)
        state = RigState(state.point, lit, state.gain)
        if lit:
            target = state.point.copy()
            target[:WAVELENGTH] = target[:WAVELENGTH] if row.pose is None else row.pose
            target[WAVELENGTH] = target[WAVELENGTH] if row.wavelength_nm is None else row.wavelength_nm
            # An unknown position without a target (NaN) does not move.
            before = np.where(np.isnan(target), 0.0, state.point)
            seconds += float(self.moves.seconds(before[None], np.nan_to_num(target)[None])[0])
            state = RigState(target, lit, state.gain)
        if row.kind == "warm-up":
            return seconds + shortest_warm_up_s(row.longest_s), state
        if row.kind == "mount":
            return seconds, state
        seconds += self.reading_s(row, state.gain) + (self.read_back_s if lit else 0.0)
        return seconds, RigState(state.point, lit, self.gain_after(row, state.gain))

    def reading_s(self, row: Row, gain: int | None) -> float:
        """Seconds to read a row at all its gains, from a gain of the amplifiers.

        How many gains auto-range needs, and how many readings a target uncertainty needs, is known only after the row. The
        row is assumed to need its TYPICAL_GAINS highest gains, and the geometric mean of the fewest and the most readings.
        """
        if row.sample in self.expected_reading_s and row.kind != "dark":
            return self.expected_reading_s[row.sample]
        return self._typical_reading_s(row, gain)

    def similar_reading_s(self, row: Row) -> float:
        """Seconds to read a row after a similar row."""
        return self.reading_s(row, self.gain_after(row, None))

    def gain_after(self, row: Row, gain: int | None, rows: int = 1) -> int | None:
        """Gain of the amplifiers after this number of similar rows, from a gain before them."""
        repeated = 2 - rows % 2 if rows else 0  # every second row leaves the same gain
        key = row.gains, row.automatic, row.target, gain, repeated
        if key not in self._gains_after:
            for _ in range(repeated):
                gain = _typical_gains(row, gain)[-1]
            self._gains_after[key] = gain
        return self._gains_after[key]

    def reading_range_s(self, row: Row) -> tuple[float, float]:
        """Shortest and longest time to read a row after a similar row; auto-range may need a single gain."""
        gains = gain_order(row, max(row.gains))
        least = gains[:1] if row.automatic else gains
        longest = max_readings(row, self._photodiodes.period_s)
        return self._reading_s(least, min_readings(row), gains[0]), self._reading_s(gains, longest, gains[-1])

    def least_row_s(self, row: Row) -> float:
        """Least duration of a row after a similar row, without moves, s."""
        return self.reading_range_s(row)[0] + self.read_back_s

    def longest_reading_s(self, row: Row) -> float:
        """Longest time that a plan assumes for reading a row, from any gain of the amplifiers."""
        return max(self._typical_reading_s(row, None), self.expected_reading_s.get(row.sample, 0.0))

    def lots_seconds(self, lots: list[ReadingLots]) -> float:
        """Seconds to read a row with these lots, after a similar row."""
        seconds, before = 0.0, lots[-1][0]
        for gain, (first, *further) in lots:
            seconds += self._reading_s((gain,), first, before)
            seconds += sum(self._reading_s((gain,), lot, gain) for lot in further)
            before = gain
        return seconds

    def shutter_s(self, state: RigState, *, opened: bool) -> float:
        """Seconds to open or close the shutter, 0 where it is already so."""
        return 0.0 if state.shutter_open is opened else self._shutter_s[opened]

    def _typical_reading_s(self, row: Row, gain: int | None) -> float:
        key = row.gains, row.automatic, row.target, row.readings, row.longest_s, gain
        if key not in self._typical_s:
            readings = round(math.sqrt(min_readings(row) * max_readings(row, self._photodiodes.period_s)))
            self._typical_s[key] = self._reading_s(_typical_gains(row, gain), readings, gain)
        return self._typical_s[key]

    def _reading_s(self, gains: tuple[int, ...], readings: int, before: int | None) -> float:
        """Seconds for this number of readings at each of the gains; the monitor is read at the same time."""
        settings = self._photodiodes
        seconds = 0.0
        for gain in gains:
            changed = gain != before
            before = gain
            fetching = max(settings.fetching_seconds(after_change=changed), self._monitor.fetching_seconds)
            seconds += (settings.gain_seconds if changed else 0.0) + settings.wait_s
            seconds += (readings - 1) * settings.period_s + fetching
        return seconds


def _typical_gains(row: Row, before: int | None) -> tuple[int, ...]:
    gains = gain_order(row, before)
    return gains[:TYPICAL_GAINS] if row.automatic else gains


def min_intervals(rows: int, reading_s: float, every_s: float) -> int:
    """Least number of intervals for rows of at least `reading_s` each, none longer than `every_s` unless it is a single row."""
    return math.ceil(rows / max(1, int(min(rows, every_s / reading_s + TINY))))
