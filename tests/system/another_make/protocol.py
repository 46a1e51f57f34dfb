"""The command language of a motion controller in the manner of Newport's ESP301: ASCII, axis number before the mnemonic.

A request is one or several commands, joined by `;` and ended by CR. A query ends in `?` or is TP; each gives one line, ended by
CR LF, and another command gives none. `TE?` takes the oldest error code, 0 for none. Volatile settings, such as the jog speed
`JW`, have their default values again after a power-up.
"""

from dataclasses import dataclass

REQUEST_END, REPLY_END = b"\r", b"\r\n"
JOIN = ";"
NO_ERROR, UNKNOWN_COMMAND, NO_SUCH_AXIS, BAD_VALUE, NOT_WHILE_MOVING = 0, 6, 9, 7, 20
JOG_AT_POWER_UP = 1.0
DECIMALS = 4
"""Positions in degrees have so many decimals."""


@dataclass(frozen=True)
class EspCommand:
    """A command: axis number (0: none), mnemonic, value, and whether it asks for a value."""

    axis: int
    mnemonic: str
    value: float | None = None
    query: bool = False

    def __str__(self) -> str:
        value = "" if self.value is None else f"{self.value:.{DECIMALS}f}"
        return f"{self.axis or ''}{self.mnemonic}{value}{'?' if self.query else ''}"

    @property
    def has_reply(self) -> bool:
        """Whether a line comes back."""
        return self.query or self.mnemonic == "TP"


def parse(text: str) -> EspCommand:
    """The command of a text. Raises ValueError."""
    digits = len(text) - len(text.lstrip("0123456789"))
    mnemonic, rest = text[digits : digits + 2].upper(), text[digits + 2 :]
    if len(mnemonic) < 2 or not mnemonic.isalpha():
        raise ValueError(f"no mnemonic in {text!r}")
    query = rest.endswith("?")
    number = rest.removesuffix("?")
    return EspCommand(int(text[:digits] or 0), mnemonic, float(number) if number else None, query)


def encode(*commands: EspCommand) -> bytes:
    """The bytes of a request."""
    return JOIN.join(map(str, commands)).encode("ascii") + REQUEST_END
