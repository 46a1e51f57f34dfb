"""Text files: read whole, whatever wrote them, and written so that nobody ever finds half of one.

Comments made safe for a file: lines without line ends or control characters, in ASCII where the format is ASCII.
"""

import codecs
import re
import unicodedata
from collections.abc import Iterable

from goniotwin.app.formats.errors import FormatError, StrPath
from goniotwin.app.formats.whole_file import read_whole, write_whole

# C0 control characters other than tab, line ends, vertical tab, form feed and DOS's end-of-file mark.
CONTROL = re.compile("[\x00-\x08\x0e-\x19\x1b-\x1f]")
LINE_END = re.compile(r"\r\n|\r|\n")
UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def read_text(path: StrPath) -> str:
    """The text of a file (UTF-8, or the 8-bit alphabet of older programs), line ends as they are.

    Raises FormatError if the file is absent, not a regular file, unreadable, empty or not text.
    """
    content = read_whole(path)
    if content.startswith(UTF16_MARKS):
        raise FormatError(path, "is UTF-16 text", "save it as plain text (ASCII or UTF-8)")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    if found := CONTROL.search(text):
        line = 1 + len(LINE_END.findall(text, 0, found.start()))
        raise FormatError(path, "holds binary data, not text", "name a text file of this format", line)
    if not text.strip():
        raise FormatError(path, "is empty", "export or copy it again")
    return text


def write_text(path: StrPath, text: str | Iterable[str]) -> None:
    """Write a file as a whole, as `write_whole` does, at once or in parts. Raises FormatError if that is impossible."""
    write_whole(path, _encoded(path, text) if isinstance(text, str) else (_encoded(path, part) for part in text))


def _encoded(path: StrPath, text: str) -> bytes:
    try:
        return text.encode("utf-8")
    except UnicodeEncodeError as error:
        raise FormatError(path, "the text holds broken characters", "correct names and comments") from error


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
