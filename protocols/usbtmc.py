"""USBTMC-USB488: the headers of bulk messages and the class requests of test and measurement devices.

Source: USB-IF, "Universal Serial Bus Test and Measurement Class" 1.0 (tables 1 to 9, 15 to 45) and its subclass USB488.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag

HEADER_BYTES = 12
INTERFACE_CLASS = (0xFE, 0x03)
PROTOCOL_USB488 = 0x01
_HEADER = struct.Struct("<BBBBIBBH")


class MsgId(IntEnum):
    """What a bulk message is."""

    DEV_DEP_MSG_OUT = 1
    DEV_DEP_MSG_IN = 2  # from the host: the request for one
    TRIGGER = 128


class Request(IntEnum):
    """bRequest of the class requests."""

    INITIATE_ABORT_BULK_OUT = 1
    CHECK_ABORT_BULK_OUT_STATUS = 2
    INITIATE_ABORT_BULK_IN = 3
    CHECK_ABORT_BULK_IN_STATUS = 4
    INITIATE_CLEAR = 5
    CHECK_CLEAR_STATUS = 6
    GET_CAPABILITIES = 7
    INDICATOR_PULSE = 64
    READ_STATUS_BYTE = 128
    REN_CONTROL = 160
    GO_TO_LOCAL = 161
    LOCAL_LOCKOUT = 162


class Status(IntEnum):
    """USBTMC_status, the first byte of each answer."""

    SUCCESS = 0x01
    PENDING = 0x02
    INTERRUPT_IN_BUSY = 0x20
    FAILED = 0x80
    TRANSFER_NOT_IN_PROGRESS = 0x81
    SPLIT_NOT_IN_PROGRESS = 0x82
    SPLIT_IN_PROGRESS = 0x83


class StatusByte(IntFlag):
    """IEEE 488.2 status byte."""

    EAV = 0x04
    MAV = 0x10
    ESB = 0x20
    SRQ = 0x40


class HeaderError(ValueError):
    """Bytes that are no bulk header."""


@dataclass(frozen=True, slots=True)
class Header:
    """The twelve bytes before each bulk message.

    `size` is the payload's length, or, in a request, the most bytes wanted. `end` is EOM. `term_char` is the character that
    ends an answer, where one was asked for.
    """

    msg_id: int
    tag: int
    size: int
    end: bool = True
    term_char: int | None = None

    def encode(self) -> bytes:
        """The twelve bytes."""
        attributes = int(self.end) if self.msg_id != MsgId.TRIGGER else 0
        term = 0
        if self.term_char is not None:
            attributes, term = attributes | 2, self.term_char
        return _HEADER.pack(self.msg_id, self.tag, self.tag ^ 0xFF, 0, self.size, attributes, term, 0)

    @classmethod
    def decode(cls, data: bytes) -> "Header":
        """A header from the first twelve bytes. Raises HeaderError where the class forbids what stands there."""
        if len(data) < HEADER_BYTES:
            raise HeaderError(f"a bulk header has {HEADER_BYTES} bytes, not {len(data)}: {data.hex(' ')}")
        msg_id, tag, inverse, reserved, size, attributes, term, reserved_end = _HEADER.unpack(data[:HEADER_BYTES])
        if tag == 0 or tag ^ 0xFF != inverse:
            raise HeaderError(f"bTag {tag:02x} with complement {inverse:02x}")
        if reserved or reserved_end:
            raise HeaderError(f"reserved bytes are not zero: {data[:HEADER_BYTES].hex(' ')}")
        return cls(msg_id, tag, size, bool(attributes & 1), term if attributes & 2 else None)


def request_in(tag: int, size: int) -> bytes:
    """REQUEST_DEV_DEP_MSG_IN: the host asks for at most `size` bytes."""
    return Header(MsgId.DEV_DEP_MSG_IN, tag, size, end=False).encode()


def message(msg_id: int, tag: int, payload: bytes, *, end: bool = True) -> bytes:
    """Header, payload and the zero bytes that fill up to a multiple of four."""
    return Header(msg_id, tag, len(payload), end).encode() + payload + bytes(-len(payload) % 4)


def next_tag(tag: int) -> int:
    """1 to 255, then 1 again: zero is no tag."""
    return tag % 255 + 1


def capabilities(*, trigger: bool = True) -> bytes:
    """The answer to GET_CAPABILITIES of a USB488 device that speaks SCPI."""
    answer = bytearray(24)
    answer[0] = Status.SUCCESS
    answer[2:4] = answer[12:14] = (0x0100).to_bytes(2, "little")
    answer[14] = 0b110 | int(trigger)  # 488.2, REN/GTL/LLO, TRIGGER
    answer[15] = 0b1000 | int(trigger)  # SCPI, DT1
    return bytes(answer)
