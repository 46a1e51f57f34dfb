"""Scattered points as CSV: columns of equal length under a header row, with `# ` comment lines at the top.

A missing number is an empty field, never a number. The file is UTF-8, with a decimal point and a comma as the separator. The
last of the comments has the number of rows and a digest, by which a reader finds a line that was lost, doubled, moved or
changed. A text that a spreadsheet would take for a formula has an apostrophe before it, which a reader removes.
"""

import csv
import hashlib
import io
import itertools
import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from goniotwin.app.formats.content import HORIZON_DEG, BsdfFile, ScatteredBsdf, has_one_psi, psi_of_gamma
from goniotwin.app.formats.file import FormatError, StrPath, name_file, quote_word, replace_file
from goniotwin.app.formats.numerals import format_number
from goniotwin.app.formats.text import CONTROL_CHARACTER, LINE_END, comment_lines, encode_text, mark_comments, read_text
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import from_specular
from goniotwin.twin.optics.geometry.coordinates import arc_direction, wrap_azimuth, zenith_and_azimuth

MOST_BYTES = 250_000_000
"""Bytes of a file: those of two million points."""
MOST_TEXT_BYTES = 400_000_000
"""Bytes of a column of texts, each of which takes as many as the longest."""
NO_NUMBER = re.compile(r"[^0-9eE+\-.,]")
FEW = 4
"""A value of a column is spelled once where the different ones are fewer than all by this factor."""
TO_QUOTE = re.compile(r'[,"\r\n#]')
"""What a field is quoted for; the `#` for other programs' readers, for which it begins a comment anywhere else."""
FORMULA = re.compile(r"'*[=+\-@\t\r\n]")
"""The beginning of a text that a spreadsheet takes for a formula, also after apostrophes: these are then read back exactly."""
MARKED = re.compile(f"'{FORMULA.pattern}")
DIGEST_LINE = "# {rows} rows; sha256 of all other lines: {digest}; remove this line after a change on purpose"
DIGEST_PATTERN = re.compile(re.escape(DIGEST_LINE).replace(r"\{rows\}", "([0-9]+)").replace(r"\{digest\}", "([0-9a-f]{64})"))
DIGEST_BEGIN = re.compile(r"# *[0-9]+ rows; *sha256", re.IGNORECASE)
"""Of a line that is, or was, such a one."""
DIGEST_BYTES = len(DIGEST_LINE.format(rows=10**9, digest="0" * 64))
"""Bytes of the line, which is filled with blanks: it is written when the rows are known."""


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


def read(path: Path) -> BsdfFile:
    """Read a CSV of a BSDF, by the names of its columns: sigma_deg, and bsdf_per_sr or luminance_factor.

    The direction is psi_deg, polar_deg and azimuth_deg in the sample's frame, or theta_deg and phi_deg about the specular
    direction, with gamma_deg, the rotation of the sample in the rig. What is not there is unknown; the light is reflected and
    the side the front, if the file does not state another. Each sample is a part. Raises FormatError.
    """
    points = read_points_csv(path)
    with name_file(path):
        try:
            return content_of_points(path, points)
        except ColumnError as error:
            raise FormatError(path, error.wrong, error.remedy, _line_of_row(path, error.row)) from None


def write(path: Path, content: BsdfFile | PointStream) -> None:
    """Write a CSV file of points, completely or not at all. Raises FormatError."""
    points = content if isinstance(content, PointStream) else stream_of(content)
    write_points_csv(path, points.comments, points.parts)


SIMULATED = "SIMULATED: "
"""The beginning of a comment that marks simulated values in a CSV."""
SYMMETRY_LINES = {True: "the sample is taken as isotropic", False: "the sample is not taken as isotropic"}
"""Comments that keep what was stated; without one, values with light at one azimuth count as isotropic."""
PART_ROWS, PART_CHARACTERS = 50_000, 8_000_000
"""Rows that are written at once, and characters of rows that are read at once."""
LONGEST_PLAIN = 100_000
"""Characters of a line below which no field is too long for `csv`."""
ABOUT_INTERVAL = "low95_per_sr, high95_per_sr: the ends of the interval of 95 %; interval: linear, logarithmic or drawn"
OPTIONAL_COLUMNS = ("channel", "photodiode", "interval", "low95_per_sr", "high95_per_sr")
"""Columns that are written where they have a value."""


