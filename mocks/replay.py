"""Replay of a transcript: against a twin device, or, in the device's place, against drivers. Differences byte by byte.

This is for serial lines and Modbus connections, where bytes come in a stream; USB is in `mocks.replay_usb`.
"""

from collections import deque
from collections.abc import Iterable
from typing import Protocol

from goniotwin.mocks.replay_difference import Difference, compare_exchanges, describe_differences
from goniotwin.mocks.transcript import Transfer, exchanges
from goniotwin.twin.devices.line import BITS_A_BYTE, SerialDevice

ROUNDING_S = 2.0e-6
"""Times are written to the microsecond: what was read at once must not come too late for that."""


class Replay(Protocol):
    """A transcript that is sent to a twin device, one request after the other."""

    @property
    def due(self) -> float:
        """Time of the next recorded request, s; infinity after the last."""

    def step(self) -> None:
        """Send the next recorded request."""

    def differences(self) -> list[Difference]:
        """Replies of the device that were not recorded, and recorded ones that are missing."""


def replay_all(replays: Iterable[Replay]) -> None:
    """Replay all wires of one rig in the order of the times: the state of one device may affect another."""
    left = list(replays)
    while left:
        following = min(left, key=lambda each: each.due)
        if following.due == float("inf"):
            return
        following.step()


class LineReplay:
    """Replay on a serial line or a Modbus connection. `way_s` is the delay of the bytes, besides their own length."""

    def __init__(self, device: SerialDevice, transcript: list[Transfer], way_s: float = 0.0) -> None:
        self._device = device
        self._way_s = way_s
        self._exchanges = exchanges(transcript)
        self._replies: list[bytes] = []
        self._now = float("-inf")

    @property
    def due(self) -> float:
        """Time of the next recorded request, s; infinity after the last."""
        if len(self._replies) == len(self._exchanges):
            return float("inf")
        sent = self._exchanges[len(self._replies)].sent
        return sent.t if sent is not None else float("-inf")

    def step(self) -> None:
        """Send the next recorded request. Bytes that the device has begun to send by then answer the request before."""
        sent = self._exchanges[len(self._replies)].sent
        if sent is None:
            self._replies.append(b"")
            return
        self._now = max(self._now, sent.t + self._way_s + _seconds(len(sent.data), self._device.baudrate))
        self._hear(self._now)
        self._device.receive(sent.data, self._now)
        self._replies.append(b"")

    def differences(self) -> list[Difference]:
        """Differences between the recording and the replies of the device."""
        self._hear(float("inf"))
        return compare_exchanges(self._exchanges[: len(self._replies)], self._replies)

    def _hear(self, until: float) -> None:
        outbox = self._device.outbox
        while outbox and outbox[0][0] <= until:
            _, data = outbox.popleft()
            if self._replies:
                self._replies[-1] += data


def replay_to_device(device: SerialDevice, transcript: list[Transfer], way_s: float = 0.0) -> list[Difference]:
    """Send the recorded requests at the recorded times, and compare the replies."""
    sent = LineReplay(device, transcript, way_s)
    replay_all([sent])
    return sent.differences()


class RecordedDevice:
    """A device that replies as recorded: requests of a driver that differ from the recording are reported.

    It answers as fast as it did, as far as the transcript shows: what a driver left unread for a while comes as late as it
    was read. It keeps silent from the first difference on. `way_s` is how long bytes are on their way
    there and back, besides their own length. Of a line with several units it takes the merged transcript.
    """

    def __init__(self, transcript: list[Transfer], baudrate: int = 0, way_s: float = 0.0) -> None:
        self.baudrate = baudrate
        self.outbox: deque[tuple[float, bytes]] = deque()
        self.differences: list[Difference] = []
        self._way_s = way_s
        self._left = deque(exchanges(transcript, _seconds(1, baudrate)))
        self._end = transcript[-1] if transcript else None
        self._heard = b""

    @property
    def finished(self) -> bool:
        """Whether the whole recording has been replayed."""
        return not self._left and not self._heard and not self.differences

    def receive(self, data: bytes, t: float) -> None:
        """Compare, and reply once the whole recorded request has arrived."""
        self._heard += data
        while self._left and not self.differences:
            sent, answers = self._left[0].sent, self._left[0].answers
            expected = sent.data if sent is not None else b""
            if not self._heard.startswith(expected):
                if not expected.startswith(self._heard):
                    self.differences.append(describe_differences(sent, self._heard[: len(expected)], self._end))
                return
            if not self._heard and expected:
                return
            self._heard = self._heard[len(expected) :]
            self._left.popleft()
            for answer in answers:
                after = answer.t - sent.t if sent is not None else 0.0
                # The recorded time is that of the last byte's arrival at the host; the line adds the bytes' own time.
                begin = after - _seconds(len(answer.data) + len(expected), self.baudrate) - self._way_s - ROUNDING_S
                self.outbox.append((t + max(0.0, begin), answer.data))
            if not self._heard:
                return
        if self._heard and not self._left:
            self.differences.append(describe_differences(None, self._heard, self._end))
            self._heard = b""

    def reset(self, t: float) -> None:
        """Without effect: a recording has no state to reset."""
        del t


def _seconds(count: int, baudrate: int) -> float:
    """Duration of a number of bytes on a line, s; 0 without byte timing."""
    return BITS_A_BYTE * count / baudrate if baudrate else 0.0
