"""Text files: characters and line ends, comments, and the words that the table formats consist of.

Words are separated by any white space; a line break is white space too. A word that begins with the format's comment mark
begins a comment, which ends with the line.
"""

import codecs
import itertools
import re
import unicodedata
from array import array
from collections import Counter, deque
from collections.abc import Collection, Iterable

import numpy as np

from goniotwin.app.errors import printable
from goniotwin.app.formats.file import FormatError, StrPath, quote_word, read_file, write_file
from goniotwin.app.formats.numerals import COUNT, NUMBER, NotANumber, parse_number
from goniotwin.arrays import Floats

# C0 control characters other than tab, line ends, vertical tab, form feed and DOS's end-of-file mark.
CONTROL_CHARACTER = re.compile("[\x00-\x08\x0e-\x19\x1b-\x1f]")
LINE_END = re.compile(r"\r\n|\r|\n")
MOST_BYTES = 50_000_000
"""Bytes of a text, which needs some ten times as much memory."""
HEADER_WORDS = 5000
"""The keywords of a table are among so many words: a list of angles can be long."""
UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def read_text(path: StrPath) -> str:
    """The text of a file in UTF-8 or, if it is not UTF-8, in Latin-1 (older programs); line ends are not changed.

    Raises FormatError if the file is absent, not a regular file, unreadable, empty or not text.
    """
    content = read_file(path, MOST_BYTES)
    if content.startswith(UTF16_MARKS):
        raise FormatError(path, "is UTF-16 text", "save it as plain text (ASCII or UTF-8)")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    if found := CONTROL_CHARACTER.search(text):
        line = 1 + len(LINE_END.findall(text, 0, found.start()))
        raise FormatError(path, "contains binary data, not text", "give a text file of this format", line)
    if not text.strip():
        raise FormatError(path, "is empty", "export or copy it again")
    return text


def write_text(path: StrPath, text: str | Iterable[str]) -> None:
    """Write a text in UTF-8 atomically, as `write_file` does, in one piece or in parts. Raises FormatError."""
    write_file(path, _encoded(path, text) if isinstance(text, str) else (_encoded(path, part) for part in text))


def _encoded(path: StrPath, text: str) -> bytes:
    try:
        return text.encode("utf-8")
    except UnicodeEncodeError as error:
        raise FormatError(path, "the text contains broken characters", "correct names and comments") from error


# Characters of laboratory notes that are not ASCII, and their spelling in ASCII.
ASCII_SPELLING = str.maketrans(
    {
        "°": " deg", "µ": "u", "μ": "u", "α": "alpha", "β": "beta", "γ": "gamma", "θ": "theta", "λ": "lambda",
        "π": "pi", "σ": "sigma", "φ": "phi", "ψ": "psi", "Ω": "Ohm", "±": "+/-", "·": "*", "×": "x", "−": "-",
        "–": "-", "—": "-", "‘": "'", "’": "'", "“": '"', "”": '"', "ß": "ss",
    }
)  # fmt: skip


def comment_lines(comments: Iterable[str], *, ascii_only: bool) -> tuple[str, ...]:
    """The lines of comments, without line ends and control characters; a character that cannot be written becomes '?'.

    With `ascii_only` common symbols are spelled in ASCII.
    """
    lines = (line for comment in comments for line in LINE_END.split(comment))
    return tuple(_safe(line, ascii_only=ascii_only) for line in lines)


def _safe(line: str, *, ascii_only: bool) -> str:
    line = printable(line)
    if ascii_only and not line.isascii():
        spelled = unicodedata.normalize("NFKD", line.translate(ASCII_SPELLING))
        line = "".join(letter for letter in spelled if not unicodedata.combining(letter))
        line = line.encode("ascii", "replace").decode("ascii")
    return line.rstrip()


def mark_comments(lines: Iterable[str], mark: str) -> list[str]:
    """The lines with the format's comment mark in front of each."""
    return [f"{mark} {line}".rstrip() for line in lines]


def header_words(head: bytes, mark: str, stop: Collection[str] = ()) -> set[str]:
    """The first `HEADER_WORDS` words, in lower case, of a text that begins with `head`, up to a word in `stop`; no comments."""
    words = (
        word
        for line in head.decode("latin-1").splitlines()
        for word in itertools.takewhile(lambda word: not word.startswith(mark), line.lower().split())
    )
    return set(itertools.islice(itertools.takewhile(lambda word: word not in stop, words), HEADER_WORDS))


