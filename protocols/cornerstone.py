"""The statements of the Oriel Cornerstone 260 monochromator: lines of ASCII over RS232.

Source: Newport/Oriel, "Cornerstone 260 monochromator" user's manual (MCS260): syntax, echo and handshake mode, error
codes. To be confirmed on hardware: the spelling of UNITS and what the classic 260 answers to statements of the 260B.
"""

from dataclasses import dataclass
from enum import IntEnum

TO_DEVICE = b"\n"
FROM_DEVICE = b"\r\n"
NO_ERROR = 0x00
ERROR_SINCE_LAST_READ = 0x20
MAX_LINE = 256


class Error(IntEnum):
    """What `ERROR?` answers."""

    NONE = 0
    NOT_UNDERSTOOD = 1
    BAD_PARAMETER = 2
    DESTINATION_NOT_ALLOWED = 3
    ACCESSORY_NOT_PRESENT = 6
    ACCESSORY_ALREADY_THERE = 7
    CANNOT_HOME = 8
    LABEL_TOO_LONG = 9
    SYSTEM = 10

    def in_words(self) -> str:
        """The manual's meaning."""
        return self.name.replace("_", " ").lower()


class StatementError(ValueError):
    """A line that is no statement, or an answer that is none."""


@dataclass(frozen=True, slots=True)
class Statement:
    """A command or a query: the word in capitals without `?`, and what stands behind it."""

    word: str
    query: bool = False
    parameter: str = ""

    def encode(self) -> bytes:
        """The line with its terminator."""
        mark = "?" if self.query else ""
        parameter = f" {self.parameter}" if self.parameter else ""
        return f"{self.word}{mark}{parameter}".encode("ascii") + TO_DEVICE

    @classmethod
    def decode(cls, line: bytes) -> "Statement":
        """A statement from a line with or without its terminator. Raises StatementError."""
        try:
            text = line.decode("ascii").strip()
        except UnicodeDecodeError:
            raise StatementError(f"not ASCII: {line!r}") from None
        word, _, parameter = text.partition(" ")
        if not word:
            raise StatementError("an empty line")
        query = word.endswith("?")
        return cls(word.removesuffix("?").upper(), query, parameter.strip())

    def __str__(self) -> str:
        return self.encode().decode("ascii").strip()


def encode_status(status: int) -> bytes:
    """The status byte as handshake mode sends it: two hexadecimal digits."""
    return f"{status:02X}".encode("ascii") + FROM_DEVICE


def decode_status(line: bytes) -> int:
    """The status byte from its line. Raises StatementError."""
    text = line.strip()
    if len(text) != 2:
        raise StatementError(f"no status byte: {line!r}")
    try:
        return int(text, 16)
    except ValueError:
        raise StatementError(f"no status byte: {line!r}") from None


def encode_nm(wavelength_nm: float) -> str:
    """A wavelength as the device writes it, three decimals."""
    return f"{wavelength_nm:.3f}"


def decode_number(line: bytes) -> float:
    """A number from an answer's line. Raises StatementError."""
    try:
        return float(line.decode("ascii").strip())
    except (UnicodeDecodeError, ValueError):
        raise StatementError(f"no number: {line!r}") from None
