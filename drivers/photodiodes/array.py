"""The photodiodes of the arc behind Advantech modules: gain by digital outputs, counts by registers.

The gain is chosen by each module's own two digital outputs. An ADAM-4117 has none: its amplifiers have one fixed gain,
and the settings list that one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from goniotwin.arrays import Counts, Flags, Floats
from goniotwin.drivers.device import Pending, Until
from goniotwin.drivers.errors import DeviceError, NoAnswer, Refused
from goniotwin.drivers.photodiodes.adam import AdamModule, Check
from goniotwin.drivers.photodiodes.modbus import ModbusUnit, explain, explain_rtu
from goniotwin.protocols import adam
from goniotwin.protocols.clock import Clock

__all__ = ["PhotodiodeArray", "PhotodiodeSettings", "Readings", "explain", "explain_rtu"]

PERIOD_MARGIN = 1.01


@dataclass(frozen=True)
class PhotodiodeSettings:
    """What the operator believes of the photodiodes and their modules.

    `upper_deg` and `lower_deg` are the polar angles on the two arcs at shift 0; channels count through the upper arc
    first. A module makes `conversions_per_s` in all, so each of its channels is new once a `period_s`. After a change
    of gain or pose the first reading is `wait_s` later. `exchange_s` is how long one question takes.
    """

    upper_deg: tuple[float, ...]
    lower_deg: tuple[float, ...]
    gains_v_per_a: tuple[float, ...]
    gain_uncertainty: float = 1.0e-3
    range_code: int = adam.PLUS_MINUS_10_V
    conversions_per_s: float = 100.0
    settling_s: float = 0.25
    exchange_s: float = 4.0e-4
    kind: str = "adam-6017"

    @property
    def count(self) -> int:
        """How many photodiodes there are."""
        return len(self.upper_deg) + len(self.lower_deg)

    @property
    def modules(self) -> int:
        """How many modules of eight channels they take."""
        return -(-self.count // adam.CHANNELS)

    @property
    def model(self) -> adam.Model:
        """The kind of module."""
        return adam.MODELS[self.kind]

    @property
    def period_s(self) -> float:
        """Between two readings: a little more than a channel's conversions take, so that no reading comes twice.

        On a slow line it is as long as asking all modules takes.
        """
        return PERIOD_MARGIN * max(adam.CHANNELS / self.conversions_per_s, self.modules * self.exchange_s)

    @property
    def wait_s(self) -> float:
        """From a change of gain or pose to the first reading, which has to have been converted after the settling.

        What is read at a time was converted up to a round and a channel's turn before; and a change of range loses one.
        """
        conversion_s = PERIOD_MARGIN * adam.CHANNELS / self.conversions_per_s
        return max(self.settling_s + (1.0 + 1.0 / adam.CHANNELS) * conversion_s, 2.0 * conversion_s)

    @property
    def gain_seconds(self) -> float:
        """Setting the gain of all modules; nothing where it is fixed."""
        return self.modules * self.exchange_s if self.model.outputs else 0.0

    def fetching_seconds(self, *, after_change: bool) -> float:
        """The last reading and what has to follow it, of all modules: after a change of the gain one question more."""
        return (3 if after_change and self.model.outputs else 2) * self.modules * self.exchange_s

    @property
    def range(self) -> adam.Range:
        """The input range of all channels."""
        return adam.RANGES[self.range_code]


class PhotodiodeArray:
    """All modules of the arc, as one row of counts."""

    def __init__(self, units: list[ModbusUnit], settings: PhotodiodeSettings, clock: Clock) -> None:
        self._clock = clock
        self.settings = settings
        self._modules = [
            AdamModule(f"photodiodes module {index}", unit, settings.model, settings.range_code, clock)
            for index, unit in enumerate(units)
        ]
        self._connected = False

    def connect(self) -> list[str]:
        """Opens all modules, checks who they are, writes their settings; returns who they are. Raises DeviceError.

        Every module is tried; the error is the first one's and names the others that failed.
        """
        self.close()
        self._each(AdamModule.connect)
        self._connected = True
        return [module.identity for module in self._modules]

    def reconnect(self) -> list[str]:
        """After a fault: identity checked and settings restored, module by module; returns what was restored.

        Raises DeviceError as `connect`; it may be tried again, and a module that has come back meanwhile joins.
        """
        restored = [line for lines in self._each(AdamModule.reconnect) for line in lines]
        self._connected = True
        return restored

    def close(self) -> None:
        """Gives the connections back."""
        self._connected = False
        for module in self._modules:
            module.close()

    def start_gain(self, gain: int) -> Pending:
        """Has all amplifiers use the gain of that number in the settings' list; done when all modules have confirmed it.

        That they have it is read back with the next readings, and these are not good before.
        Raises Refused for a gain that is not in the list.
        """
        if not 0 <= gain < len(self.settings.gains_v_per_a):
            raise Refused("photodiodes", f"set gain {gain}", f"there are {len(self.settings.gains_v_per_a)}: mend the schedule")
        outputs = [bool(gain >> bit & 1) for bit in range(self.settings.model.outputs)]
        if not outputs:
            return Until(self._clock, self._clock.now())
        return Steps(self._clock, [partial(module.set_outputs, outputs) for module in self._linked("set the gain")])

    def start_readings(self, readings: int) -> "Readings":
        """Reads all channels so many times, once a conversion, after the settling time. Raises NoAnswer."""
        return Readings(self._linked("read"), self.settings, self._clock, readings)

    def _linked(self, doing: str) -> list[AdamModule]:
        if not self._connected:
            raise NoAnswer("photodiodes", doing, "they are not connected", "connect them first")
        return self._modules

    def _each(self, action: Callable[[AdamModule], list[str] | str]) -> list[list[str]]:
        done: list[list[str]] = []
        failed: list[DeviceError] = []
        for module in self._modules:
            try:
                found = action(module)
                done.append(found if isinstance(found, list) else [found])
            except DeviceError as error:
                failed.append(error)
        if failed:
            self._connected = False
            first = failed[0]
            if len(failed) == 1:
                raise first
            others = "".join(f"; also {error.device}: {error.happened}" for error in failed[1:])
            raise DeviceError(first.device, first.doing, first.happened + others, first.remedy)
        return done


class Steps:
    """Exchanges one after the other, one a poll."""

    def __init__(self, clock: Clock, steps: list[Callable[[], None]]) -> None:
        self._steps = steps
        self.due = clock.now()

    def poll(self) -> bool:
        """Does the next. Raises DeviceError."""
        if self._steps:
            self._steps.pop(0)()
        return not self._steps


class Readings:
    """Readings under way, one exchange a poll; done when each module has shown that it still has its settings."""

    def __init__(self, modules: list[AdamModule], settings: PhotodiodeSettings, clock: Clock, readings: int) -> None:
        self._modules = modules
        self._settings = settings
        self._clock = clock
        self._row: list[int] = []
        self._row_started = 0.0
        self._checks: list[Check] | None = None
        self._taken = 0
        self._counts: Counts = np.zeros((readings, settings.count), dtype=np.uint16)
        self.due = self._first = clock.now() + settings.wait_s

    @property
    def started(self) -> float:
        """When the first reading is due, s."""
        return self._first

    @property
    def counts(self) -> Counts:
        """Raw values, shape (readings taken so far, photodiodes). They are good once `poll` has said that it is done."""
        return self._counts[: self._taken]

    @property
    def clipped(self) -> Flags:
        """Which of the counts stand at an end of the range: bounds, not readings."""
        ends: Flags = (self.counts == 0) | (self.counts == adam.FULL_SCALE)
        return ends

    def mean_volts(self) -> Floats:
        """The mean of each photodiode's readings, V; NaN where one of them is clipped or none was taken."""
        if not self._taken:
            return np.full(self._settings.count, np.nan)
        scale = self._settings.range
        mean = scale.low_v + scale.lsb_v * self.counts.mean(axis=0)
        return np.where(self.clipped.any(axis=0), np.nan, mean)

    def poll(self) -> bool:
        """Asks one module: its counts, or in the end its settings. Raises DeviceError; no reading is invented."""
        if self._taken == len(self._counts):
            if self._checks is None:
                self._checks = [check for module in self._modules for check in module.checks()]
            self._checks.pop(0)()
            return not self._checks
        at = len(self._row) // adam.CHANNELS
        if at == 0:
            self._row_started = self._clock.now()
        self._row += self._modules[at].counts()
        if at + 1 == len(self._modules):
            self._counts[self._taken] = self._row[: self._settings.count]
            self._row = []
            self._taken += 1
            if self._taken < len(self._counts):
                # A fault that took time shifts the rest: two readings of one conversion would be one reading counted twice.
                planned = self._first + self._taken * self._settings.period_s
                late = self._row_started - (planned - self._settings.period_s) > 0.1 * self._settings.period_s
                self.due = self._row_started + self._settings.period_s if late else planned
        return False
