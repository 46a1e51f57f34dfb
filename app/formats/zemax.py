"""Zemax (Radiant) tabular .bsdf files, Monochrome or XYZ, of one sample rotation or several.

The geometry is that of .ddr: ScatterRadial is the angle from the specular direction, ScatterAzimuth the azimuth about it,
zero in the plane of incidence towards the normal. Values are BSDF in 1/sr (no factor pi). The lines of the file are those of
Radiant's description (http://www.zemax.com/kb/articles/229/3, table 1). libbsdf (https://github.com/KimuraRyo/libbsdf:
src/Reader/ZemaxBsdfReader.cpp) reads a sample rotation as the azimuth of the light, here psi, without a change of sign; the
description does not state which way the sample is turned. Of the spellings of the description it takes `Asymmetrical` and
`ASymmetrical4D`, which are written. "NaN" is a node without a value: the files of a real instrument have it below the horizon
(https://github.com/ua-loft/bsdf-tools, data/processed/zemax/test.bsdf).
"""

import difflib
import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from goniotwin.app.formats.content import BsdfFile
from goniotwin.app.formats.coverage import covered, held, scattered_share, uncovered
from goniotwin.app.formats.file import FormatError, StrPath, name_file, quote_word
from goniotwin.app.formats.notes import HALF, noted, read_notes
from goniotwin.app.formats.numerals import MISSING, ascending_array, finite_array, format_angles, format_number
from goniotwin.app.formats.table import BsdfTable
from goniotwin.app.formats.text import Words, comment_lines, header_words, mark_comments, write_text
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics.geometry.coordinates import round_deg

SYMMETRIES = ("PlaneSymmetrical", "Asymmetrical", "ASymmetrical4D")
CHANNELS = {"Monochrome": ("Monochrome",), "XYZ": ("TristimulusX", "TristimulusY", "TristimulusZ")}
"""The keywords of the data of each SpectralContent."""
XYZ = ("X", "Y", "Z")
LISTS = ("sample_rotation_deg", "incidence_deg", "azimuth_deg", "radial_deg")
SCATTER_TYPES = ("BRDF", "BTDF")
LIMITS_DEG = {
    "SampleRotation": (-360.0, 360.0),
    "AngleOfIncidence": (0.0, 90.0),
    "ScatterAzimuth": (0.0, 360.0),
    "ScatterRadial": (0.0, 180.0),
}
SHARE_ERROR = 1e-4
NOT_STATED = ("n/a", "none")
"""What scripts write as TIS where they have computed none (ua-loft/bsdf-tools, from_max)."""
HEADER = ("Source", "Symmetry", "SpectralContent", "ScatterType", *LIMITS_DEG)


@dataclass(frozen=True, eq=False)
class ZemaxBsdf:
    """A BSDF in specular coordinates. Angles in degrees, each list ascending.

    `values` has the axes [channel, rotation, incidence, azimuth, radial], in 1/sr, with one channel, or three for X, Y and Z;
    `tis` [channel, rotation, incidence] is the total integrated scatter stated in the file, NaN where
    it has none. `known` marks the values that the
    file has, None: all of them. `source` is a word such as "Measured". Raises ValueError where these do not fit together.
    """

    source: str
    symmetry: str
    scatter_type: str
    sample_rotation_deg: Floats
    incidence_deg: Floats
    azimuth_deg: Floats
    radial_deg: Floats
    values: Floats
    tis: Floats
    comments: tuple[str, ...] = ()
    known: Flags | None = None

    def __post_init__(self) -> None:
        """Check the fields, and copy the arrays."""
        if self.symmetry not in SYMMETRIES:
            raise ValueError(f"symmetry is one of {SYMMETRIES}, not {self.symmetry!r}")
        if self.scatter_type not in SCATTER_TYPES:
            raise ValueError(f"scatter_type is one of {SCATTER_TYPES}, not {self.scatter_type!r}")
        keep = object.__setattr__
        for field, (name, limits) in zip(LISTS, LIMITS_DEG.items(), strict=True):
            keep(self, field, ascending_array(name, getattr(self, field), *limits))
        if self.symmetry == "PlaneSymmetrical" and self.azimuth_deg[-1] > 180:
            wrong = f"ScatterAzimuth goes to {self.azimuth_deg[-1]:g} deg, but PlaneSymmetrical has 0 to 180 only"
            raise ValueError(f"{wrong}; write ASymmetrical, or end the list at 180")
        channels = 3 if np.shape(self.values)[:1] == (3,) else 1
        blocks = (channels, self.sample_rotation_deg.size, self.incidence_deg.size)
        keep(self, "values", finite_array("values", self.values, (*blocks, self.azimuth_deg.size, self.radial_deg.size)))
        keep(self, "tis", _shares(self.tis, blocks))
        keep(self, "comments", tuple(self.comments))


