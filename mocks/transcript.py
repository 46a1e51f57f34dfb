"""Transcripts read back: what passed over a wire, when, in which direction."""

import re
from dataclasses import dataclass
from pathlib import Path

TO_DEVICE, FROM_DEVICE = ">", "<"
_LINE = re.compile(r"\s*(?P<t>-?\d+(\.\d+)?) (?P<direction>[<>]) (?P<bytes>([0-9a-fA-F]{2} ?)+?)\s*(\|.*)?")


class TranscriptError(ValueError):
    """A file that is no transcript: file, line, what is wrong."""


@dataclass(frozen=True, slots=True)
class Passed:
    """Bytes that passed at a time, s; `line` is where they stand in the file."""

    t: float
    direction: str
    data: bytes
    line: int


def read_transcript(path: Path) -> list[Passed]:
    """All that passed, in order. Raises TranscriptError."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise TranscriptError(f"{path}: cannot be read: {error}") from None
    found = []
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.startswith("#"):
            continue
        match = _LINE.fullmatch(line)
        if match is None:
            raise TranscriptError(f"{path}, line {number}: is no line of a transcript: {line[:60]!a}")
        found.append(Passed(float(match["t"]), match["direction"], bytes.fromhex(match["bytes"]), number))
    return found
