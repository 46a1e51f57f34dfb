"""The canonical form of what the chain hashes: a JSON list of numbers and of the contents' lengths in bytes; then the contents.

docs/exchange/journal.md has it for other programs. `encode` does it for one row, `CanonicalColumns` for many rows at once,
column by column: in a third of the time, and to the same bytes. A damaged journal may have a value of any type in any column.
"""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from json.encoder import encode_basestring_ascii
from types import NoneType
from typing import Any

_json = json.JSONEncoder(default=repr).encode  # a damaged value may be of any type
FEW = 0.5
"""Share of different numbers in a column below which each is spelled once."""


def encode(numbers: Sequence[Any], contents: Sequence[Any]) -> bytes:
    """The canonical form of one row: a JSON list of the numbers and of the contents' lengths (null for NULL); the contents."""
    parts = [content_bytes(each) for each in contents]
    listed = _json([*numbers, *(None if each is None else len(each) for each in parts)])
    return b"".join([listed.encode(), *(each for each in parts if each is not None)])


def content_bytes(value: Any) -> bytes | None:
    """The bytes of a content; None for NULL."""
    return value if isinstance(value, bytes) or value is None else str(value).encode()


class CanonicalColumns:
    """Some rows, of which there is at least one: the JSON of their `numbers` and of the contents' `lengths`, and `contents`.

    Each of `numbers` and `lengths` has the elements of the list of a row, without brackets; each of `contents` the contents of
    a row together.
    """

    def __init__(self, numbers: Iterable[Sequence[Any]], contents: Iterable[Sequence[Any]]) -> None:
        self.numbers = list(map(", ".join, zip(*map(_spelled, numbers), strict=True)))
        parts = list(map(_bytes_of, contents))
        self.lengths = list(map(", ".join, zip(*map(_lengths_of, parts), strict=True)))
        held = ([each or b"" for each in column] if None in column else column for column in parts)
        self.contents = list(map(b"".join, zip(*held, strict=True)))

    def encoded(self) -> Iterator[bytes]:
        """The canonical form of each row."""
        for numbers, lengths, contents in zip(self.numbers, self.lengths, self.contents, strict=True):
            yield b"".join([f"[{numbers}, {lengths}]".encode(), contents])


def _spelled(column: Sequence[Any]) -> list[str]:
    """The values of a column in JSON."""
    kinds = set(map(type, column))
    if NoneType in kinds:
        held = iter(_spelled([each for each in column if each is not None]))
        return ["null" if each is None else next(held) for each in column]
    spell: Callable[[Any], str] = _json
    if kinds == {float}:
        different = set(column)
        if all(map(math.isfinite, different)):
            if len(different) < FEW * len(column) and 0.0 not in different:  # -0.0 is equal to 0.0, and has another text
                return list(map({each: repr(each) for each in different}.__getitem__, column))
            spell = float.__repr__
    elif kinds == {int}:
        spell = int.__repr__
    elif kinds == {str}:
        spell = encode_basestring_ascii
    return list(map(spell, column))


def _bytes_of(column: Sequence[Any]) -> Sequence[bytes | None]:
    """The contents of a column as bytes."""
    return column if set(map(type, column)) == {bytes} else list(map(content_bytes, column))


def _lengths_of(column: Sequence[bytes | None]) -> list[str]:
    if None in column:
        return ["null" if each is None else str(len(each)) for each in column]
    return list(map(str, map(len, column)))  # type: ignore[arg-type]  # there is no None
