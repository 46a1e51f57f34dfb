"""Transcripts read back: bytes on a wire with time and direction, and the exchanges they make."""

import heapq
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

TO_DEVICE, FROM_DEVICE = ">", "<"
LATEST_S = 1.0e9
MOST_BYTES, MOST_TRANSFERS = 150_000_000, 1_500_000
"""Of one file: some 22 hours of the axes, at the 18 transfers a second of quick.toml. They take several hundred bytes each."""
_LINE = re.compile(r"\s*(?P<t>-?[0-9]+(\.[0-9]+)?) (?P<direction>[<>]) (?P<bytes>([0-9a-fA-F]{2} ?)+?)\s*(\|.*)?")


class TranscriptError(ValueError):
    """A file that is no transcript: file, line, what is wrong."""


@dataclass(frozen=True, slots=True)
class Transfer:
    """Bytes that passed at a time, s; `line` of `file` is where they stand."""

    t: float
    direction: str
    data: bytes
    line: int
    file: str = ""


@dataclass(frozen=True, slots=True)
class Exchange:
    """A request and the replies until the next request; the first exchange may have no request."""

    sent: Transfer | None
    answers: list[Transfer] = field(default_factory=list)

    @property
    def reply(self) -> bytes:
        """All replies in one piece."""
        return b"".join(answer.data for answer in self.answers)


def read_transcript(path: Path, most_transfers: int = MOST_TRANSFERS) -> list[Transfer]:
    """Read all transfers, in order. Raises TranscriptError, also for more than `most_transfers`."""
    try:
        if path.exists() and not path.is_file():  # a pipe blocks, and a device such as /dev/zero has no end
            raise TranscriptError(f"{path}: is a folder or a device, not a file; check the name")
        if path.stat().st_size > MOST_BYTES:
            raise TranscriptError(f"{path}: has more than {MOST_BYTES} bytes; give a part of it")
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise TranscriptError(f"{path}: cannot be read: {error}") from None
    *lines, last = text.split("\n")
    if last.strip() and "|" not in last:
        raise TranscriptError(
            f"{path}, line {len(lines) + 1}: the file ends within it: end the line if it is whole, else remove it"
        )
    found: list[Transfer] = []
    for number, line in enumerate((*lines, last), 1):
        if not line.strip() or line.startswith("#"):
            continue
        match = _LINE.fullmatch(line)
        if match is None:
            raise TranscriptError(f"{path}, line {number}: is no line of a transcript: {line[:60]!a}")
        if abs(t := float(match["t"])) > LATEST_S:
            raise TranscriptError(f"{path}, line {number}: {match['t'][:60]} s is no time")
        if len(found) == most_transfers:
            raise TranscriptError(f"{path}, line {number}: has more than {most_transfers} transfers; give a part of it")
        found.append(Transfer(t, match["direction"], bytes.fromhex(match["bytes"]), number, path.name))
    return found


def merge_transcripts(transcripts: Iterable[list[Transfer]]) -> list[Transfer]:
    """Merge the transcripts of several units on one line: in order of time, each in its own order.

    Where times are equal a reply comes first: the next request follows it.
    """
    return list(heapq.merge(*transcripts, key=lambda passed: (passed.t, passed.direction == TO_DEVICE)))


def exchanges(transcript: list[Transfer], byte_s: float = 0.0) -> list[Exchange]:
    """Requests, each with the replies until the next request.

    Where a byte takes `byte_s`, what must have begun to come before the first byte of a question was there does not
    answer it, and is left to the exchange before: drivers may write down a line only when they have all of it.
    """
    found: list[Exchange] = []
    for passed in transcript:
        if passed.direction == TO_DEVICE:
            found.append(Exchange(passed))
            continue
        if not found:
            found.append(Exchange(None))
        last = found[-1]
        begun = passed.t - byte_s * len(passed.data)
        too_soon = byte_s > 0.0 and last.sent is not None and begun < last.sent.t + 0.5 * byte_s
        (found[-2] if too_soon and not last.answers and len(found) > 1 else last).answers.append(passed)
    return found
