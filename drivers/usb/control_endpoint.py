"""Endpoint 0 (control) of a USBTMC instrument: the class requests for abort, clear and status byte, each in bounded time.

Source: USB-IF, USBTMC 1.0 section 4.2.1; USB488 section 4.3.1.
"""

import contextlib
import struct
from collections.abc import Iterator
from typing import Any

import usb.core

from goniotwin.drivers.errors import BadAnswer
from goniotwin.drivers.tap import FROM_DEVICE, TO_DEVICE, Tap
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.usbtmc import HEADER_BYTES, ClassRequest, Header, HeaderError, MsgId, RequestStatus

TO_INTERFACE, TO_ENDPOINT = 0xA1, 0xA2
CLEAR_FEATURE = (0x02, 1)
ROUNDS = 20
LONGEST_S = 2.0
"""Longest duration of all rounds of one request."""
DRAIN_BYTES = 4096
DRAIN_MS = 100


class ControlEndpoint:
    """Control requests of one device. All methods raise pyusb's USBError, or BadAnswer."""

    def __init__(self, name: str, device: Any, interface: int, timeout_ms: int, clock: Clock, tap: Tap) -> None:
        self._name = name
        self._clock = clock
        self._device = device
        self._interface = interface
        self._timeout_ms = timeout_ms
        self._tap = tap

    def request(self, request: ClassRequest, value: int, index: int, size: int) -> bytes:
        """Send a class request and return its complete reply."""
        kind = TO_ENDPOINT if request.of_endpoint else TO_INTERFACE
        self._tap(TO_DEVICE, struct.pack("<BBHHH", kind, request, value, index, size))
        reply = bytes(self._device.ctrl_transfer(kind, request, value, index, size, self._timeout_ms))
        self._tap(FROM_DEVICE, reply)
        if len(reply) != size:
            raise BadAnswer(self._name, request.name, f"{len(reply)} of {size} bytes", "ask again")
        return reply

    def clear(self, bulk_in: int, bulk_out: int) -> None:
        """Device clear: empties the buffers, keeps the settings."""
        status = self.request(ClassRequest.INITIATE_CLEAR, 0, self._interface, 1)
        if status[0] != RequestStatus.SUCCESS:
            raise BadAnswer(self._name, "clear its buffers", f"status {status[0]:#04x}", "switch it off and on")
        for _ in self._rounds():
            status = self.request(ClassRequest.CHECK_CLEAR_STATUS, 0, self._interface, 2)
            if status[0] != RequestStatus.PENDING:
                break
            # It may wait until its data are read; otherwise the read times out, which gives it time.
            self._drain(bulk_in)
        if status[0] != RequestStatus.SUCCESS:
            raise BadAnswer(self._name, "clear its buffers", "it stays busy", "switch it off and on")
        self.clear_halt(bulk_out)

    def abort_in(self, tag: int, bulk_in: int) -> None:
        """Abort a request for a reply: everything up to a short packet is discarded."""
        status = self.request(ClassRequest.INITIATE_ABORT_BULK_IN, tag, bulk_in, 2)
        if status[0] != RequestStatus.SUCCESS:
            return  # nothing in progress, or another transfer: the clear that follows ends it
        for _ in self._rounds():
            self._drain(bulk_in)
            status = self.request(ClassRequest.CHECK_ABORT_BULK_IN_STATUS, 0, bulk_in, 8)
            if status[0] != RequestStatus.PENDING:
                return
        raise BadAnswer(self._name, "abort a reply", "it stays busy", "switch it off and on")

    def abort_out(self, tag: int, bulk_out: int) -> None:
        """Abort a message that was written in part."""
        status = self.request(ClassRequest.INITIATE_ABORT_BULK_OUT, tag, bulk_out, 2)
        if status[0] != RequestStatus.SUCCESS:
            return
        for _ in self._rounds():
            if self.request(ClassRequest.CHECK_ABORT_BULK_OUT_STATUS, 0, bulk_out, 8)[0] != RequestStatus.PENDING:
                break
        self.clear_halt(bulk_out)

    def status_byte(self, tag: int, interrupt: int | None) -> int:
        """Status byte: from the reply, or from the interrupt endpoint if there is one."""
        reply = self.request(ClassRequest.READ_STATUS_BYTE, tag, self._interface, 3)
        if reply[0] == RequestStatus.INTERRUPT_IN_BUSY and interrupt is not None:
            self._notice(interrupt)  # an earlier notice that was not read
            reply = self.request(ClassRequest.READ_STATUS_BYTE, tag, self._interface, 3)
        if reply[0] != RequestStatus.SUCCESS or reply[1] != tag:
            raise BadAnswer(self._name, "READ_STATUS_BYTE", f"{reply.hex(' ')} for tag {tag}", "ask again")
        if interrupt is None:
            return reply[2]
        for _ in self._rounds():
            kind, status = self._notice(interrupt)
            if kind == 0x80 | tag:
                return status
        raise BadAnswer(self._name, "READ_STATUS_BYTE", "no notice with its tag", "ask again")

    def clear_halt(self, endpoint: int) -> None:
        """CLEAR_FEATURE(ENDPOINT_HALT)."""
        self._tap(TO_DEVICE, struct.pack("<BBHHH", *CLEAR_FEATURE, 0, endpoint, 0))
        self._device.clear_halt(endpoint)

    def _notice(self, interrupt: int) -> tuple[int, int]:
        notice = bytes(self._device.read(interrupt, 2, self._timeout_ms))
        self._tap(FROM_DEVICE, notice)
        if len(notice) != 2:
            raise BadAnswer(self._name, "READ_STATUS_BYTE", f"a notice of {len(notice)} bytes", "ask again")
        return notice[0], notice[1]

    def _rounds(self) -> Iterator[int]:
        """Rounds of questions to a device that is not ready yet, at least two and at most ROUNDS, for LONGEST_S."""
        deadline = self._clock.now() + LONGEST_S
        for k in range(ROUNDS):
            if k > 1 and self._clock.now() > deadline:
                return
            yield k

    def _drain(self, bulk_in: int) -> None:
        with contextlib.suppress(usb.core.USBTimeoutError):
            self._tap(FROM_DEVICE, bytes(self._device.read(bulk_in, DRAIN_BYTES, DRAIN_MS)))


def explain(direction: str, data: bytes) -> str:
    """A bulk message or a control transfer as text, for transcripts."""
    if len(data) < HEADER_BYTES:
        return _explain_control(direction, data)
    try:
        header = Header.decode(data)
    except HeaderError as error:
        return str(error)
    if direction == TO_DEVICE and header.msg_id == MsgId.DEV_DEP_MSG_IN:
        return f"transfer {header.tag}: up to {header.size} bytes requested"
    payload = data[HEADER_BYTES : HEADER_BYTES + header.size]
    return f"transfer {header.tag}: {payload.decode('ascii', 'backslashreplace')!a}"


def _explain_control(direction: str, data: bytes) -> str:
    if direction == FROM_DEVICE:
        if len(data) == 2 and data[0] & 0x80 and data[0] not in set(RequestStatus):
            return f"notice: status byte {data[1]:#04x}"
        return f"control: {RequestStatus(data[0]).name}" if data and data[0] in set(RequestStatus) else "control"
    if len(data) != 8:
        return "not a bulk message"
    kind, request, *_ = struct.unpack("<BBHHH", data)
    if kind in (TO_INTERFACE, TO_ENDPOINT) and request in set(ClassRequest):
        return f"control: {ClassRequest(request).name}"
    return "control: CLEAR_FEATURE(ENDPOINT_HALT)"