def stream_of(content: BsdfFile) -> PointStream:
    """Scattered values as the columns of a CSV; each sample has the same columns."""
    parts = content.scattered
    symmetries = {part.isotropic for part in parts}
    written = {name for name in _NONE for part in parts if (getattr(part, name) != _NONE[name]).any()}
    if "interval" in written:
        written |= {"low95_per_sr", "high95_per_sr"}
    comments = [
        *([f"{SIMULATED}no value is from a real instrument"] if content.simulated else []),
        *(
            f"{name}: {line}"
            for name, metadata in content.of_samples.items()
            for line in metadata.lines()
            if line not in content.metadata.lines()
        ),
        "directions in the sample's frame: sigma, psi: polar angle and azimuth of the light; polar, azimuth: observation;",
        "theta, phi: about the specular direction, phi 0 towards the normal; degrees",
        "bsdf with its standard uncertainty u_bsdf in 1/sr, u_shared the part of it that neighbouring values share; "
        "luminance_factor is pi times bsdf",
        *([ABOUT_INTERVAL] if "interval" in written else []),
        *(SYMMETRY_LINES[each] for each in symmetries if len(symmetries) == 1),
        *content.heading(comment for part in parts for comment in part.comments),
    ]
    return PointStream(
        list(dict.fromkeys(comments)), (_columns_of(piece, written) for part in parts for piece in _pieces(part))
    )


_NONE: dict[str, Any] = {"channel": "", "photodiode": -1, "interval": ""}


def _pieces(part: ScatteredBsdf) -> Iterator[ScatteredBsdf]:
    """The values in parts: as text they take a kilobyte each."""
    begins = range(0, max(part.size, 1), PART_ROWS)
    return (part.where(np.arange(begin, min(begin + PART_ROWS, part.size))) for begin in begins)


def _columns_of(part: ScatteredBsdf, optional: Collection[str]) -> dict[str, NDArray[Any]]:
    theta, phi = part.specular()
    columns = {
        "sample": np.full(part.size, part.sample),
        "wavelength_nm": part.wavelength_nm,
        "channel": part.channel,
        "sigma_deg": part.sigma_deg,
        "psi_deg": part.psi_deg,
        "polar_deg": part.polar_deg,
        "azimuth_deg": part.azimuth_deg,
        "theta_deg": theta,
        "phi_deg": phi,
        "photodiode": part.photodiode,
        "bsdf_per_sr": part.values,
        "u_bsdf_per_sr": part.u,
        "u_shared_per_sr": part.u_shared,
        "low95_per_sr": part.low95,
        "high95_per_sr": part.high95,
        "interval": part.interval,
        "luminance_factor": np.pi * part.values,
        "side": np.where(part.back, "back", "front"),
        "light": np.where(part.transmitted, "transmitted", "reflected"),
        "flags": part.flags,
    }
    return {name: np.asarray(column) for name, column in columns.items() if name not in OPTIONAL_COLUMNS or name in optional}


class ColumnError(ValueError):
    """A value that a column cannot have, in one of its rows, from 0; why, where the value does not show it, and the remedy."""

    def __init__(self, column: str, row: int, has: str, remedy: str, why: str = "") -> None:
        because = f", {why}" if why else ""
        super().__init__(f"the column {column} has {has} in row {row}{because}; {remedy}")
        self.wrong, self.row, self.remedy = f"the column {column} has {has}{because}", row, remedy


