"""Replay of a USBTMC instrument's transcript: against the twin's, or, in the instrument's place, against drivers.

A recorded request is a control request where it has the eight bytes of a setup packet (CLEAR_FEATURE among them), else a bulk
message, whose header alone has twelve. Of the answers, the first after a control request is its answer; what follows
READ_STATUS_BYTE's are notices of the interrupt endpoint; all else is bulk IN. What failed (a stall, a timeout) is in no
transcript: it shows as the answer that is not there.
"""

import contextlib
import struct
from collections import deque

from goniotwin.mocks.replay import ROUNDING_S, replay_all
from goniotwin.mocks.replay_difference import Difference, describe_differences
from goniotwin.mocks.transcript import FROM_DEVICE, Exchange, Transfer, exchanges
from goniotwin.protocols.usbtmc import ClassRequest
from goniotwin.twin.devices.usbtmc import UsbTmcDevice
from goniotwin.twin.devices.usbtmc_transfers import Overflow, Stall

SETUP = struct.Struct("<BBHHH")
CLEAR_HALT = (0x02, 1)
NEVER_S = float("inf")


class UsbReplay:
    """A transcript of an instrument, replayed to a twin device."""

    def __init__(self, device: UsbTmcDevice, transcript: list[Transfer]) -> None:
        self._device = device
        self._left = deque(exchanges(transcript))
        self._found: list[Difference] = []
        self._now = float("-inf")

    @property
    def due(self) -> float:
        """Time of the next recorded request, s; infinity after the last."""
        if not self._left:
            return NEVER_S
        sent = self._left[0].sent
        return sent.t if sent is not None else float("-inf")

    def step(self) -> None:
        """Send it, and read from the device what was read in the recording."""
        exchange = self._left.popleft()
        sent, answers = exchange.sent, deque(exchange.answers)
        read = self._read
        if sent is not None:
            self._now = max(self._now, sent.t)
            if _is_setup(sent.data):
                self._compare(sent, answers.popleft() if answers else None, self._control(sent.data))
                read = self._notice if _asks_for_status(sent.data) else read
            else:
                self._write(sent.data)
                if not answers and self._left:
                    self._compare(sent, None, self._read(self.due))
        for answer in answers:
            self._compare(sent, answer, read(NEVER_S))

    def differences(self) -> list[Difference]:
        """Differences between the recording and the replies of the device."""
        return self._found

    def _compare(self, sent: Transfer | None, answer: Transfer | None, now: bytes) -> None:
        recorded = answer.data if answer is not None else b""
        at = answer if answer is not None else sent
        if now != recorded and at is not None:
            asked = sent.data if sent is not None else b""
            self._found.append(Difference(at.line, FROM_DEVICE, recorded, now, asked, at.file))

    def _control(self, setup: bytes) -> bytes:
        kind, request, value, index, length = SETUP.unpack(setup)
        try:
            return self._device.control(kind, request, value, index, length, self._now + self._device.latency_s)
        except Stall:
            return b""

    def _write(self, data: bytes) -> None:
        # A stall shows as the answer that does not come.
        with contextlib.suppress(Stall):
            self._device.bulk_out(data, self._now + 0.5 * self._device.latency_s)

    def _read(self, until: float) -> bytes:
        """Data of bulk IN for a host that waits as long as the recorded one."""
        try:
            ready = self._device.bulk_in_ready()
            return self._device.bulk_in() if ready is not None and ready <= until else b""
        except Stall:
            return b""

    def _notice(self, until: float) -> bytes:
        try:
            ready = self._device.interrupt_in_ready()
            return self._device.interrupt_in(max(self._now, ready)) if ready is not None and ready <= until else b""
        except Stall:
            return b""


def replay_to_usb(device: UsbTmcDevice, transcript: list[Transfer]) -> list[Difference]:
    """Send the recorded requests at the recorded times, and compare the replies."""
    sent = UsbReplay(device, transcript)
    replay_all([sent])
    return sent.differences()


class RecordedUsb(UsbTmcDevice):
    """An instrument that replies as recorded: requests of a driver that differ from the recording are reported.

        rig.usb["monitor"] = RecordedUsb(rig.usb["monitor"], transcript)

    It answers as fast as it did. From the first difference on it stalls requests on endpoint 0, and sends nothing on
    the others. No transcript has the descriptors: they are those of `device`.
    """

    def __init__(self, device: UsbTmcDevice, transcript: list[Transfer]) -> None:
        super().__init__(device.instrument, device.latency_s)
        self.differences: list[Difference] = []
        self._recorded = deque(exchanges(transcript))
        self._end = transcript[-1] if transcript else None
        self._bulk: deque[tuple[float, bytes]] = deque()
        self._interrupts: deque[tuple[float, bytes]] = deque()

    @property
    def finished(self) -> bool:
        """Whether the whole recording has been replayed."""
        return not (self._recorded or self._bulk or self._interrupts or self.differences)

    def control(self, kind: int, request: int, value: int, index: int, length: int, t: float) -> bytes:
        """As recorded; standard requests, but for CLEAR_FEATURE, as `device`. Raises Stall where no answer was recorded."""
        if kind & 0x60 == 0 and (kind, request) != CLEAR_HALT:
            return super().control(kind, request, value, index, length, t)
        if (kind, request) == CLEAR_HALT:
            self.clear_halt(index)
            return b""
        setup = SETUP.pack(kind, request, value, index, length)
        answers = self._match(setup, t - self.latency_s)
        if not answers:
            raise Stall
        (self._interrupts if _asks_for_status(setup) else self._bulk).extend(answers[1:])
        return answers[0][1]

    def clear_halt(self, endpoint: int) -> None:
        """CLEAR_FEATURE(ENDPOINT_HALT)."""
        self._match(SETUP.pack(*CLEAR_HALT, 0, endpoint, 0), float("-inf"))

    def bulk_out(self, data: bytes, t: float) -> None:
        """Compare the host's write with the recording."""
        self._bulk.extend(self._match(data, t - 0.5 * self.latency_s))

    def bulk_in_ready(self) -> float | None:
        """Time of the next recorded bulk IN data."""
        return self._bulk[0][0] if self._bulk else None

    def bulk_in(self, size: int | None = None) -> bytes:
        """Recorded data. Raises Overflow where the host has no room for it."""
        data = self._bulk.popleft()[1]
        if size is not None and len(data) > size:
            raise Overflow
        return data

    def interrupt_in_ready(self) -> float | None:
        """Time of the next recorded notice."""
        return self._interrupts[0][0] if self._interrupts else None

    def interrupt_in(self, t: float) -> bytes:
        """Recorded notice."""
        del t
        return self._interrupts.popleft()[1]

    def _match(self, data: bytes, t: float) -> list[tuple[float, bytes]]:
        """Recorded answers with their times; none after the first difference."""
        if self.differences:
            return []
        expected = self._recorded.popleft() if self._recorded else Exchange(None)
        sent = expected.sent
        if sent is None or sent.data != data:
            self.differences.append(describe_differences(sent, data, self._end))
            return []
        return [(t + each.t - sent.t - 0.5 * self.latency_s - ROUNDING_S, each.data) for each in expected.answers]


def _is_setup(data: bytes) -> bool:
    return len(data) == SETUP.size


def _asks_for_status(data: bytes) -> bool:
    return _is_setup(data) and data[1] == ClassRequest.READ_STATUS_BYTE
