"""The tap on the drivers' side of every wire: each byte that passes, with its time, in a form that a person can read."""

from collections.abc import Callable
from pathlib import Path
from typing import Protocol, TextIO

from protocols.clock import Clock

TO_DEVICE, FROM_DEVICE = ">", "<"
Explain = Callable[[str, bytes], str]


class Tap(Protocol):
    """What a driver calls with each piece of bytes that it sends or gets."""

    def __call__(self, direction: str, data: bytes) -> None: ...


def no_tap(direction: str, data: bytes) -> None:
    """Nobody listens."""


class Transcript:
    """A folder with one text file a device.

    A line is: time in seconds, `>` to the device or `<` from it, the bytes in hexadecimal, what they mean.
    """

    def __init__(self, folder: Path, clock: Clock) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._clock = clock
        self._files: dict[str, TextIO] = {}

    def tap(self, device: str, explain: Explain) -> Tap:
        """The tap of one device; `explain` puts bytes into words (an empty string where it cannot)."""
        file = (self._folder / f"{device}.txt").open("w", encoding="utf-8", newline="\n")
        file.write("# time s | > to the device, < from it | bytes | meaning\n")
        self._files[device] = file

        def write(direction: str, data: bytes) -> None:
            if data and not file.closed:
                file.write(f"{self._clock.now():14.6f} {direction} {data.hex(' ')}  | {explain(direction, data)}\n")

        return write

    def close(self) -> None:
        """Ends all files."""
        for file in self._files.values():
            file.close()


def as_text(direction: str, data: bytes) -> str:
    """For wires that carry ASCII."""
    del direction
    return ascii(data.decode("ascii", "backslashreplace"))
