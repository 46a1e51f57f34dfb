"""Text files: characters and line ends, comments, and the words that the table formats consist of.

Words are separated by any white space; a line break is white space too. A word that begins with the format's comment mark
begins a comment, which ends with the line.
"""

import codecs
import itertools
import math
import re
import unicodedata
from array import array
from collections.abc import Collection, Iterable

import numpy as np

from goniotwin.app.errors import printable
from goniotwin.app.formats.file import FormatError, StrPath, quote_word, read_file, write_file
from goniotwin.app.formats.numerals import COUNT, MISSING, NUMBER, NotANumber, parse_number
from goniotwin.arrays import Floats

# C0 control characters other than tab, line ends, vertical tab, form feed and DOS's end-of-file mark.
CONTROL_CHARACTER = re.compile("[\x00-\x08\x0e-\x19\x1b-\x1f]")
LINE_END = re.compile(r"\r\n|\r|\n")
MOST_BYTES = 50_000_000
"""Bytes of a text."""
MOST_COMMENTS = 500_000
"""Lines of comments of a table, which stay in memory."""
HEADER_WORDS = 5000
"""The keywords of a table are among so many words: a list of angles can be long."""
OTHER_CHARACTER = {missing: re.compile(rf"[^0-9eE+\-.\s{'nNaA' * missing}]") for missing in (False, True)}
"""What no number has, and neither has "nan" where values may be missing: of a keyword, a comment, another spelling."""
PIECE = 1_000_000
"""Characters of a long list of numbers that are parsed at a time, to bound memory."""
UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def read_text(path: StrPath, most: int = MOST_BYTES) -> str:
    """The text of a file in UTF-8 or, if it is not UTF-8, in Latin-1 (older programs), without DOS's mark of the end.

    Line ends are not changed. Raises FormatError if the file is absent, not a regular file, unreadable, empty, not text, or of
    more bytes than `most`.
    """
    content = read_file(path, most)
    if content.startswith(UTF16_MARKS):
        raise FormatError(path, "is UTF-16 text", "save it as plain text (ASCII or UTF-8)")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    if found := CONTROL_CHARACTER.search(text):
        line = 1 + len(LINE_END.findall(text, 0, found.start()))
        raise FormatError(path, "contains binary data, not text", "give a text file of this format", line)
    text = text.rstrip("\x1a")
    if not text.strip():
        raise FormatError(path, "is empty", "export or copy it again")
    return text


def write_text(path: StrPath, text: str | Iterable[str]) -> None:
    """Write a text in UTF-8 atomically, as `write_file` does, in one piece or in parts. Raises FormatError."""
    write_file(path, encode_text(path, text) if isinstance(text, str) else (encode_text(path, part) for part in text))


def encode_text(path: StrPath, text: str) -> bytes:
    """A text in UTF-8. Raises FormatError."""
    try:
        return text.encode("utf-8")
    except UnicodeEncodeError as error:
        raise FormatError(path, "the text contains broken characters", "correct names and comments") from error


# Characters of laboratory notes that are not ASCII, and their spelling in ASCII.
ASCII_SPELLING = str.maketrans(
    {
        "°": " deg",
        "µ": "u",
        "μ": "u",
        "α": "alpha",
        "β": "beta",
        "γ": "gamma",
        "θ": "theta",
        "λ": "lambda",
        "π": "pi",
        "σ": "sigma",
        "φ": "phi",
        "ψ": "psi",
        "Ω": "Ohm",
        "±": "+/-",
        "·": "*",
        "×": "x",
        "−": "-",
        "–": "-",
        "—": "-",
        "‘": "'",
        "’": "'",
        "“": '"',
        "”": '"',
        "ß": "ss",
    }
)


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
    """The first `HEADER_WORDS` words, in lower case, of a text that begins with `head`, up to a word in `stop`; no comments.

    None of a text that begins with the comment of another format: its comments may have any words.
    """
    if mark != "#" and head.lstrip().startswith(b"#"):
        return set()
    words = (
        word
        for line in head.decode("latin-1").splitlines()
        for word in itertools.takewhile(lambda word: not word.startswith(mark), line.lower().split())
    )
    return set(itertools.islice(itertools.takewhile(lambda word: word not in stop, words), HEADER_WORDS))


