"""One Advantech converter module, ADAM-6017 or ADAM-4117: its settings, readings and outputs.

What the wire can do wrong is detected by `ModuleRegisters`. Beyond that:

* Settings are read back, and a setting that seems wrong is read a second time; the engine compares the readings of a row
  (`app.campaign.readout.contradictions`), and takes them again where one contradicts the others.
* A module that reset and lost gain and ranges replies as before. A canary shows it, one exchange after each group of
  readings: the outputs if one is on, else the ranges. A change of gain would hide an earlier reset, so that both are read
  after the next readings. (This requires that the power-on values of the outputs are off.) At intervals name, ranges,
  outputs and enabled channels are all read back.

Ranges, enabled channels and outputs get back at the end what was found; a range is in the module's memory, and written only if
it differs.
"""

import contextlib
from collections.abc import Callable, Iterable
from functools import partial
from typing import TypeVar

from goniotwin.drivers.errors import BadAnswer, DeviceError
from goniotwin.drivers.photodiodes.modbus import ModbusBus, ModbusUnit
from goniotwin.drivers.photodiodes.registers import ModuleRegisters
from goniotwin.protocols import adam
from goniotwin.protocols.clock import Clock

T = TypeVar("T")
SettingsCheck = Callable[[], None]
"""A check of settings of a module, in one exchange. Raises DeviceError."""

CHECK_INTERVAL_S = 60.0
RANGES, ENABLED, OUTPUTS = "ranges", "enabled channels", "outputs"


