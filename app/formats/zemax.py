"""Zemax (Radiant) tabular .bsdf files with SpectralContent Monochrome.

The geometry is that of .ddr: ScatterRadial is the angle from the specular direction, ScatterAzimuth the azimuth about it,
zero in the plane of incidence towards the normal. Values are BSDF in 1/sr (no factor pi).
"""

import difflib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from goniotwin.app.formats.content import BsdfFile
from goniotwin.app.formats.file import FormatError, StrPath, name_file, quote_word
from goniotwin.app.formats.numerals import ascending_array, finite_array, format_angles, format_number, format_row
from goniotwin.app.formats.table import BsdfTable
from goniotwin.app.formats.text import Words, comment_lines, header_words, mark_comments, write_text
from goniotwin.arrays import Floats
from goniotwin.twin.optics import from_specular

SYMMETRIES = ("PlaneSymmetrical", "ASymmetrical", "ASymmetrical4D")
LISTS = ("sample_rotation_deg", "incidence_deg", "azimuth_deg", "radial_deg")
SCATTER_TYPES = ("BRDF", "BTDF")
LIMITS_DEG = {
    "SampleRotation": (-360.0, 360.0),
    "AngleOfIncidence": (0.0, 90.0),
    "ScatterAzimuth": (0.0, 360.0),
    "ScatterRadial": (0.0, 180.0),
}
HEADER = ("Source", "Symmetry", "SpectralContent", "ScatterType", *LIMITS_DEG)


@dataclass(frozen=True, eq=False)
class ZemaxBsdf:
    """A BSDF in specular coordinates. Angles in degrees, each list ascending.

    `values` has the axes [rotation, incidence, azimuth, radial], in 1/sr; `tis` [rotation, incidence] is the total integrated
    scatter stated in the file. `source` is a word such as "Measured". Raises ValueError where these do not fit together.
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
        blocks = (self.sample_rotation_deg.size, self.incidence_deg.size)
        keep(self, "values", finite_array("values", self.values, (*blocks, self.azimuth_deg.size, self.radial_deg.size)))
        keep(self, "tis", finite_array("tis", self.tis, blocks))
        keep(self, "comments", tuple(self.comments))


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` is a tabular .bsdf file; LightTools states the scatter type in its blocks."""
    return {"spectralcontent", "scattertype"} <= header_words(head, "#", ("databegin",))


def read(path: Path) -> BsdfFile:
    """Read a .bsdf file with one sample rotation. Raises FormatError."""
    table = read_zemax(path)
    if (count := table.sample_rotation_deg.size) != 1:
        wrong = f"it has {count} sample rotations, and the format does not state which way the sample is turned"
        raise FormatError(path, wrong, "give a table with one of them, or a .ddr of four dimensions")
    bsdf_table = BsdfTable(
        sigma_deg=table.incidence_deg,
        phi_deg=table.azimuth_deg,
        theta_deg=table.radial_deg,
        values=table.values[None],
        transmitted=table.scatter_type == "BTDF",
        generated=table.source.lower() == "generated",
        comments=table.comments,
    )
    return BsdfFile((bsdf_table,))


def write(path: Path, content: BsdfFile) -> None:
    """Write a .bsdf file of one wavelength, which is in its comments, completely or not at all. Raises FormatError."""
    table = content.only_table()
    wavelength = [] if table.wavelengths_nm is None else [f"wavelength: {format_number(table.wavelengths_nm[0])} nm"]
    mirrored = bool(table.phi_deg[-1] <= 180.0)
    written = ZemaxBsdf(
        source="Generated" if table.generated else "Measured",
        symmetry="PlaneSymmetrical" if mirrored else "ASymmetrical",
        scatter_type="BTDF" if table.transmitted else "BRDF",
        sample_rotation_deg=np.zeros(1),
        incidence_deg=table.sigma_deg,
        azimuth_deg=table.phi_deg,
        radial_deg=table.theta_deg,
        values=table.values[0],
        tis=_total_scatter(table)[None] * (2.0 if mirrored else 1.0),
        comments=(*wavelength, *table.comments),
    )
    write_zemax(path, written)