@dataclass(frozen=True)
class Range:
    """The numbers of a column: finite, from `low` to `high`; `above` low: without it; `whole` numbers. `empty`: NaN may be."""

    low: float = -math.inf
    high: float = math.inf
    above: bool = False
    whole: bool = False
    empty: bool = True

    def without(self, numbers: Floats) -> Flags:
        """The numbers (n,) that are not in the range."""
        missing = np.isnan(numbers)
        within = (numbers > self.low if self.above else numbers >= self.low) & (numbers <= self.high) & ~np.isinf(numbers)
        if self.whole:
            within &= numbers == np.rint(numbers)
        return ~np.where(missing, self.empty, within)

    def __str__(self) -> str:
        numbers = "whole numbers" if self.whole else "numbers"
        if math.isinf(self.low):
            return f"{numbers} that are finite"
        if math.isinf(self.high):
            return f"{numbers} above {self.low:g}" if self.above else f"{numbers} from {self.low:g} on"
        return f"{numbers} from {self.low:g} to {self.high:g}"


RANGES = {
    "sigma_deg": Range(0.0, 90.0, empty=False),
    "polar_deg": Range(0.0, 90.0, empty=False),
    "theta_deg": Range(0.0, 180.0, empty=False),
    **dict.fromkeys(("psi_deg", "azimuth_deg", "phi_deg", "gamma_deg"), Range(empty=False)),
    **dict.fromkeys(("bsdf_per_sr", "luminance_factor", "low95_per_sr", "high95_per_sr"), Range()),
    **dict.fromkeys(("u_bsdf_per_sr", "u_shared_per_sr", "standard_error"), Range(0.0)),
    "wavelength_nm": Range(0.0, above=True),
    "photodiode": Range(-1.0, whole=True),
}
"""The columns of numbers of a BSDF, and what they may be."""
WORDS = {"light": ("reflected", "transmitted"), "side": ("front", "back"), "interval": ("linear", "logarithmic", "drawn")}
"""The words of columns that have no others; a field may be empty."""
SAME_DEG = 0.02
"""Directions that are given in two ways are one if they are no further apart: angles of two decimals."""
SAME_U = 1e-6
"""Relative difference of uncertainties that are equal, in single precision or nine digits."""


def content_of_points(path: StrPath, points: Points, titles: Mapping[str, str] | None = None) -> BsdfFile:
    """The content of a CSV by the names of its columns; `titles` are the names in messages, where they have others.

    Raises FormatError, ColumnError and ValueError.
    """
    found = _BsdfColumns(path, points, titles or {})
    values, u = found.values()
    size = values.size
    back = found.stated("side", "back", "side: light on the back")
    transmitted = found.stated("light", "transmitted", "quantity: luminance factor of transmitted light")
    sigma, psi, polar, azimuth = found.directions(back)
    check, flags = found.texts("check", ""), found.texts("flags", "")
    flags = np.where(check == "", flags, np.char.strip(np.char.add(np.char.add(flags, " "), check)))
    stated = (line.removeprefix("sample: ") for line in points.comments if line.startswith("sample: "))
    names = found.texts("sample", next(stated, ""))
    photodiode = found.numbers("photodiode", -1.0)
    shared, (low95, high95) = found.shared(u), found.interval()
    everything = ScatteredBsdf(
        sigma,
        psi,
        polar,
        azimuth,
        values,
        u,
        u_shared=shared,
        low95=low95,
        high95=high95,
        interval=found.texts("interval", ""),
        wavelength_nm=found.numbers("wavelength_nm", np.nan),
        channel=found.texts("channel", ""),
        transmitted=transmitted,
        back=back,
        flags=flags,
        photodiode=np.where(np.isnan(photodiode), -1.0, photodiode).astype(np.int64),
        generated=any(line.startswith(SIMULATED) for line in points.comments),
    )
    samples = list(dict.fromkeys(names.tolist()))
    if not size:
        raise FormatError(path, "it has columns and no values", "give a file with values")
    symmetries = {isotropic for isotropic, line in SYMMETRY_LINES.items() if line in points.comments}
    parts = []
    for name in samples:
        part = everything if len(samples) == 1 else everything.where(names == name)
        isotropic = True in symmetries if symmetries else has_one_psi(part.psi_deg, part.flags)
        parts.append(replace(part, sample=str(name), isotropic=isotropic))
    comments = tuple(line for line in points.comments if line not in SYMMETRY_LINES.values())
    return BsdfFile(tuple(parts), comments=comments)


