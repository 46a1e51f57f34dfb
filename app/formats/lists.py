"""Lists of scattered values in text: lines of so many numbers each, read in bulk, and what such formats share."""

import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from goniotwin.app.formats.content import BsdfFile, ScatteredBsdf, nodes
from goniotwin.app.formats.file import FormatError, StrPath, quote_word, read_head
from goniotwin.app.formats.numerals import MISSING, NotANumber, parse_number
from goniotwin.app.formats.text import read_text
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import HALF_TURN_DEG, polar_and_azimuth, wrap_azimuth

MOST_BYTES = 100_000_000
MOST_LINES = 5_000_000
LONGEST_LINE = 1_000_000
"""Characters: a line of a damaged file may be the whole of it."""
LINES_AT_ONCE = 1 << 16
PLAIN = re.compile(r"[-+.0-9eE\s]*")
BEYOND_DEG = 0.02
"""A polar angle beyond 90 deg by no more than this is 90 deg: files round pi / 2 to 1.571."""
MOST_FILES = 1000
"""Files of a folder that is one table."""
ASSUMED_REFLECTED = "the file does not state whether the light is reflected or transmitted: read as reflected"


class Lines:
    """The lines of a text, whatever their ends, with the number of words of each, `counts` (n,).

    Methods raise FormatError; they take lines by their index, from 0.
    """

    def __init__(self, path: StrPath) -> None:
        self.path = path
        text = read_text(path, MOST_BYTES)
        if "\r" in text:
            text = text.replace("\r\n", "\n").replace("\r", "\n")
        if text.count("\n") > MOST_LINES:
            raise FormatError(path, f"has more than {MOST_LINES} lines", "divide it into several files")
        self.lines = text.rstrip("\n \t").split("\n")
        if len(longest := max(self.lines, key=len)) > LONGEST_LINE:
            raise self.error(self.lines.index(longest), "is too long for a line of this format", "correct its line ends")
        self.counts = np.fromiter((len(line.split()) for line in self.lines), np.int64, len(self.lines))

    def separate(self, chosen: Ints, separators: str) -> None:
        """Take characters that separate the numbers of some lines as blanks."""
        lines = [self.lines[at] for at in chosen.tolist()]
        for separator in separators:
            lines = [line.replace(separator, " ") for line in lines]
        for at, line in zip(chosen.tolist(), lines, strict=True):
            self.lines[at] = line
        self.counts[chosen] = np.fromiter((len(line.split()) for line in lines), np.int64, len(lines))

    def error(self, index: int, wrong: str, remedy: str) -> FormatError:
        """A FormatError at a line."""
        return FormatError(self.path, wrong, remedy, index + 1)

    def numbers(self, chosen: Ints, per_line: int, *, missing: bool = False) -> Floats:
        """The numbers (lines, per_line) of some lines. One that is spelled as nan is NaN, if it may be `missing`."""
        odd = np.flatnonzero(self.counts[chosen] != per_line)
        if odd.size:
            at = int(chosen[odd[0]])
            raise self.error(at, f"{self.counts[at]} numbers in a line of {per_line}", "correct this line")
        found = np.empty((chosen.size, per_line))
        for start in range(0, chosen.size, LINES_AT_ONCE):
            some = chosen[start : start + LINES_AT_ONCE]
            found[start : start + some.size] = self._parsed(some, missing).reshape(-1, per_line)
        return found

    def _parsed(self, chosen: Ints, missing: bool) -> Floats:
        text = "\n".join([self.lines[each] for each in chosen.tolist()])
        try:
            if PLAIN.fullmatch(text):
                found = np.array(list(map(float, text.split())))
                if np.isfinite(found).all():
                    return found
        except ValueError:
            pass
        return np.array([self._number(word, each, missing) for each in chosen.tolist() for word in self.lines[each].split()])

    def _number(self, word: str, index: int, missing: bool) -> float:
        try:
            return np.nan if missing and MISSING.fullmatch(word) else parse_number(word)
        except NotANumber as error:
            raise self.error(index, error.wrong, error.remedy) from None

    def within(
        self, name: str, angles_deg: Floats, low: float, high: float, chosen: Ints, remedy: str = "correct it"
    ) -> Floats:
        """Angles (n,), one each line, unchanged but for those a little beyond 90 deg. They have to be within low..high."""
        if high == 90.0:
            angles_deg = np.where((angles_deg > 90.0) & (angles_deg <= 90.0 + BEYOND_DEG), 90.0, angles_deg)
        odd = np.flatnonzero(~((angles_deg >= low) & (angles_deg <= high)))
        if odd.size:
            at = int(odd[0])
            raise self.error(int(chosen[at]), f"{name} {angles_deg[at]:g} deg is outside {low:g} to {high:g} deg", remedy)
        return angles_deg


