"""SCPI: headers with short and long forms and optional nodes, parameters, and the numbers of answers.

Source: SCPI-99 volume 1, chapters 5 to 7; IEEE 488.2 chapter 7.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

OVERRANGE = 9.9e37
NOT_A_NUMBER = 9.91e37
MAX_MESSAGE = 4096
LONGEST_MNEMONIC = 12
MESSAGES_KEPT = 256

_NUMBER = re.compile(r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:\s*[eE]\s*[+-]?\d{1,5})?")
_NODE = re.compile(r"[A-Z][A-Z0-9_]*")
_BLANK = re.compile(r"[\x00-\x20]+")
_PREFIXES = {"": 1.0, "M": 1e-3, "U": 1e-6, "N": 1e-9, "P": 1e-12, "K": 1e3}


class ScpiError(ValueError):
    """A fault with its SCPI number."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(f'{code},"{text}"')
        self.code = code
        self.text = text


@dataclass(frozen=True, slots=True)
class MessageUnit:
    """One program message unit: the header in capitals from the root, query or not, its parameters."""

    header: tuple[str, ...]
    query: bool
    parameters: tuple[str, ...]


def parse(message: bytes) -> list[MessageUnit]:
    """The units of a message, in order. Raises ScpiError as `units` does."""
    return list(units(message))


def units(message: bytes) -> Iterator[MessageUnit]:
    """The units of a message one by one; `;` joins on the level of the unit before, `;:` at the root.

    Raises ScpiError where the message goes wrong, after the units before that: -101 for characters that are not ASCII,
    -102 for a header that is none, -103 for a separator too many, -112 for a mnemonic of more than twelve characters.
    """
    known, error = parsed(message)
    yield from known
    if error is not None:
        raise ScpiError(*error)


@lru_cache(maxsize=MESSAGES_KEPT)
def parsed(message: bytes) -> tuple[tuple[MessageUnit, ...], tuple[int, str] | None]:
    """The units of a message, in order, and number and text of the error after them: the same is asked again and again."""
    found: list[MessageUnit] = []
    try:
        for each in _units(message):
            found.append(each)
    except ScpiError as error:
        return tuple(found), (error.code, error.text)
    return tuple(found), None


def _units(message: bytes) -> Iterator[MessageUnit]:
    try:
        text = message.decode("ascii")
    except UnicodeDecodeError:
        raise ScpiError(-101, "Invalid character") from None
    path: tuple[str, ...] = ()
    for part in _outside_quotes(text, ";"):
        piece = part.strip("".join(map(chr, range(33))))
        if not piece:
            continue
        words, *rest = _BLANK.split(piece, maxsplit=1)
        tail = rest[0] if rest else ""
        parameters = tuple(each.strip() for each in _outside_quotes(tail, ",")) if tail else ()
        if parameters and not all(parameters):
            raise ScpiError(-103, "Invalid separator")
        query = words.endswith("?")
        words = words.removesuffix("?").upper()
        if words.startswith("*"):
            if not _NODE.fullmatch(words[1:]):
                raise ScpiError(-102, f"Syntax error: {_printable(words)}")
            yield MessageUnit((words,), query, parameters)
            continue
        if words.startswith(":"):
            path, words = (), words[1:]
        nodes = tuple(words.split(":"))
        if not all(_NODE.fullmatch(node) for node in nodes):
            raise ScpiError(-102, f"Syntax error: {_printable(words)}")
        if any(len(node.rstrip("0123456789")) > LONGEST_MNEMONIC for node in nodes):
            raise ScpiError(-112, "Program mnemonic too long")
        header = path + nodes
        path = header[:-1]
        yield MessageUnit(header, query, parameters)


def _outside_quotes(text: str, separator: str) -> list[str]:
    """Split at a separator, but not within a string in single or double quotes. Raises ScpiError -151."""
    if '"' not in text and "'" not in text:
        return text.split(separator)
    pieces, begin, quote = [], 0, ""
    for index, character in enumerate(text):
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        elif character == separator:
            pieces.append(text[begin:index])
            begin = index + 1
    if quote:
        raise ScpiError(-151, "Invalid string data")
    return [*pieces, text[begin:]]


def _printable(text: str) -> str:
    """For an error's text: nothing in it ends a line or a string."""
    return "".join(each if " " < each <= "~" and each != '"' else "?" for each in text[:40])


@lru_cache(maxsize=1024)
def spellings(pattern: str) -> frozenset[tuple[str, ...]]:
    """All spellings of a header such as `[SENSe]:CURRent[:DC]:RANGe[:UPPer]`: short and long, optional nodes or not."""
    nodes: list[list[tuple[str, ...]]] = []
    for optional, plain in re.findall(r"\[:?([*A-Za-z0-9]+):?\]|([*A-Za-z0-9]+)", pattern):
        word = optional or plain
        short = "".join(each for each in word if not each.islower())
        forms: list[tuple[str, ...]] = [(short,), (word.upper(),)]
        nodes.append([*forms, ()] if optional else forms)
    return frozenset(tuple(word for form in chosen for word in form) for chosen in product(*nodes))


@lru_cache(maxsize=256)
def words(pattern: str) -> tuple[str, str]:
    """Short and long form of one word, such as `MINimum`."""
    return "".join(each for each in pattern if not each.islower()), pattern.upper()


def suffixes(unit: str) -> dict[str, float]:
    """What a number in a unit may be followed by: `A` gives A, MA (milli), UA, NA, PA, KA."""
    return {prefix + unit: factor for prefix, factor in _PREFIXES.items()}


def decode_quantity(text: str, factors: Mapping[str, float]) -> float:
    """A parameter's number with one of the suffixes, or with none.

    Raises ScpiError: -104 for what is no number, -131 for another suffix, -138 where none is allowed.
    """
    match = _NUMBER.match(text)
    if match is None:
        raise ScpiError(-104, "Data type error")
    suffix = text[match.end() :].strip().upper()
    if suffix and not factors:
        raise ScpiError(-138, "Suffix not allowed")
    if suffix and suffix not in factors:
        raise ScpiError(-131, "Invalid suffix")
    return float(re.sub(r"\s", "", match[0])) * (factors[suffix] if suffix else 1.0)


def encode_number(value: float) -> bytes:
    """A number as answers carry it, such as `1.23456789E-09`."""
    return f"{value:.8E}".encode("ascii")


@lru_cache(maxsize=MESSAGES_KEPT)
def decode_number(answer: bytes) -> float:
    """The number of an answer: digits and nothing else. Raises ScpiError -104."""
    try:
        text = answer.decode("ascii").strip()
    except UnicodeDecodeError:
        text = ""
    if not _NUMBER.fullmatch(text):
        raise ScpiError(-104, f"no number: {answer!r}")
    return float(re.sub(r"\s", "", text))


def overloaded(value: float) -> bool:
    """Whether a number stands for an overrange, and not for itself."""
    return not abs(value) < OVERRANGE


def encode_error(code: int, text: str) -> bytes:
    """An entry of the error queue, such as `+0,"No error"`."""
    return f'{code:+d},"{text}"'.encode("ascii")


def decode_error(answer: bytes) -> tuple[int, str]:
    """Number and text of an entry of the error queue. Raises ScpiError -104."""
    match = re.fullmatch(rb'\s*([+-]?\d{1,9})\s*,\s*"(.*)"\s*', answer)
    if match is None:
        raise ScpiError(-104, f"no entry of an error queue: {answer!r}")
    return int(match[1]), match[2].decode("ascii", "replace")
