"""Scattered points as CSV: columns of equal length under a header row, with `# ` comment lines at the top.

A missing number is an empty field, never a number. The file is UTF-8, with a decimal point and a comma as the separator.
"""

import csv
import io
import itertools
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from goniotwin.app.formats.file import FormatError, StrPath, quote_word
from goniotwin.app.formats.numerals import NUMBER, NotANumber, format_number, parse_number
from goniotwin.app.formats.text import CONTROL_CHARACTER, comment_lines, mark_comments, read_text, write_text

TO_QUOTE = re.compile(r'[,"\r\n]')


@dataclass(frozen=True, eq=False)
class Points:
    """The content of a CSV file of points.

    A column is float64 (NaN where the field is empty) if all its fields are numbers or empty, else strings.
    """

    comments: tuple[str, ...]
    columns: Mapping[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class PointStream:
    """Points to write: comments, and columns of equal length in parts, at least one, each with the same names.

    All points have the columns wavelength_nm, sigma_deg, theta_deg, phi_deg, luminance_factor and flags, except in formats that
    hold columns of any names.
    """

    comments: Sequence[str]
    parts: Iterable[Mapping[str, ArrayLike]]


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` has a header row with several names, after comments."""
    lines = (line for line in head.decode("utf-8", "replace").splitlines() if not line.startswith("#"))
    names = next(lines, "").split(",")
    return len(names) > 1 and all(re.fullmatch(r'\s*"?[A-Za-z]\w*"?\s*', name) for name in names)


def write(path: Path, points: PointStream) -> None:
    """Write a CSV file of points, completely or not at all. Raises FormatError."""
    write_points_csv(path, points.comments, points.parts)


def write_points_csv(
    path: StrPath, header_comments: Sequence[str], columns: Mapping[str, ArrayLike] | Iterable[Mapping[str, ArrayLike]]
) -> None:
    """Write columns of equal length: floats with nine significant digits, NaN as an empty field, strings unchanged.

    Many points may be given in parts, at least one, each with the same columns. The file is written completely or not at all.
    Raises FormatError for columns that such a file cannot represent.
    """
    parts = [columns] if isinstance(columns, Mapping) else columns
    heading = mark_comments(comment_lines(header_comments, ascii_only=False), "#")
    write_text(path, itertools.chain(["".join(f"{line}\n" for line in heading)], _lines(path, parts)))


def _lines(path: StrPath, parts: Iterable[Mapping[str, ArrayLike]]) -> Iterator[str]:
    """The header row with the points of the first part, then the points of each further part."""
    names: tuple[str, ...] = ()
    for columns in parts:
        if names and tuple(columns) != names:
            raise FormatError(path, f"one part has the columns {', '.join(columns)}", f"give {', '.join(names)} in each")
        rows = _rows(path, columns)
        yield "".join(f"{_line(row)}\n" for row in (rows if names else itertools.chain([tuple(columns)], rows)))
        names = tuple(columns)


def _rows(path: StrPath, columns: Mapping[str, ArrayLike]) -> Iterator[tuple[str, ...]]:
    fields = {name: _fields(path, name, np.asanyarray(column)) for name, column in columns.items()}
    for name in fields:
        if not name.strip() or name.startswith("#") or _unwritable(name):
            raise FormatError(path, f"the column name {quote_word(name)} cannot be written", "choose a plain name")
    lengths = {name: len(column) for name, column in fields.items()}
    if len(set(lengths.values())) != 1:
        raise FormatError(path, f"the columns have the lengths {lengths}", "give columns, all of the same length")
    return zip(*fields.values(), strict=True)


def _line(row: tuple[str, ...]) -> str:
    # Not csv.writer: with a plain line feed as line end it does not quote a carriage return in a field.
    if row == ("",):
        return '""'  # a reader skips an empty line
    return ",".join('"' + field.replace('"', '""') + '"' if TO_QUOTE.search(field) else field for field in row)


def _fields(path: StrPath, name: str, column: NDArray[Any]) -> list[str]:
    if column.ndim != 1 or np.ma.isMaskedArray(column):
        raise FormatError(
            path, f"column {quote_word(name)} is not a plain list", "give one dimension, and NaN for a missing value"
        )
    if column.dtype.kind in "biu":
        return [str(int(value)) for value in column]
    if column.dtype.kind == "f":
        if np.isinf(column).any():
            raise FormatError(path, f"column {quote_word(name)} has an infinite value", "write NaN for a missing value")
        return ["" if value != value else format_number(value) for value in column.astype(np.float64).tolist()]
    if column.dtype.kind == "U":
        for value in column:
            if _unwritable(value):
                raise FormatError(path, f"column {quote_word(name)} has the text {quote_word(value)}", "write plain text")
        return [str(value) for value in column]
    raise FormatError(path, f"column {quote_word(name)} is of the type {column.dtype}", "give numbers or strings")


def _unwritable(text: str) -> bool:
    return bool(CONTROL_CHARACTER.search(text))


def read_points_csv(path: StrPath) -> Points:
    """Read a CSV file of points, with comments only at the top. Raises FormatError."""
    text = io.StringIO(read_text(path), newline="")
    comments = []
    start = 0
    while (line := text.readline()).startswith("#"):
        comments.append(line[1:].removeprefix(" ").rstrip())
        start += len(line)
    text.seek(start)
    reader = csv.reader(text, strict=True)
    names: list[str] = []
    rows: list[list[str]] = []
    try:
        for fields in reader:
            if not names:
                names = fields
            elif fields and len(fields) != len(names):
                wrong = f"{len(fields)} fields, but the header has {len(names)}"
                raise FormatError(path, wrong, "correct this line", len(comments) + reader.line_num)
            elif fields:
                rows.append(fields)
    except csv.Error as error:
        raise FormatError(path, f"not CSV: {error}", "correct this line", len(comments) + reader.line_num) from error
    if not names or len(set(names)) != len(names) or not all(name.strip() for name in names):
        wrong = "in the header a column has no name, or two have the same"
        raise FormatError(path, wrong, "give each column its own name", len(comments) + 1)
    columns = zip(*rows, strict=True) if rows else ((),) * len(names)
    return Points(tuple(comments), {name: _column(column) for name, column in zip(names, columns, strict=True)})


def _column(fields: Sequence[str]) -> NDArray[Any]:
    if not all(field == "" or NUMBER.fullmatch(field) for field in fields):
        return np.array(fields, dtype=np.str_)
    try:
        return np.array([np.nan if field == "" else parse_number(field) for field in fields], dtype=np.float64)
    except NotANumber:
        return np.array(fields, dtype=np.str_)


read = read_points_csv
"""The reader of the registry."""