def _total_scatter(table: BsdfTable) -> Floats:
    """Share of the light (sigma,) that is scattered within the list of phi, by the trapezoidal rule."""
    angles = np.meshgrid(table.sigma_deg, table.phi_deg, table.theta_deg, indexing="ij")
    cosine = np.maximum(from_specular(angles[0], angles[2], angles[1])[..., 2], 0.0)
    along_theta = np.trapezoid(table.values[0, 0] * cosine * np.sin(np.radians(angles[2])), np.radians(table.theta_deg), axis=2)
    total: Floats = np.trapezoid(along_theta, np.radians(table.phi_deg), axis=1)
    return total


def read_zemax(path: StrPath) -> ZemaxBsdf:
    """Read a .bsdf file with SpectralContent Monochrome. Raises FormatError for anything else."""
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
        values = []
        tis: list[float] = []
        for turn in rotation:
            for angle in incidence:
                name = f"BSDF at rotation {turn:g}, incidence {angle:g} deg"
                self._next_block(len(tis), rotation.size * incidence.size)
                tis.append(self.words.number("TIS"))
                values.append(self.words.block(name, azimuth.size, radial.size, {"tis", "dataend"}))
        self._end(len(tis))
        return ZemaxBsdf(
            source=self.word_of["Source"],
            symmetry=self.word_of["Symmetry"],
            scatter_type=self.word_of["ScatterType"],
            sample_rotation_deg=rotation,
            incidence_deg=incidence,
            azimuth_deg=azimuth,
            radial_deg=radial,
            values=np.array(values).reshape(rotation.size, incidence.size, azimuth.size, radial.size),
            tis=np.array(tis).reshape(rotation.size, incidence.size),
            comments=tuple(self.words.comments),
        )

    def _header(self) -> None:
        while self.words.peek() not in ("monochrome", "databegin", None):
            word = self.words.take("a keyword")
            if word.lower().startswith("tristimulus"):
                raise self.words.error(f"{quote_word(word)}: tristimulus data are not supported", "export it as Monochrome")
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
        self.words.expect("Monochrome")
        self.words.expect("DataBegin")

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
        known = {"Symmetry": SYMMETRIES, "ScatterType": SCATTER_TYPES, "SpectralContent": ("Monochrome",)}[name]
        spelled = {word.lower(): word for word in known}.get(value.replace(" ", "").lower())
        if spelled is None:
            if name == "SpectralContent" and value.lower() == "xyz":
                raise self.words.error("SpectralContent XYZ (tristimulus) is not supported", "export it as Monochrome")
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
        if self.words.peek() is not None:
            word = self.words.take("the end")
            raise self.words.error(f"{quote_word(word)} follows DataEnd", "remove everything after DataEnd")


def write_zemax(path: StrPath, table: ZemaxBsdf) -> None:
    """Write a .bsdf file with nine significant digits and comments at the top, completely or not at all. Raises FormatError."""
    source = comment_lines([table.source], ascii_only=True)
    if len(source) != 1 or source[0].split() != table.source.split() or not source[0].strip() or "#" in source[0]:
        raise FormatError(path, f"the source {quote_word(table.source)} cannot be written", "write it in plain words")
    lines = [
        *mark_comments(comment_lines(table.comments, ascii_only=True), "#"),
        f"Source\t{source[0].strip()}",
        f"Symmetry\t{table.symmetry}",
        "SpectralContent\tMonochrome",
        f"ScatterType\t{table.scatter_type}",
    ]
    for name, field in zip(LIMITS_DEG, LISTS, strict=True):
        angles: Floats = getattr(table, field)
        lines += [f"{name}\t{angles.size}", format_angles(path, name, angles, "\t")]
    lines += ["", "Monochrome", "DataBegin"]
    for rotation in range(table.sample_rotation_deg.size):
        for incidence in range(table.incidence_deg.size):
            lines.append(f"TIS\t{format_number(table.tis[rotation, incidence])}")
            lines += [format_row(values, "\t") for values in table.values[rotation, incidence].tolist()]
    lines.append("DataEnd")
    write_text(path, "\n".join(lines) + "\n")