@dataclass(frozen=True)
class _BsdfColumns:
    """The columns of a CSV, with what is taken for one that is absent. All raise FormatError and ColumnError."""

    path: StrPath
    points: Points
    titles: Mapping[str, str] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Number of rows."""
        return len(next(iter(self.points.columns.values())))

    def has(self, *names: str) -> bool:
        """Whether all of these columns are there."""
        return all(name in self.points.columns for name in names)

    def title(self, name: str) -> str:
        """The name of a column in messages."""
        return self.titles.get(name, name)

    def refuse(self, name: str, wrong: Flags, has: NDArray[Any], remedy: str, why: Callable[[int], str] | str = "") -> None:
        """Raise ColumnError for the first row that is `wrong`, with what it `has` and why it cannot have that."""
        if wrong.any():
            row = int(np.argmax(wrong))
            number = (
                "no number" if has[row] != has[row] else f"{has[row]:g}" if has.dtype.kind == "f" else quote_word(str(has[row]))
            )
            raise ColumnError(self.title(name), row, number, remedy, why if isinstance(why, str) else why(row))

    def numbers(self, name: str, default: float | None = None) -> Floats:
        """A column of numbers in their range, NaN for an empty field."""
        return self.within(name, self.unchecked(name, default))

    def within(self, name: str, numbers: Floats) -> Floats:
        """Numbers of a column, which have to be in its range."""
        allowed = RANGES[name]
        self.refuse(name, allowed.without(numbers), numbers, f"give {allowed}{', or none' if allowed.empty else ''}")
        return numbers

    def unchecked(self, name: str, default: float | None = None) -> Floats:
        """A column of any numbers."""
        column = self.points.columns.get(name)
        if column is None:
            if default is None:
                raise FormatError(self.path, f"the column {name} is missing", "give a CSV of a BSDF, as goniotwin writes it")
            return np.full(self.size, default)
        if column.dtype.kind != "f" and self.size:
            odd = np.array([_numbers([each]) is None for each in column.tolist()])
            self.refuse(name, odd, column, "correct it", "which is not a number")
        return np.asarray(column, dtype=np.float64)

    def texts(self, name: str, default: str) -> NDArray[np.str_]:
        """A column of texts. One whose fields are all empty is read as numbers, and so is one of names such as 12."""
        column = self.points.columns.get(name)
        if column is None:
            return np.full(self.size, default)
        if column.dtype.kind == "f":
            column = np.array(["" if each != each else format_number(each) for each in column.tolist()], dtype=np.str_)
        texts = np.asarray(column, dtype=np.str_)
        if name in WORDS:
            wrong = np.logical_and.reduce([texts != word for word in ("", *WORDS[name])])
            self.refuse(name, wrong, texts, f"give {' or '.join(WORDS[name])}")
        return texts

    def stated(self, name: str, word: str, comment: str) -> Flags:
        """The rows with this word in a column; without the column all of them, where a comment begins with `comment`."""
        if name in self.points.columns:
            return np.asarray(self.texts(name, "") == word)
        return np.full(self.size, any(line.startswith(comment) for line in self.points.comments))

    def values(self) -> tuple[Floats, Floats]:
        """The BSDF with its standard uncertainty, 1/sr."""
        if self.has("bsdf_per_sr") or not self.has("luminance_factor"):
            return self.numbers("bsdf_per_sr"), self.numbers("u_bsdf_per_sr", np.nan)
        return self.numbers("luminance_factor") / np.pi, self.numbers("standard_error", np.nan) / np.pi

    def shared(self, u: Floats) -> Floats:
        """The part of the standard uncertainty `u` that neighbouring values share, 1/sr."""
        name = "u_shared_per_sr"
        shared = self.numbers(name, 0.0)
        more = shared > (1.0 + SAME_U) * u
        self.refuse(name, more, shared, "give a part of u", lambda k: f"which is more than u, {u[k]:g}")
        return shared

    def interval(self) -> tuple[Floats, Floats]:
        """The ends of the intervals of 95 %, 1/sr."""
        low, high = self.numbers("low95_per_sr", np.nan), self.numbers("high95_per_sr", np.nan)
        above = self.title("high95_per_sr")
        self.refuse("low95_per_sr", low > high, low, "exchange them", lambda k: f"which is more than {above}, {high[k]:g}")
        return low, high

    def directions(self, back: Flags) -> tuple[Floats, Floats, Floats, Floats]:
        """sigma, psi, polar angle and azimuth in the sample's frame."""
        sigma = self.unchecked("sigma_deg")
        # Of the rig, whose mirror unit turns to the back.
        sigma = self.within("sigma_deg", np.where(back & (sigma > 90.0), 180.0 - sigma, sigma))
        psi = self.numbers("psi_deg") if self.has("psi_deg") else psi_of_gamma(self.numbers("gamma_deg", 0.0), back)
        if not self.has("psi_deg", "polar_deg", "azimuth_deg"):
            theta, phi = self.numbers("theta_deg"), self.numbers("phi_deg")
            polar, azimuth = zenith_and_azimuth(from_specular(sigma, theta, phi))
            self.refuse(
                "theta_deg",
                polar > HORIZON_DEG,
                theta,
                "give directions to 90 deg from it",
                lambda k: f"which at phi {phi[k]:g} and sigma {sigma[k]:g} is {polar[k]:g} deg from the normal",
            )
            return sigma, psi, np.minimum(polar, 90.0), wrap_azimuth(azimuth + psi)
        polar, azimuth = self.numbers("polar_deg"), self.numbers("azimuth_deg")
        if self.has("theta_deg", "phi_deg"):
            theta, phi = self.unchecked("theta_deg"), self.unchecked("phi_deg")
            apart = np.linalg.norm(arc_direction(polar, azimuth - psi) - from_specular(sigma, theta, phi), axis=-1)
            self.refuse(
                "theta_deg",
                apart > math.radians(SAME_DEG),
                theta,
                "correct them, or leave two of these columns out",
                lambda k: f"which with phi {phi[k]:g} is not the direction polar {polar[k]:g}, azimuth {azimuth[k]:g}",
            )
        return sigma, psi, polar, azimuth


