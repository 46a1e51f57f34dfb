"""SCPI: headers with short and long forms and optional nodes, and the numbers of answers.

Source: SCPI-99 volume 1, chapters 5 to 7; IEEE 488.2 chapter 7.
"""

import re
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

OVERRANGE = 9.9e37
MAX_MESSAGE = 4096


class ScpiError(ValueError):
    """A fault with its SCPI number."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(f'{code},"{text}"')
        self.code = code
        self.text = text


@dataclass(frozen=True, slots=True)
class Unit:
    """One program message unit: the header in capitals from the root, query or not, its parameters."""

    header: tuple[str, ...]
    query: bool
    parameters: tuple[str, ...]


def parse(message: bytes) -> list[Unit]:
    """The units of a message, in order; `;` joins on the level of the unit before, `;:` at the root.

    Raises ScpiError: -101 for characters that are not ASCII, -102 for a header that is none.
    """
    try:
        text = message.decode("ascii").strip()
    except UnicodeDecodeError:
        raise ScpiError(-101, "Invalid character") from None
    units: list[Unit] = []
    path: tuple[str, ...] = ()
    for part in text.split(";"):
        piece = part.strip()
        if not piece:
            continue
        head, _, tail = piece.partition(" ")
        query = head.endswith("?")
        words = head.removesuffix("?")
        parameters = tuple(each.strip() for each in tail.split(",")) if tail.strip() else ()
        if words.startswith("*"):
            header: tuple[str, ...] = (words.upper(),)
        else:
            if words.startswith(":"):
                path, words = (), words[1:]
            nodes = tuple(words.upper().split(":"))
            if not all(re.fullmatch(r"[A-Z][A-Z0-9_]*", node) for node in nodes):
                raise ScpiError(-102, f"Syntax error: {head}")
            header = path + nodes
            path = header[:-1]
        units.append(Unit(header, query, parameters))
    return units


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


def encode_number(value: float) -> bytes:
    """A number as answers carry it, such as `1.23456789E-09`."""
    return f"{value:.8E}".encode("ascii")


def decode_number(answer: bytes) -> float:
    """The number of an answer. Raises ScpiError -104."""
    try:
        return float(answer.decode("ascii").strip())
    except (UnicodeDecodeError, ValueError):
        raise ScpiError(-104, f"no number: {answer!r}") from None


def overloaded(value: float) -> bool:
    """Whether a number stands for an overrange, and not for itself."""
    return not abs(value) < OVERRANGE


def encode_error(code: int, text: str) -> bytes:
    """An entry of the error queue, such as `+0,"No error"`."""
    return f'{code:+d},"{text}"'.encode("ascii")


def decode_error(answer: bytes) -> tuple[int, str]:
    """Number and text of an entry of the error queue. Raises ScpiError -104."""
    match = re.fullmatch(rb'\s*([+-]?\d+)\s*,\s*"(.*)"\s*', answer)
    if match is None:
        raise ScpiError(-104, f"no entry of an error queue: {answer!r}")
    return int(match[1]), match[2].decode("ascii", "replace")
