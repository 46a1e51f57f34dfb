"""One Advantech converter module, ADAM-6017 or ADAM-4117, on a Modbus wire.

What the wires let one detect, and what they do not:

* Silence, refusals, answers to another function, of another unit, length, address or (over TCP) transaction: always seen.
* A late or repeated answer. Over TCP its transaction identifier gives it away. RTU has none: after each fault the line is
  drained and the module answers a marker, its own name, asked for in turns of function and length so that a marker that
  was late before is not taken for this one; and reads are asked with functions 03 and 04 in turns, which these modules
  answer alike, so that the answer to one question does not pass for that to the next.
* A changed byte. RTU has a checksum of 16 bits, which lets through 1 of 65,536 arbitrary errors and no error of up to
  16 bits in a row. Modbus TCP has none of its own: a changed count between 0 and 65535 *cannot be detected*, only TCP's
  checksum stands before it. What limits the damage: lengths, unit, function and transaction have to agree, which covers
  most of a frame but the values; settings are read back, and where they seem wrong read a second time; a row has many
  readings, whose scatter shows one that does not belong.
* A module that has reset and forgotten gain and ranges answers as if nothing had been. A canary shows it, one exchange
  after each group of readings: the outputs where one is on, else the ranges. After each change of gain, which would hide
  a reset before it, both are, once the readings are there. (It holds if the outputs' power-on values are left at off.) At
  intervals name, ranges, outputs and enabled channels are all read back.

A read, and the writing of a setting to a value, are repeated once after a fault. Five timeouts are the most that a call
takes, and that only with the first fault.
"""

from collections.abc import Callable

from goniotwin.drivers.errors import BadAnswer, Forgotten
from goniotwin.drivers.photodiodes.exchange import AdamWire, Call, T
from goniotwin.drivers.photodiodes.modbus import ModbusUnit
from goniotwin.protocols import adam
from goniotwin.protocols.clock import Clock

WRITE_COILS, WRITE_REGISTERS = 15, 16
CHECK_EVERY_S = 60.0
Check = Callable[[], None]