def write_points_csv(
    path: StrPath, header_comments: Sequence[str], columns: Mapping[str, ArrayLike] | Iterable[Mapping[str, ArrayLike]]
) -> None:
    """Write columns of equal length: floats with nine significant digits, NaN as an empty field, strings unchanged.

    Many points may be given in parts, at least one, each with the same columns. The file is written completely or not at all.
    Raises FormatError for columns that such a file cannot represent.
    """
    parts = [columns] if isinstance(columns, Mapping) else columns
    heading = mark_comments(comment_lines(header_comments, ascii_only=False), "#")
    digest, rows = hashlib.sha256(), 0
    with replace_file(path) as out:

        def put(text: str) -> None:
            digest.update(encode_text(path, _line_feeds(text)))
            out.write(encode_text(path, text))

        put("".join(f"{line}\n" for line in heading if not DIGEST_BEGIN.match(line)))  # of an earlier file
        place = out.seek(0, io.SEEK_CUR)
        out.write(b" " * DIGEST_BYTES + b"\n")
        for text, count in _lines(path, parts):
            put(text)
            rows += count
        out.seek(place)
        out.write(DIGEST_LINE.format(rows=rows, digest=digest.hexdigest()).encode())


def _line_feeds(text: str) -> str:
    """A text of whole lines with line feeds as line ends: a program that copies the file may have changed them."""
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text


def _lines(path: StrPath, parts: Iterable[Mapping[str, ArrayLike]]) -> Iterator[tuple[str, int]]:
    """The header row with the points of the first part, then the points of each further part; with the number of points."""
    names: tuple[str, ...] = ()
    for columns in parts:
        if names and tuple(columns) != names:
            raise FormatError(path, f"one part has the columns {', '.join(columns)}", f"give {', '.join(names)} in each")
        rows = _rows(path, columns)
        count = np.asanyarray(next(iter(columns.values()))).size
        heading = [] if names else [tuple(_quoted(_harmless(name)) for name in columns)]
        # A reader skips an empty line: a single column has something in each.
        join = _line if len(columns) == 1 else ",".join
        yield "".join(f"{line}\n" for line in map(join, itertools.chain(heading, rows))), count
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
    return ",".join(row) if row != ("",) else '""'


