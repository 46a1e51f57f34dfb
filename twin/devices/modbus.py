"""Modbus stations between a wire and its modules: they cut requests from the byte stream and answer them.

Any split of the bytes gives the same requests. Cut and answered they are here, byte by byte, as the Modbus specification has
them: pymodbus, on the other side of the wire, is then the independent reader, and what its own server would do with a request
(functions that these modules lack, foreign units, pipelined or malformed requests) differs from the modules anyway. Both
stations look like a device on a line to their doors (`twin.devices.line`).
"""

from collections import deque
from functools import lru_cache
from struct import Struct, unpack
from typing import NamedTuple

from pymodbus.framer import FramerRTU

from goniotwin.protocols import adam
from goniotwin.twin.devices.adam import ConverterModule, ModbusFault
from goniotwin.twin.devices.line import BITS_A_BYTE

LONGEST_TCP = 260
LONGEST_RTU = 256
GAP_CHARACTERS = 3.5
BROADCAST = 0
COIL_VALUES = (0x0000, 0xFF00)
REQUESTS_KEPT = 256
TRANSACTION, FRAME_HEAD = 2, 6
"""Bytes of a Modbus TCP frame that name its transaction; the fewest that follow."""
HEADER = Struct(">HHHB")
"""Of a Modbus TCP frame: transaction, protocol, bytes from the unit on, unit. Source: Modbus on TCP/IP 1.0b, 3.1.3."""
WORDS = Struct(">HH")
EIGHT_WORDS = Struct(">8H")
READS = (1, 2, 3, 4)
ECHOES = (5, 6, 8, 15, 16)
"""Functions that are confirmed with the first four bytes of the request, or all of them."""


class Request(NamedTuple):
    """A request to a unit. `refusal` is the exception code of one that no module carries out, else 0."""

    unit: int
    pdu: bytes
    address: int
    number: int
    refusal: int


@lru_cache(REQUESTS_KEPT)
def parsed(unit: int, pdu: bytes) -> Request:
    """The request of a PDU."""
    function, refusal = pdu[0], 0
    if (function not in READS and function not in ECHOES) or (function == 8 and pdu[1:3] != b"\0\0"):
        refusal = adam.ILLEGAL_FUNCTION
    elif not well_formed(pdu):
        refusal = adam.ILLEGAL_VALUE
    address, number = WORDS.unpack_from(pdu, 1) if len(pdu) > WORDS.size else (0, 0)
    return Request(unit, pdu, address, number, refusal)


@lru_cache(REQUESTS_KEPT)
def _whole(body: bytes) -> Request | None:
    """The request of one whole frame of Modbus TCP, without its transaction; None for other bytes."""
    if len(body) < FRAME_HEAD or body[:2] != b"\0\0" or int.from_bytes(body[2:4], "big") != len(body) - 4:
        return None
    return parsed(body[4], body[5:]) if len(body) <= LONGEST_TCP - TRANSACTION else None


class TcpStation:
    """The module's end of one Modbus TCP connection: one request after the other; foreign units are silent.

    `free` is the time from which it can take the next one, s.
    """

    baudrate = 0

    def __init__(self, device: ConverterModule) -> None:
        self.device = device
        self.outbox: deque[tuple[float, bytes]] = deque()
        self._buffer = b""
        self._lost = False
        self.free = 0.0

    def receive(self, data: bytes, t: float) -> None:
        """Bytes of which the last has arrived at `t`.

        What begins with no header of Modbus, or with one of more bytes than a frame can have, is dropped until a request of
        this module begins: the length does not show where the next one begins.
        """
        if not self._buffer and not self._lost and (request := _whole(data[TRANSACTION:])) is not None:
            self._hear(data[:TRANSACTION], request, t)
            return
        self._buffer += data
        while len(self._buffer) >= adam.MBAP + 1:
            _, protocol, length, unit = HEADER.unpack_from(self._buffer)
            legal = protocol == 0 and 2 <= length <= LONGEST_TCP - adam.MBAP + 1
            if legal and self._lost:
                legal = unit in self.device.units and self._buffer[adam.MBAP] in (*READS, *ECHOES)
            self._lost = not legal
            if self._lost:
                self._buffer = self._buffer[1:]
                continue
            frame = self._buffer[: 6 + length]
            if len(frame) < 6 + length:
                return
            self._buffer = self._buffer[len(frame) :]
            self._hear(frame[:TRANSACTION], parsed(unit, frame[adam.MBAP :]), t)

    def _hear(self, transaction: bytes, request: Request, t: float) -> None:
        device = self.device
        if request.unit in device.units and not device.silent:
            begins = self.free if self.free > t else t
            answer = answered(device, request, begins)
            self.free = begins + 0.5 * device.latency_s  # the other half is the way here
            self.outbox.append((self.free, transaction + bytes((0, 0, 0, 1 + len(answer), request.unit)) + answer))

    @property
    def waiting(self) -> int:
        """Number of bytes of a request that is not complete yet."""
        return len(self._buffer)

    def reset(self, t: float) -> None:
        """The module loses its power for a moment, and with it incomplete requests and replies."""
        self.device.reset(t)
        self._buffer, self._lost = b"", False


