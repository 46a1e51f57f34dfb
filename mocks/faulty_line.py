"""A serial line or a Modbus connection that fails: it takes the place of the device at the door or at the endpoint.

    line = FaultyLine(rig.serial["axes"], FaultPlan(seed, ON_A_SERIAL_LINE), foreign=foreign_tmcl)
    plug_in(line, rig.clock, lambda end: rig.serial.update(axes=end))             # in this process
    rig.modbus_wires["adc-0"] = lambda station: End(FaultyLine(station, ...))     # a connection each

On a real endpoint the line stands for the device itself, and `unplug` is what closes the endpoint's connections.
"""

from collections import deque
from collections.abc import Callable

from pymodbus.framer import FramerRTU
from serial import SerialException

from goniotwin.mocks.faults import Fault, FaultPlan, corrupt, noise, truncate
from goniotwin.protocols import adam
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.tmcl import checksum
from goniotwin.twin.devices.line import SerialDevice

ForeignReply = Callable[[bytes], bytes]
"""Turns a reply into one of another address, with a correct checksum."""
ExceptionReply = Callable[[bytes, int], bytes]
"""The exception response of a code to a request."""
CODES = (adam.ILLEGAL_FUNCTION, adam.ILLEGAL_ADDRESS, adam.ILLEGAL_VALUE, adam.DEVICE_FAILURE, adam.BUSY)


class FaultyLine:
    """`device` behind a bad wire. `late_s` is the delay of a late reply.

    A wire without addresses has no `foreign` replies, one that is not Modbus no `refusal`. `unplug` is called when the plug
    is pulled. `plugs` counts how often it was.
    """

    def __init__(
        self,
        device: SerialDevice,
        misfortune: FaultPlan,
        late_s: float = 0.1,
        foreign: ForeignReply | None = None,
        refusal: ExceptionReply | None = None,
        unplug: Callable[[], object] = lambda: None,
    ) -> None:
        self.device = device
        self.misfortune = misfortune
        self.baudrate = device.baudrate
        self.outbox: deque[tuple[float, bytes]] = device.outbox
        self.unplug = unplug
        self.plugs = 0
        self.late_s = late_s
        self._foreign = foreign
        self._refusal = refusal
        self._held: list[bytes] = []

    def receive(self, data: bytes, t: float) -> None:
        """Pass bytes to the device and its replies back, with the fault of this exchange."""
        fault = self.misfortune.next()
        if fault in (Fault.UNHEARD, Fault.HANG):
            return
        if fault is Fault.EXCEPTION and self._refusal is not None:
            code = CODES[self.misfortune.draw(self.misfortune.exchanges + (1 << 38), len(CODES))]
            self.outbox.append((t, self._refusal(data, code)))
            return
        if fault is Fault.RESET:
            self.device.reset(t)
        there = len(self.outbox)
        if fault is not Fault.UNPLUGGED or self.misfortune.draw(self.misfortune.exchanges + (1 << 39), 2):
            self.device.receive(corrupt(data, self.misfortune) if fault is Fault.GARBLED else data, t)
        if fault is Fault.UNPLUGGED:
            self.pull()
            return
        replies = [self.outbox.pop() for _ in range(len(self.outbox) - there)][::-1]
        for ready, reply in replies:
            self.outbox.extend(self._failed(fault, ready, reply))

    def pull(self) -> None:
        """Pull the plug. Replies that were not sent yet are lost."""
        self.plugs += 1
        self.outbox.clear()
        self._held = []
        self.unplug()

    def reset(self, t: float) -> None:
        """Reset the device behind the line."""
        self.device.reset(t)

    def _failed(self, fault: Fault, ready: float, reply: bytes) -> list[tuple[float, bytes]]:
        held, self._held = b"".join(self._held), []
        match fault:
            case Fault.LATE:
                return [(ready + self.late_s, held + reply)]
            case Fault.LOST:
                return []
            case Fault.TRUNCATED:
                return [(ready, held + truncate(reply, self.misfortune))]
            case Fault.MERGED:
                self._held = [held + reply]
                return []
            case Fault.CORRUPTED:
                return [(ready, held + corrupt(reply, self.misfortune))]
            case Fault.REPEATED:
                return [(ready, held + reply + reply)]
            case Fault.FOREIGN if self._foreign is not None:
                return [(ready, held + self._foreign(reply))]
            case Fault.NOISE:
                return [(ready, noise(self.misfortune) + held + reply)]
        return [(ready, held + reply)]


class FaultyEnd:
    """Open end of a faulty line in this process: dead for good once the plug has been out.

    Everything then raises SerialException, as a real port does.
    """

    def __init__(self, line: FaultyLine) -> None:
        self._line = line
        self._plugs = line.plugs
        self.baudrate = line.baudrate

    @property
    def outbox(self) -> deque[tuple[float, bytes]]:
        """The line's."""
        self._check()
        return self._line.outbox

    @outbox.setter
    def outbox(self, _: deque[tuple[float, bytes]]) -> None:
        raise AttributeError("the outbox is the device's own")

    def receive(self, data: bytes, t: float) -> None:
        """Pass bytes to the line."""
        self._check()
        self._line.receive(data, t)

    def reset(self, t: float) -> None:
        """Reset the device behind the line."""
        self._line.reset(t)

    def _check(self) -> None:
        if self._line.plugs != self._plugs:
            raise SerialException("the port is gone: its plug has been pulled")


def plug_in(line: FaultyLine, clock: Clock, put: Callable[[SerialDevice], object], away_s: float = 0.3) -> None:
    """Connect an end of a line with `put`; connect a new one `away_s` after the plug is pulled."""

    def again() -> None:
        line.outbox.clear()
        put(FaultyEnd(line))

    line.unplug = lambda: clock.at(clock.now() + away_s, again)
    put(FaultyEnd(line))


def foreign_tmcl(reply: bytes) -> bytes:
    """The same reply, of the module with the address after the next."""
    body = bytes((reply[0], (reply[1] + 2) & 0xFF, *reply[2:8]))
    return body + bytes((checksum(body),))


def foreign_tcp(reply: bytes) -> bytes:
    """The same reply, of the next unit."""
    return reply[: adam.MBAP - 1] + bytes((reply[adam.MBAP - 1] + 1,)) + reply[adam.MBAP :]


def foreign_rtu(reply: bytes) -> bytes:
    """The same reply, of the next unit."""
    return _with_crc(bytes((reply[0] + 1,)) + reply[1:-2])


def exception_tcp(request: bytes, code: int) -> bytes:
    """An exception response over TCP."""
    return request[:4] + b"\0\3" + bytes((request[adam.MBAP - 1], request[adam.MBAP] | 0x80, code))


def exception_rtu(request: bytes, code: int) -> bytes:
    """An exception response on a serial line."""
    return _with_crc(bytes((request[0], request[1] | 0x80, code)))


def _with_crc(body: bytes) -> bytes:
    return body + FramerRTU.compute_CRC(body).to_bytes(2, "big")