def _harmless(text: str) -> str:
    return f"'{text}" if FORMULA.match(text) else text


def _quoted(field: str) -> str:
    # Not csv.writer: with a plain line feed as line end it does not quote a carriage return in a field.
    return '"' + field.replace('"', '""') + '"' if TO_QUOTE.search(field) else field


def _fields(path: StrPath, name: str, column: NDArray[Any]) -> list[str]:
    if column.ndim != 1 or np.ma.isMaskedArray(column):
        raise FormatError(
            path, f"column {quote_word(name)} is not a plain list", "give one dimension, and NaN for a missing value"
        )
    if column.dtype.kind in "biu":
        return _spelled_once(column, lambda different: [str(int(value)) for value in different])
    if column.dtype.kind == "f":
        if np.isinf(column).any():
            raise FormatError(path, f"column {quote_word(name)} has an infinite value", "write NaN for a missing value")
        bits = column.astype(np.float64).view(np.int64)  # -0 is written as such
        return _spelled_once(bits, lambda different: _number_fields(different.view(np.float64)))
    if column.dtype.kind == "U":
        alike = column.size and (column == column[0]).all()  # as samples and sides often are
        distinct, which = np.unique(column[:1] if alike else column, return_inverse=True)
        for value in distinct:
            if _unwritable(value):
                raise FormatError(path, f"column {quote_word(name)} has the text {quote_word(value)}", "write plain text")
        texts = [_quoted(_harmless(str(value))) for value in distinct]
        return texts * column.size if alike else _each(texts, which)
    raise FormatError(path, f"column {quote_word(name)} is of the type {column.dtype}", "give numbers or strings")


def _spelled_once(column: NDArray[Any], spelled: Callable[[NDArray[Any]], list[str]]) -> list[str]:
    """The fields of a column of whole numbers; where most of them repeat, each different one is spelled once."""
    ordered = np.sort(column)
    if FEW * np.count_nonzero(ordered[1:] != ordered[:-1]) >= column.size:
        return spelled(column)
    different, which = np.unique(column, return_inverse=True)
    return _each(spelled(different), which)


def _each(texts: list[str], which: NDArray[np.intp]) -> list[str]:
    fields: list[str] = np.array(texts, dtype=object)[which.ravel()].tolist()
    return fields


def _number_fields(column: Floats) -> list[str]:
    missing = np.isnan(column)
    fields = ("%.9g " * column.size % tuple(column.tolist())).split()  # in one call
    for k in np.flatnonzero(missing).tolist():
        fields[k] = ""
    return fields


def _unwritable(text: str) -> bool:
    return bool(CONTROL_CHARACTER.search(text))


def read_points_csv(path: StrPath) -> Points:
    """Read a CSV file of points, with comments only at the top.

    Raises FormatError, also for one whose lines are not those that its digest is of; a file may have none.
    """
    text = read_text(path, MOST_BYTES)
    lines = _lines_of(text)
    comments: list[str] = []
    start = before = 0
    while (line := next(lines, "")).startswith("#"):
        stated = DIGEST_PATTERN.fullmatch(line.rstrip(", \t\r\n"))  # a spreadsheet adds commas
        if stated is None and DIGEST_BEGIN.match(line):
            remedy = f"copy or export the file again, or remove line {before + 1} if the file was changed on purpose"
            raise FormatError(path, "has a damaged line with the number of rows and the digest", remedy, before + 1)
        if stated is None:
            comments.append(line[1:].removeprefix(" ").rstrip())
        else:
            _check_digest(path, text, start, start + len(line), stated)
        start, before = start + len(line), before + 1
    as_text: set[int] = set()
    names, columns = _columns(path, text, start, before, as_text)
    if columns is None:  # with all of the columns known that are texts further down
        names, columns = _columns(path, text, start, before, as_text)
    assert columns is not None
    return Points(tuple(comments), dict(zip(names, columns, strict=True)))