class AdamModule:
    """One module. A call takes one exchange, unless there is a fault; connect and reconnect take several."""

    def __init__(
        self,
        name: str,
        unit: ModbusUnit,
        model: adam.Model,
        range_code: int,
        clock: Clock,
        raw_format: adam.RawFormat = "unsigned",
    ) -> None:
        self.name = name
        self.identity = ""
        self.registers = ModuleRegisters(name, unit, model, clock, self._check_after_fault)
        self._found = unit.found
        self._last_outputs: list[bool] | None = None
        self._model = model
        self._ranges = [range_code] * adam.CHANNELS
        self._sign_bit = adam.sign_bit(raw_format)
        self._clock = clock
        self._outputs: list[bool] | None = None
        self._outputs_written = self._outputs_checked = False
        self._settings_written = False
        self._checked_s = clock.now()

    # ---- connection ----

    @property
    def bus(self) -> ModbusBus:
        """Its wire."""
        return self.registers.bus

    def identify(self) -> str:
        """Open the wire and identify the module; nothing is written. Raises DeviceError."""
        self.registers.open()
        self._begin()
        self._outputs = None
        self._identify()
        self._leave_as_found()
        return self.identity

    def connect(self) -> str:
        """Open the wire, identify the module, write its settings; return its identity. Raises DeviceError."""
        self.registers.open()
        self._outputs = None
        self._initialise()
        return self.identity

    def reconnect(self) -> list[str]:
        """Identify the module and write all settings again; return what had to be restored.

        Raises DeviceError; another attempt may follow. A module that was never connected is connected.
        """
        with self.bus.lock:
            if not self.identity:
                self.connect()
                return [f"{self.name}: connected, {self.identity}"]
            self.registers.open()
            self.registers.unverified = True
            return self._initialise()

    def close(self) -> None:
        """Restore what was found, unless the module is not responding, and release the wire."""
        with contextlib.suppress(DeviceError):
            self._leave_as_found()
        self.release()

    def release(self) -> None:
        """Release the wire; nothing is sent."""
        self.registers.release()

    # ---- readings and outputs ----

    def counts(self) -> list[int]:
        """Raw values of all channels, 0 to 65535 over the range. Raises DeviceError."""
        registers = self.registers.read(adam.AI_VALUE, adam.CHANNELS)
        return [each ^ self._sign_bit for each in registers] if self._sign_bit else registers

    def set_outputs(self, outputs: list[bool]) -> None:
        """Set the digital outputs, lowest first; `checks` confirm them. Raises DeviceError."""
        doing = f"set its outputs to {_bits(outputs)}"
        if self._last_outputs is not None:
            self._found.note(_changes(OUTPUTS, map(int, self._last_outputs), map(int, outputs)))
            self._last_outputs = list(outputs)
        self._outputs, self._outputs_written, self._outputs_checked = list(outputs), False, False
        self.registers.write_outputs(outputs, doing)
        self._outputs_written = True

    # ---- checks of the settings ----

    def checks(self) -> list[SettingsCheck]:
        """Checks that must follow readings before these are accepted, one exchange each.

        The canary; after a change of the outputs these and the ranges; at intervals all settings. Each raises DeviceError,
        Forgotten if the module has lost its settings.
        """
        if self._clock.now() - self._checked_s >= CHECK_INTERVAL_S:
            return [self.check_outputs, self._check_ranges_after_outputs, self.registers.check_name, self._check_rest]
        if self._outputs is not None and not self._outputs_checked:
            return [self.check_outputs, self._check_ranges_after_outputs]
        return [self.check_outputs if self._outputs is not None and any(self._outputs) else self.check_ranges]

    def check_outputs(self) -> None:
        """Read the outputs back. Raises Forgotten if they differ from those that were set."""
        self._compare_outputs(self.registers.read_outputs)

    def check_ranges(self) -> None:
        """Read the ranges back. Raises Forgotten if they differ from those that were set."""
        self._compare_ranges(partial(self.registers.read, adam.RANGE_CODE, adam.CHANNELS))

    def _check_ranges_after_outputs(self) -> None:
        self.check_ranges()
        self._outputs_checked = True

    def _check_rest(self) -> None:
        self.check_enabled()
        self._checked_s = self._clock.now()

    def check_enabled(self) -> None:
        """Read the enabled channels back. Raises Forgotten if not all are."""
        if self._differs(lambda: self.registers.read(adam.CHANNEL_ENABLE, 1), [adam.ALL_CHANNELS]):
            self._forget("not all of its channels are enabled")

    def _check_after_fault(self) -> None:
        """Compare the settings, once they are written, before the next value is accepted. Raises DeviceError."""
        if self._settings_written:
            self._compare_ranges(partial(self.registers.read_unrepeated, adam.RANGE_CODE, adam.CHANNELS))
            self._compare_outputs(self.registers.read_outputs_unrepeated)

    def _compare_outputs(self, read: Callable[[], list[bool]]) -> None:
        if self._outputs is not None and self._outputs_written and self._differs(read, self._outputs):
            self._forget(f"its outputs are not {_bits(self._outputs)}, to which they were set")

    def _compare_ranges(self, read: Callable[[], list[int]]) -> None:
        if self._differs(read, self._ranges):
            self._forget("its ranges differ from those that were set")

    def _differs(self, read: Callable[[], list[T]], wanted: list[T]) -> bool:
        """True if a setting differs from the wanted value in two readings."""
        return read() != wanted and read() != wanted

    def _forget(self, what: str) -> None:
        self.registers.lost_settings = f"{what}: it has reset, or its settings were changed elsewhere"
        raise self.registers.forgotten("check its settings")

    # ---- settings ----

    def _begin(self) -> None:
        """Allow exchanges after lost settings; settings are not compared after a fault until they are written."""
        self.registers.lost_settings, self._settings_written = None, False

    def _initialise(self) -> list[str]:
        """Identify the module and write its settings. Returns what had to be restored."""
        self._begin()
        self._identify()
        if self._found.asks and self._model.outputs and self._outputs is None:
            self._last_outputs = self.registers.read_outputs()
        restored = self._restore(RANGES, adam.RANGE_CODE, self._ranges)
        restored += self._restore(ENABLED, adam.CHANNEL_ENABLE, [adam.ALL_CHANNELS])
        if self._outputs is not None and not (self._outputs_written and self.registers.read_outputs() == self._outputs):
            self.set_outputs(self._outputs)
            self.check_outputs()
            restored.append(f"{self.name}: outputs set to {_bits(self._outputs or [])}")
        self._settings_written = True
        self._checked_s = self._clock.now()
        return restored

    def _identify(self) -> None:
        self.registers.check_name()
        version = self.registers.read(adam.FIRMWARE_VERSION, 2)
        self.identity = f"{self._model.title} firmware {adam.firmware(version)}"
        self._found.take_up(self.identity)

    def _leave_as_found(self) -> None:
        """Restore settings that another program has not changed since. Raises DeviceError."""
        if not self._found.changes:
            return
        self._begin()  # they are compared here
        for what, address, count in ((RANGES, adam.RANGE_CODE, adam.CHANNELS), (ENABLED, adam.CHANNEL_ENABLE, 1)):
            if self._has_changed(what):
                present = self.registers.read(address, count)
                if (found := self._as_found(what, present)) != present:
                    self._set_registers(what, address, found)
        if self._has_changed(OUTPUTS):
            outputs = self.registers.read_outputs()
            if (found := self._as_found(OUTPUTS, list(map(int, outputs)))) != outputs:
                self.set_outputs(list(map(bool, found)))
                self.check_outputs()
        self._found.clear()

    def _has_changed(self, what: str) -> bool:
        return any(name.startswith(f"{what} ") for name in self._found.changes)

    def _as_found(self, what: str, present: list[int]) -> list[int]:
        """The values to be restored, and the present ones of what another program has set."""
        found = [self._found.value_to_restore(f"{what} {number}", str(now)) for number, now in enumerate(present)]
        return [now if was is None else int(was) for now, was in zip(present, found, strict=True)]

    def _restore(self, what: str, address: int, wanted: list[int]) -> list[str]:
        """Write registers that differ from their wanted values, read them back, and report it."""
        present = self.registers.read(address, len(wanted))
        if present != wanted:
            present = self.registers.read(address, len(wanted))
        self._found.note(_changes(what, present, wanted))
        if present == wanted:
            return []
        self._set_registers(what, address, wanted)
        return [f"{self.name}: {what} set"]

    def _set_registers(self, what: str, address: int, values: list[int]) -> None:
        doing = f"set its {what}"
        self.registers.write(address, values, doing)
        if self._differs(lambda: self.registers.read(address, len(values)), values):
            raise BadAnswer(self.name, doing, "it reads back other values", "check the module")


def _bits(outputs: list[bool]) -> str:
    """Outputs, highest first, as in the manual."""
    return "".join(str(int(on)) for on in reversed(outputs))


def _changes(what: str, present: Iterable[int], wanted: Iterable[int]) -> dict[str, tuple[str, str]]:
    """What is noted of registers or outputs, each by itself: a program killed between two writes has written some of them."""
    return {f"{what} {number}": (str(now), str(then)) for number, (now, then) in enumerate(zip(present, wanted, strict=True))}