def _shares(tis: Floats, shape: tuple[int, ...]) -> Floats:
    """A copy of the scattered shares; they may be NaN. Raises ValueError for others."""
    stated = ~np.isnan(np.asarray(tis, dtype=np.float64))
    return np.where(stated, finite_array("tis", np.where(stated, tis, 0.0), shape), np.nan)


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` is a tabular .bsdf file; LightTools states the scatter type in its blocks."""
    return {"spectralcontent", "scattertype"} <= header_words(head, "#", ("databegin",))


def read(path: Path) -> BsdfFile:
    """Read a .bsdf file; sample rotations are psi. Raises FormatError."""
    table = read_zemax(path)
    notes = read_notes(table.comments)
    comments = list(notes.comments)
    if table.symmetry != "PlaneSymmetrical" and table.azimuth_deg[-1] <= 180.0:
        comments.append(HALF)
    values, known, psi = table.values, table.known, np.zeros(1)
    if table.sample_rotation_deg.size > 1 or table.symmetry == "ASymmetrical4D":
        comments.append("psi is the sample rotation of the file; the format does not state which way the sample is turned")
        psi, order = np.unique(round_deg(_within_turn(table.sample_rotation_deg)), return_index=True)
        if psi.size < table.sample_rotation_deg.size:
            wrong = "two sample rotations are the same azimuth of the light"
            raise FormatError(path, wrong, "leave one of them out")
        values, known = values[:, order], None if known is None else known[:, order]
    with name_file(path):
        part = BsdfTable(
            sigma_deg=table.incidence_deg,
            phi_deg=table.azimuth_deg,
            theta_deg=table.radial_deg,
            values=values,
            wavelengths_nm=None if len(values) == 3 else notes.wavelengths_nm,
            psi_deg=psi,
            transmitted=table.scatter_type == "BTDF",
            generated=table.source.lower() == "generated",
            comments=tuple(comments),
            colours=XYZ if len(values) == 3 else (),
            known=known,
            back=notes.back,
            sample=notes.sample,
        )
    return BsdfFile((uncovered(part),))


def _within_turn(rotation_deg: Floats) -> Floats:
    """Rotations in 0 to 360; a list from 0 to 360 keeps its end."""
    return np.where(rotation_deg < 0.0, rotation_deg + 360.0, rotation_deg)


def write(path: Path, content: BsdfFile) -> None:
    """Write the one table of a file as .bsdf, completely or not at all; a wavelength is in its comments. Raises FormatError."""
    with name_file(path, "write its parts in files of their own"):
        table = content.only_table()
    if (count := len(table.wavelengths_nm or ())) > 1:
        raise FormatError(path, f"it has {count} wavelengths, and a .bsdf has one", "write each in a file of its own")
    if table.colours not in ((), XYZ):
        raise FormatError(path, f"it has the colours {', '.join(table.colours)}, and a .bsdf has XYZ", "use .ssdd")
    anisotropic = table.psi_deg.tolist() != [0.0]
    table = covered(table, whole_turn=anisotropic, lists=["psi"])  # no type of symmetry states both
    symmetry = "PlaneSymmetrical" if table.phi_deg[-1] <= 180.0 else "Asymmetrical"
    written = ZemaxBsdf(
        source="Generated" if table.generated else "Measured",
        symmetry="ASymmetrical4D" if anisotropic else symmetry,
        scatter_type="BTDF" if table.transmitted else "BRDF",
        sample_rotation_deg=table.psi_deg,
        incidence_deg=table.sigma_deg,
        azimuth_deg=table.phi_deg,
        radial_deg=table.theta_deg,
        values=table.values,
        tis=_tis(table),
        comments=tuple(content.heading(noted(table, wavelength=True))),
    )
    write_zemax(path, written)


def _tis(table: BsdfTable) -> Floats:
    """Scattered shares; 1 where they are above it by no more than their integrals are wrong."""
    shares = scattered_share(table)
    return np.where((shares > 1.0) & (shares < 1.0 + SHARE_ERROR), 1.0, shares)


def read_zemax(path: StrPath) -> ZemaxBsdf:
    """Read a .bsdf file. Raises FormatError for anything else."""
    with name_file(path):
        return _Reader(Words(path, "#")).table()


class _Reader:
    def __init__(self, words: Words) -> None:
        self.words = words
        self.word_of: dict[str, str] = {}
        self.angles_of: dict[str, Floats] = {}
        self.keywords: dict[str, tuple[str, Callable[[str], None]]] = {
            name.lower(): (name, self._angles if name in LIMITS_DEG else self._word) for name in HEADER
        }

    def table(self) -> ZemaxBsdf:
        self._header()
        rotation, incidence, azimuth, radial = (self.angles_of[name] for name in LIMITS_DEG)
        names = CHANNELS[self.word_of["SpectralContent"]]
        values = []
        tis: list[float] = []
        for name in names:
            self.words.expect(name)
            if name == names[0] or self.words.peek() == "databegin":
                self.words.expect("DataBegin")
            values += self._blocks(tis)
            if name == names[-1] or not (self.words.peek() or "").startswith("tristimulus"):
                self._end(rotation.size * incidence.size)
        if self.words.peek() is not None:
            word = self.words.take("the end")
            raise self.words.error(f"{quote_word(word)} follows DataEnd", "remove everything after DataEnd")
        blocks = (len(names), rotation.size, incidence.size)
        filled, known = held(np.array(values).reshape(*blocks, azimuth.size, radial.size))
        return ZemaxBsdf(
            source=self.word_of["Source"],
            symmetry=self.word_of["Symmetry"],
            scatter_type=self.word_of["ScatterType"],
            sample_rotation_deg=rotation,
            incidence_deg=incidence,
            azimuth_deg=azimuth,
            radial_deg=radial,
            values=filled,
            tis=np.array(tis).reshape(blocks),
            comments=tuple(self.words.comments),
            known=None if known.all() else known,
        )

    def _blocks(self, tis: list[float]) -> list[Floats]:
        rotation, incidence, azimuth, radial = (self.angles_of[name] for name in LIMITS_DEG)
        values: list[Floats] = []
        ends = {"tis", "dataend", *map(str.lower, CHANNELS["XYZ"])}
        for turn in rotation:
            for angle in incidence:
                name = f"BSDF at rotation {turn:g}, incidence {angle:g} deg"
                self._next_block(len(values), rotation.size * incidence.size)
                tis.append(self._share())
                values.append(self.words.block(name, azimuth.size, radial.size, ends, missing=True))
        return values

    def _share(self) -> float:
        """The scattered share of a block; NaN where a file has none."""
        word = self.words.peek() or ""
        if word in NOT_STATED or MISSING.fullmatch(word):
            self.words.take("TIS")
            return math.nan
        return self.words.number("TIS")

    def _header(self) -> None:
        while self.words.peek() not in ("monochrome", *map(str.lower, CHANNELS["XYZ"]), "databegin", None):
            word = self.words.take("a keyword")
            if word.lower() not in self.keywords:
                near = difflib.get_close_matches(word, HEADER, 1)
                remedy = f"did you mean {near[0]}?" if near else "remove it, or make it a comment with #"
                raise self.words.error(f"{quote_word(word)} is not a keyword of a .bsdf file", remedy)
            name, read = self.keywords[word.lower()]
            if name in self.word_of or name in self.angles_of:
                raise self.words.error(f"{name} is given twice", "remove one of them")
            read(name)
        missing = [name for name in HEADER if name not in self.word_of and name not in self.angles_of]
        if missing:
            wrong = f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing"
            raise FormatError(self.words.path, wrong, "add it before the data")

    def _angles(self, name: str) -> None:
        low, high = LIMITS_DEG[name]
        self.angles_of[name] = self.words.angles(name, high, low)

    def _word(self, name: str) -> None:
        line = self.words.line
        value = self.words.take_line(f"the value of {name}")
        if self.words.line != line:
            raise self.words.error(f"{name} has no value", "write the value in the same line", line)
        if name == "Source":
            self.word_of[name] = value
            return
        known = {"Symmetry": SYMMETRIES, "ScatterType": SCATTER_TYPES, "SpectralContent": tuple(CHANNELS)}[name]
        spelled = {word.lower(): word for word in known}.get(value.replace(" ", "").lower())
        if spelled is None:
            raise self.words.error(f"{name} {quote_word(value)} is not known", f"write {' or '.join(known)}")
        self.word_of[name] = spelled

    def _next_block(self, done: int, blocks: int) -> None:
        if self.words.peek() == "dataend":
            self.words.take("DataEnd")
            wrong = f"{done} blocks of data, but SampleRotation and AngleOfIncidence need {blocks}"
            raise self.words.error(wrong, "add the missing blocks, or correct the lists")
        self.words.expect("TIS")

    def _end(self, blocks: int) -> None:
        if self.words.peek() == "tis":
            self.words.take("DataEnd")
            wrong = f"more blocks of data than the {blocks} of SampleRotation and AngleOfIncidence"
            raise self.words.error(wrong, "remove blocks, or correct the lists")
        self.words.expect("DataEnd")


def write_zemax(path: StrPath, table: ZemaxBsdf) -> None:
    """Write a .bsdf file with nine significant digits and comments at the top, completely or not at all. Raises FormatError."""
    source = comment_lines([table.source], ascii_only=True)
    if len(source) != 1 or source[0].split() != table.source.split() or not source[0].strip() or "#" in source[0]:
        raise FormatError(path, f"the source {quote_word(table.source)} cannot be written", "write it in plain words")
    if np.isnan(table.tis).any():
        raise FormatError(path, "the total integrated scatter (tis) of some blocks is not known", "compute it")
    content = "XYZ" if len(table.values) == 3 else "Monochrome"
    lines = [
        *mark_comments(comment_lines(table.comments, ascii_only=True), "#"),
        f"Source\t{source[0].strip()}",
        f"Symmetry\t{table.symmetry}",
        f"SpectralContent\t{content}",
        f"ScatterType\t{table.scatter_type}",
    ]
    for name, field in zip(LIMITS_DEG, LISTS, strict=True):
        angles: Floats = getattr(table, field)
        lines += [f"{name}\t{angles.size}", format_angles(path, name, angles, "\t")]
    write_text(path, itertools.chain(["\n".join(lines) + "\n\n"], _data(table, CHANNELS[content])))


def _data(table: ZemaxBsdf, names: tuple[str, ...]) -> Iterator[str]:
    block = ("\t".join(["%.9g"] * table.radial_deg.size) + "\n") * table.azimuth_deg.size
    for name, tis, values in zip(names, table.tis, table.values, strict=True):
        yield f"{name}\nDataBegin\n"
        for share, of_incidence in zip(tis.ravel(), values.reshape(-1, *values.shape[2:]), strict=True):
            yield f"TIS\t{format_number(share)}\n{block % tuple(of_incidence.ravel().tolist())}"
        yield "DataEnd\n"