def _check_digest(path: StrPath, text: str, begin: int, end: int, stated: re.Match[str]) -> None:
    """Raise FormatError where a text without its line of the digest, from `begin` to `end`, is not the one that was written."""
    digest, last = hashlib.sha256(), ""
    for piece in itertools.chain([text[:begin]], _pieces_of(text, end)):
        digest.update(_line_feeds(piece).encode())
        last = piece or last
    digest.update(b"" if last.endswith(("\n", "\r")) else b"\n")  # an editor may have removed it
    if digest.hexdigest() == stated[2]:
        return
    line = 1 + len(LINE_END.findall(text, 0, begin))
    remedy = f"copy or export the file again, or remove line {line}, with the digest, if it was changed on purpose"
    raise FormatError(path, _difference(text, end, line, int(stated[1])), remedy)


def _difference(text: str, end: int, line: int, stated: int) -> str:
    """How a text differs from what was written, as far as it can be seen; `end` is the place after line number `line`."""
    lines = list(_lines_of(text, end))
    try:
        below = itertools.dropwhile(lambda line: line.startswith("#"), lines)
        rows = sum(1 for fields in csv.reader(below) if fields) - 1
    except csv.Error:
        rows = stated
    if rows < stated:
        return f"has {rows} rows, and {stated} were written: {stated - rows} are missing"
    if rows > stated:
        seen: dict[str, int] = {}
        double = next(((k, seen[each]) for k, each in enumerate(lines, line + 1) if seen.setdefault(each, k) != k), None)
        about = "" if double is None else f", and line {double[0]} is the same as line {double[1]}"
        return f"has {rows} rows, and {stated} were written: {rows - stated} too many{about}"
    return "is not what was written: a row or a comment was changed, lost or moved"


def _pieces_of(text: str, start: int) -> Iterator[str]:
    """A text from a place on, in pieces of whole lines."""
    while start < len(text):
        end = text.find("\n", start + PART_CHARACTERS) + 1 or len(text)
        yield text[start:end]
        start = end


def _lines_of(text: str, start: int = 0) -> Iterator[str]:
    """The lines of a text from a place on, with their ends. Not by StringIO, which takes four bytes a character."""
    for end in LINE_END.finditer(text, start):
        yield text[start : end.end()]
        start = end.end()
    if start < len(text):
        yield text[start:]


def _line_of_row(path: StrPath, row: int) -> int:
    """The line of a row, from 0, in a file that can be read."""
    lines = list(_lines_of(read_text(path, MOST_BYTES)))
    before = sum(1 for _ in itertools.takewhile(lambda line: line.startswith("#"), lines))
    reader = csv.reader(lines[before:], strict=True)
    ends = (reader.line_num for fields in reader if fields)
    return before + next(itertools.islice(ends, row + 1, None))


def _columns(path: StrPath, text: str, start: int, line: int, as_text: set[int]) -> tuple[list[str], list[NDArray[Any]] | None]:
    """The names and columns of a text from a place, after so many lines, in blocks of rows: as lists, all would take gigabytes.

    `as_text` are the columns that are not of numbers; it gets others that are found. None instead of columns where one of
    these had numbers in earlier blocks: then all has to be read again.
    """
    reader = csv.reader(_lines_of(text, start), strict=True)
    blocks: list[list[NDArray[Any]]] = []
    again = False
    try:
        names = next((fields for fields in reader if fields), [])
        if not names or len(set(names)) != len(names) or not all(name.strip() for name in names):
            wrong = "in the header a column has no name, or two have the same"
            raise FormatError(path, wrong, "give each column its own name", line + 1)
        names = _without_marks(names)
        plain = _is_plain(text, start, len(names))
        parts = _plain_blocks(text, start, len(names)) if plain else _read_blocks(path, reader, len(names), line)
        for part in parts:
            block = []
            for k, fields in enumerate(part):
                numbers = None if k in as_text else _numbers(fields)
                if numbers is None and k not in as_text:
                    as_text.add(k)
                    again = again or bool(blocks)
                block.append(_texts(fields) if numbers is None else numbers)
            if not again:
                blocks.append(block)
    except csv.Error as error:
        raise FormatError(path, f"not CSV: {error}", "correct this line", line + reader.line_num) from error
    if again:
        return names, None
    if not blocks:
        return names, [np.zeros(0)] * len(names)
    count = sum(block[0].size for block in blocks)
    for name, parts in zip(names, zip(*blocks, strict=True), strict=True):
        if (width := max(part.dtype.itemsize for part in parts)) * count > MOST_TEXT_BYTES:
            wrong = f"the column {quote_word(name)} has a text of {width // 4} characters, among {count} rows"
            raise FormatError(path, wrong, "shorten it")
    return names, [np.concatenate(parts) for parts in zip(*blocks, strict=True)]


