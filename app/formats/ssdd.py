"""SSDD: BRDF, BTDF, regular reflectance and regular transmittance of one sample, in one file of text with blocks of data.

The specification is public (https://github.com/KimuraRyo/libbsdf, doc/SsddFileFormatSpecification.md, version 0.2), and so is
the reader of its author, libbsdf (src/Reader/SsddReader.cpp). A header of `KEYWORD value` lines, `# ` comments; then for each
quantity the lines of its metadata, in a fixed order, and `DATA ascii` (one colour a line) or `DATA binary` (32-bit floats,
little-endian). PARAM0 is fastest, then 1, 2, 3. Values are BSDF in 1/sr, without pi. Angles are in degrees; without PARAM1 the
light is at azimuth 0. For transmitted light the directions are mirrored to the lit side. In specular coordinates PARAM4 is the
offset of the axis from the specular direction, for each angle of incidence.

A grid on specular coordinates is a table; other parameters are directions of their own, and read as scattered values. What is
written are tables and regular factors, in text, with nine significant digits. Comments on the file follow VERSION, those on a
block stand before it, never after an empty line: libbsdf takes such a comment for an entry.
"""

import itertools
import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from goniotwin.app.formats.content import BsdfFile, Part, RegularTable, ScatteredBsdf
from goniotwin.app.formats.coverage import covered, covered_regular, uncovered
from goniotwin.app.formats.ddr import about_axis
from goniotwin.app.formats.file import FormatError, StrPath, name_file, quote_word, read_file
from goniotwin.app.formats.metadata import InstrumentMetadata, Metadata, SampleMetadata
from goniotwin.app.formats.notes import BACK, HALF, read_notes
from goniotwin.app.formats.numerals import NotANumber, format_angles, parse_number
from goniotwin.app.formats.table import BsdfTable
from goniotwin.app.formats.text import comment_lines, mark_comments, write_text
from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.coordinates import TOLERANCE_DEG, arc_direction, wrap_azimuth, zenith_and_azimuth

