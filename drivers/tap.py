"""The tap on the drivers' side of every wire: each byte that passes, with its time, in a form that a person can read."""

import logging
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Protocol, TextIO

from goniotwin.protocols.clock import Clock

TO_DEVICE, FROM_DEVICE = ">", "<"
Explain = Callable[[str, bytes], str]


class Tap(Protocol):
    """What a driver calls with each piece of bytes that it sends or gets."""

    def __call__(self, direction: str, data: bytes) -> None: ...


def no_tap(direction: str, data: bytes) -> None:
    """Nobody listens."""


class Transcript:
    """A folder with one text file a device.

    A line is: time in seconds, `>` to the device or `<` from it, the bytes in hexadecimal, what they mean. Each is on its
    way to the disk when its bytes have passed, so that a program that is killed leaves whole lines.

    A measurement is worth more than its transcript. Where a file cannot be written any more (the disk is full), all end
    there, the measurement goes on, and `trouble` says so in words, as the log does, once. Raises OSError only at the
    start, for a folder in which nothing can be written.
    """

    def __init__(self, folder: Path, clock: Clock) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
        self.trouble: str | None = None
        self._folder = folder
        self._clock = clock
        self._files: dict[str, TextIO] = {}

    def tap(self, device: str, explain: Explain) -> Tap:
        """The tap of one device; `explain` puts bytes into words (an empty string where it cannot)."""
        path = self._folder / f"{device}.txt"
        if self.trouble is not None:
            return no_tap
        try:
            file = path.open("w", encoding="utf-8", newline="\n", buffering=1)
            self._files[device] = file
            file.write("# time s | > to the device, < from it | bytes | meaning\n")
        except OSError as error:
            self._give_up(path, error)
            return no_tap

        def write(direction: str, data: bytes) -> None:
            if not data or file.closed or self.trouble is not None:
                return
            meaning = " ".join(explain(direction, data).splitlines())
            try:
                file.write(f"{self._clock.now():14.6f} {direction} {data.hex(' ')}  | {meaning}\n")
            except OSError as error:
                self._give_up(path, error)

        return write

    def close(self) -> None:
        """Ends all files."""
        for device, file in self._files.items():
            try:
                file.close()
            except OSError as error:
                self._give_up(self._folder / f"{device}.txt", error)

    def _give_up(self, path: Path, error: OSError) -> None:
        if self.trouble is None:
            self.trouble = (
                f"{path}: the transcript cannot be written: {error.strerror or error}; the measurement goes on and all "
                "transcripts end here; make room or name another folder for the next"
            )
            logging.getLogger(__name__).error("%s", self.trouble)


def as_text(direction: str, data: bytes) -> str:
    """For wires that carry ASCII."""
    del direction
    return ascii(data.decode("ascii", "backslashreplace"))
