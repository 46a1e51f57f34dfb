"""The transfers of a USBTMC-USB488 instrument: bulk OUT, bulk IN, interrupt IN, and what halts them.

Strict where the class is: what a host must do it must do here too, or the endpoint halts. What it should do and does not
is in `complaints`; every transfer is in `log`. Source: USB-IF, USBTMC 1.0 section 3, USB488 section 3.
"""

from collections import deque

from goniotwin.protocols.usbtmc import (
    HEADER_BYTES,
    Header,
    HeaderError,
    MsgId,
    RequestStatus,
    StatusByte,
    message,
    next_tag,
)
from goniotwin.twin.devices.scpi_instrument import OUTPUT_QUEUE_BYTES, ScpiInstrument
from goniotwin.twin.devices.usb_standard import BULK_IN, BULK_OUT, INTERRUPT_IN, MAX_PACKET

LOG_KEPT = 2000
WHITE_SPACE = bytes(range(33))
"""IEEE 488.2, 7.4.1.2: a control character is white space too, such as the zero with which C ends a text."""


class Stall(Exception):
    """The endpoint is halted: the host gets a stall."""


class Overflow(Exception):
    """A packet is larger than what the host has left room for."""


class Transfers:
    """One instrument on the bus. Times are those at which a transfer reaches it.

    `keeps_fifo`: whether an aborted or cleared transfer stays in the FIFO until the host has read it, as the class
    allows. `clear_s`: how long a device clear takes.
    """

    def __init__(self, instrument: ScpiInstrument, latency_s: float, *, keeps_fifo: bool = False, clear_s: float = 0.0) -> None:
        self.instrument = instrument
        self.latency_s = latency_s
        self.keeps_fifo = keeps_fifo
        self.clear_s = clear_s
        self.log: deque[tuple[float, str, bytes]] = deque(maxlen=LOG_KEPT)
        self.complaints: deque[str] = deque(maxlen=LOG_KEPT)
        self.plugged = True
        self.plugs = 0
        self.pulses = 0
        self.remote = self.locked_out = False
        self.reset()

    def reset(self) -> None:
        """A reset of the port: no endpoint is halted, nothing is pending."""
        self._halted: set[int] = set()
        self._notices: deque[bytes] = deque()
        self._clear_until = float("-inf")
        self._reported = 0
        self._clear()

    def unplug(self) -> None:
        """The cable is out: open handles are dead."""
        self.plugged = False
        self.plugs += 1
        self.reset()

    def replug(self) -> None:
        """The cable is in again."""
        self.plugged = True

    def _clear(self) -> None:
        self._transfer = bytearray()
        self._input = bytearray()
        self._answers: deque[tuple[float, bytes]] = deque()
        self._request: Header | None = None
        self._fifo: bytes | None = None
        self._sent = 0
        self._last_out = self._last_in = 0
        self._aborting = False
        self._received = 0

    @property
    def serial_number(self) -> str:
        """As in the device descriptor."""
        return self.instrument.serial_number

    # ---- bulk ----

    def bulk_out(self, data: bytes, t: float) -> None:
        """Receive one write to bulk OUT. Raises Stall where the endpoint is halted, or where the class halts it.

        A transfer may come in several writes, each but the last of whole packets.
        """
        self.log.append((t, "bulk OUT", data))
        if BULK_OUT in self._halted:
            raise Stall
        self._transfer += data
        if len(self._transfer) < HEADER_BYTES:
            self._halt("a header of fewer than 12 bytes")
        try:
            header = Header.from_host(bytes(self._transfer[:HEADER_BYTES]))
        except HeaderError as error:
            self._halt(str(error))
        if header.tag == self._last_out:
            self._halt(f"bTag {header.tag} twice")
        carries = header.msg_id in (MsgId.DEV_DEP_MSG_OUT, MsgId.VENDOR_OUT)
        whole = HEADER_BYTES + (header.size + -header.size % 4 if carries else 0)
        if len(self._transfer) > whole:
            self._halt(f"{len(self._transfer)} bytes in a transfer of {whole}")
        if len(self._transfer) < whole:
            if len(data) % MAX_PACKET:
                self._halt(f"a short packet after {len(self._transfer)} bytes of a transfer of {whole}")
            return
        body = bytes(self._transfer[HEADER_BYTES : HEADER_BYTES + header.size])
        self._transfer.clear()
        if self._last_out and header.tag != next_tag(self._last_out):
            self.complaints.append(f"bTag {header.tag} after {self._last_out}")
        self._last_out = header.tag
        self._carry_out(header, body, t)

    def _carry_out(self, header: Header, body: bytes, t: float) -> None:
        match header.msg_id:
            case MsgId.DEV_DEP_MSG_OUT:
                self._take(body, header.end, t)
            case MsgId.DEV_DEP_MSG_IN:
                if self._request is not None:
                    self._halt("a request while one is pending")
                self._request = header
                if not self._answers and self._fifo is None:
                    self.instrument.report(-420, "Query UNTERMINATED")
            case MsgId.TRIGGER:
                self._execute(b"*TRG", t)
            case _:
                self._halt(f"MsgID {header.msg_id}: nothing vendor-specific here")

    def bulk_in_ready(self) -> float | None:
        """Time at which bulk IN has data for the host; None without data."""
        if BULK_IN in self._halted:
            raise Stall
        if self._fifo is not None:
            return float("-inf")
        if self._request is None or not self._answers:
            return None
        return self._answers[0][0]

    def bulk_in(self, size: int | None = None) -> bytes:
        """The data announced by `bulk_in_ready`: packets until a short one, or until `size` bytes are full. Raises Overflow."""
        if self._fifo is None:
            self._fifo = self._answer()
        fifo = self._fifo
        room = len(fifo) + 1 if size is None else size
        if room > len(fifo) or (room == len(fifo) and len(fifo) % MAX_PACKET):
            given, self._fifo = fifo, None  # the last packet is short, or an empty one follows
        elif room % MAX_PACKET:
            self._fifo = None
            raise Overflow
        else:
            given, self._fifo = fifo[:room], fifo[room:]
        self._sent += len(given)
        if self._fifo is None:
            self._aborting = False
        self.log.append((float("nan"), "bulk IN", given))
        return given

    def _answer(self) -> bytes:
        request, (ready, answer) = self._request, self._answers.popleft()
        assert request is not None
        size = min(len(answer), request.size)
        ended = False
        if request.term_char is not None and (found := answer.find(request.term_char, 0, size)) >= 0:
            size, ended = found + 1, True
        rest = answer[size:]
        if rest:
            self._answers.appendleft((ready, rest))
        self._request, self._last_in, self._sent = None, request.tag, 0
        return message(MsgId.DEV_DEP_MSG_IN, request.tag, answer[:size], end=not rest, by_term_char=ended)

    def _take(self, body: bytes, end: bool, t: float) -> None:
        *programs, rest = (bytes(self._input) + body).split(b"\n")
        if end:
            programs, rest = [*programs, rest], b""
        # What is too much is kept as far as the instrument needs to see that it is.
        self._input = bytearray(rest[: self.instrument.max_message + 1])
        for program in programs:
            if program.strip(WHITE_SPACE):
                self._execute(program, t)

    def _execute(self, program: bytes, t: float) -> None:
        if self._answers or self._fifo is not None:
            self._answers.clear()
            self._fifo = None
            self.instrument.clear(t)  # what it was still busy with is not waited for
            self.instrument.report(-410, "Query INTERRUPTED")
        answers = self.instrument.execute(program, t)
        if sum(len(answer) for _, answer in answers) > OUTPUT_QUEUE_BYTES:
            self.instrument.report(-430, "Query DEADLOCKED")
            return
        self._answers.extend(answers)

    def _halt(self, reason: str, endpoint: int = BULK_OUT) -> None:
        self.complaints.append(reason)
        self._transfer.clear()
        self._halted.add(endpoint)
        raise Stall

    # ---- interrupt IN ----

    def interrupt_in_ready(self) -> float | None:
        """Time at which interrupt IN has a notice for the host: a service request, or the answer to READ_STATUS_BYTE."""
        if INTERRUPT_IN in self._halted:
            raise Stall
        if self._notices:
            return float("-inf")
        enabled = self.instrument.service_enable
        if self._summary(float("-inf")) & enabled & ~self._reported:
            return float("-inf")
        if self._answers and enabled & StatusByte.MAV & ~self._reported:
            return self._answers[0][0]
        return None

    def interrupt_in(self, t: float) -> bytes:
        """The notice that `interrupt_in_ready` announces: two bytes."""
        if self._notices:
            notice = self._notices.popleft()
        else:
            status = self._summary(t)
            self._reported |= status & self.instrument.service_enable
            notice = bytes((0x81, status | StatusByte.SRQ))
        self.log.append((t, "interrupt IN", notice))
        return notice

    def _summary(self, t: float) -> int:
        """The status byte without bit 6."""
        available = StatusByte.MAV if self._fifo is not None or (self._answers and self._answers[0][0] <= t) else 0
        return self.instrument.status_byte() & ~StatusByte.MAV & ~StatusByte.SRQ | available

    def _read_status(self, tag: int, t: float) -> bytes:
        if not 2 <= tag <= 127:
            return bytes((RequestStatus.FAILED, tag & 0xFF, 0))
        if self._notices:
            return bytes((RequestStatus.INTERRUPT_IN_BUSY, tag, 0))
        status = self._summary(t)
        enabled = status & self.instrument.service_enable
        self._reported &= enabled  # what has gone away may ask for service again
        self._notices.append(bytes((0x80 | tag, status | (StatusByte.SRQ if enabled else 0))))
        return bytes((RequestStatus.SUCCESS, tag, 0))

    def halt(self, endpoint: int) -> None:
        """Halt an endpoint without a cause; for tests."""
        self._halted.add(endpoint)

    def clear_halt(self, endpoint: int) -> None:
        """CLEAR_FEATURE(ENDPOINT_HALT)."""
        self._halted.discard(endpoint)

    def new_host(self) -> None:
        """The device was opened: the bTags begin anew."""
        self._last_out = 0
