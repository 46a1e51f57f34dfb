"""TMCL, the binary protocol of Trinamic's motion modules: nine bytes each way, big-endian, summed.

Source: Trinamic, "TMCM-6214 TMCL Firmware Manual" V1.06 (frames, commands, axis parameters) and "TMCL Reference and
Programming Manual" 2.22. The parameters' numbers are in `tmcl_parameters`.

The sum finds every error that changes one byte. Of errors that change two bytes at random it passes one in 255, and it
always passes an exchange of two bytes: a decoder has to check addresses, command and echoed value as well.
"""

import struct
from enum import IntEnum
from typing import NamedTuple

from goniotwin.protocols.tmcl_parameters import AxisParameter, SearchCommand

FRAME_BYTES = 9
HOST_ADDRESS = 2
_FRAME = struct.Struct(">BBBBi")
_VALUE_MIN, _VALUE_MAX = -(2**31), 2**31 - 1


class Command(IntEnum):
    """Instruction numbers."""

    ROR = 1
    ROL = 2
    MST = 3
    MVP = 4
    SAP = 5
    GAP = 6
    STAP = 7
    RSAP = 8
    SGP = 9
    GGP = 10
    STGP = 11
    RSGP = 12
    RFS = 13
    SIO = 14
    GIO = 15
    SCO = 30
    GCO = 31
    CCO = 32
    STOP_APPLICATION = 128
    RUN_APPLICATION = 129
    RESET_APPLICATION = 131
    APPLICATION_STATUS = 135
    FIRMWARE_VERSION = 136
    FACTORY_RESET = 137
    REQUEST_TARGET_REACHED = 138
    GET_INFO = 157


class ReplyStatus(IntEnum):
    """Status of a reply."""

    OK = 100
    LOADED = 101
    TARGET_REACHED = 128
    WRONG_CHECKSUM = 1
    INVALID_COMMAND = 2
    WRONG_TYPE = 3
    INVALID_VALUE = 4
    EEPROM_LOCKED = 5
    NOT_AVAILABLE = 6
    MAXIMUM_EXCEEDED = 9


class MoveType(IntEnum):
    """The kinds of MVP."""

    ABSOLUTE = 0
    RELATIVE = 1
    COORDINATE = 2


class FrameError(ValueError):
    """Bytes that are no TMCL frame."""


def checksum(data: bytes) -> int:
    """The sum of the bytes, modulo 256."""
    return sum(data) & 0xFF


def pack(first: int, second: int, third: int, fourth: int, value: int) -> bytes:
    """The nine bytes of a frame: four of one byte each, the value, the checksum. Raises struct.error."""
    body = _FRAME.pack(first, second, third, fourth, value)
    return body + bytes((sum(body) & 0xFF,))


class CommandFrame(NamedTuple):
    """What the host sends: module address, command, type, motor or bank, signed 32 bit value."""

    address: int
    command: int
    type: int
    motor: int
    value: int = 0

    def encode(self) -> bytes:
        """The nine bytes. Raises FrameError for a field that does not fit its bytes."""
        try:
            return pack(*self)
        except struct.error as error:
            raise FrameError(f"{self} does not fit a TMCL request: {error}") from None

    @classmethod
    def decode(cls, frame: bytes) -> "CommandFrame":
        """A request from its nine bytes. Raises FrameError for a wrong length or checksum."""
        return cls(*unpack(frame))

    def __str__(self) -> str:
        return f"{_name(Command, self.command)} {_type_name(self.command, self.type)} motor {self.motor} = {self.value}"


class ReplyFrame(NamedTuple):
    """What a module answers: host address, module address, status, echoed command, signed 32 bit value."""

    host: int
    address: int
    status: int
    command: int
    value: int = 0

    def encode(self) -> bytes:
        """The nine bytes. Raises FrameError for a field that does not fit its bytes."""
        try:
            return pack(*self)
        except struct.error as error:
            raise FrameError(f"{self} does not fit a TMCL reply: {error}") from None

    @classmethod
    def decode(cls, frame: bytes) -> "ReplyFrame":
        """A reply from its nine bytes. Raises FrameError for a wrong length or checksum."""
        return cls(*unpack(frame))

    def __str__(self) -> str:
        return f"{_name(Command, self.command)} {_name(ReplyStatus, self.status)} value {self.value}"


def split(buffer: bytes) -> tuple[list[bytes], bytes]:
    """The whole frames that bytes begin with, and what is left, less than a frame: bytes are frames by count alone.

    However the bytes of a line are cut into pieces, each piece put behind what was left of the one before gives the same
    frames. What does not begin with a frame's first byte stays shifted, so that both sides drop what is left after a pause.
    """
    whole = len(buffer) - len(buffer) % FRAME_BYTES
    return [buffer[k : k + FRAME_BYTES] for k in range(0, whole, FRAME_BYTES)], buffer[whole:]


def encode_version_text(host: int, text: str) -> bytes:
    """The special answer to FIRMWARE_VERSION type 0: host address and eight ASCII characters, no checksum."""
    body = text.encode("ascii")
    if len(body) != FRAME_BYTES - 1:
        raise FrameError(f"a version text has {FRAME_BYTES - 1} characters, not {len(body)}: {text!r}")
    return bytes((host,)) + body


def decode_version_text(frame: bytes) -> str:
    """The eight characters of the special answer, such as `6214V117`. Raises FrameError."""
    if len(frame) != FRAME_BYTES or not all(32 <= byte < 127 for byte in frame[1:]):
        raise FrameError(f"no version text: {frame.hex(' ')}")
    return frame[1:].decode("ascii")


def version_number(module: int, major: int, minor: int) -> int:
    """The value of the answer to FIRMWARE_VERSION type 1."""
    return module << 16 | major << 8 | minor


def unpack(frame: bytes) -> tuple[int, int, int, int, int]:
    """What `pack` has packed. Raises FrameError for a wrong length or checksum."""
    if len(frame) != FRAME_BYTES:
        raise FrameError(f"a TMCL frame has {FRAME_BYTES} bytes, not {len(frame)}: {frame.hex(' ')}")
    body = frame[:-1]
    if sum(body) & 0xFF != frame[-1]:
        raise FrameError(f"checksum {frame[-1]:02x} instead of {checksum(body):02x}: {frame.hex(' ')}")
    return _FRAME.unpack(body)


def _name(names: type[IntEnum], number: int) -> str:
    try:
        return names(number).name
    except ValueError:
        return str(number)


def _type_name(command: int, number: int) -> str:
    if command in (Command.SAP, Command.GAP, Command.STAP, Command.RSAP):
        return f"{number} {_name(AxisParameter, number)}"
    if command == Command.MVP:
        return _name(MoveType, number)
    if command == Command.RFS:
        return _name(SearchCommand, number)
    return str(number)
