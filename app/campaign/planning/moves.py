"""How long the rig takes from one pose and wavelength to another: ramps, settling, the grating, the words on the wires.

For arrays of moves at once, so that orders of a million rows can be compared; what the engine does one by one is the same.
"""

from collections.abc import Callable

import numpy as np

from goniotwin.app.rig import AXES, RigFile, axis_settings, monochromator_settings
from goniotwin.arrays import Floats, Ints
from goniotwin.drivers.axis import ARRIVED_AFTER_S
from goniotwin.drivers.axis_settings import AxisSettings
from goniotwin.drivers.monochromator import STATUS_MARGIN_S
from goniotwin.protocols.cornerstone import Statement, encode_nm
from goniotwin.protocols.tmcl import FRAME_BYTES

CONTROLLER_LATENCY_S = 3.0e-4
WHEEL_AFTER_POWER_ON = 1
BEFORE_A_MOVE, AFTER_A_MOVE, BETWEEN_LEGS = 3, 2, 2
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
        self._words_s = told + STATUS_MARGIN_S + self._monochromator.question_seconds("WAVE?", farthest)
        self._wheel = self._monochromator.wheel
        self._ask_wheel_s = self._monochromator.question_seconds("FILTER?", "1")
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
            begun += np.where(changed, BEFORE_A_MOVE * self.exchange_s, 0.0)
            known = np.where(np.isnan(here), axis.zero_offset_deg, here)
            arrived = begun + self._turning(axis, known, there)
            done = np.where(changed, np.maximum(done, arrived) + AFTER_A_MOVE * self.exchange_s, done)
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
        detour = legs + 2 * ARRIVED_AFTER_S + BETWEEN_LEGS * self.exchange_s
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
    """Seconds from rest to rest over ways of any sign: `drivers.ramp.move_seconds`, for arrays."""
    distance = np.abs(way)
    ramps = speed * speed / acceleration
    short = 2.0 * np.sqrt(distance / acceleration)
    return np.asarray(np.where(distance >= ramps, 2.0 * speed / acceleration + (distance - ramps) / speed, short))
