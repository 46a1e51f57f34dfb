"""Comments made safe for a file: lines without line ends or control characters, in ASCII where the format is ASCII."""

import unicodedata
from collections.abc import Iterable

from goniotwin.app.formats.textfile import LINE_END

# What a laboratory writes outside ASCII, and how it is written inside.
SPELLED = str.maketrans(
    {
        "°": " deg", "µ": "u", "μ": "u", "α": "alpha", "β": "beta", "γ": "gamma", "θ": "theta", "λ": "lambda",
        "π": "pi", "σ": "sigma", "φ": "phi", "ψ": "psi", "Ω": "Ohm", "±": "+/-", "·": "*", "×": "x", "−": "-",
        "–": "-", "—": "-", "‘": "'", "’": "'", "“": '"', "”": '"', "ß": "ss",
    }
)  # fmt: skip


def comment_lines(comments: Iterable[str], *, ascii_only: bool) -> tuple[str, ...]:
    """One safe line for each line of each comment; what cannot be written becomes '?'."""
    lines = (line for comment in comments for line in LINE_END.split(comment))
    return tuple(_safe(line, ascii_only=ascii_only) for line in lines)


def _safe(line: str, *, ascii_only: bool) -> str:
    line = "".join(letter if letter.isprintable() else " " if letter.isspace() else "?" for letter in line)
    if ascii_only and not line.isascii():
        spelled = unicodedata.normalize("NFKD", line.translate(SPELLED))
        line = "".join(letter for letter in spelled if not unicodedata.combining(letter))
        line = line.encode("ascii", "replace").decode("ascii")
    return line.rstrip()


def marked(lines: Iterable[str], mark: str) -> list[str]:
    """The lines as they stand in a file behind the format's comment mark."""
    return [f"{mark} {line}".rstrip() for line in lines]
