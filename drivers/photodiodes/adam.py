"""One Advantech converter module, ADAM-6017 or ADAM-4117, on Modbus.

Detectable and undetectable faults of the wires:

* No reply, exceptions, replies to another function, of another unit, length, address or (over TCP) transaction: always
  detected.
* A late or repeated reply. Over TCP its transaction identifier shows it. RTU has none. After each fault the line is
  drained, and the module must return a marker: its own name, read with alternating function and length, so that a late
  marker is not taken for this one. Reads alternate between functions 03 and 04, to which these modules reply alike, so
  that the reply to one read is not taken for the next.
* A changed byte. RTU has a checksum of 16 bits, which passes 1 of 65,536 arbitrary errors and no error of up to 16 bits in
  a row. Modbus TCP has none: a changed count between 0 and 65535 *cannot be detected*, only TCP's checksum protects it.
  Limits of the damage: lengths, unit, function and transaction must agree, which covers most of a frame except the values;
  settings are read back, and a setting that seems wrong is read a second time; the engine compares the readings of a row
  (`app.campaign.readout.contradictions`), and takes them again where one contradicts the others.
* A module that reset and lost gain and ranges replies as before. A canary shows it, one exchange after each group of
  readings: the outputs if one is on, else the ranges. A change of gain would hide an earlier reset, so that both are read
  after the next readings. (This requires that the power-on values of the outputs are off.) At intervals name, ranges,
  outputs and enabled channels are all read back.

Ranges, enabled channels and outputs get back at the end what was found; a range is in the module's memory, and written only if
it differs.

A read, and writing a setting, are repeated once after a fault. A call takes five timeouts at most, and that only with the
first fault.
"""

import contextlib
from collections.abc import Callable, Iterable
from functools import partial
from typing import TypeVar

from pymodbus.client.base import ModbusBaseSyncClient
from pymodbus.pdu import ModbusPDU

from goniotwin.drivers.errors import BadAnswer, DeviceError, Forgotten, NoAnswer, Refused, WrongDevice, unless_late
from goniotwin.drivers.photodiodes.modbus import WIRE_FAULTS, ModbusBus, ModbusUnit, describe_fault
from goniotwin.protocols import adam
from goniotwin.protocols.clock import Clock

T = TypeVar("T")
Call = Callable[[ModbusBaseSyncClient], ModbusPDU]
SettingsCheck = Callable[[], None]
"""A check of settings of a module, in one exchange. Raises DeviceError."""
Exchange = Callable[[Call, str, int], ModbusPDU]
"""Takes a call of a client, its description, and the function code of the reply."""


READ_COILS = 1
READ_REGISTERS = (3, 4)
WRITE_COIL, WRITE_REGISTER, WRITE_COILS, WRITE_REGISTERS = 5, 6, 15, 16
CHECK_INTERVAL_S = 60.0
CHECK_WIRING = "check address, cable and power"
RANGES, ENABLED, OUTPUTS = "ranges", "enabled channels", "outputs"
TRANSIENT = (adam.DEVICE_FAILURE, adam.BUSY)
EXCEPTIONS = {
    adam.ILLEGAL_FUNCTION: "it does not support the function",
    adam.ILLEGAL_ADDRESS: "it has no such register or coil",
    adam.ILLEGAL_VALUE: "it does not accept the value",
    adam.DEVICE_FAILURE: "it reports a device failure",
    adam.BUSY: "it is busy",
}


class ModuleRefused(Refused):
    """The module replied with a Modbus exception, number `code`."""

    def __init__(self, device: str, doing: str, code: int) -> None:
        super().__init__(
            device,
            doing,
            f"the module replies with exception {code}: {EXCEPTIONS.get(code, 'a code it should not have')}",
            "check that the rig file names the kind of the connected module",
        )
        self.code = code


