"""Registers and outputs of one converter module over its Modbus wire: exchanges that detect faults and recover from them.

Detectable and undetectable faults of the wires:

* No reply, exceptions, replies to another function, of another unit, length, address or (over TCP) transaction: always
  detected.
* A late or repeated reply. Over TCP its transaction identifier shows it. RTU has none. After each fault the line is
  drained, and the module must return a marker: its own name, read with alternating function and length, so that a late
  marker is not taken for this one. Reads alternate between functions 03 and 04, to which these modules reply alike, so
  that the reply to one read is not taken for the next.
* A changed byte. RTU has a checksum of 16 bits, which passes 1 of 65,536 arbitrary errors and no error of up to 16 bits in
  a row. Modbus TCP has none: a changed count between 0 and 65535 *cannot be detected*, only TCP's checksum protects it.
  Limits of the damage: lengths, unit, function and transaction must agree, which covers most of a frame except the values.

A read, and writing a setting, are repeated once after a fault. A call takes five timeouts at most, and that only with the
first fault.
"""

from collections.abc import Callable
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

READ_COILS = 1
READ_REGISTERS = (3, 4)
WRITE_COIL, WRITE_REGISTER, WRITE_COILS, WRITE_REGISTERS = 5, 6, 15, 16
CHECK_WIRING = "check address, cable and power"
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


