"""Questions to a converter module over a Modbus wire, and what is done before an answer is believed after a fault.

See `drivers.photodiodes.adam` for what that is worth on which wire.
"""

from collections.abc import Callable
from typing import TypeVar

from pymodbus.client.base import ModbusBaseSyncClient
from pymodbus.pdu import ModbusPDU

from goniotwin.drivers.errors import BadAnswer, DeviceError, NoAnswer, Refused
from goniotwin.drivers.photodiodes.modbus import WIRE_FAULTS, ModbusUnit, in_words
from goniotwin.protocols import adam

T = TypeVar("T")
Call = Callable[[ModbusBaseSyncClient], ModbusPDU]
Ask = Callable[[Call, str, int], ModbusPDU]
"""Takes what to call on a client, what that does, and the function that has to answer."""

READ_COILS = 1
READ_REGISTERS = (3, 4)
PASSING = (adam.DEVICE_FAILURE, adam.BUSY)
CHECK_WIRING = "check address, cable and power"
REFUSALS = {
    adam.ILLEGAL_FUNCTION: "it does not know the function",
    adam.ILLEGAL_ADDRESS: "it has no such register or coil",
    adam.ILLEGAL_VALUE: "it does not take the value",
    adam.DEVICE_FAILURE: "it reports a failure of its own",
    adam.BUSY: "it is busy",
}


class ModuleRefused(Refused):
    """The module answered with an exception; `code` is which."""

    def __init__(self, device: str, doing: str, code: int) -> None:
        super().__init__(
            device, doing, f"the module answers with exception {code}: {REFUSALS.get(code, 'a code that it should not have')}",
            "check that the rig file names the kind of module that is there",
        )  # fmt: skip
        self.code = code


class AdamWire:
    """One module's questions. A subclass says what is verified after a fault, and may allow no more questions."""

    def __init__(self, name: str, unit: ModbusUnit, model: adam.Model) -> None:
        self.name = name
        self._bus = unit.bus
        self._unit = unit.unit
        self._tap = unit.tap
        self._model = model
        self._doubtful = False
        self._turn = self._marker = 0

    def _allow(self, doing: str) -> None:
        """Raises DeviceError where the module is not to be asked for now."""

    def _verify(self) -> None:
        """Reads settings back, with `_exchange`, once each. Raises DeviceError where they are not what they should be."""

    def _open(self) -> None:
        try:
            there = self._bus.open(self)
        except WIRE_FAULTS as error:
            raise DeviceError(self.name, "open the connection", in_words(error), "check the address in the rig file") from None
        if not there:
            raise NoAnswer(self.name, "connect", "nobody is there", CHECK_WIRING)

    def _registers(self, address: int, count: int) -> list[int]:
        return self._twice(lambda: self._read(address, count, self._ask))

    def _coils(self, ask: Ask) -> list[bool]:
        doing, count = "read its outputs back", self._model.outputs
        call: Call = lambda client: client.read_coils(adam.DIGITAL_OUTPUT, count=count, device_id=self._unit)  # noqa: E731
        answer = ask(call, doing, READ_COILS)
        if len(answer.bits) != 8:  # one byte carries them
            self._distrust(doing, f"{len(answer.bits)} coils came instead of {count}")
        return [bool(bit) for bit in answer.bits[:count]]

    def _read(self, address: int, count: int, ask: Ask) -> list[int]:
        doing = f"read registers {address} to {address + count - 1}"
        self._turn ^= int(self._bus.line)
        answer = ask(self._reader(self._turn, address, count), doing, READ_REGISTERS[self._turn])
        if len(answer.registers) != count:
            self._distrust(doing, f"{len(answer.registers)} values came instead of {count}")
        return list(answer.registers)

    def _reader(self, turn: int, address: int, count: int) -> Call:
        def call(client: ModbusBaseSyncClient) -> ModbusPDU:
            read = client.read_input_registers if turn else client.read_holding_registers
            return read(address, count=count, device_id=self._unit)

        return call

    def _write(self, call: Call, doing: str, function: int, address: int, count: int) -> None:
        answer = self._ask(call, doing, function)
        if (answer.address, answer.count) != (address, count):
            self._distrust(doing, f"{answer.count} from {answer.address} confirmed instead of {count} from {address}")

    def _twice(self, action: Callable[[], T]) -> T:
        """For what may happen twice: once more after the first fault, not while the module is silent anyway."""
        hopeful = not self._doubtful
        try:
            return action()
        except (NoAnswer, BadAnswer):
            if not hopeful:
                raise
        except ModuleRefused as refused:
            if refused.code not in PASSING:
                raise
        return action()

    def _ask(self, call: Call, doing: str, function: int) -> ModbusPDU:
        with self._bus.lock:
            self._allow(doing)
            if self._doubtful or self._bus.stale:
                self._resynchronise()
            return self._exchange(call, doing, function)

    def _exchange(self, call: Call, doing: str, function: int) -> ModbusPDU:
        try:
            answer = self._bus.ask(call, self._tap)
        except WIRE_FAULTS as error:
            self._doubtful = self._bus.stale = True
            raise NoAnswer(self.name, doing, in_words(error), CHECK_WIRING) from None
        if answer.function_code & 0x7F != function or answer.dev_id != self._unit:
            self._distrust(doing, f"function {answer.function_code} of unit {answer.dev_id} answers instead of {function}")
        if answer.isError():
            raise ModuleRefused(self.name, doing, answer.exception_code)
        return answer

    def _distrust(self, doing: str, happened: str) -> None:
        self._doubtful = self._bus.stale = True
        raise BadAnswer(self.name, doing, happened, "a late answer or a disturbed wire: check cable and grounding")

    def _resynchronise(self) -> None:
        """Nothing is believed before the module has answered a marker, and has its settings. Raises DeviceError."""
        for last in (not self._bus.line, True):
            try:
                self._mark()
                break
            except (NoAnswer, BadAnswer):
                if last:
                    raise
        self._doubtful = self._bus.stale = False
        self._verify()

    def _mark(self) -> None:
        doing = "find it again after a fault"
        try:
            there = self._bus.renew()
        except WIRE_FAULTS as error:
            raise NoAnswer(self.name, doing, in_words(error), CHECK_WIRING) from None
        if not there:
            raise NoAnswer(self.name, doing, "nobody is there", CHECK_WIRING)
        self._marker = (self._marker + 1) % 4
        turn, count = self._marker >> 1 & int(self._bus.line), 1 + (self._marker & 1)
        answer = self._exchange(self._reader(turn, adam.MODULE_NAME, count), doing, READ_REGISTERS[turn])
        if len(answer.registers) != count:
            self._distrust(doing, f"{len(answer.registers)} values came instead of {count}")
        if tuple(answer.registers) != self._model.name[:count]:
            self._wrong_name(list(answer.registers))

    def _wrong_name(self, found: list[int]) -> None:
        raise BadAnswer(
            self.name, "ask for its name", f"it is {found[0]:04x}, not {self._model.name[0]:04x}",
            "check which module has this address, and the kind in the rig file",
        )  # fmt: skip