class AdamModule:
    """One module. A call takes one exchange, unless there is a fault; connect and reconnect take several.

    `unit` is its own on the wire. After a fault the module is *unverified*: the wire is resynchronised and the settings are
    read back before the next value is accepted.
    """

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
        self._bus = unit.bus
        self.unit = unit.unit
        self._tap = unit.tap
        self._found = unit.found
        self._last_outputs: list[bool] | None = None
        self._model = model
        self._ranges = [range_code] * adam.CHANNELS
        self._sign_bit = adam.sign_bit(raw_format)
        self._clock = clock
        self._outputs: list[bool] | None = None
        self._outputs_written = self._outputs_checked = False
        self._settings_written = False
        self._lost_settings: str | None = None
        self._checked_s = clock.now()
        self._unverified = False
        self._writes_singly = self._sets_outputs_singly = False
        self._function_index = self._marker = 0

    # ---- connection ----

    @property
    def bus(self) -> ModbusBus:
        """Its wire."""
        return self._bus

    def identify(self) -> str:
        """Open the wire and identify the module; nothing is written. Raises DeviceError."""
        self._open()
        self._lost_settings, self._settings_written, self._outputs = None, False, None
        self._identify()
        self._leave_as_found()
        return self.identity

    def connect(self) -> str:
        """Open the wire, identify the module, write its settings; return its identity. Raises DeviceError."""
        self._open()
        self._outputs = None
        self._initialise()
        return self.identity

    def reconnect(self) -> list[str]:
        """Identify the module and write all settings again; return what had to be restored.

        Raises DeviceError; another attempt may follow. A module that was never connected is connected.
        """
        with self._bus.lock:
            if not self.identity:
                self.connect()
                return [f"{self.name}: connected, {self.identity}"]
            self._open()
            self._unverified = True
            return self._initialise()

    def close(self) -> None:
        """Restore what was found, unless the module is not responding, and release the wire."""
        with contextlib.suppress(DeviceError):
            self._leave_as_found()
        self.release()

    def release(self) -> None:
        """Release the wire; nothing is sent."""
        self._bus.close(self)

    # ---- readings and outputs ----

    def counts(self) -> list[int]:
        """Raw values of all channels, 0 to 65535 over the range. Raises DeviceError."""
        registers = self._read_registers(adam.AI_VALUE, adam.CHANNELS)
        return [each ^ self._sign_bit for each in registers] if self._sign_bit else registers

    def set_outputs(self, outputs: list[bool]) -> None:
        """Set the digital outputs, lowest first; `checks` confirm them. Raises DeviceError."""
        doing = f"set its outputs to {_bits(outputs)}"
        if self._last_outputs is not None:
            self._found.note(_changes(OUTPUTS, map(int, self._last_outputs), map(int, outputs)))
            self._last_outputs = list(outputs)
        self._outputs, self._outputs_written, self._outputs_checked = list(outputs), False, False
        self._write_outputs(outputs, doing)
        self._outputs_written = True

    # ---- checks of the settings ----

    def checks(self) -> list[SettingsCheck]:
        """Checks that must follow readings before these are accepted, one exchange each.

        The canary; after a change of the outputs these and the ranges; at intervals all settings. Each raises DeviceError,
        Forgotten if the module has lost its settings.
        """
        if self._clock.now() - self._checked_s >= CHECK_INTERVAL_S:
            return [self.check_outputs, self._check_ranges_after_outputs, self._check_name, self._check_rest]
        if self._outputs is not None and not self._outputs_checked:
            return [self.check_outputs, self._check_ranges_after_outputs]
        return [self.check_outputs if self._outputs is not None and any(self._outputs) else self.check_ranges]

    def check_outputs(self) -> None:
        """Read the outputs back. Raises Forgotten if they differ from those that were set."""
        self._compare_outputs(self._read_outputs)

    def check_ranges(self) -> None:
        """Read the ranges back. Raises Forgotten if they differ from those that were set."""
        self._compare_ranges(self._read_ranges)

    def _check_ranges_after_outputs(self) -> None:
        self.check_ranges()
        self._outputs_checked = True

    def _check_rest(self) -> None:
        self._check_enabled()
        self._checked_s = self._clock.now()

    def _check_name(self) -> None:
        name = self._read_registers(adam.MODULE_NAME, len(self._model.name))
        self._check_first_word(name)

    def _check_enabled(self) -> None:
        if self._differs(lambda: self._read_registers(adam.CHANNEL_ENABLE, 1), [adam.ALL_CHANNELS]):
            self._forget("not all of its channels are enabled")

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
        self._lost_settings = f"{what}: it has reset, or its settings were changed elsewhere"
        raise self._forgotten("check its settings")

    def _forgotten(self, doing: str) -> Forgotten:
        return Forgotten(self.name, doing, str(self._lost_settings), "reconnect it, which writes its settings again")

    # ---- settings ----

    def _initialise(self) -> list[str]:
        """Identify the module and write its settings. Returns what had to be restored."""
        self._lost_settings, self._settings_written = None, False
        self._identify()
        if self._found.asks and self._model.outputs and self._outputs is None:
            self._last_outputs = self._read_outputs()
        restored = self._restore(RANGES, adam.RANGE_CODE, self._ranges)
        restored += self._restore(ENABLED, adam.CHANNEL_ENABLE, [adam.ALL_CHANNELS])
        if self._outputs is not None and not (self._outputs_written and self._read_outputs() == self._outputs):
            self.set_outputs(self._outputs)
            self.check_outputs()
            restored.append(f"{self.name}: outputs set to {_bits(self._outputs or [])}")
        self._settings_written = True
        self._checked_s = self._clock.now()
        return restored

    def _identify(self) -> None:
        self._check_name()
        version = self._read_registers(adam.FIRMWARE_VERSION, 2)
        self.identity = f"{self._model.title} firmware {adam.firmware(version)}"
        self._found.take_up(self.identity)

    def _leave_as_found(self) -> None:
        """Restore settings that another program has not changed since. Raises DeviceError."""
        if not self._found.changes:
            return
        self._lost_settings, self._settings_written = None, False  # they are compared here
        for what, address, count in ((RANGES, adam.RANGE_CODE, adam.CHANNELS), (ENABLED, adam.CHANNEL_ENABLE, 1)):
            if self._has_changed(what):
                present = self._read_registers(address, count)
                if (found := self._as_found(what, present)) != present:
                    self._set_registers(what, address, found)
        if self._has_changed(OUTPUTS):
            outputs = self._read_outputs()
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
        present = self._read_registers(address, len(wanted))
        if present != wanted:
            present = self._read_registers(address, len(wanted))
        self._found.note(_changes(what, present, wanted))
        if present == wanted:
            return []
        self._set_registers(what, address, wanted)
        return [f"{self.name}: {what} set"]

    def _set_registers(self, what: str, address: int, values: list[int]) -> None:
        doing = f"set its {what}"
        self._write_registers(address, values, doing)
        if self._differs(lambda: self._read_registers(address, len(values)), values):
            raise BadAnswer(self.name, doing, "it reads back other values", "check the module")

    # ---- registers and coils ----

    def _read_registers(self, address: int, count: int) -> list[int]:
        return self._repeat_once(partial(self._registers, address, count, self._ask))

    def _write_registers(self, address: int, values: list[int], doing: str) -> None:
        """Write registers at once, or one by one where the module refuses function 16.

        On a serial line some modules do not confirm the longer request in a legible way; that counts as a refusal.
        """
        call: Call = lambda client: client.write_registers(address, values, device_id=self.unit)  # noqa: E731
        if not self._writes_singly:
            try:
                self._repeat_once(lambda: self._write(call, doing, WRITE_REGISTERS, address, len(values)))
                return
            except ModuleRefused as refused:
                if refused.code in TRANSIENT:
                    raise
            except (NoAnswer, BadAnswer):
                if not self._bus.rtu:
                    raise
        for at, value in enumerate(values, address):
            self._repeat_once(partial(self._write_register, at, value, doing))
        self._writes_singly = True

    def _write_register(self, address: int, value: int, doing: str) -> None:
        reply = self._ask(lambda client: client.write_register(address, value, device_id=self.unit), doing, WRITE_REGISTER)
        if (reply.address, reply.registers) != (address, [value]):
            self._reject(doing, f"{reply.registers} in {reply.address} confirmed instead of {value} in {address}")

    def _write_outputs(self, outputs: list[bool], doing: str) -> None:
        """Write the outputs at once, or one by one where the module refuses function 15."""
        call: Call = lambda client: client.write_coils(adam.DIGITAL_OUTPUT, outputs, device_id=self.unit)  # noqa: E731
        if not self._sets_outputs_singly:
            try:
                self._repeat_once(lambda: self._write(call, doing, WRITE_COILS, adam.DIGITAL_OUTPUT, len(outputs)))
                return
            except ModuleRefused as refused:
                if refused.code in TRANSIENT:
                    raise
        for at, on in enumerate(outputs, adam.DIGITAL_OUTPUT):
            self._repeat_once(partial(self._write_output, at, on, doing))
        self._sets_outputs_singly = True

    def _write_output(self, at: int, on: bool, doing: str) -> None:
        reply = self._ask(lambda client: client.write_coil(at, on, device_id=self.unit), doing, WRITE_COIL)
        if (reply.address, reply.bits) != (at, [on]):
            self._reject(doing, f"{reply.bits} in {reply.address} confirmed instead of {on} in {at}")

    def _read_ranges(self) -> list[int]:
        return self._read_registers(adam.RANGE_CODE, adam.CHANNELS)

    def _read_outputs(self) -> list[bool]:
        return self._repeat_once(lambda: self._coils(self._ask))

    def _registers(self, address: int, count: int, exchange: Exchange) -> list[int]:
        doing = f"read registers {address} to {address + count - 1}"
        self._function_index ^= self._bus.rtu
        reply = exchange(self._register_call(self._function_index, address, count), doing, READ_REGISTERS[self._function_index])
        if len(reply.registers) != count:
            self._reject(doing, f"{len(reply.registers)} values received instead of {count}")
        return [*reply.registers]

    def _register_call(self, function_index: int, address: int, count: int) -> Call:
        def call(client: ModbusBaseSyncClient) -> ModbusPDU:
            read = client.read_input_registers if function_index else client.read_holding_registers
            return read(address, count=count, device_id=self.unit)

        return call

    def _coils(self, exchange: Exchange) -> list[bool]:
        doing, count = "read its outputs back", self._model.outputs
        call: Call = lambda client: client.read_coils(adam.DIGITAL_OUTPUT, count=count, device_id=self.unit)  # noqa: E731
        reply = exchange(call, doing, READ_COILS)
        if len(reply.bits) != 8:  # one byte carries them
            self._reject(doing, f"{len(reply.bits)} coils received instead of {count}")
        return [bool(bit) for bit in reply.bits[:count]]

    def _write(self, call: Call, doing: str, function: int, address: int, count: int) -> None:
        reply = self._ask(call, doing, function)
        if (reply.address, reply.count) != (address, count):
            self._reject(doing, f"{reply.count} from {reply.address} confirmed instead of {count} from {address}")

    # ---- exchanges ----

    def _repeat_once(self, action: Callable[[], T]) -> T:
        """Repeat a repeatable action after the first fault, but not while the module is unverified already."""
        verified = not self._unverified
        try:
            return action()
        except (NoAnswer, BadAnswer):
            if not verified:
                raise
        except ModuleRefused as refused:
            if refused.code not in TRANSIENT:
                raise
        return action()

    def _ask(self, call: Call, doing: str, function: int) -> ModbusPDU:
        """One exchange, after a resynchronisation if there was a fault. Raises DeviceError."""
        with self._bus.lock:
            if self._lost_settings is not None:
                raise self._forgotten(doing)
            if self._unverified or self._bus.stale:
                self._resynchronise()
            return self._exchange(call, doing, function)

    def _exchange(self, call: Call, doing: str, function: int) -> ModbusPDU:
        """One exchange, whose reply must have the function code and the unit. Raises DeviceError."""
        try:
            reply = self._bus.exchange(call, self._tap, self._clock)
        except WIRE_FAULTS as error:
            self._unverified = self._bus.stale = True
            happened = unless_late(self._bus.late_s, self._bus.timeout_s, describe_fault(error), CHECK_WIRING)
            raise NoAnswer(self.name, doing, *happened) from None
        if reply.function_code & 0x7F != function or reply.dev_id != self.unit:
            self._reject(doing, f"a reply to function {reply.function_code} of unit {reply.dev_id} instead of {function}")
        if reply.isError():
            raise ModuleRefused(self.name, doing, reply.exception_code)
        return reply

    def _reject(self, doing: str, happened: str) -> None:
        self._unverified = self._bus.stale = True
        raise BadAnswer(self.name, doing, happened, "a late reply or a disturbed wire: check cable and grounding")

    def _resynchronise(self) -> None:
        """Require a marker from the module, then read its settings back. Raises DeviceError."""
        for last in (not self._bus.rtu, True):
            try:
                self._exchange_marker()
                break
            except (NoAnswer, BadAnswer):
                if last:
                    raise
        self._unverified = self._bus.stale = False
        if self._settings_written:
            self._compare_ranges(lambda: self._registers(adam.RANGE_CODE, adam.CHANNELS, self._exchange))
            self._compare_outputs(lambda: self._coils(self._exchange))

    def _exchange_marker(self) -> None:
        doing = "resynchronise after a fault"
        try:
            connected = self._bus.renew()
        except WIRE_FAULTS as error:
            raise NoAnswer(self.name, doing, describe_fault(error), CHECK_WIRING) from None
        if not connected:
            raise NoAnswer(self.name, doing, "not responding", CHECK_WIRING)
        self._marker = (self._marker + 1) % 4
        function_index, count = self._marker >> 1 & int(self._bus.rtu), 1 + (self._marker & 1)
        call = self._register_call(function_index, adam.MODULE_NAME, count)
        reply = self._exchange(call, doing, READ_REGISTERS[function_index])
        if len(reply.registers) != count:
            self._reject(doing, f"{len(reply.registers)} values received instead of {count}")
        self._check_first_word(list(reply.registers))

    def _check_first_word(self, name: list[int]) -> None:
        """Raise BadAnswer for the name of another model. The second word may have the letter of a revision."""
        if name[0] != self._model.name[0]:
            raise WrongDevice(
                self.name,
                "read its name",
                f"it is {name[0]:04x}, not {self._model.name[0]:04x}",
                "check which module has this address, and the kind in the rig file",
            )

    def _open(self) -> None:
        try:
            connected = self._bus.open(self)
        except WIRE_FAULTS as error:
            raise DeviceError(
                self.name, "open the connection", describe_fault(error), "check the address in the rig file"
            ) from None
        if not connected:
            raise NoAnswer(self.name, "connect", "not responding", CHECK_WIRING)


def _bits(outputs: list[bool]) -> str:
    """Outputs, highest first, as in the manual."""
    return "".join(str(int(on)) for on in reversed(outputs))


def _changes(what: str, present: Iterable[int], wanted: Iterable[int]) -> dict[str, tuple[str, str]]:
    """What is noted of registers or outputs, each by itself: a program killed between two writes has written some of them."""
    return {f"{what} {number}": (str(now), str(then)) for number, (now, then) in enumerate(zip(present, wanted, strict=True))}