VERSIONS = ("0.1", "0.2")
QUANTITIES = ("brdf", "btdf", "specular_reflectance", "specular_transmittance")
COLOURS = {"monochrome": (), "rgb": ("red", "green", "blue"), "xyz": ("X", "Y", "Z")}
SPHERICAL, SPECULAR, HALF_DIFFERENCE, DISTORTED = (
    f"{name}_coordinate_system" for name in ("spherical", "specular", "half_difference", "distorted_spherical")
)
BILATERAL, RECIPROCITY = "bilateral_symmetry", "reciprocity"
LAST_DEG = {
    SPHERICAL: (90.0, 360.0, 90.0, 360.0), SPECULAR: (90.0, 360.0, 180.0, 360.0),
    HALF_DIFFERENCE: (90.0, 360.0, 90.0, 360.0), DISTORTED: (90.0, 360.0, 90.0, 360.0),
}  # fmt: skip
"""The last angles of PARAM0 to PARAM3."""
FILE_WORDS = ("VERSION", "SOFTWARE", "API", "DATE")
LISTS = ("PARAM0_LIST", "PARAM1_LIST", "PARAM2_LIST", "PARAM3_LIST")
OFFSETS = "PARAM4_LIST"
BLOCK_WORDS = (
    "DATA_TYPE",
    "COLOR_MODEL",
    "WAVELENGTH_LIST",
    "PARAM_TYPE",
    "REDUCTION_TYPE",
    *LISTS,
    OFFSETS,
    "NAME",
    "SOURCE_TYPE",
    "DEVICE",
    "CREATION_DATE",
    "MEASUREMENT_DATE",
    "DATA",
)
TEXTS = {"SOFTWARE", "API", "NAME", "DEVICE"}
"""Entries of any text to the end of the line; the others may have a comment there."""
REMARK = re.compile(r"(^|\s)#(\s.*)?$")
SOURCES = ("measured", "generated", "edited")
LINE_END = re.compile(rb"\r\n|\r|\n")
NO_NUMBER = re.compile(rb"[^0-9eE+\-.\s]")
PIECE = 1_000_000
"""Bytes of data that are parsed at a time, to bound memory."""
ROWS = 4096
"""Rows that are written at a time."""
DATE = re.compile(r"\d{4}-\d\d-\d\d")


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` is SSDD: its first entry is VERSION, and there are entries of a block."""
    for line in LINE_END.split(head.removeprefix(b"\xef\xbb\xbf")):
        words = line.split()
        if words and not words[0].startswith(b"#"):
            return words[0] == b"VERSION" and re.search(rb"^\s*DATA_TYPE\s", head, re.MULTILINE) is not None
    return False


# ---- reading ----


def read(path: Path) -> BsdfFile:
    """Read a .ssdd file. Raises FormatError."""
    with name_file(path):
        return _Reader(path).content()


class _Reader:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.bytes = read_file(path)
        self.place = 3 if self.bytes.startswith(b"\xef\xbb\xbf") else 0
        self.line = 0
        """Number of the line taken last."""
        self.comments: list[str] = []
        """Those since the last entry of the header, or since the last block."""

    def error(self, wrong: str, remedy: str) -> FormatError:
        return FormatError(self.path, wrong, remedy, self.line or None)

    def content(self) -> BsdfFile:
        entry = self._entry()
        if entry is None:
            raise FormatError(self.path, "is empty", "export or copy it again")
        if entry[0] != "VERSION":
            raise self.error(f"expected VERSION, found {quote_word(entry[0])}", "give a .ssdd file")
        if entry[1] not in VERSIONS:
            wrong = f"VERSION {quote_word(entry[1])} is not supported"
            raise self.error(wrong, f"export it as version {' or '.join(VERSIONS)}")
        stated: dict[str, str] = {}
        about: list[str] = []
        while entry is not None and entry[0] != "DATA_TYPE":
            if entry[0] not in FILE_WORDS:
                raise self.error(f"{quote_word(entry[0])} is not an entry of the file's header", "put DATA_TYPE before it")
            self._state(stated, entry)
            about, self.comments = about + self.comments, []
            entry = self._entry()
        notes = read_notes(about)
        parts: dict[str, Part] = {}
        metadata = Metadata(instrument=InstrumentMetadata(software=stated.get("SOFTWARE", "")))
        while entry is not None:
            block = self._block(entry)
            quantity = block["DATA_TYPE"]
            if quantity in parts:
                raise self.error(f"there are two blocks of {quote_word(quantity)}", "write them in two files")
            comments, self.comments = tuple(self.comments), []
            parts[quantity] = _noted(self._part(block), comments, back=notes.back)
            metadata = _metadata(metadata, block)
            entry = self._entry()
        if not parts:
            raise FormatError(self.path, "it has no block of data (DATA_TYPE)", "it is cut short: copy it again")
        dates = [f"{word.lower()}: {stated[word]}" for word in ("API", "DATE") if word in stated]
        return BsdfFile(tuple(parts.values()), metadata, (*notes.comments, *dates))

    def _take_line(self) -> str | None:
        """The next line, without its end; None at the end of the file."""
        if self.place >= len(self.bytes):
            return None
        found = LINE_END.search(self.bytes, self.place)
        stop, after = (len(self.bytes), len(self.bytes)) if found is None else found.span()
        line = self.bytes[self.place : stop]
        self.place, self.line = after, self.line + 1
        if b"\0" in line:
            raise self.error("contains binary data, not text", "give a .ssdd file")
        try:
            return line.decode("utf-8")
        except UnicodeDecodeError:
            return line.decode("latin-1")

    def _entry(self) -> tuple[str, str] | None:
        """The next keyword, and the rest of its line; None at the end."""
        while (line := self._take_line()) is not None:
            words = line.split(maxsplit=1)
            if words and words[0].startswith("#"):
                self.comments.append(line.strip().removeprefix("#").removeprefix(" "))
            elif words:
                value = "".join(words[1:])
                return words[0], (value if words[0] in TEXTS else REMARK.sub("", value)).strip()
        return None

    def _state(self, stated: dict[str, str], entry: tuple[str, str]) -> None:
        if entry[0] in stated:
            raise self.error(f"{entry[0]} is given twice", "remove one of them")
        stated[entry[0]] = entry[1]

    def _block(self, entry: tuple[str, str] | None) -> dict[str, str]:
        """The entries of a block, up to DATA."""
        block: dict[str, str] = {}
        while entry is not None:
            if entry[0] not in BLOCK_WORDS:
                raise self.error(f"{quote_word(entry[0])} is not an entry of a block", "remove it, or make it a comment with #")
            if not block and entry[0] != "DATA_TYPE":
                raise self.error(f"expected DATA_TYPE, found {quote_word(entry[0])}", "a block begins with DATA_TYPE")
            self._state(block, entry)
            if entry[0] == "DATA":
                return block
            entry = self._entry()
        raise self.error("the file ends before DATA", "it is cut short: copy it again")

    def _one_of(self, block: dict[str, str], word: str, known: tuple[str, ...]) -> str:
        if word not in block:
            raise self.error(f"{word} is missing", "add it before DATA")
        if block[word] not in known:
            raise self.error(f"{word} {quote_word(block[word])} is not supported", f"give {' or '.join(known)}")
        return block[word]

    def _numbers(self, block: dict[str, str], word: str, low: float, high: float, *, ascending: bool = True) -> Floats:
        try:
            numbers = np.array([parse_number(each) for each in block[word].split()])
        except NotANumber as error:
            raise self.error(f"{word}: {error.wrong}", error.remedy) from None
        if not numbers.size:
            raise self.error(f"{word} has no number", "write its list in the same line")
        if numbers.min() < low or numbers.max() > high:
            wrong = f"{word} has {numbers[(numbers < low) | (numbers > high)][0]:g}, outside {low:g} to {high:g}"
            raise self.error(wrong, "correct the list")
        if ascending and (np.diff(numbers) <= 0.0).any():
            raise self.error(f"{word} does not ascend", "sort the list and give each number once")
        return numbers

    def _part(self, block: dict[str, str]) -> Part:
        quantity = self._one_of(block, "DATA_TYPE", QUANTITIES)
        model = self._one_of(block, "COLOR_MODEL", (*COLOURS, "spectrum"))
        wavelengths: tuple[float, ...] | None = None
        if model == "spectrum":
            if "WAVELENGTH_LIST" not in block:
                raise self.error("WAVELENGTH_LIST is missing", "a spectrum needs it")
            wavelengths = tuple(self._numbers(block, "WAVELENGTH_LIST", 1e-3, 1e9).tolist())
        source = self._one_of(block, "SOURCE_TYPE", SOURCES) if "SOURCE_TYPE" in block else "measured"
        mode = self._one_of(block, "DATA", ("ascii", "binary"))
        colours = COLOURS.get(model, ())
        channels = len(wavelengths or colours or (None,))
        regular = quantity.startswith("specular")
        system = SPHERICAL if regular else self._one_of(block, "PARAM_TYPE", tuple(LAST_DEG))
        reductions = set() if regular else self._reductions(block, system)
        wanted = [0, 1] if regular else [0, 1, 2, 3]
        lists = [
            np.zeros(1) if n == 1 and word not in block else self._listed(block, word, LAST_DEG[system][n])
            for n, word in enumerate(LISTS)
            if n in wanted
        ]
        rows = math.prod(each.size for each in lists)
        data = self._ascii(rows, channels) if mode == "ascii" else self._binary(rows, channels)
        values = data.reshape(*(each.size for each in reversed(lists)), channels)
        transmitted = quantity in (QUANTITIES[1], QUANTITIES[3])
        part: Part
        if regular:
            factors = values.transpose(2, 0, 1)
            part = RegularTable(lists[0], factors, wavelengths, colours, lists[1], transmitted)
        elif system == SPECULAR:
            part = self._table(block, lists, values, wavelengths, colours, transmitted=transmitted, mirrored=bool(reductions))
        else:
            if OFFSETS in block:
                raise self.error(f"{OFFSETS} is not supported with {system}", "export it in specular coordinates")
            part = _scattered(system, lists, values, reductions, wavelengths, colours, transmitted=transmitted)
        return replace(part, sample=block.get("NAME", ""), generated=source == "generated")

    def _listed(self, block: dict[str, str], word: str, high: float) -> Floats:
        if word not in block:
            raise self.error(f"{word} is missing", "add it before DATA")
        return self._numbers(block, word, 0.0, high)

    def _reductions(self, block: dict[str, str], system: str) -> set[str]:
        reductions = set(block.get("REDUCTION_TYPE", "").split())
        if unknown := reductions - {BILATERAL, RECIPROCITY}:
            wrong = f"REDUCTION_TYPE {quote_word(min(unknown))} is not supported"
            raise self.error(wrong, f"give {BILATERAL} or {RECIPROCITY}")
        if RECIPROCITY in reductions and system != HALF_DIFFERENCE:
            raise self.error(f"REDUCTION_TYPE {RECIPROCITY} is of {HALF_DIFFERENCE} alone", "remove it")
        if reductions and LISTS[3] in block:
            self._numbers(block, LISTS[3], 0.0, 90.0 if len(reductions) == 2 else 180.0)
        return reductions

    def _table(
        self,
        block: dict[str, str],
        lists: list[Floats],
        values: Floats,
        wavelengths: tuple[float, ...] | None,
        colours: tuple[str, ...],
        *,
        transmitted: bool,
        mirrored: bool,
    ) -> Part:
        sigma, psi, theta, phi = lists
        comments: tuple[str, ...] = ()
        if phi.size == 1:  # one row, whatever phi is
            phi, values = np.array([0.0, 180.0]), np.repeat(values, 2, axis=0)
        elif phi[-1] <= 180.0 and not mirrored:
            comments = (HALF,)
        table = BsdfTable(
            sigma,
            phi,
            theta,
            values.transpose(4, 2, 3, 0, 1),
            wavelengths,
            psi_deg=psi,
            transmitted=transmitted,
            comments=comments,
            colours=colours,
        )
        if OFFSETS not in block:
            return table
        offsets = self._numbers(block, OFFSETS, -90.0, 90.0, ascending=False)
        if offsets.size != sigma.size:
            raise self.error(f"{OFFSETS} has {offsets.size} angles, and {LISTS[0]} {sigma.size}", "give one for each")
        axis = sigma + offsets
        if axis.min() < 0.0 or axis.max() > 90.0 + TOLERANCE_DEG:
            raise self.error(f"{OFFSETS} turns the axis beyond 0 to 90 deg", "correct it")
        return about_axis(table, np.minimum(axis, 90.0)) if offsets.any() else table

    def _ascii(self, rows: int, per_row: int) -> Floats:
        if 2 * rows * per_row > len(self.bytes) - self.place + 1:
            wrong = f"the file is too short for {rows} colours of {per_row}, which the lists ask for"
            raise self.error(wrong, "correct the lists, or copy it again")
        values, done = np.empty((rows, per_row)), 0
        while done < rows:
            done += self._ascii_piece(values[done:])
        return values

    def _ascii_piece(self, into: Floats) -> int:
        """Fill the first rows of `into`, and return how many."""
        stop = self.place + PIECE
        if stop < len(self.bytes):
            newline = self.bytes.find(b"\n", stop)
            stop = len(self.bytes) if newline < 0 else newline + 1
        lines = self.bytes[self.place : stop].splitlines(keepends=True)
        if not lines:
            raise self.error(f"the file ends {len(into)} colours early", "it is cut short: copy it again")
        found: list[float] = []
        rows = 0
        for line in lines:
            words = line.partition(b"#")[0].split()
            self.line += 1
            self.place += len(line)
            if not words:
                continue
            if len(words) != into.shape[1] or (NO_NUMBER.search(line) and NO_NUMBER.search(b" ".join(words))):
                self._refuse(words, into.shape[1], len(into) - rows)
            try:
                found += map(float, words)
            except ValueError:
                self._refuse(words, into.shape[1], len(into) - rows)
            rows += 1
            if rows == len(into):
                break
        into[:rows] = np.array(found).reshape(rows, into.shape[1])
        if not np.isfinite(into[:rows]).all():
            raise self.error("a number is larger than a 64-bit float", "correct the number")
        return rows

    def _refuse(self, words: list[bytes], per_row: int, left: int) -> None:
        texts = [word.decode("latin-1") for word in words]
        if texts[0] in BLOCK_WORDS:
            raise self.error(f"{left} colours are missing before {texts[0]}", "correct the lists, or add them")
        for text in texts:
            try:
                parse_number(text)
            except NotANumber as error:
                raise self.error(error.wrong, error.remedy) from None
        raise self.error(f"a colour has {len(words)} numbers, not {per_row}", "write one colour in a line")

    def _binary(self, rows: int, per_row: int) -> Floats:
        size = 4 * rows * per_row
        if size > len(self.bytes) - self.place:
            wrong = f"the file has {len(self.bytes) - self.place} bytes of data, and the lists ask for {size}"
            raise self.error(wrong, "correct the lists, or copy it again")
        values = np.frombuffer(self.bytes, dtype="<f4", count=rows * per_row, offset=self.place).astype(np.float64)
        self.place += size
        if not np.isfinite(values).all():
            raise self.error("the binary data have values that are not finite", "correct them")
        return values.reshape(rows, per_row)


def _noted(part: Part, comments: tuple[str, ...], *, back: bool) -> Part:
    """A part with the comments before its block, on the side that the file is of."""
    comments = (*comments, *part.comments)
    if isinstance(part, ScatteredBsdf):
        return replace(part, comments=comments, back=np.full(part.size, back))
    if isinstance(part, RegularTable):
        return uncovered(replace(part, comments=comments, back=back))
    return uncovered(replace(part, comments=comments, back=back))


def _metadata(before: Metadata, block: dict[str, str]) -> Metadata:
    """What a block states, where no earlier one did."""
    return replace(
        before,
        date=before.date or block.get("MEASUREMENT_DATE", ""),
        sample=SampleMetadata(identifier=before.sample.identifier or block.get("NAME", "")),
        instrument=replace(before.instrument, name=before.instrument.name or block.get("DEVICE", "")),
    )


def _scattered(
    system: str,
    lists: list[Floats],
    values: Floats,
    reductions: set[str],
    wavelengths: tuple[float, ...] | None,
    colours: tuple[str, ...],
    *,
    transmitted: bool,
) -> ScatteredBsdf:
    """The values [3, 2, 1, 0, channel] of other parameters, with all that reductions leave out, at their directions."""
    zero, one, two, three = lists
    isotropic = one.size == 1
    if RECIPROCITY in reductions:  # light and observed direction exchanged: half a turn further
        both = BILATERAL in reductions
        three, values = _joined(three, values, (180.0 - three) if both else (three + 180.0))
    if BILATERAL in reductions:
        three, values = _joined(three, values, 360.0 - three)
    grid = [each.ravel() for each in np.meshgrid(three, two, one, zero, indexing="ij")]
    azimuth3, polar2, azimuth1, polar0 = grid
    if system == HALF_DIFFERENCE:
        light, seen = _half_difference(polar0, azimuth1, polar2, azimuth3)
    else:
        light = arc_direction(polar0, azimuth1)
        seen = arc_direction(polar2, azimuth3) if system == SPHERICAL else _distorted(light, polar2, azimuth3)
    sigma, psi = zenith_and_azimuth(light)
    polar, azimuth = zenith_and_azimuth(seen)
    if system != HALF_DIFFERENCE:  # as stated: at the pole that has the azimuth, too
        sigma, psi = polar0, azimuth1
    if system == SPHERICAL:
        polar, azimuth = polar2, azimuth3
    if isotropic:
        azimuth, psi = wrap_azimuth(azimuth - psi), np.zeros(psi.size)
    above = (sigma <= 90.0 + TOLERANCE_DEG) & (polar <= 90.0 + TOLERANCE_DEG)
    channels = values.shape[-1]
    data = values.reshape(-1, channels)[above]
    count = int(above.sum())
    return ScatteredBsdf(
        sigma_deg=np.tile(np.minimum(sigma, 90.0)[above], channels),
        psi_deg=np.tile(wrap_azimuth(psi)[above], channels),
        polar_deg=np.tile(np.minimum(polar, 90.0)[above], channels),
        azimuth_deg=np.tile(wrap_azimuth(azimuth)[above], channels),
        values=data.T.ravel(),
        wavelength_nm=np.repeat(np.array(wavelengths or (math.nan,) * channels), count),
        channel=np.repeat(np.array(colours or ("",) * channels), count),
        transmitted=np.full(count * channels, transmitted),
        isotropic=isotropic,
        comments=(f"{system} of the file, at its directions",),
    )


def _joined(angles: Floats, values: Floats, further: Floats) -> tuple[Floats, Floats]:
    """The list of PARAM3, and the values, with those at `further` angles, which are the same; each once, ascending."""
    both = np.concatenate([angles, further])
    kept, first = np.unique(both.round(9), return_index=True)
    return kept, values[first % angles.size]


def _half_difference(half_polar: Floats, half_azimuth: Floats, polar: Floats, azimuth: Floats) -> tuple[Floats, Floats]:
    """Directions (n, 3) of light and observation (Rusinkiewicz 1998; libbsdf, HalfDifferenceCoordinateSystem.h)."""
    x, y, z = np.moveaxis(arc_direction(polar, azimuth), -1, 0)
    tilt, turn = np.radians(half_polar), np.radians(half_azimuth)
    along, up = np.cos(tilt) * x + np.sin(tilt) * z, np.cos(tilt) * z - np.sin(tilt) * x
    light = np.stack([np.cos(turn) * along - np.sin(turn) * y, np.sin(turn) * along + np.cos(turn) * y, up], axis=-1)
    half = arc_direction(half_polar, half_azimuth)
    seen: Floats = 2.0 * np.sum(light * half, axis=-1, keepdims=True) * half - light
    return light, seen


def _distorted(light: Floats, polar: Floats, azimuth: Floats) -> Floats:
    """Observed directions (n, 3), of polar angles that are stretched between the specular direction and the horizon.

    By libbsdf (DistortedSphericalCoordinateSystem.h); the specification does not have it yet.
    """
    radius = polar / 90.0
    disk = radius[:, None] * np.stack([np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))], axis=-1)
    zenith, turn = zenith_and_azimuth(light * [-1.0, -1.0, 1.0])
    centre = (zenith / 90.0)[:, None] * np.stack([np.cos(np.radians(turn)), np.sin(np.radians(turn))], axis=-1)
    place = disk + centre * (1.0 - radius[:, None])
    return arc_direction(90.0 * np.hypot(*place.T), np.degrees(np.arctan2(place[:, 1], place[:, 0])))


# ---- writing ----


def write(path: Path, content: BsdfFile) -> None:
    """Write a file of one sample and one side, completely or not at all. Raises FormatError."""
    parts: dict[str, BsdfTable | RegularTable] = {}
    for part in content.parts:
        if isinstance(part, ScatteredBsdf):
            raise FormatError(path, "it has scattered values, and a .ssdd is written with tables", "convert it to a grid")
        quantity = QUANTITIES[2 * isinstance(part, RegularTable) + part.transmitted]
        if quantity in parts:
            wrong = f"it has two parts that are a {quantity}, and a .ssdd holds one"
            raise FormatError(path, wrong, "write samples and sides in files of their own")
        if part.colours not in COLOURS.values():
            wrong = f"it has the colours {', '.join(part.colours)}, and a .ssdd has RGB or XYZ"
            raise FormatError(path, wrong, "write them as grey values, one file each")
        parts[quantity] = part
    if not parts:
        raise FormatError(path, "there is nothing to write", "give a table")
    if len({(part.sample, part.back) for part in parts.values()}) > 1:
        raise FormatError(path, "its parts are of several samples or sides", "write them in files of their own")
    software = " ".join(comment_lines([content.metadata.instrument.software], ascii_only=True)).strip()
    notes = [BACK] if next(iter(parts.values())).back else []
    known = [line for line in _without_entries(content.metadata).lines() if line not in content.comments]
    head = [f"VERSION {VERSIONS[-1]}", *_comments([*notes, *known, *content.comments]), f"SOFTWARE {software or 'goniotwin'}"]
    blocks = [_written(path, quantity, parts[quantity], content.metadata) for quantity in QUANTITIES if quantity in parts]
    write_text(path, itertools.chain(["\n".join(head) + "\n"], *blocks))


def _without_entries(metadata: Metadata) -> Metadata:
    """What the format has no entry for."""
    return replace(
        metadata,
        date="" if DATE.fullmatch(metadata.date) else metadata.date,
        sample=replace(metadata.sample, identifier=""),
        instrument=replace(metadata.instrument, name="", software=""),
    )


def _comments(lines: Iterable[str]) -> list[str]:
    """Comment lines; an empty one has a space after its mark, too, as the specification asks."""
    return [line if line != "#" else "# " for line in mark_comments(comment_lines(lines, ascii_only=True), "#")]


def _written(path: StrPath, quantity: str, part: BsdfTable | RegularTable, metadata: Metadata) -> Iterator[str]:
    """The text of a block."""
    part = covered(part) if isinstance(part, BsdfTable) else covered_regular(part)
    model = "spectrum" if part.wavelengths_nm else next(name for name, each in COLOURS.items() if each == part.colours)
    lines = [*_comments(part.comments), f"DATA_TYPE {quantity}", f"COLOR_MODEL {model}"]
    if part.wavelengths_nm:
        lines.append(f"WAVELENGTH_LIST {format_angles(path, 'WAVELENGTH_LIST', np.array(part.wavelengths_nm))}")
    angles: dict[str, Floats] = {LISTS[0]: part.sigma_deg}
    if part.psi_deg.tolist() != [0.0]:
        angles[LISTS[1]] = part.psi_deg
    if isinstance(part, BsdfTable):
        angles |= {LISTS[2]: part.theta_deg, LISTS[3]: part.phi_deg}
        lines.append(f"PARAM_TYPE {SPECULAR}")
        if part.phi_deg[-1] <= 180.0:
            lines.append(f"REDUCTION_TYPE {BILATERAL}")
        rows = part.values.transpose(3, 4, 1, 2, 0)
    else:
        rows = part.values.transpose(1, 2, 0)
    lines += [f"{word} {format_angles(path, word, each)}" for word, each in angles.items()]
    for word, text in (("NAME", part.sample or metadata.sample.identifier), ("DEVICE", metadata.instrument.name)):
        lines += [f"{word} {line.strip()}" for line in comment_lines([text], ascii_only=False)[:1] if line.strip()]
    lines.append(f"SOURCE_TYPE {SOURCES[part.generated]}")
    if DATE.match(metadata.date):
        lines.append(f"MEASUREMENT_DATE {metadata.date[:10]}")
    yield "\n".join([*lines, "DATA ascii"]) + "\n"
    colours = rows.reshape(-1, rows.shape[-1])
    colour = " ".join(["%.9g"] * rows.shape[-1]) + "\n"
    for start in range(0, len(colours), ROWS):
        piece = colours[start : start + ROWS]
        yield colour * len(piece) % tuple(piece.ravel().tolist())
