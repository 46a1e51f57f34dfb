"""Replay of a transcript: against a twin device, or, in the device's place, against drivers. Differences byte by byte."""

from collections import deque
from dataclasses import dataclass
from itertools import zip_longest

from mocks.transcript import FROM_DEVICE, TO_DEVICE, Passed
from twin.devices.line import SerialDevice

SHOWN = 48


@dataclass(frozen=True)
class Difference:
    """Bytes that are not those of the transcript, from its line `line` on."""

    line: int
    direction: str
    recorded: bytes
    replayed: bytes

    def __str__(self) -> str:
        places = [
            f"byte {k}: {_hex(one)} recorded, {_hex(other)} now"
            for k, (one, other) in enumerate(zip_longest(self.recorded, self.replayed))
            if one != other
        ]
        who = "to the device" if self.direction == TO_DEVICE else "from the device"
        more = f", and {len(places) - SHOWN} more" if len(places) > SHOWN else ""
        return f"line {self.line}, {who}: " + "; ".join(places[:SHOWN]) + more


def replay_to_device(device: SerialDevice, transcript: list[Passed]) -> list[Difference]:
    """Tells the device what it was told, at the same times, and compares what it says until it is told the next thing."""
    differences = []
    for told, answers in _exchanges(transcript):
        if told is not None:
            device.receive(told.data, told.t)
        said = b"".join(data for _, data in device.outbox)
        device.outbox.clear()
        recorded = b"".join(answer.data for answer in answers)
        if said != recorded:
            line = answers[0].line if answers else (told.line if told is not None else 0)
            differences.append(Difference(line, FROM_DEVICE, recorded, said))
    return differences


class RecordedDevice:
    """A device that says what it said: drivers that tell it something else than was recorded are found out.

    It answers as fast as it did, and keeps silent from the first difference on.
    """

    def __init__(self, transcript: list[Passed], baudrate: int) -> None:
        self.baudrate = baudrate
        self.outbox: deque[tuple[float, bytes]] = deque()
        self.differences: list[Difference] = []
        self._left = deque(_exchanges(transcript))
        self._heard = b""

    @property
    def finished(self) -> bool:
        """Whether everything that was recorded has happened again."""
        return not self._left and not self._heard and not self.differences

    def receive(self, data: bytes, t: float) -> None:
        """Compares, and answers once all that was told then has been told again."""
        self._heard += data
        while self._left and not self.differences:
            told, answers = self._left[0]
            expected = told.data if told is not None else b""
            if not self._heard.startswith(expected):
                if not expected.startswith(self._heard):
                    line = told.line if told is not None else 0
                    self.differences.append(Difference(line, TO_DEVICE, expected, self._heard[: len(expected)]))
                return
            if not self._heard and expected:
                return
            self._heard = self._heard[len(expected) :]
            self._left.popleft()
            for answer in answers:
                after = answer.t - told.t if told is not None else 0.0
                # The recorded time is that of the last byte's arrival at the host; the line adds the bytes' own time.
                begin = after - 10.0 * (len(answer.data) + len(expected)) / self.baudrate
                self.outbox.append((t + max(0.0, begin), answer.data))
            if not self._heard:
                return
        if self._heard and not self._left:
            self.differences.append(Difference(0, TO_DEVICE, b"", self._heard))
            self._heard = b""

    def reset(self, t: float) -> None:
        """What was recorded cannot forget."""
        del t


def _exchanges(transcript: list[Passed]) -> list[tuple[Passed | None, list[Passed]]]:
    """What was told, each with what the device said until the next thing."""
    found: list[tuple[Passed | None, list[Passed]]] = []
    for passed in transcript:
        if passed.direction == TO_DEVICE:
            found.append((passed, []))
        else:
            if not found:
                found.append((None, []))
            found[-1][1].append(passed)
    return found


def _hex(byte: int | None) -> str:
    return "nothing" if byte is None else f"{byte:02x}"
