"""The USB side of a USBTMC-USB488 instrument: bulk transfers, class requests, halted endpoints.

Source: USB-IF, USBTMC 1.0 sections 3 and 4, USB488 section 4.
"""

from collections import deque

from protocols.usbtmc import (
    HEADER_BYTES,
    PROTOCOL_USB488,
    Header,
    HeaderError,
    MsgId,
    Request,
    Status,
    StatusByte,
    capabilities,
    message,
)
from twin.devices.pm100d import Pm100d

VENDOR_ID = 0x1313
PRODUCT_ID = 0x8078
MANUFACTURER = "Thorlabs"
PRODUCT = "PM100D"
BULK_OUT, BULK_IN = 0x02, 0x82
MAX_PACKET = 64
PROTOCOL = PROTOCOL_USB488


class Stall(Exception):
    """The endpoint is halted: the host gets a stall."""


class UsbTmcDevice:
    """One instrument on the bus. Times are those at which a transfer reaches it."""

    def __init__(self, instrument: Pm100d, latency_s: float) -> None:
        self.instrument = instrument
        self.latency_s = latency_s
        self._halted: set[int] = set()
        self._clear()

    def _clear(self) -> None:
        self._input = bytearray()
        self._answers: deque[tuple[float, bytes]] = deque()
        self._request: Header | None = None
        self._last_out = self._last_in = 0

    @property
    def serial_number(self) -> str:
        """As in the device descriptor."""
        return self.instrument.serial_number

    def bulk_out(self, data: bytes, t: float) -> None:
        """A bulk OUT transfer. Raises Stall where the endpoint is halted, or where the class says to halt it."""
        if BULK_OUT in self._halted:
            raise Stall
        try:
            header = Header.decode(data)
        except HeaderError:
            self._halt(BULK_OUT)
        self._last_out = header.tag
        body = data[HEADER_BYTES : HEADER_BYTES + header.size]
        if header.msg_id == MsgId.DEV_DEP_MSG_OUT:
            if len(body) != header.size:
                self._halt(BULK_OUT)
            self._take(body, header.end, t)
        elif header.msg_id == MsgId.DEV_DEP_MSG_IN:
            if self._request is not None:
                self._halt(BULK_OUT)
            self._request = header
        elif header.msg_id == MsgId.TRIGGER:
            self._take(b"INIT\n", True, t)
        else:
            self._halt(BULK_OUT)

    def bulk_in_ready(self) -> float | None:
        """When the bulk IN transfer that the host has asked for can begin; None while there is nothing to send."""
        if BULK_IN in self._halted:
            raise Stall
        if self._request is None or not self._answers:
            return None
        return self._answers[0][0]

    def bulk_in(self) -> bytes:
        """The transfer that `bulk_in_ready` spoke of."""
        request, (ready, answer) = self._request, self._answers.popleft()
        assert request is not None
        size = min(len(answer), request.size)
        if request.term_char is not None and (found := answer.find(request.term_char)) >= 0:
            size = min(size, found + 1)
        rest = answer[size:]
        if rest:
            self._answers.appendleft((ready, rest))
        self._request, self._last_in = None, request.tag
        return message(MsgId.DEV_DEP_MSG_IN, request.tag, answer[:size], end=not rest)

    def control_in(self, request: int, value: int, t: float) -> bytes:
        """A class request and its answer. Raises Stall for one that the device does not know."""
        match request:
            case Request.GET_CAPABILITIES:
                return capabilities()
            case Request.INITIATE_CLEAR:
                self._clear()
                return bytes((Status.SUCCESS,))
            case Request.CHECK_CLEAR_STATUS:
                return bytes((Status.SUCCESS, 0))
            case Request.INITIATE_ABORT_BULK_OUT:
                found = bool(self._input) and value == self._last_out
                self._input.clear()
                return bytes((Status.SUCCESS if found else Status.FAILED, self._last_out))
            case Request.CHECK_ABORT_BULK_OUT_STATUS | Request.CHECK_ABORT_BULK_IN_STATUS:
                return bytes((Status.SUCCESS, 0, 0, 0, 0, 0, 0, 0))
            case Request.INITIATE_ABORT_BULK_IN:
                return self._abort_in(value, t)
            case Request.READ_STATUS_BYTE:
                available = StatusByte.MAV if self._answers and self._answers[0][0] <= t else 0
                return bytes((Status.SUCCESS, value & 0x7F, self.instrument.status_byte() | available))
            case Request.INDICATOR_PULSE | Request.REN_CONTROL | Request.GO_TO_LOCAL | Request.LOCAL_LOCKOUT:
                return bytes((Status.SUCCESS,))
        raise Stall

    def clear_halt(self, endpoint: int) -> None:
        """CLEAR_FEATURE(ENDPOINT_HALT)."""
        self._halted.discard(endpoint)

    def reset(self) -> None:
        """A reset of the port: no endpoint is halted, nothing is pending."""
        self._halted.clear()
        self._clear()

    def _abort_in(self, tag: int, t: float) -> bytes:
        request, self._request = self._request, None
        if request is None:
            return bytes((Status.FAILED, self._last_in))
        if request.tag != tag:
            self._request = request
            return bytes((Status.TRANSFER_NOT_IN_PROGRESS, request.tag))
        # The host waits for a short packet: an empty last message, which it throws away.
        self._answers.clear()
        self._answers.append((t, b""))
        self._request = request
        return bytes((Status.SUCCESS, tag))

    def _take(self, body: bytes, end: bool, t: float) -> None:
        self._input += body
        if not end and not self._input.endswith(b"\n"):
            return
        program, self._input = bytes(self._input), bytearray()
        if self._answers:
            self._answers.clear()
            self.instrument.report(-410, "Query INTERRUPTED")
        self._answers.extend(self.instrument.execute(program, t))

    def _halt(self, endpoint: int) -> None:
        self._halted.add(endpoint)
        raise Stall
