"""Replay of a transcript: against a twin device, or, in the device's place, against drivers. Differences byte by byte.

This is for serial lines and Modbus connections, where bytes come in a stream; USB is in `mocks.replay_usb`.
"""

from collections import deque
from collections.abc import Iterable
from typing import Protocol

from goniotwin.mocks.replay_difference import Difference, compare_exchanges, describe_differences
from goniotwin.mocks.transcript import Transfer, exchanges
from goniotwin.twin.devices.line import SerialDevice

BITS_A_BYTE = 10.0
ROUNDING_S = 2.0e-6
"""Times are written to the microsecond: what was read at once must not come too late for that."""


class Replay(Protocol):
    """A transcript that is told to a twin device, one thing after the other."""

    @property
    def due(self) -> float:
        """When the next thing was told, s; infinity after the last."""

    def step(self) -> None:
        """Tells it."""

    def differences(self) -> list[Difference]:
        """What the device has said that was not recorded, or has not said that was."""


def replay_all(replays: Iterable[Replay]) -> None:
    """Tells all wires of one rig what they were told, in the order of the times: what one device does another may see."""
    left = list(replays)
    while left:
        following = min(left, key=lambda each: each.due)
        if following.due == float("inf"):
            return
        following.step()


class LineReplay:
    """On a serial line or a Modbus connection. `way_s` is how long bytes are on their way, besides their own length."""

    def __init__(self, device: SerialDevice, transcript: list[Transfer], way_s: float = 0.0) -> None:
        self._device = device
        self._way_s = way_s
        self._exchanges = exchanges(transcript)
        self._said: list[bytes] = []
        self._now = float("-inf")

    @property
    def due(self) -> float:
        """When the next thing was told, s; infinity after the last."""
        if len(self._said) == len(self._exchanges):
            return float("inf")
        told = self._exchanges[len(self._said)].told
        return told.t if told is not None else float("-inf")

    def step(self) -> None:
        """Tells it. What the device has begun to say by then is its answer to what came before."""
        told = self._exchanges[len(self._said)].told
        if told is None:
            self._said.append(b"")
            return
        self._now = max(self._now, told.t + self._way_s + _seconds(len(told.data), self._device.baudrate))
        self._hear(self._now)
        self._device.receive(told.data, self._now)
        self._said.append(b"")

    def differences(self) -> list[Difference]:
        """Between what was recorded and what the device has said."""
        self._hear(float("inf"))
        return compare_exchanges(self._exchanges[: len(self._said)], self._said)

    def _hear(self, until: float) -> None:
        outbox = self._device.outbox
        while outbox and outbox[0][0] <= until:
            _, data = outbox.popleft()
            if self._said:
                self._said[-1] += data


def replay_to_device(device: SerialDevice, transcript: list[Transfer], way_s: float = 0.0) -> list[Difference]:
    """Tells the device what it was told, at the same times, and compares what it says."""
    told = LineReplay(device, transcript, way_s)
    replay_all([told])
    return told.differences()


class RecordedDevice:
    """A device that says what it said: drivers that tell it something else than was recorded are found out.

    It answers as fast as it did, as far as the transcript tells: what a driver left unread for a while comes as late as it
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
        """Whether everything that was recorded has happened again."""
        return not self._left and not self._heard and not self.differences

    def receive(self, data: bytes, t: float) -> None:
        """Compares, and answers once all that was told then has been told again."""
        self._heard += data
        while self._left and not self.differences:
            told, answers = self._left[0].told, self._left[0].answers
            expected = told.data if told is not None else b""
            if not self._heard.startswith(expected):
                if not expected.startswith(self._heard):
                    self.differences.append(describe_differences(told, self._heard[: len(expected)], self._end))
                return
            if not self._heard and expected:
                return
            self._heard = self._heard[len(expected) :]
            self._left.popleft()
            for answer in answers:
                after = answer.t - told.t if told is not None else 0.0
                # The recorded time is that of the last byte's arrival at the host; the line adds the bytes' own time.
                begin = after - _seconds(len(answer.data) + len(expected), self.baudrate) - self._way_s - ROUNDING_S
                self.outbox.append((t + max(0.0, begin), answer.data))
            if not self._heard:
                return
        if self._heard and not self._left:
            self.differences.append(describe_differences(None, self._heard, self._end))
            self._heard = b""

    def reset(self, t: float) -> None:
        """What was recorded cannot forget."""
        del t


def _seconds(count: int, baudrate: int) -> float:
    """That so many bytes take on a line; nothing where they keep no time."""
    return BITS_A_BYTE * count / baudrate if baudrate else 0.0