def degrees_of(radians: Floats) -> Floats:
    """Degrees of angles that a file has in radians, with so many decimals.

    0.872665 rad is 50.00002 deg, and means 50: an angle of few decimals that agrees with one within half a unit of the file's
    last place is taken. No angle changes by more than what its file can hold.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # a damaged number, which is refused for its size
        decimals = next((each for each in range(2, 12) if _has_decimals(radians, each)), 12)
        resolution = np.degrees(0.501 * 10.0**-decimals)
        degrees: Floats = np.degrees(radians)
        for places in (3, 6):
            plain = np.round(degrees, places)
            degrees = np.where(np.abs(degrees - plain) <= resolution, plain, degrees)
    return degrees


def _has_decimals(numbers: Floats, decimals: int) -> bool:
    scaled = numbers * 10.0**decimals
    return bool(np.all(np.abs(scaled - np.rint(scaled)) <= 4e-16 * np.abs(scaled)))


def observed(signed_deg: Floats, azimuth_deg: Floats) -> tuple[Floats, Floats]:
    """Polar angles and azimuths: a negative polar angle is on the opposite side of the normal."""
    polar, azimuth = polar_and_azimuth(signed_deg, azimuth_deg)
    return polar, wrap_azimuth(azimuth)


def opposite(azimuth_deg: Floats) -> Floats:
    """The azimuths of the light for those of the specular ray, and the other way round."""
    return wrap_azimuth(azimuth_deg + HALF_TURN_DEG)


def by_channel(columns: dict[str, Floats], values: Floats, channels: Sequence[float | str]) -> dict[str, Any]:
    """The columns of `ScatteredBsdf` for values (n, channels) at n directions; a channel is a wavelength or a colour's name."""
    repeated: dict[str, Any] = {name: np.tile(column, len(channels)) for name, column in columns.items()}
    wavelengths = [np.nan if isinstance(each, str) else each for each in channels]
    repeated |= {"values": values.T.ravel(), "wavelength_nm": np.repeat(wavelengths, len(values))}
    if any(isinstance(each, str) and each for each in channels):
        repeated["channel"] = np.repeat([each if isinstance(each, str) else "" for each in channels], len(values))
    return repeated


def turned(psi_deg: Floats, azimuth_deg: Floats) -> tuple[Floats, Floats, bool]:
    """Azimuths of the light and of the observation, and whether one azimuth of the light stands for all: it is then 0."""
    if np.unique(psi_deg).size > 1:
        return psi_deg, azimuth_deg, False
    return np.zeros_like(psi_deg), wrap_azimuth(azimuth_deg - psi_deg), True