class RtuStation:
    """The modules' end of one RS485 line: a gap ends a frame; what has no right checksum is silent until the next gap.

    `gap_s` is 3.5 characters where it is not given; on an endpoint whose bytes keep no time it has to be longer.
    """

    def __init__(self, devices: list[ConverterModule], baudrate: int = adam.BAUDRATE, gap_s: float | None = None) -> None:
        self.devices = devices
        self.baudrate = baudrate
        self.outbox: deque[tuple[float, bytes]] = deque()
        self._byte_s = BITS_A_BYTE / baudrate
        self._quiet_s = GAP_CHARACTERS * self._byte_s
        self._gap_s = self._quiet_s if gap_s is None else gap_s
        self._buffer = b""
        self._deaf = False
        self._last = float("-inf")

    def receive(self, data: bytes, t: float) -> None:
        """Bytes of which the last has arrived at `t`, the others right before it."""
        if t - len(data) * self._byte_s - self._last > self._gap_s * (1.0 - 1e-9):
            self._buffer, self._deaf = b"", False
        self._last = t
        if self._deaf:
            return
        self._buffer += data
        while (frame := self._cut()) is not None:
            self._hear(frame, t)

    def reset(self, t: float) -> None:
        """All modules of the line lose their power for a moment."""
        for device in self.devices:
            device.reset(t)
        self._buffer = b""

    def _cut(self) -> bytes | None:
        """The next frame, once it is complete."""
        if len(self._buffer) < FramerRTU.MIN_SIZE:
            return None
        size = self._size()
        if size is None:  # only the checksum shows the end of a function that pymodbus does not know
            whole = checked(self._buffer)
            if not whole and len(self._buffer) > LONGEST_RTU:
                self._buffer, self._deaf = b"", True
            if not whole:
                return None
            size = len(self._buffer)
        elif size == 0 or len(self._buffer) < size:
            return None
        frame, self._buffer = self._buffer[:size], self._buffer[size:]
        if not checked(frame):
            self._buffer, self._deaf = b"", True
            return None
        return frame

    def _size(self) -> int | None:
        """Of the frame that begins the buffer: 0 while its count is missing, None where only its end decides."""
        function = self._buffer[1]
        if function in (15, 16):
            return 9 + self._buffer[6] if len(self._buffer) > 6 else 0
        return 8 if function in READS or function in ECHOES else None

    def _hear(self, frame: bytes, t: float) -> None:
        unit, pdu = frame[0], frame[1:-2]
        for device in self.devices:
            if device.silent or unit not in (device.unit, BROADCAST):
                continue
            begins = t + self._quiet_s
            answer = answered(device, parsed(unit, pdu), begins)
            if unit != BROADCAST:
                body = bytes([unit]) + answer
                self.outbox.append((begins + device.latency_s, body + FramerRTU.compute_CRC(body).to_bytes(2, "big")))


def checked(frame: bytes) -> bool:
    """Whether an RTU frame's checksum is right."""
    return FramerRTU.check_CRC(frame[:-2], int.from_bytes(frame[-2:], "big"))


def well_formed(pdu: bytes) -> bool:
    """Whether a request's lengths agree and its counts and values are legal."""
    function, length = pdu[0], len(pdu)
    if function == 8:
        return length >= 5
    if length < 5:
        return False
    number = int.from_bytes(pdu[3:5], "big")
    if function in (1, 2, 3, 4):
        return length == 5 and 1 <= number <= (2000 if function < 3 else 125)
    if function == 5:
        return length == 5 and number in COIL_VALUES
    if function == 6:
        return length == 5
    size = -(-number // 8) if function == 15 else 2 * number
    return 1 <= number <= (1968 if function == 15 else 123) and length == 6 + size and pdu[5] == size


def answered(device: ConverterModule, request: Request, t: float) -> bytes:
    """The PDU with which a module answers a request that arrives at `t`: an exception where it refuses."""
    if (known := device.settings_reply(request.pdu)) is not None:
        return known
    function = request.pdu[0]
    try:
        if request.refusal:
            raise ModbusFault(request.refusal)
        return _read(device, request, t) if function in READS else _written(device, request, t)
    except ModbusFault as fault:
        return bytes([0x80 | function, fault.code])


def _read(device: ConverterModule, request: Request, t: float) -> bytes:
    _, pdu, address, count, _ = request
    function = pdu[0]
    if function >= 3:
        values = device.registers(address, count, t)
        packed = EIGHT_WORDS.pack(*values) if count == adam.CHANNELS else b"".join(each.to_bytes(2, "big") for each in values)
    else:
        bits = sum(1 << place for place, on in enumerate(device.coils(address, count, t)) if on)
        packed = bits.to_bytes(-(-count // 8), "little")
    reply = bytes([function, len(packed)]) + packed
    device.keep_reply(pdu, address, count, reply)
    return reply


def _written(device: ConverterModule, request: Request, t: float) -> bytes:
    _, pdu, address, number, _ = request
    match pdu[0]:
        case 8:
            return pdu
        case 5:
            device.write_coils(address, [number != 0], t)
        case 6:
            device.write_registers(address, [number], t)
        case 15:
            bits = int.from_bytes(pdu[6:], "little")
            device.write_coils(address, [bool(bits >> place & 1) for place in range(number)], t)
        case 16 if not device.multiple_writes:
            raise ModbusFault(adam.ILLEGAL_FUNCTION)
        case 16:
            device.write_registers(address, [*unpack(f">{number}H", pdu[6:])], t)
    return pdu[:5]
