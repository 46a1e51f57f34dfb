"""The statements of the Oriel Cornerstone 260 monochromator: lines of ASCII over RS232.

Source: Newport/Oriel, "Cornerstone 260 monochromator" user's manual (MCS260): syntax, echo and handshake mode (p. 49 to
51), error codes (p. 58). Each fact with its proof is in docs/rig/interoperability.md. To be confirmed on hardware: the
statement BANDPASS, the decimals of wavelengths in um and 1/cm.
"""

import math
import re
from dataclasses import dataclass
from enum import Enum, IntEnum

TO_DEVICE = b"\n"
FROM_DEVICE = b"\r\n"
NO_ERROR = 0x00
ERROR_SINCE_LAST_READ = 0x20
STATUS_TEXTS = {b"00": NO_ERROR, b"0": NO_ERROR, b"20": ERROR_SINCE_LAST_READ, b"32": ERROR_SINCE_LAST_READ}
"""The status byte as units send it: bit 5 in hexadecimal (p. 58), or in decimal; without an error one digit or two."""
MAX_LINE = 256
MAX_LABEL = 8

LINE_ENDED = b"\r"
"""What `take_lines` leaves pending after a line that a CR has ended."""
_TERMINATOR = re.compile(rb"\r\n|\r|\n")
_NUMBER = re.compile(rb"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d{1,3})?")


class ErrorCode(IntEnum):
    """What `ERROR?` answers. 0 is a system error in the manual of the 260 (p. 58), and no error in that of the 260B (p. 62)."""

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
        """The manuals' meaning."""
        if self is ErrorCode.NONE:
            return "none, or a system error"
        return self.name.replace("_", " ").lower()


class WavelengthUnit(Enum):
    """Unit of wavelengths: nm, um or 1/cm, with the decimals that the device writes."""

    NM = 3
    UM = 6
    WN = 2

    def to_nm(self, value: float) -> float:
        """In nm; infinity for a wavenumber of 0."""
        if self is WavelengthUnit.WN:
            return 1e7 / value if value else math.inf
        return value * 1e3 if self is WavelengthUnit.UM else value

    def encode(self, wavelength_nm: float) -> str:
        """As the device writes it; 0 where a wavelength of 0 has no wavenumber."""
        value = wavelength_nm
        if self is WavelengthUnit.WN:
            value = 1e7 / wavelength_nm if wavelength_nm else 0.0
        elif self is WavelengthUnit.UM:
            value = wavelength_nm * 1e-3
        return f"{value:.{self.value}f}"


class StatementError(ValueError):
    """A line that is no statement, or an answer that is none."""


def take_lines(pending: bytes, data: bytes) -> tuple[list[bytes], bytes]:
    """The lines that `data` completes after `pending`, without their ends, and what is left pending.

    CR, LF and CR LF end a line: an echo has the end that was sent, a reply CR LF. A CR at the end is left pending although its
    line is complete: an LF that follows belongs to it. Of an endless line the first MAX_LINE + 1 bytes are kept, one too many
    for `decode`. The lines are the same however the bytes are split.
    """
    if not data:
        return [], pending
    received = data.removeprefix(b"\n") if pending == LINE_ENDED else pending + data
    *whole, rest = _TERMINATOR.split(received)
    left = LINE_ENDED if received.endswith(LINE_ENDED) else rest[: MAX_LINE + 1]
    return [line[: MAX_LINE + 1] for line in whole], left


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
        if len(line) > MAX_LINE:
            raise StatementError(f"a line of more than {MAX_LINE} characters")
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

    def echoed_by(self, line: bytes) -> bool:
        """Whether a line is this statement's echo."""
        return line.strip().upper() == str(self).encode("ascii").upper()


def encode_status(status: int, digits: int = 2, *, decimal: bool = False) -> str:
    """The status byte as `STB?` and handshake mode answer it, with so many digits at least."""
    return f"{status:0{digits}{'d' if decimal else 'X'}}"


def decode_status(line: bytes) -> int:
    """NO_ERROR or ERROR_SINCE_LAST_READ: a status byte with any other bit is taken for a fault. Raises StatementError."""
    try:
        return STATUS_TEXTS[line.strip()]
    except KeyError:
        raise StatementError(f"no status byte: {line!r}") from None


def encode_nm(wavelength_nm: float) -> str:
    """A wavelength as the device writes it, three decimals."""
    return f"{wavelength_nm:.3f}"


def decode_number(line: bytes) -> float:
    """A finite number from an answer's line, digits and nothing else. Raises StatementError."""
    text = line.strip()
    if not _NUMBER.fullmatch(text):
        raise StatementError(f"no number: {line!r}")
    value = float(text)
    if not math.isfinite(value):
        raise StatementError(f"no number: {line!r}")
    return value


@dataclass(frozen=True, slots=True)
class Grating:
    """What `GRAT?` answers: number, lines per mm, label."""

    number: int
    lines_per_mm: int
    label: str

    def encode(self) -> str:
        """Such as `1,1200,VIS`."""
        return f"{self.number},{self.lines_per_mm},{self.label}"

    @classmethod
    def decode(cls, line: bytes) -> "Grating":
        """Raises StatementError."""
        match = re.fullmatch(rb"\s*(\d)\s*,\s*(\d{1,5})\s*,\s*([ -~]{0,%d}?)\s*" % MAX_LABEL, line)
        if match is None:
            raise StatementError(f"no grating: {line!r}")
        return cls(int(match[1]), int(match[2]), match[3].decode("ascii"))