def _read_blocks(path: StrPath, reader: Any, width: int, line: int) -> Iterator[list[tuple[str, ...]]]:
    """The fields of each column of a CSV, some rows at a time. Raises FormatError, csv.Error."""
    while rows := _rows_of(path, reader, width, line):
        yield list(zip(*rows, strict=True))


def _rows_of(path: StrPath, reader: Any, width: int, line: int) -> list[list[str]]:
    """The next rows of a CSV; none at its end. Raises FormatError, csv.Error."""
    rows: list[list[str]] = []
    for fields in reader:
        if fields and len(fields) != width:
            wrong = f"{len(fields)} fields, but the header has {width}"
            raise FormatError(path, wrong, "correct this line", line + reader.line_num)
        if fields:
            rows.append(fields)
        if len(rows) == PART_ROWS:
            break
    return rows


def _is_plain(text: str, start: int, width: int) -> bool:
    """Whether a CSV, from its header on, has no quotes, line feeds as line ends, and as many fields in each row."""
    if width < 2 or any(text.find(each, start) >= 0 for each in ('"', "\r", "\0")):
        return False
    return all(
        line.count(",") == width - 1 and len(line) < LONGEST_PLAIN for lines in _line_blocks(text, start) for line in lines
    )


def _plain_blocks(text: str, start: int, width: int) -> Iterator[list[list[str]]]:
    """The fields of each column of a plain CSV without its header, some rows at a time: in a quarter of the time of `csv`."""
    first = 1  # the header
    for lines in _line_blocks(text, start):
        fields = ",".join(lines[first:]).split(",") if len(lines) > first else []
        first = 0
        if fields:
            yield [fields[k::width] for k in range(width)]


def _line_blocks(text: str, start: int) -> Iterator[list[str]]:
    """The lines that are not empty, some at a time, without their line feeds."""
    while start < len(text):
        end = text.find("\n", start + PART_CHARACTERS)
        end = len(text) if end < 0 else end
        lines = text[start:end].split("\n")
        if found := [line for line in lines if line]:
            yield found
        start = end + 1


def _texts(fields: Sequence[str]) -> NDArray[np.str_]:
    if fields and fields.count(fields[0]) == len(fields):  # as the sample and the side often are
        return np.full(len(fields), _without_marks(fields[:1])[0])
    return np.array(_without_marks(fields), dtype=np.str_)


def _without_marks(fields: Sequence[str]) -> list[str]:
    return [field[1:] if field[:1] == "'" and MARKED.match(field) else field for field in fields]


def _numbers(fields: Sequence[str]) -> Floats | None:
    """Fields as numbers, NaN where one is empty; None if any is anything else."""
    if fields and fields.count(fields[0]) == len(fields):
        fields, repeated = fields[:1], len(fields)
    else:
        repeated = 1
    if NO_NUMBER.search(",".join(fields)):
        return None
    try:
        found = np.array([float(field) if field else np.nan for field in fields] if "" in fields else list(map(float, fields)))
    except ValueError:
        return None
    return None if np.isinf(found).any() else np.repeat(found, repeated)