def incidences(lines: Lines, chosen: Ints) -> tuple[Floats, Floats, Floats]:
    """Light (n, 2), observation (n, 2) and values (n,) of lines of two numbers, each followed by lines of three.

    The angles are polar and azimuth, deg: of the light within 0..90, of the observation within -90..90.
    """
    heads, rows = chosen[lines.counts[chosen] == 2], chosen[lines.counts[chosen] != 2]
    if not heads.size or not rows.size or rows[0] < heads[0]:
        at = int(rows[0]) if rows.size else len(lines.lines) - 1
        raise lines.error(at, "no line with the two angles of the incidence precedes", "add it before the values")
    light, found = lines.numbers(heads, 2), lines.numbers(rows, 3)
    light[:, 0] = lines.within("the polar angle of incidence", light[:, 0], 0.0, 90.0, heads)
    signed = lines.within("the polar angle of observation", found[:, 0], -90.0, 90.0, rows)
    for angles, of_lines in ((light[:, 1], heads), (found[:, 1], rows)):
        lines.within("an azimuth", angles, -360.0, 360.0, of_lines)
    block = np.searchsorted(heads, rows) - 1
    starts = np.searchsorted(rows, heads)
    empty = np.flatnonzero(np.diff(starts, append=rows.size) == 0)
    if empty.size:
        raise lines.error(int(heads[empty[0]]), "two numbers, and no line of three follows", "add the value, or remove it")
    # A value that lost its last number looks like an incidence, and continues the angles of the lines around it.
    # Where all blocks are alike and do so, such as those of the specular direction alone, they are what they look like.
    before, after = signed[starts[1:] - 1], signed[starts[1:]]
    sense = -1.0 if np.sign(np.diff(signed)[np.diff(block) == 0]).sum() < 0.0 else 1.0  # angles may descend
    odd = np.flatnonzero((sense * before <= sense * light[1:, 0]) & (sense * light[1:, 0] <= sense * after))
    alike = odd.size > 1 and odd.size == before.size and np.unique(np.diff(starts, append=rows.size)).size == 1
    if odd.size and not alike:
        wrong = "two numbers, which continue the polar angles of the lines around: an incidence, or a line without its value"
        raise lines.error(int(heads[1 + odd[0]]), wrong, "add the value, or order the lines of each incidence by polar angle")
    return light[block], np.stack(observed(signed, found[:, 1]), axis=1), found[:, 2]


def one_list(path: StrPath, content: BsdfFile, name: str) -> ScatteredBsdf:
    """All values of a content, for a format that holds one list of one sample. Raises FormatError where it has more."""
    if len(content.samples) > 1:
        wrong = f"{name} holds one sample, and there are {len(content.samples)}"
        raise FormatError(path, wrong, f"choose one of {', '.join(map(quote_word, content.samples))}")
    if content.regular or not content.parts:
        what = "no regular reflectance or transmittance" if content.parts else "values, and there are none"
        raise FormatError(path, f"{name} holds {what}", "write scattered values, or a table")
    return ScatteredBsdf.join([*(nodes(table, once=True) for table in content.tables), *content.scattered])


def refuse_mixture(path: StrPath, name: str, column: Flags, one: str, other: str) -> bool:
    """Which of two kinds all values are. Raises FormatError for a mixture."""
    if column.any() and not column.all():
        raise FormatError(path, f"{name} holds {one} or {other}, and there are both", f"write {one} and {other} in two files")
    return bool(column.size and column[0])


def files_of(path: Path, recognise: Callable[[bytes], bool]) -> list[Path]:
    """The file at `path`, or, of a folder, all of its files that are of a format, by their names. Raises FormatError."""
    if not path.is_dir():
        return [path]
    try:
        files = sorted(each for each in path.iterdir() if each.is_file() and not each.name.startswith("."))
        size = sum(each.stat().st_size for each in files)
    except OSError as error:
        raise FormatError(path, f"cannot be read ({error.strerror})", "check its permissions") from error
    if len(files) > MOST_FILES:
        raise FormatError(path, f"has more than {MOST_FILES} files", "give the folder of one table")
    if size > MOST_BYTES:
        raise FormatError(path, f"its files have more than {MOST_BYTES} bytes", "give the folder of one table")
    found = [each for each in files if recognise(read_head(each, 1 << 16))]
    if not found:
        raise FormatError(path, "none of its files is of this format", "give the folder of one table")
    return found


def numbered(names: Iterable[str]) -> list[str]:
    """Names of measurements, each once: the second of the same sample is 'NAME, measurement 2'."""
    counts: dict[str, int] = {}
    found = []
    for name in names:
        counts[name] = counts.get(name, 0) + 1
        found.append(name if counts[name] == 1 else f"{name}, measurement {counts[name]}".removeprefix(", "))
    return found