class AdamModule(AdamWire):
    """One module. Its calls take one exchange, unless something goes wrong; only connect and reconnect take several."""

    def __init__(self, name: str, unit: ModbusUnit, model: adam.Model, range_code: int, clock: Clock) -> None:
        super().__init__(name, unit, model)
        self.identity = ""
        self._ranges = [range_code] * adam.CHANNELS
        self._clock = clock
        self._outputs: list[bool] | None = None
        self._written = self._proved = False
        self._set_up = False
        self._forgotten: str | None = None
        self._checked = clock.now()

    def connect(self) -> str:
        """Opens the wire, checks who answers, writes its settings; returns who it is. Raises DeviceError."""
        self._open()
        self._outputs = None
        self._greet()
        return self.identity

    def reconnect(self) -> list[str]:
        """Makes sure of the wire and of who is there, and writes all settings again; says what had to be restored.

        Raises DeviceError; another try may follow. A module that was never connected is connected.
        """
        with self._bus.lock:
            if not self.identity:
                self.connect()
                return [f"{self.name}: connected, {self.identity}"]
            self._open()
            self._doubtful = True
            return self._greet()

    def close(self) -> None:
        """Gives the wire back."""
        self._bus.close(self)

    def counts(self) -> list[int]:
        """The raw values of all channels. Raises DeviceError."""
        return self._registers(adam.AI_VALUE, adam.CHANNELS)

    def set_outputs(self, outputs: list[bool]) -> None:
        """The digital outputs, lowest first; the checks make sure. Raises DeviceError."""
        doing = f"set its outputs to {_bits(outputs)}"
        call: Call = lambda client: client.write_coils(adam.DIGITAL_OUTPUT, outputs, device_id=self._unit)  # noqa: E731
        self._outputs, self._written, self._proved = list(outputs), False, False
        self._twice(lambda: self._write(call, doing, WRITE_COILS, adam.DIGITAL_OUTPUT, len(outputs)))
        self._written = True

    def check_outputs(self) -> None:
        """Reads the outputs back. Raises Forgotten where they are not what they were set to."""
        self._check_outputs(self._read_outputs)

    def check_ranges(self) -> None:
        """Reads the ranges back. Raises Forgotten where they are not what they were set to."""
        self._check_ranges(self._read_ranges)

    def checks(self) -> list[Check]:
        """What readings have to be followed by before they are believed, an exchange each.

        It is the canary; after a change of the outputs these and the ranges; now and then all settings. Each raises
        DeviceError, and Forgotten where the module has lost its settings.
        """
        if self._clock.now() - self._checked >= CHECK_EVERY_S:
            return [self.check_outputs, self._prove, self._check_name, self._review]
        if self._outputs is not None and not self._proved:
            return [self.check_outputs, self._prove]
        return [self.check_outputs if self._outputs is not None and any(self._outputs) else self.check_ranges]

    def _prove(self) -> None:
        self.check_ranges()
        self._proved = True

    def _review(self) -> None:
        self._check_enabled()
        self._checked = self._clock.now()

    def _check_outputs(self, read: Callable[[], list[bool]]) -> None:
        if self._outputs is not None and self._written and self._differs(read, self._outputs):
            self._forget(f"its outputs are not {_bits(self._outputs)}, as they were set to")

    def _check_ranges(self, read: Callable[[], list[int]]) -> None:
        if self._differs(read, self._ranges):
            self._forget("its ranges are not those that were set")

    def _greet(self) -> list[str]:
        """Who it is, and its settings. Returns what was not as it should be."""
        self._forgotten, self._set_up = None, False
        self._check_name()
        version = self._registers(adam.FIRMWARE_VERSION, 2)
        self.identity = f"{self._model.title} firmware {adam.firmware(version)}"
        restored = self._restore("ranges", adam.RANGE_CODE, self._ranges)
        restored += self._restore("enabled channels", adam.CHANNEL_ENABLE, [adam.ALL_CHANNELS])
        if self._outputs is not None and not (self._written and self._read_outputs() == self._outputs):
            self.set_outputs(self._outputs)
            self.check_outputs()
            restored.append(f"{self.name}: outputs set to {_bits(self._outputs or [])}")
        self._set_up = True
        self._checked = self._clock.now()
        return restored

    def _restore(self, what: str, address: int, wanted: list[int]) -> list[str]:
        """Writes registers that are not as they should be, and reads them back; says so."""
        doing = f"set its {what}"

        def read() -> list[int]:
            return self._registers(address, len(wanted))

        if not self._differs(read, wanted):
            return []
        call: Call = lambda client: client.write_registers(address, wanted, device_id=self._unit)  # noqa: E731
        self._twice(lambda: self._write(call, doing, WRITE_REGISTERS, address, len(wanted)))
        if self._differs(read, wanted):
            raise BadAnswer(self.name, doing, "it says that it has others", "check the module")
        return [f"{self.name}: {what} set"]

    def _check_name(self) -> None:
        found = self._registers(adam.MODULE_NAME, len(self._model.name))
        if tuple(found) != self._model.name:
            self._wrong_name(found)

    def _check_enabled(self) -> None:
        if self._differs(lambda: self._registers(adam.CHANNEL_ENABLE, 1), [adam.ALL_CHANNELS]):
            self._forget("not all of its channels are enabled any more")

    def _differs(self, read: Callable[[], list[T]], wanted: list[T]) -> bool:
        """Whether a setting is another than wanted, read a second time where it seems so."""
        return read() != wanted and read() != wanted

    def _forget(self, what: str) -> None:
        self._forgotten = f"{what}: it has reset or somebody has changed it"
        raise self._lost("check its settings")

    def _lost(self, doing: str) -> Forgotten:
        return Forgotten(self.name, doing, str(self._forgotten), "reconnect it: that writes its settings again")

    def _allow(self, doing: str) -> None:
        if self._forgotten is not None:
            raise self._lost(doing)

    def _verify(self) -> None:
        if self._set_up:
            self._check_ranges(lambda: self._read(adam.RANGE_CODE, adam.CHANNELS, self._exchange))
            self._check_outputs(lambda: self._coils(self._exchange))

    def _read_outputs(self) -> list[bool]:
        return self._twice(lambda: self._coils(self._ask))

    def _read_ranges(self) -> list[int]:
        return self._registers(adam.RANGE_CODE, adam.CHANNELS)


def _bits(outputs: list[bool]) -> str:
    """Outputs, highest first, as a manual prints them."""
    return "".join(str(int(on)) for on in reversed(outputs))
