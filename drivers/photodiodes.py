"""The photodiodes of the arc behind Advantech ADAM-6017 modules: gain by digital outputs, counts by registers."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt
from pymodbus.client.base import ModbusBaseSyncClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU

from drivers.errors import BadAnswer, DeviceError, NoAnswer, Refused
from drivers.pending import Pending, Until
from drivers.tap import FROM_DEVICE, TO_DEVICE, Tap
from protocols import adam
from protocols.clock import Clock

Counts = npt.NDArray[np.uint16]
ModbusOpener = Callable[[Callable[[bool, bytes], bytes] | None], ModbusBaseSyncClient]
"""Makes the client of a module; takes what pymodbus calls with each packet."""

PERIOD_MARGIN = 1.01


@dataclass(frozen=True)
class PhotodiodeSettings:
    """What the operator believes of the photodiodes and their modules.

    `upper_deg` and `lower_deg` are the polar angles on the two arcs at shift 0; channels count through the upper arc
    first. A module makes `conversions_per_s` in all, so each of its channels is new once a `period_s`. After a change
    of gain or pose the first conversion that counts begins `settling_s` later.
    """

    upper_deg: tuple[float, ...]
    lower_deg: tuple[float, ...]
    gains_v_per_a: tuple[float, ...]
    gain_uncertainty: float = 1.0e-3
    range_code: int = adam.PLUS_MINUS_10_V
    conversions_per_s: float = 100.0
    settling_s: float = 0.25
    exchange_s: float = 4.0e-4

    @property
    def count(self) -> int:
        """How many photodiodes there are."""
        return len(self.upper_deg) + len(self.lower_deg)

    @property
    def modules(self) -> int:
        """How many modules of eight channels they take."""
        return -(-self.count // adam.CHANNELS)

    @property
    def period_s(self) -> float:
        """Between two readings: a little more than a channel's conversions take, so that no reading comes twice."""
        return PERIOD_MARGIN * adam.CHANNELS / self.conversions_per_s

    @property
    def range(self) -> adam.Range:
        """The input range of all channels."""
        return adam.RANGES[self.range_code]

    def reading_seconds(self, readings: int) -> float:
        """From the trigger to the last of so many readings, settling included."""
        return self.settling_s + readings * self.period_s + self.modules * self.exchange_s


class PhotodiodeArray:
    """All modules of the arc, as one row of counts."""

    def __init__(
        self,
        openers: list[ModbusOpener],
        settings: PhotodiodeSettings,
        clock: Clock,
        taps: list[Tap] | None = None,
    ) -> None:
        self._openers = openers
        self._taps = taps
        self._clock = clock
        self.settings = settings
        self._modules: list[AdamModule] = []

    def connect(self) -> list[str]:
        """Opens all modules, checks who they are, sets their range; returns their names. Raises DeviceError."""
        self.close()
        for index, opener in enumerate(self._openers):
            tap = self._taps[index] if self._taps else None
            module = AdamModule(f"photodiodes module {index}", opener, tap)
            self._modules.append(module)
            module.connect(self.settings.range_code)
        return [module.name for module in self._modules]

    def close(self) -> None:
        """Gives the connections back."""
        for module in self._modules:
            module.close()
        self._modules = []

    def start_gain(self, gain: int) -> Pending:
        """Has all amplifiers use the gain of that number in the settings' list; done when they have settled."""
        for module in self._modules:
            module.set_outputs([bool(gain >> bit & 1) for bit in range(adam.DIGITAL_OUTPUTS)])
        return Until(self._clock, self._clock.now())

    def start_readings(self, readings: int) -> "Readings":
        """Reads all channels so many times, once a conversion, after the settling time."""
        return Readings(self._modules, self.settings, self._clock, readings)


class Readings:
    """Readings under way; `counts` (readings, photodiodes) is filled as they come."""

    def __init__(self, modules: list["AdamModule"], settings: PhotodiodeSettings, clock: Clock, readings: int) -> None:
        self._modules = modules
        self._settings = settings
        self._clock = clock
        self._taken = 0
        self.counts: Counts = np.zeros((readings, settings.count), dtype=np.uint16)
        # What is read was converted up to a period before.
        self.due = self._first = clock.now() + settings.settling_s + settings.period_s

    @property
    def started(self) -> float:
        """When the first reading is due, s."""
        return self._first

    def poll(self) -> bool:
        """Takes one reading of every module. Raises DeviceError."""
        row: list[int] = []
        for module in self._modules:
            row += module.counts()
        self.counts[self._taken] = row[: self._settings.count]
        self._taken += 1
        self.due = self._first + self._taken * self._settings.period_s
        return self._taken == len(self.counts)


