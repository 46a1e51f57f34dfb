"""How long each row takes on the rig's clock: moves, conversions, and the bytes on the wires."""

import math

import numpy as np

from goniotwin.app.campaign.planning.lattice import WAVELENGTH
from goniotwin.app.campaign.planning.moves import Moves
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.running.averaging import LEAST as LEAST_AVERAGED
from goniotwin.app.campaign.running.gains import in_order
from goniotwin.app.campaign.running.performing import MONITORED_S
from goniotwin.app.campaign.running.warming import EVERY_S, LEAST
from goniotwin.app.rig import AXES, RigFile, axis_settings, monochromator_settings, photodiode_settings
from goniotwin.arrays import Floats
from goniotwin.drivers.monitor import ANSWER_MARGIN_S
from goniotwin.drivers.monochromator import STATUS_MARGIN_S

USB_LATENCY_S = 1.0e-3
TINY = 1e-9
LIKELY_GAINS = 2
UNKNOWN: Floats = np.full(5, np.nan)
Lots = tuple[int, tuple[int, ...]]
"""A gain, and how many readings are taken at it, one lot after the other."""


def least_warm_up_seconds(longest_s: float) -> float:
    """A warm-up ends no sooner than the monitor has been looked at so often, or its time is up; when it does is the lamp's."""
    looks = min(LEAST, 1 + math.ceil(max(0.0, longest_s - MONITORED_S) / EVERY_S))
    return (looks - 1) * EVERY_S + MONITORED_S


class Timing:
    """Follows the rows of a plan in order, knowing where each left the rig."""

    def __init__(self, rig: RigFile) -> None:
        self.foreseen: dict[str, float] = {}
        """By sample, what its rows take to be read, where that is not known from the schedule alone and was looked at."""
        self.moves = Moves(rig)
        self._monochromator = monochromator_settings(rig)
        self._photodiodes = photodiode_settings(rig)
        encoders = sum(settings.encoder for settings in axis_settings(rig).values())
        self.readback_s = 2 * (len(AXES) + encoders) * self.moves.exchange_s  # each with the canary
        self.here = UNKNOWN
        self._shutter_open: bool | None = None
        self._gain: int | None = None

    def row_seconds(self, row: Row) -> float:
        """The duration of the next row, s; a person's time at mountings is not in it."""
        if row.kind == "mount":
            return self.shutter(opened=False)
        if row.kind == "dark":
            return self.shutter(opened=False) + self.readings(row)
        there = self.here.copy()
        there[:WAVELENGTH] = there[:WAVELENGTH] if row.pose is None else row.pose
        there[WAVELENGTH] = there[WAVELENGTH] if row.wavelength_nm is None else row.wavelength_nm
        # What is not known before and not told either (NaN) does not move.
        before = np.where(np.isnan(there), 0.0, self.here)
        moving = float(self.moves.seconds(before[None], np.nan_to_num(there)[None])[0])
        self.here = there
        opening = moving + self.shutter(opened=True)
        return opening + (
            least_warm_up_seconds(row.longest_s) if row.kind == "warm-up" else self.readings(row) + self.readback_s
        )

    def readings(self, row: Row) -> float:
        """All gains of a row, from where the rows before have left the amplifiers.

        How many gains are needed where they are automatic, and how many readings where there is a target, is known when the
        row has been read. It is taken to need its two highest gains, and between the fewest and the most readings the
        geometric mean.
        """
        seconds = self.readings_from_here(row)
        self.pass_by(row, 1)
        return seconds

    def readings_from_here(self, row: Row) -> float:
        """The same for a row that only might come next."""
        if row.sample in self.foreseen and row.kind != "dark":
            return self.foreseen[row.sample]
        return self._reading(self._likely(row, self._gain), self._likely_readings(row), self._gain)

    def usual_readings(self, row: Row) -> float:
        """The same for a row that comes after one like it."""
        if row.sample in self.foreseen and row.kind != "dark":
            return self.foreseen[row.sample]
        before = self._likely(row, None)[-1]
        return self._reading(self._likely(row, before), self._likely_readings(row), before)

    def pass_by(self, row: Row, rows: int) -> None:
        """The amplifiers are where so many such rows leave them."""
        for _ in range(2 - rows % 2 if rows else 0):  # every second one leaves them alike
            self._gain = self._likely(row, self._gain)[-1]

    def readings_range(self, row: Row) -> tuple[float, float]:
        """The least and the most that `usual_readings` could turn out to be: with automatic gains one may do."""
        gains = in_order(row, max(row.gains))
        least = gains[:1] if row.automatic else gains
        return self._reading(least, _least_readings(row), gains[0]), self._reading(gains, self._most_readings(row), gains[-1])

    def longest_readings(self, row: Row) -> float:
        """The most that a plan takes such a row to need, wherever the amplifiers are before it."""
        likely = self._reading(self._likely(row, None), self._likely_readings(row), None)
        return max(likely, self.foreseen.get(row.sample, 0.0))

    def lots_seconds(self, taken: list[Lots]) -> float:
        """Of a row that is read at these gains, after one like it."""
        seconds, before = 0.0, taken[-1][0]
        for gain, (first, *further) in taken:
            seconds += self._reading((gain,), first, before)
            seconds += sum(self._reading((gain,), lot, gain) for lot in further)
            before = gain
        return seconds

    def _likely(self, row: Row, before: int | None) -> tuple[int, ...]:
        gains = in_order(row, before)
        return gains[:LIKELY_GAINS] if row.automatic else gains

    def _likely_readings(self, row: Row) -> int:
        return round(math.sqrt(_least_readings(row) * self._most_readings(row)))

    def _most_readings(self, row: Row) -> int:
        least = _least_readings(row)
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

    def shutter(self, *, opened: bool) -> float:
        """Opening or closing it, where it is not yet."""
        seconds = self.shutter_seconds(opened=opened)
        self._shutter_open = opened
        return seconds

    def shutter_seconds(self, *, opened: bool) -> float:
        """What that would take."""
        if self._shutter_open is opened:
            return 0.0
        asked = self._monochromator.question_seconds("SHUTTER?", "O")
        told = self._monochromator.statement_seconds(f"SHUTTER {'O' if opened else 'C'}")
        return self._monochromator.shutter_s + told + STATUS_MARGIN_S + asked


def _least_readings(row: Row) -> int:
    """At each gain; where their scatter decides, there have to be some to scatter."""
    return row.readings if row.target is None else max(row.readings, LEAST_AVERAGED)


def fewest_stretches(rows: int, reading_s: float, every_s: float) -> int:
    """Of rows that each take so long at least: none longer than `every_s`, unless it is a single row that takes longer."""
    return math.ceil(rows / max(1, int(min(rows, every_s / reading_s + TINY))))
