"""Photodiodes of the arc behind Advantech modules: gain by digital outputs, counts by registers.

Each module sets the gain of its amplifiers by two digital outputs. An ADAM-4117 has no outputs: its amplifiers have one
fixed gain, and the settings list only this one.
"""

from collections.abc import Callable, Sequence

import numpy as np

from goniotwin.arrays import Counts, Flags, Floats
from goniotwin.drivers.device import Pending, Until
from goniotwin.drivers.errors import DeviceError, NoAnswer, Refused
from goniotwin.drivers.photodiodes.adam import AdamModule, SettingsCheck
from goniotwin.drivers.photodiodes.modbus import NOT_QUIET, ModbusUnit
from goniotwin.drivers.photodiodes.registers import CHECK_WIRING
from goniotwin.drivers.photodiodes.settings import PhotodiodeSettings
from goniotwin.protocols import adam
from goniotwin.protocols.clock import Clock

NAME = "photodiodes"
LATE = 0.1
"""A reading that begins later than planned, by this part of the period, delays those that follow."""


class PhotodiodeArray:
    """All modules of the arc, as one row of counts (photodiodes,)."""

    name = NAME

    def __init__(self, units: list[ModbusUnit], settings: PhotodiodeSettings, clock: Clock) -> None:
        self._clock = clock
        self.settings = settings
        self.modules = [
            AdamModule(f"photodiodes module {index}", unit, settings.model, settings.range.code, clock, settings.raw_format)
            for index, unit in enumerate(units)
        ]
        self._connected = False

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the modules."""
        return tuple(module.name for module in self.modules)

    @property
    def model(self) -> str:
        """The model of the modules, of the rig file."""
        return self.settings.model.title

    @property
    def identities(self) -> list[str]:
        """Identities of the modules, once connected."""
        return [module.identity for module in self.modules]

    def identify(self) -> str:
        """Open and identify all modules; nothing is written. Raises DeviceError as `connect` does."""
        self._each(AdamModule.identify)
        return self._identity

    def connect(self) -> str:
        """Open and identify all modules, write their settings; return their number and model. Raises DeviceError.

        Every module is tried; the error is that of the first failed one, and names the others.
        """
        self._connected = False
        for module in self.modules:
            module.release()
        self._each(AdamModule.connect)
        self._connected = True
        return self._identity

    @property
    def _identity(self) -> str:
        return f"{len(self.modules)} modules {self.model}"

    def reconnect(self) -> list[str]:
        """After a fault: identify each module and restore its settings; return what was restored.

        Raises DeviceError as `connect` does; it may be called again, and includes modules that respond again.
        """
        restored = [line for lines in self._each(AdamModule.reconnect) for line in lines]
        self._connected = True
        return restored

    def check(self) -> None:
        """Read the ranges of each module back. Raises DeviceError, Forgotten where a module has lost its settings."""
        for module in self._connected_modules("check"):
            module.check_ranges()

    def close(self) -> None:
        """Restore the settings that were found, and close the connections."""
        self._connected = False
        for module in self.modules:
            module.close()

    def start_gain(self, gain: int) -> Pending:
        """Set the gain of all amplifiers, by its index in the settings; done when all modules have confirmed it.

        The outputs are read back after the next readings, which are valid only then. Raises Refused for an unknown gain.
        """
        if not 0 <= gain < len(self.settings.gains_v_per_a):
            gains = len(self.settings.gains_v_per_a)
            raise Refused(self.name, f"set gain {gain}", f"the rig file has {gains} gains", "correct the schedule")
        outputs = [bool(gain >> bit & 1) for bit in range(self.settings.model.outputs)]
        if not outputs:
            return Until(self._clock, self._clock.now())
        return GainChange(self._clock, self._connected_modules("set the gain"), outputs)

    def start_readings(self, readings: int, *, settled: bool = False) -> "Readings":
        """Start a number of readings of all channels, one per conversion, after the settling time. Raises NoAnswer.

        With `settled`, at once: nothing has changed since the readings before, or it does not matter.
        """
        wait_s = 0.0 if settled else self.settings.wait_s
        return Readings(self._connected_modules("read"), self.settings, self._clock, readings, wait_s)

    def _connected_modules(self, doing: str) -> list[AdamModule]:
        if not self._connected:
            raise NoAnswer(self.name, doing, "not connected", "connect them first")
        return self.modules

    def _each(self, action: Callable[[AdamModule], list[str] | str]) -> list[list[str]]:
        done: list[list[str]] = []
        failed: list[DeviceError] = []
        for module in self.modules:
            try:
                if failed and module.bus.noisy:  # a line of several modules, of which none can be heard
                    raise NoAnswer(module.name, "use its line", NOT_QUIET, CHECK_WIRING)
                outcome = action(module)
                done.append(outcome if isinstance(outcome, list) else [outcome])
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


class GainChange:
    """Change of the outputs of all modules, one exchange per poll."""

    def __init__(self, clock: Clock, modules: Sequence[AdamModule], outputs: list[bool]) -> None:
        self._clock = clock
        self._left = list(modules)
        self._outputs = outputs
        self.due = clock.now()

    def poll(self) -> bool:
        """Set the outputs of the next module. Raises DeviceError."""
        if self._left:
            self._left.pop(0).set_outputs(self._outputs)
        return not self._left


class Readings:
    """Readings in progress, one exchange per poll; done when the settings of each module have been checked."""

    def __init__(
        self, modules: list[AdamModule], settings: PhotodiodeSettings, clock: Clock, readings: int, wait_s: float
    ) -> None:
        self._modules = modules
        self._settings = settings
        self._clock = clock
        self._row: list[int] = []
        self._row_started = 0.0
        self._checks: list[SettingsCheck] | None = None
        self._taken = 0
        self._counts: Counts = np.zeros((readings, settings.count), dtype=np.uint16)
        self.due = self._first = clock.now() + wait_s

    @property
    def started(self) -> float:
        """Time of the first reading, s."""
        return self._first

    @property
    def counts(self) -> Counts:
        """Raw values, shape (readings taken so far, photodiodes). They are valid once `poll` has returned True."""
        return self._counts[: self._taken]

    @property
    def saturated(self) -> Flags:
        """Counts at an end of the range, shape of `counts`; they are bounds, not readings."""
        return self._settings.range.saturated(self.counts)

    def mean_volts(self) -> Floats:
        """Mean of the readings, V, shape (photodiodes,); NaN if one of them is saturated or none was taken."""
        if not self._taken:
            return np.full(self._settings.count, np.nan)
        mean = self._settings.range.volts(self.counts.mean(axis=0))
        return np.where(self.saturated.any(axis=0), np.nan, mean)

    def poll(self) -> bool:
        """Read the counts of one module, or after the last reading check its settings. Raises DeviceError."""
        if self._taken == len(self._counts):
            if self._checks is None:
                self._checks = [check for module in self._modules for check in module.checks()]
            self._checks.pop(0)()
            return not self._checks
        index = len(self._row) // adam.CHANNELS
        if index == 0:
            self._row_started = self._clock.now()
        self._row += self._modules[index].counts()
        if index + 1 == len(self._modules):
            self._counts[self._taken] = self._row[: self._settings.count]
            self._row = []
            self._taken += 1
            if self._taken < len(self._counts):
                # A fault that took time delays the rest, so that no conversion is read twice.
                planned = self._first + self._taken * self._settings.period_s
                late = self._row_started - (planned - self._settings.period_s) > LATE * self._settings.period_s
                self.due = self._row_started + self._settings.period_s if late else planned
        return False