class AdamModule:
    """One module on its own connection. Raises DeviceError where its address leads nowhere."""

    def __init__(self, name: str, opener: ModbusOpener, tap: Tap | None) -> None:
        self.name = name
        self._tap = tap
        try:
            self._client = opener(self._trace if tap is not None else None)
        except (LookupError, OSError, ValueError) as error:
            raise DeviceError(name, "open the connection", str(error), "check the address in the rig file") from None

    def connect(self, range_code: int) -> None:
        """Checks that it is an ADAM-6017 and sets all channels' range. Raises DeviceError."""
        if not self._client.connect():
            raise NoAnswer(self.name, "connect", f"nobody at {self._client}", "check address, cable and power")
        found = self._registers(adam.MODULE_NAME, len(adam.NAME_6017))
        if tuple(found) != adam.NAME_6017:
            raise BadAnswer(self.name, "ask for its name", f"it is {found[0]:04x}, not {adam.NAME_6017[0]:04x}")
        for channel in range(adam.CHANNELS):
            self._ask(partial(self._client.write_register, adam.RANGE_CODE + channel, range_code), "set the range")

    def close(self) -> None:
        """Gives the connection back."""
        self._client.close()  # type: ignore[no-untyped-call]

    def counts(self) -> list[int]:
        """The raw values of all channels. Raises DeviceError."""
        return self._registers(adam.AI_VALUE, adam.CHANNELS)

    def set_outputs(self, outputs: list[bool]) -> None:
        """The digital outputs, lowest first. Raises DeviceError."""
        self._ask(lambda: self._client.write_coils(adam.DIGITAL_OUTPUT, outputs), f"set its outputs to {outputs}")

    def _registers(self, address: int, count: int) -> list[int]:
        doing = f"read registers {address} to {address + count - 1}"
        answer = self._ask(lambda: self._client.read_holding_registers(address, count=count), doing)
        if len(answer.registers) != count:
            raise BadAnswer(self.name, doing, f"{len(answer.registers)} values instead of {count}")
        return list(answer.registers)

    def _ask(self, call: Callable[[], ModbusPDU], doing: str) -> ModbusPDU:
        try:
            answer = call()
        except ModbusException as error:
            raise NoAnswer(self.name, doing, str(error), "check address, cable and power") from None
        except OSError as error:
            raise DeviceError(self.name, doing, f"the connection failed: {error}", "check cable and power") from None
        if answer.isError():
            raise Refused(self.name, doing, f"the module answers with exception {answer.exception_code}")
        return answer

    def _trace(self, sending: bool, data: bytes) -> bytes:
        assert self._tap is not None
        self._tap(TO_DEVICE if sending else FROM_DEVICE, data)
        return data


FUNCTIONS = {
    1: "read coils",
    3: "read registers",
    4: "read input registers",
    5: "write coil",
    6: "write register",
    15: "write coils",
    16: "write registers",
}


def explain(direction: str, data: bytes) -> str:
    """A Modbus TCP frame in words, for transcripts."""
    if len(data) < 9:
        return "too short for a Modbus TCP frame"
    transaction, unit, function = int.from_bytes(data[:2], "big"), data[6], data[7]
    head = f"{FUNCTIONS.get(function & 0x7F, f'function {function & 0x7F}')}, transaction {transaction}, unit {unit}"
    if function & 0x80:
        return f"{head}: exception {data[8]}"
    if direction == FROM_DEVICE and function in (3, 4):
        values = [int.from_bytes(data[at : at + 2], "big") for at in range(9, len(data) - 1, 2)]
        return f"{head}: {' '.join(map(str, values))}"
    return f"{head}: {' '.join(str(int.from_bytes(data[at : at + 2], 'big')) for at in (8, 10) if at + 2 <= len(data))}"