class ModuleRegisters:
    """The registers and outputs of one module. A call takes one exchange, unless there is a fault.

    After a fault the module is `unverified`: before the next exchange the wire is resynchronised, and `check_settings` reads
    the settings back by the calls that do not repeat. While `lost_settings` is a text, every exchange raises Forgotten with it.
    """

    def __init__(
        self, name: str, unit: ModbusUnit, model: adam.Model, clock: Clock, check_settings: Callable[[], None]
    ) -> None:
        self.name = name
        self.bus: ModbusBus = unit.bus
        self.unverified = False
        self.lost_settings: str | None = None
        self.unit = unit.unit
        self._tap = unit.tap
        self._model = model
        self._clock = clock
        self._check_settings = check_settings
        self._writes_singly = self._sets_outputs_singly = False
        self._function_index = self._marker = 0

    def open(self) -> None:
        """Open the wire. Raises DeviceError."""
        try:
            connected = self.bus.open(self)
        except WIRE_FAULTS as error:
            raise DeviceError(
                self.name, "open the connection", describe_fault(error), "check the address in the rig file"
            ) from None
        if not connected:
            raise NoAnswer(self.name, "connect", "not responding", CHECK_WIRING)

    def release(self) -> None:
        """Release the wire; nothing is sent."""
        self.bus.close(self)

    def forgotten(self, doing: str) -> Forgotten:
        """The error of a module that has lost its settings."""
        return Forgotten(self.name, doing, str(self.lost_settings), "reconnect it, which writes its settings again")

    # ---- registers and coils ----

    def read(self, address: int, count: int) -> list[int]:
        """Values of consecutive registers. Raises DeviceError."""
        return self._repeat_once(partial(self.read_unrepeated, address, count))

    def read_outputs(self) -> list[bool]:
        """The digital outputs, lowest first. Raises DeviceError."""
        return self._repeat_once(self.read_outputs_unrepeated)

    def check_name(self) -> None:
        """Read the name. Raises WrongDevice for that of another model."""
        self._check_first_word(self.read(adam.MODULE_NAME, len(self._model.name)))

    def write(self, address: int, values: list[int], doing: str) -> None:
        """Write registers at once, or one by one where the module refuses function 16. Raises DeviceError.

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
                if not self.bus.rtu:
                    raise
        for at, value in enumerate(values, address):
            self._repeat_once(partial(self._write_register, at, value, doing))
        self._writes_singly = True

    def write_outputs(self, outputs: list[bool], doing: str) -> None:
        """Write the outputs at once, or one by one where the module refuses function 15. Raises DeviceError."""
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

    def read_unrepeated(self, address: int, count: int) -> list[int]:
        """Values of consecutive registers, in one exchange. Raises DeviceError."""
        doing = f"read registers {address} to {address + count - 1}"
        self._function_index ^= self.bus.rtu
        call, function = self._register_call(self._function_index, address, count), READ_REGISTERS[self._function_index]
        return self._values(self._ask(call, doing, function), count, doing)

    def read_outputs_unrepeated(self) -> list[bool]:
        """The digital outputs, lowest first, in one exchange. Raises DeviceError."""
        doing, count = "read its outputs back", self._model.outputs
        call: Call = lambda client: client.read_coils(adam.DIGITAL_OUTPUT, count=count, device_id=self.unit)  # noqa: E731
        reply = self._ask(call, doing, READ_COILS)
        if len(reply.bits) != 8:  # one byte carries them
            self._reject(doing, f"{len(reply.bits)} coils received instead of {count}")
        return [bool(bit) for bit in reply.bits[:count]]

    def _write_register(self, address: int, value: int, doing: str) -> None:
        reply = self._ask(lambda client: client.write_register(address, value, device_id=self.unit), doing, WRITE_REGISTER)
        if (reply.address, reply.registers) != (address, [value]):
            self._reject(doing, f"{reply.registers} in {reply.address} confirmed instead of {value} in {address}")

    def _write_output(self, at: int, on: bool, doing: str) -> None:
        reply = self._ask(lambda client: client.write_coil(at, on, device_id=self.unit), doing, WRITE_COIL)
        if (reply.address, reply.bits) != (at, [on]):
            self._reject(doing, f"{reply.bits} in {reply.address} confirmed instead of {on} in {at}")

    def _write(self, call: Call, doing: str, function: int, address: int, count: int) -> None:
        reply = self._ask(call, doing, function)
        if (reply.address, reply.count) != (address, count):
            self._reject(doing, f"{reply.count} from {reply.address} confirmed instead of {count} from {address}")

    def _register_call(self, function_index: int, address: int, count: int) -> Call:
        def call(client: ModbusBaseSyncClient) -> ModbusPDU:
            read = client.read_input_registers if function_index else client.read_holding_registers
            return read(address, count=count, device_id=self.unit)

        return call

    def _values(self, reply: ModbusPDU, count: int, doing: str) -> list[int]:
        if len(reply.registers) != count:
            self._reject(doing, f"{len(reply.registers)} values received instead of {count}")
        return [*reply.registers]

    # ---- exchanges ----

    def _repeat_once(self, action: Callable[[], T]) -> T:
        """Repeat a repeatable action after the first fault, but not while the module is unverified already."""
        verified = not self.unverified
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
        with self.bus.lock:
            if self.lost_settings is not None:
                raise self.forgotten(doing)
            if self.unverified or self.bus.stale:
                self._resynchronise()
            return self._exchange(call, doing, function)

    def _exchange(self, call: Call, doing: str, function: int) -> ModbusPDU:
        """One exchange, whose reply must have the function code and the unit. Raises DeviceError."""
        try:
            reply = self.bus.exchange(call, self._tap, self._clock)
        except WIRE_FAULTS as error:
            self.unverified = self.bus.stale = True
            happened = unless_late(self.bus.late_s, self.bus.timeout_s, describe_fault(error), CHECK_WIRING)
            raise NoAnswer(self.name, doing, *happened) from None
        if reply.function_code & 0x7F != function or reply.dev_id != self.unit:
            self._reject(doing, f"a reply to function {reply.function_code} of unit {reply.dev_id} instead of {function}")
        if reply.isError():
            raise ModuleRefused(self.name, doing, reply.exception_code)
        return reply

    def _reject(self, doing: str, happened: str) -> None:
        self.unverified = self.bus.stale = True
        raise BadAnswer(self.name, doing, happened, "a late reply or a disturbed wire: check cable and grounding")

    def _resynchronise(self) -> None:
        """Require a marker from the module, then check its settings. Raises DeviceError."""
        for last in (not self.bus.rtu, True):
            try:
                self._exchange_marker()
                break
            except (NoAnswer, BadAnswer):
                if last:
                    raise
        self.unverified = self.bus.stale = False
        self._check_settings()

    def _exchange_marker(self) -> None:
        doing = "resynchronise after a fault"
        try:
            connected = self.bus.renew()
        except WIRE_FAULTS as error:
            raise NoAnswer(self.name, doing, describe_fault(error), CHECK_WIRING) from None
        if not connected:
            raise NoAnswer(self.name, doing, "not responding", CHECK_WIRING)
        self._marker = (self._marker + 1) % 4
        function_index, count = self._marker >> 1 & int(self.bus.rtu), 1 + (self._marker & 1)
        call = self._register_call(function_index, adam.MODULE_NAME, count)
        reply = self._exchange(call, doing, READ_REGISTERS[function_index])
        self._check_first_word(self._values(reply, count, doing))

    def _check_first_word(self, name: list[int]) -> None:
        """Raise BadAnswer for the name of another model. The second word may have the letter of a revision."""
        if name[0] != self._model.name[0]:
            raise WrongDevice(
                self.name,
                "read its name",
                f"it is {name[0]:04x}, not {self._model.name[0]:04x}",
                "check which module has this address, and the kind in the rig file",
            )
