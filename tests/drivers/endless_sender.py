"""Devices that never stop sending, one for each wire: in the place of the device, from a given request on."""

from collections import deque
from dataclasses import dataclass

from goniotwin.protocols.clock import Clock
from goniotwin.protocols.usbtmc import ClassRequest, Header, MsgId, RequestStatus
from goniotwin.twin.devices.line import BITS_A_BYTE, SerialDevice
from goniotwin.twin.devices.usbtmc import UsbTmcDevice

STAYS_PENDING = {ClassRequest.CHECK_ABORT_BULK_IN_STATUS: 8, ClassRequest.CHECK_CLEAR_STATUS: 2}
"""Requests to which an endless sender replies that it is not done yet, with the length of the reply."""


@dataclass(frozen=True)
class Stream:
    """`piece` is sent every `period_s` s; on a serial line no faster than its baud rate."""

    piece: bytes
    period_s: float = 1e-4


class _EndlessOutbox(deque[tuple[float, bytes]]):
    """An outbox in which the next piece follows each one that is taken."""

    def __init__(self, t: float, stream: Stream) -> None:
        super().__init__([(t, stream.piece)])
        self._stream = stream

    def popleft(self) -> tuple[float, bytes]:
        t, piece = super().popleft()
        self.append((t + self._stream.period_s, piece))
        return t, piece

    def clear(self) -> None:
        self.popleft()


class EndlessSender:
    """`device` until the `after`-th request from now; from then on the stream, and nothing that belongs to a request."""

    def __init__(self, device: SerialDevice, stream: Stream) -> None:
        self._device = device
        on_the_line_s = len(stream.piece) * BITS_A_BYTE / device.baudrate if device.baudrate else 0.0  # TCP has none
        self._stream = Stream(stream.piece, max(stream.period_s, on_the_line_s))
        self._left: int | None = None
        self.received: list[tuple[float, bytes]] = []
        self.baudrate = device.baudrate
        self.outbox: deque[tuple[float, bytes]] = device.outbox

    def begin(self, after: int) -> None:
        """Begin to send at the request `after` from now, 0 for the next one."""
        self._left = after

    def end(self) -> None:
        """Be the device again."""
        self._left = None
        self._device.outbox.clear()
        self.outbox = self._device.outbox

    def receive(self, data: bytes, t: float) -> None:
        """Bytes from the driver."""
        self.received.append((t, data))
        if self._left is not None:
            self._left -= 1
            if self._left < 0:
                if not isinstance(self.outbox, _EndlessOutbox):
                    self.outbox = _EndlessOutbox(t, self._stream)
                return
        self._device.receive(data, t)

    def reset(self, t: float) -> None:
        """Reset the device."""
        self._device.reset(t)


class EndlessUsb(UsbTmcDevice):
    """An instrument whose replies have no end: each transfer has one more byte, after `period_s`; an abort stays pending.

    With `wrong_tag` every transfer belongs to another request.
    """

    def __init__(self, device: UsbTmcDevice, clock: Clock, period_s: float, *, wrong_tag: bool = False) -> None:
        self._clock = clock
        self._period_s = period_s
        self._wrong_tag = wrong_tag
        self._left: int | None = None
        self._tag = 0
        self._next_s = 0.0
        super().__init__(device.instrument, device.latency_s, keeps_fifo=device.keeps_fifo, clear_s=device.clear_s)

    def begin(self, after: int) -> None:
        """Begin to send at the write `after` from now, 0 for the next one."""
        self._left = after

    def end(self) -> None:
        """Be the instrument again."""
        self._left = None

    @property
    def _endless(self) -> bool:
        return self._left is not None and self._left < 0

    def bulk_out(self, data: bytes, t: float) -> None:
        if self._left is not None:
            self._left -= 1
        if not self._endless:
            super().bulk_out(data, t)
            return
        self._tag, self._next_s = data[1], t + self._period_s

    def bulk_in_ready(self) -> float | None:
        return self._next_s if self._endless else super().bulk_in_ready()

    def bulk_in(self, size: int | None = None) -> bytes:
        if not self._endless:
            return super().bulk_in(size)
        self._next_s = self._clock.now() + self._period_s
        tag = self._tag % 255 + 1 if self._wrong_tag else self._tag
        return Header(MsgId.DEV_DEP_MSG_IN, tag, 1, end=False).encode() + b"1\0\0\0"

    def control(self, kind: int, request: int, value: int, index: int, length: int, t: float) -> bytes:
        if self._endless and kind & 0x60 and request in STAYS_PENDING:
            return bytes((RequestStatus.PENDING,)).ljust(STAYS_PENDING[ClassRequest(request)], b"\0")
        return super().control(kind, request, value, index, length, t)
