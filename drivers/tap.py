"""Tap on the driver side of every wire: each byte with its time, as readable transcripts."""

import logging
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Protocol, TextIO

from goniotwin.protocols.clock import Clock

TO_DEVICE, FROM_DEVICE = ">", "<"
Explain = Callable[[str, bytes], str]


class Tap(Protocol):
    """Function that a driver calls with all bytes that it sends or receives."""

    def __call__(self, direction: str, data: bytes) -> None: ...


def no_tap(direction: str, data: bytes) -> None:
    """A tap that discards everything."""


class Transcript:
    """A folder with one text file per device.

    A line is: time in seconds, `>` to the device or `<` from it, the bytes in hexadecimal, their meaning. Each line is
    flushed at once, so that a program that is killed leaves whole lines.

    A measurement is worth more than its transcript. If a file cannot be written (the disk is full), all transcripts end,
    the measurement continues, and `failure` has the message that is logged once. Raises OSError only at the start, if
    nothing can be written to the folder.
    """

    def __init__(self, folder: Path, clock: Clock) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        self.failure: str | None = None
        self._folder = folder
        self._clock = clock
        self._files: dict[str, TextIO] = {}

    def tap(self, device: str, explain: Explain) -> Tap:
        """The tap of one device; `explain` gives the meaning of bytes (an empty string if unknown)."""
        path = self._folder / f"{device}.txt"
        if self.failure is not None:
            return no_tap
        try:
            file = path.open("w", encoding="utf-8", newline="\n", buffering=1)
            self._files[device] = file
            file.write("# time s | > to the device, < from it | bytes | meaning\n")
        except OSError as error:
            self._end_all(path, error)
            return no_tap

        def write(direction: str, data: bytes) -> None:
            if not data or file.closed or self.failure is not None:
                return
            meaning = " ".join(explain(direction, data).splitlines())
            try:
                file.write(f"{self._clock.now():14.6f} {direction} {data.hex(' ')}  | {meaning}\n")
            except OSError as error:
                self._end_all(path, error)

        return write

    def close(self) -> None:
        """Close all files."""
        for device, file in self._files.items():
            try:
                file.close()
            except OSError as error:
                self._end_all(self._folder / f"{device}.txt", error)

    def _end_all(self, path: Path, error: OSError) -> None:
        if self.failure is None:
            self.failure = (
                f"{path}: the transcript cannot be written: {error.strerror or error}; the measurement continues and all "
                "transcripts end here; free disk space or name another folder for the next one"
            )
            logging.getLogger(__name__).error("%s", self.failure)


def as_text(direction: str, data: bytes) -> str:
    """Meaning of bytes on an ASCII wire."""
    del direction
    return ascii(data.decode("ascii", "backslashreplace"))