class Words:
    """The words of a file, taken one after another. Every method raises FormatError with the line."""

    def __init__(self, path: StrPath, comment_mark: str) -> None:
        self.path = path
        self.line: int | None = None
        """The line of the word taken last."""
        self.top_comments: list[str] = []
        self.comments: list[str] = []
        """All comments, including those at the top."""
        self._mark = re.compile(r"(?:^|(?<=\s))" + re.escape(comment_mark))
        self._lines: deque[tuple[int, str]] = deque()
        self._words: deque[str] = deque()
        self._words_line = 0
        for number, line in enumerate(LINE_END.split(read_text(path)), 1):
            self._sort_line(number, line)
        self._last_line = self._lines[-1][0] if self._lines else None
        self._load()

    def _sort_line(self, number: int, line: str) -> None:
        if mark := self._mark.search(line):
            comment = line[mark.end() :].removeprefix(" ").rstrip()
            line = line[: mark.start()]
            self.comments.append(comment)
            if not self._lines and not line.strip():
                self.top_comments.append(comment)
        if line.strip():
            self._lines.append((number, line))

    def _load(self) -> None:
        if not self._words and self._lines:
            self._words_line, line = self._lines.popleft()
            self._words.extend(line.split())

    def error(self, wrong: str, remedy: str, line: int | None = None) -> FormatError:
        """A FormatError at the word taken last, or at `line`."""
        return FormatError(self.path, wrong, remedy, line or self.line)

    def peek(self) -> str | None:
        """The next word, in lower case, without taking it; None at the end."""
        return self._words[0].lower() if self._words else None

    def take(self, wanted: str) -> str:
        """Take the next word; `wanted` is the name of what is expected, for the message at the end of the file."""
        if not self._words:
            raise self.error(f"the file ends before {wanted}", "it is cut short: copy it again", self._last_line)
        self.line = self._words_line
        word = self._words.popleft()
        self._load()
        return word

    def expect(self, keyword: str) -> None:
        """Take this keyword; upper and lower case are equal."""
        word = self.take(keyword)
        if word.lower() != keyword.lower():
            raise self.error(f"expected {keyword}, found {quote_word(word)}", "correct the file")

    def take_line(self, wanted: str) -> str:
        """Take the next word and the words that follow it in its line."""
        words = [self.take(wanted)]
        while self._words and self._words_line == self.line:
            words.append(self.take(wanted))
        return " ".join(words)

    def count(self, of: str) -> int:
        """Take a whole number above 0."""
        word = self.take(f"the number of {of}")
        if not COUNT.fullmatch(word) or int(word) == 0:
            raise self.error(f"{quote_word(word)} is not a possible number of {of}", "write a whole number above 0")
        return int(word)

    def number(self, of: str) -> float:
        """Take a finite number."""
        word = self.take(of)
        try:
            return parse_number(word)
        except NotANumber as error:
            raise self.error(f"{of}: {error.wrong}", error.remedy) from None

    def angles(self, name: str, high: float, low: float = 0.0) -> Floats:
        """Take a count and that many angles (n,), deg, which must ascend within low..high."""
        count = self.count(f"{name} angles")
        start = self.line
        angles = array("d")
        for taken in range(count):
            word = self.peek()
            if word is None or (word[0].isalpha() and word not in ("nan", "inf", "infinity")):
                wrong = f"{name}: the count is {count}, but the list has {taken} angles"
                raise self.error(wrong, "correct the count or the list", start)
            angle = self.number(name)
            if not low <= angle <= high:
                raise self.error(f"{name} {angle:g} is outside {low:g} to {high:g} deg", "correct the list")
            if angles and not angle > angles[-1]:
                raise self.error(f"{name} {angle:g} follows {angles[-1]:g}: the list does not ascend", "sort the list")
            angles.append(angle)
        if (after := self.peek()) is not None and NUMBER.fullmatch(after):
            wrong = f"{name}: the count is {count}, but the list is longer"
            raise self.error(wrong, "correct the count or the list", start)
        return np.array(angles)

    def block(self, name: str, rows: int, per_row: int, ends: Collection[str]) -> Floats:
        """Take numbers (rows, per_row) up to one of the words in `ends` (lower case), which is not taken."""
        numbers = array("d")
        in_line: Counter[int | None] = Counter()
        surplus = None
        while (word := self.peek()) is not None and word not in ends:
            numbers.append(self.number(name))
            in_line[self.line] += 1
            if len(numbers) == rows * per_row + 1:
                surplus = self.line
        if len(numbers) != rows * per_row:
            odd = next((line for line, count in in_line.items() if count != per_row), surplus or self.line)
            size = "few" if len(numbers) < rows * per_row else "many"
            wrong = f"{name} has too {size} numbers: {len(numbers)}, not {rows} rows of {per_row}"
            raise self.error(wrong, "correct this line, or the counts at the top", odd)
        return np.array(numbers).reshape(rows, per_row)