class Words:
    """The words of a file, taken one after another. Every method raises FormatError with the line."""

    def __init__(self, path: StrPath, comment_mark: str, most_comments: int = MOST_COMMENTS) -> None:
        self.path = path
        self._most_comments = most_comments
        self.line: int | None = None
        """The line of the word taken last."""
        self.top_comments: list[str] = []
        self.comments: list[str] = []
        """All comments, including those at the top."""
        text = read_text(path)
        self._text = text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text
        self._mark = comment_mark
        self._pattern = re.compile(rf"(?P<mark>{re.escape(comment_mark)})[^\n]*|\S+")
        self._parts = self._pattern.finditer(self._text)
        self._end = 0
        """Where in the text the word that comes next ends."""
        self._next: str | None = None
        self._next_line = 1
        self._load()

    def _load(self) -> None:
        """Find the next word, and the comments before it. Only one word is in memory: a file can have many millions."""
        self._next = None
        for part in self._parts:
            self._next_line += self._text.count("\n", self._end, part.start())
            self._end = part.end()
            if part.lastgroup is None:
                self._next = part[0]
                return
            comment = part[0].removeprefix(part["mark"]).removeprefix(" ").rstrip()
            self.comments.append(comment)
            if self.line is None:
                self.top_comments.append(comment)
            if len(self.comments) > self._most_comments:
                wrong = f"has more than {self._most_comments} lines of comments"
                raise FormatError(self.path, wrong, "remove some", self._next_line)

    def error(self, wrong: str, remedy: str, line: int | None = None) -> FormatError:
        """A FormatError at the word taken last, or at `line`."""
        return FormatError(self.path, wrong, remedy, line or self.line)

    def peek(self) -> str | None:
        """The next word, in lower case, without taking it; None at the end."""
        return None if self._next is None else self._next.lower()

    def take(self, wanted: str) -> str:
        """Take the next word; `wanted` is the name of what is expected, for the message at the end of the file."""
        if self._next is None:
            raise self.error(f"the file ends before {wanted}", "it is cut short: copy it again")
        word, self.line = self._next, self._next_line
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
        while self._next is not None and self._next_line == self.line:
            words.append(self.take(wanted))
        return " ".join(words)

    def one_of(self, name: str, known: Collection[str]) -> str:
        """Take the value of a keyword, one of these; upper and lower case are equal."""
        word = self.take(f"the value of {name}")
        spelled = {each.lower(): each for each in known}.get(word.lower())
        if spelled is None:
            raise self.error(f"{name} {quote_word(word)} is not known", f"write {' or '.join(known)}")
        return spelled

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

    def block(self, name: str, rows: int, per_row: int, ends: Collection[str], *, missing: bool = False) -> Floats:
        """Take numbers (rows, per_row) up to one of the words in `ends` (lower case), which is not taken.

        A number may be spelled as nan where values may be `missing`.
        """
        plain = self._plain_numbers(rows * per_row, ends, missing)
        if plain is not None:
            return plain.reshape(rows, per_row)
        numbers = array("d")
        count, line, in_line, odd, surplus = 0, self._next_line, 0, None, None
        while (word := self.peek()) is not None and word not in ends:
            if self._next_line != line:
                odd = odd or (line if in_line != per_row else None)
                line, in_line = self._next_line, 0
            number = self._missing() if missing and MISSING.fullmatch(word) else self.number(name)
            count, in_line = count + 1, in_line + 1
            if count <= rows * per_row:
                numbers.append(number)
            else:
                surplus = surplus or line
        if count != rows * per_row:
            odd = odd or (line if in_line not in (0, per_row) else surplus) or self.line
            size = "few" if count < rows * per_row else "many"
            wrong = f"{name} has too {size} numbers: {count}, not {rows} rows of {per_row}"
            raise self.error(wrong, "correct this line, or the counts at the top", odd)
        return np.array(numbers).reshape(rows, per_row)

    def _missing(self) -> float:
        self.take("a value")
        return math.nan

    def _plain_numbers(self, count: int, ends: Collection[str], missing: bool) -> Floats | None:
        """Take `count` numbers in large pieces, with the comments between them, up to a word in `ends`.

        None, with nothing taken, where anything else is among them: word by word, the fault gets its line.
        """
        text, pattern = self._text, OTHER_CHARACTER[missing]
        place = self.line, self._next, self._next_line, self._end
        comments, top = len(self.comments), len(self.top_comments)
        if self._next is None or 2 * count > len(text) - self._end + len(self._next) + 1:
            return None
        values, done = np.empty(count), 0
        while (word := self.peek()) is not None and word not in ends:
            start = self._end - len(self._next)
            stop = start + min(PIECE, 100 + 30 * (count - done))
            other = pattern.search(text, start, stop)
            if other is not None or stop < len(text):  # back to the start of a word
                stop = min(stop, len(text)) if other is None else other.start()
                while stop > start and not text[stop - 1].isspace():
                    stop -= 1
            piece = text[start:stop].rstrip()
            words = piece.split()
            try:
                numbers = np.array(list(map(float, words)))
            except ValueError:
                break
            if not words or done + len(words) > count or np.isinf(numbers).any():
                break
            values[done : done + len(words)] = numbers
            done += len(words)
            self.line, self._end = self._next_line + piece.count("\n"), start + len(piece)
            self._next_line = self.line
            self._parts = self._pattern.finditer(text, self._end)
            self._load()
        else:
            if done == count:
                return values
        self.line, self._next, self._next_line, self._end = place
        del self.comments[comments:], self.top_comments[top:]
        self._parts = self._pattern.finditer(text, self._end)
        return None
