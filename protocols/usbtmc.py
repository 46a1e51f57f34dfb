"""USBTMC-USB488: the headers of bulk messages and the class requests of test and measurement devices.

Source: USB-IF, "Universal Serial Bus Test and Measurement Class" 1.0 (tables 1 to 9, 15 to 45) and its subclass USB488.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import NamedTuple

HEADER_BYTES = 12
INTERFACE_CLASS = (0xFE, 0x03)
PROTOCOL_USB488 = 0x01
LARGEST_TRANSFER = 1 << 24
_HEADER = struct.Struct("<BBBBIBBH")


class MsgId(IntEnum):
    """What a bulk message is."""

    DEV_DEP_MSG_OUT = 1
    DEV_DEP_MSG_IN = 2  # from the host: the request for one
    VENDOR_OUT = 126
    VENDOR_IN = 127
    TRIGGER = 128


class ClassRequest(IntEnum):
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

    @property
    def of_endpoint(self) -> bool:
        """Whether it goes to an endpoint (bmRequestType 0xA2); the others go to the interface (0xA1)."""
        return self <= ClassRequest.CHECK_ABORT_BULK_IN_STATUS


class RequestStatus(IntEnum):
    """USBTMC_status, the first byte of each answer."""

    SUCCESS = 0x01
    PENDING = 0x02
    INTERRUPT_IN_BUSY = 0x20
    FAILED = 0x80
    TRANSFER_NOT_IN_PROGRESS = 0x81
    SPLIT_NOT_IN_PROGRESS = 0x82
    SPLIT_IN_PROGRESS = 0x83


_ATTRIBUTES_OF_A_HOST: dict[int, int] = {
    MsgId.DEV_DEP_MSG_OUT: 0x01,
    MsgId.DEV_DEP_MSG_IN: 0x02,
    MsgId.VENDOR_OUT: 0x00,
    MsgId.VENDOR_IN: 0x00,
    MsgId.TRIGGER: 0x00,
}
"""By MsgID, the bits of bmTransferAttributes that a host may set."""


class StatusByte(IntFlag):
    """IEEE 488.2 status byte, with SCPI's summaries of the error queue and of the two status groups."""

    EAV = 0x04
    QUES = 0x08
    MAV = 0x10
    ESB = 0x20
    SRQ = 0x40
    OPER = 0x80


class HeaderError(ValueError):
    """Bytes that are no bulk header."""


class Header(NamedTuple):
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

    @classmethod
    def from_host(cls, data: bytes) -> "Header":
        """A header that a host may send: known MsgID, no bit set that its kind does not have. Raises HeaderError."""
        header = cls.decode(data)
        allowed = _ATTRIBUTES_OF_A_HOST.get(header.msg_id)
        if allowed is None:
            raise HeaderError(f"MsgID {header.msg_id} is none of a host")
        attributes = data[8]
        if attributes & ~allowed:
            raise HeaderError(f"bmTransferAttributes {attributes:02x} with MsgID {header.msg_id}")
        if data[9] and not attributes & 2:
            raise HeaderError(f"a TermChar {data[9]:02x} that is not enabled")
        if header.msg_id == MsgId.TRIGGER and header.size:
            raise HeaderError("a trigger has no data")
        if header.size > LARGEST_TRANSFER:
            raise HeaderError(f"a transfer of {header.size} bytes")
        if header.size == 0 and header.msg_id == MsgId.DEV_DEP_MSG_IN:
            raise HeaderError("a request for no byte")
        return header


@dataclass(frozen=True, slots=True)
class Message:
    """A whole bulk message."""

    header: Header
    payload: bytes = b""


def take_message(data: bytes, *, from_host: bool) -> tuple[Message | None, bytes]:
    """The first whole message of the bytes so far, and what comes after it; None while it is not whole.

    However the bytes are split, the messages are the same. Raises HeaderError as soon as the first twelve bytes are none.
    """
    if len(data) < HEADER_BYTES:
        return None, data
    header = Header.from_host(data) if from_host else Header.decode(data)
    if header.size > LARGEST_TRANSFER:
        raise HeaderError(f"a transfer of {header.size} bytes")
    carried = (MsgId.DEV_DEP_MSG_OUT, MsgId.VENDOR_OUT) if from_host else (MsgId.DEV_DEP_MSG_IN, MsgId.VENDOR_IN)
    size = header.size if header.msg_id in carried else 0
    whole = HEADER_BYTES + size + -size % 4
    if len(data) < whole:
        return None, data
    return Message(header, data[HEADER_BYTES : HEADER_BYTES + size]), data[whole:]


def request_in(tag: int, size: int, term_char: int | None = None) -> bytes:
    """REQUEST_DEV_DEP_MSG_IN: the host asks for at most `size` bytes."""
    return Header(MsgId.DEV_DEP_MSG_IN, tag, size, end=False, term_char=term_char).encode()


def message(msg_id: int, tag: int, payload: bytes, *, end: bool = True, by_term_char: bool = False) -> bytes:
    """Header, payload and the zero bytes that fill up to a multiple of four; `by_term_char` where one ended an answer."""
    term = 0 if by_term_char else None
    return Header(msg_id, tag, len(payload), end, term).encode() + payload + bytes(-len(payload) % 4)


def trigger(tag: int) -> bytes:
    """USB488's TRIGGER."""
    return Header(MsgId.TRIGGER, tag, 0, end=False).encode()


def next_tag(tag: int) -> int:
    """1 to 255, then 1 again: zero is no tag."""
    return tag % 255 + 1


def next_status_tag(tag: int) -> int:
    """The tags of READ_STATUS_BYTE: 2 to 127, then 2 again."""
    return tag + 1 if 2 <= tag < 127 else 2


def capabilities(*, trigger: bool = True) -> bytes:
    """The answer to GET_CAPABILITIES of a USB488 device that speaks SCPI."""
    answer = bytearray(24)
    answer[0] = RequestStatus.SUCCESS
    answer[2:4] = answer[12:14] = (0x0100).to_bytes(2, "little")
    answer[4] = 0b100  # INDICATOR_PULSE
    answer[5] = 0b1  # TermChar
    answer[14] = 0b110 | int(trigger)  # 488.2, REN/GTL/LLO, TRIGGER
    answer[15] = 0b1110 | int(trigger)  # SCPI, SR1, RL1, DT1
    return bytes(answer)
