"""Lumicept .ddr and .ddt files: luminance factors over specular coordinates, black and white or spectral.

A .ddr is a BRDF, a .ddt a BTDF; only the data type Luminance Absolute is supported. Words are separated by white space; `;;`
begins a comment. A luminance factor is v = pi * f with f in 1/sr, so an ideal white diffuser is 1 everywhere; the number in
the file is v / kbdf. The zero of phi is in the plane of incidence, from the specular direction towards the normal.

Reading is strict: other programs accept wrong counts and lists without a message, and interpolate wrong values. They also
extrapolate linearly outside the lists, so a table should cover sigma 0..90 and theta 0..180 (at least 90 + the largest sigma).
"""

import difflib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from goniotwin.app.formats.content import BsdfFile
from goniotwin.app.formats.file import FormatError, StrPath, name_file, quote_word
from goniotwin.app.formats.numerals import NUMBER, ascending_array, finite_array, format_angles, format_number, format_row
from goniotwin.app.formats.table import BsdfTable
from goniotwin.app.formats.text import Words, comment_lines, header_words, mark_comments, write_text
from goniotwin.arrays import Floats

SOURCES = ("Measured", "Generated", "Edited", "Morphed")
SYMMETRIES = ("PlaneSymmetrical", "ASymmetrical", "ASymmetrical 4D")
LAST_DEG = {"psi": 360.0, "sigma": 90.0, "phi": 360.0, "theta": 180.0}
"""Highest angle of each list, deg."""
HEADER = ("Source", "TypeSym", "TypeColorModel", "TypeData", *LAST_DEG)
BLOCKS = ("bw", "wl", "red", "gre", "green", "blu", "blue")
IN_BLOCK = {*BLOCKS, "kbdf", "def", "enddef"}


@dataclass(frozen=True, eq=False)
class DdrTable:
    """Luminance factors (pi times the BSDF in 1/sr) in specular coordinates.

    `values` has the axes [channel, psi, sigma, phi, theta]; the lists of angles, deg, ascend. `channels` has a wavelength, nm,
    for each channel, ascending, or is (None,) for a black and white table. `psi_deg` is [0] unless the symmetry is
    "ASymmetrical 4D"; PlaneSymmetrical has phi 0..180. `comments` are at the top of the file. Raises ValueError where these
    do not fit together.
    """

    source: str
    symmetry: str
    psi_deg: Floats
    sigma_deg: Floats
    phi_deg: Floats
    theta_deg: Floats
    channels: tuple[float | None, ...]
    values: Floats
    comments: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the fields, and copy the arrays."""
        if self.source not in SOURCES:
            raise ValueError(f"source is one of {SOURCES}, not {self.source!r}")
        if self.symmetry not in SYMMETRIES:
            raise ValueError(f"symmetry is one of {SYMMETRIES}, not {self.symmetry!r}")
        keep = object.__setattr__
        for name, end in LAST_DEG.items():
            keep(self, f"{name}_deg", ascending_array(name, getattr(self, f"{name}_deg"), 0.0, end))
        if self.symmetry == "PlaneSymmetrical" and self.phi_deg[-1] > 180:
            raise ValueError(f"phi goes to {self.phi_deg[-1]:g} deg, but PlaneSymmetrical has 0 to 180 only")
        if self.symmetry != "ASymmetrical 4D" and self.psi_deg.tolist() != [0.0]:
            raise ValueError(f"psi is [0] unless the symmetry is ASymmetrical 4D, not {self.psi_deg.tolist()[:5]}")
        keep(self, "channels", tuple(self.channels))
        if self.channels != (None,):
            ascending_array("channels", [np.nan if nm is None else nm for nm in self.channels], 1e-3, 1e9)
        lists = (self.psi_deg, self.sigma_deg, self.phi_deg, self.theta_deg)
        shape = (len(self.channels), *(angles.size for angles in lists))
        keep(self, "values", finite_array("values", self.values, shape))
        keep(self, "comments", tuple(self.comments))


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` is a .ddr or a .ddt file."""
    return not {"typesym", "typecolormodel", "typedata"}.isdisjoint(header_words(head, ";;", BLOCKS))


def read(path: Path) -> BsdfFile:
    """Read a .ddr file, or a .ddt file, which is of transmitted light by its suffix alone. Raises FormatError."""
    table = read_ddr(path)
    bsdf_table = BsdfTable(
        sigma_deg=table.sigma_deg,
        phi_deg=table.phi_deg,
        theta_deg=table.theta_deg,
        values=bsdf(table),
        wavelengths_nm=tuple(nm for nm in table.channels if nm is not None) or None,
        psi_deg=table.psi_deg,
        transmitted=path.suffix.lower() == ".ddt",
        generated=table.source == "Generated",
        comments=table.comments,
    )
    return BsdfFile((bsdf_table,))


def write(path: Path, content: BsdfFile) -> None:
    """Write a .ddr or .ddt file, completely or not at all. Raises FormatError."""
    table = content.only_table()
    symmetry = "PlaneSymmetrical" if table.phi_deg[-1] <= 180.0 else "ASymmetrical"
    written = DdrTable(
        source="Generated" if table.generated else "Measured",
        symmetry=symmetry if table.psi_deg.size == 1 else "ASymmetrical 4D",
        psi_deg=table.psi_deg,
        sigma_deg=table.sigma_deg,
        phi_deg=table.phi_deg,
        theta_deg=table.theta_deg,
        channels=table.wavelengths_nm or (None,),
        values=np.pi * table.values,
        comments=table.comments,
    )
    write_ddr(path, written)


def bsdf(table: DdrTable) -> Floats:
    """The BSDF in 1/sr, [channel, psi, sigma, phi, theta]."""
    return table.values / np.pi


def write_ddr(path: StrPath, table: DdrTable) -> None:
    """Write a .ddr (or .ddt) file with nine significant digits, completely or not at all. Raises FormatError.

    Comments are written only where every reader accepts them: at the top, and before a row of data.
    """
    black_and_white = table.channels == (None,)
    lines = [
        *mark_comments(comment_lines(table.comments, ascii_only=True), ";;"),
        f"Source {table.source}",
        f"TypeSym {table.symmetry}",
        "TypeColorModel BW" if black_and_white else f"TypeColorModel spectral {len(table.channels)}",
        "TypeData Luminance Absolute",
    ]
    for name in LAST_DEG:
        if name != "psi" or table.symmetry == "ASymmetrical 4D":
            angles: Floats = getattr(table, f"{name}_deg")
            lines += [f"{name} {angles.size}", f" {format_angles(path, name, angles)}"]
    if not black_and_white:
        format_angles(path, "wl", np.array(table.channels, dtype=np.float64))
    for wavelength_nm, channel in zip(table.channels, table.values, strict=True):
        lines += ["bw" if wavelength_nm is None else f"wl {format_number(wavelength_nm)}", *_block(table, channel)]
    write_text(path, "\n".join(lines) + "\n")


def _block(table: DdrTable, channel: Floats) -> list[str]:
    factors = "  " + " ".join(["1.0"] * table.sigma_deg.size)
    lines = [" kbdf", *[factors] * table.psi_deg.size, " def"]
    for psi, of_psi in zip(table.psi_deg, channel, strict=True):
        for sigma, of_sigma in zip(table.sigma_deg, of_psi, strict=True):
            title = f"Sigma = {format_number(sigma)}"
            if table.symmetry == "ASymmetrical 4D":
                title = f"Psi = {format_number(psi)}, {title}"
            lines += [f";; {title}", *(f" {format_row(values)}" for values in of_sigma.tolist())]
    return [*lines, " enddef"]


def read_ddr(path: StrPath) -> DdrTable:
    """Read a .ddr or .ddt file with Luminance Absolute data, BW or spectral; the values are multiplied by kbdf.

    Raises FormatError for anything else, and for any inconsistency in the file: wrong counts, too few or too many numbers,
    a missing or an extra block, lists that do not ascend, unknown words.
    """
    with name_file(path):
        return _Reader(Words(path, ";;")).table()


class _Reader:
    def __init__(self, words: Words) -> None:
        self.words = words
        self.seen: set[str] = set()
        self.source = ""
        self.symmetry = "PlaneSymmetrical"  # the meaning of a file without TypeSym
        self.wavelengths: int | None = None
        self.angles_of = {"psi": np.zeros(1)}

    def table(self) -> DdrTable:
        self._header()
        channels: list[float | None] = []
        values = []
        for _ in range(self.wavelengths or 1):
            channels.append(self._channel(channels))
            values.append(self._values(channels[-1]))
        if self.words.peek() is not None:
            word = self.words.take("the end")
            wrong = f"{quote_word(word)} follows the last of the {len(channels)} blocks of TypeColorModel"
            raise self.words.error(wrong, "remove it, or correct TypeColorModel")
        return DdrTable(
            source=self.source,
            symmetry=self.symmetry,
            psi_deg=self.angles_of["psi"],
            sigma_deg=self.angles_of["sigma"],
            phi_deg=self.angles_of["phi"],
            theta_deg=self.angles_of["theta"],
            channels=tuple(channels),
            values=np.array(values),
            comments=tuple(self.words.top_comments),
        )

    def _header(self) -> None:
        while (word := self.words.peek()) is not None and word not in IN_BLOCK:
            self._keyword(self.words.take("a keyword"))
        missing = [name for name in HEADER if name not in self.seen | {"TypeSym", "TypeData", "psi"}]
        if missing:
            wrong = f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing"
            raise FormatError(self.words.path, wrong, "add it before the data")
        if self.symmetry != "ASymmetrical 4D" and self.angles_of["psi"].tolist() != [0.0]:
            wrong = "psi is [0] unless the symmetry is ASymmetrical 4D"
            raise FormatError(self.words.path, wrong, "correct psi or TypeSym")

    def _keyword(self, word: str) -> None:
        name = {known.lower(): known for known in HEADER}.get(word.lower())
        if word.lower() == "sigmat":
            raise self.words.error("sigmat (a refracted axis) is not supported", "export the table without it")
        if name is None:
            near = difflib.get_close_matches(word, HEADER, 1)
            remedy = f"did you mean {near[0]}?" if near else "remove it"
            if NUMBER.fullmatch(word):
                remedy = "correct the list before it, or its count"
            raise self.words.error(f"{quote_word(word)} is not a keyword of a .ddr file", remedy)
        if name in self.seen:
            raise self.words.error(f"{name} is given twice", "remove one of them")
        self.seen.add(name)
        if name in LAST_DEG:
            self.angles_of[name] = self.words.angles(name, LAST_DEG[name])
        elif name == "Source":
            self.source = self._one_of(name, self.words.take("the source"), SOURCES)
        elif name == "TypeSym":
            word = self.words.take("the symmetry")
            if word.lower() == "asymmetrical" and self.words.peek() == "4d":
                word += " " + self.words.take("4D")
            self.symmetry = self._one_of(name, word, SYMMETRIES)
        elif name == "TypeColorModel":
            model = self._one_of(name, self.words.take("the colour model"), ("BW", "spectral"))
            self.wavelengths = self.words.count("wavelengths") if model == "spectral" else None
        else:
            self._one_of(name, self.words.take("Luminance"), ("Luminance",))
            self._one_of(name, self.words.take("Absolute"), ("Absolute",))

    def _one_of(self, name: str, word: str, known: tuple[str, ...]) -> str:
        spelled = {each.lower(): each for each in known}.get(word.lower())
        if spelled is None:
            raise self.words.error(f"{name} {quote_word(word)} is not supported", f"export it as {' or '.join(known)}")
        return spelled

    def _channel(self, before: list[float | None]) -> float | None:
        if self.words.peek() is None:
            wrong = f"the file ends after {len(before)} of the {self.wavelengths or 1} blocks of TypeColorModel"
            raise self.words.error(wrong, "it is cut short: copy it again, or correct TypeColorModel")
        if self.wavelengths is None:
            self.words.expect("bw")
            return None
        self.words.expect("wl")
        wavelength_nm = self.words.number("wl")
        if wavelength_nm <= 0 or (before and before[-1] is not None and wavelength_nm <= before[-1]):
            raise self.words.error(f"wl {wavelength_nm:g} does not ascend", "sort the blocks by their wavelength, nm")
        return wavelength_nm

    def _values(self, channel: float | None) -> Floats:
        psi, sigma, phi, theta = (self.angles_of[name].size for name in LAST_DEG)
        factors = np.ones((psi, sigma))
        name = "bw" if channel is None else f"wl {channel:g}"
        if self.words.peek() == "kbdf":
            self.words.expect("kbdf")
            factors = self.words.block(f"kbdf of {name}", psi, sigma, IN_BLOCK)
            if factors.min() < 0:
                raise self.words.error(f"kbdf of {name} has a negative factor", "correct it")
        self.words.expect("def")
        values = self.words.block(f"def of {name}", psi * sigma * phi, theta, IN_BLOCK)
        self.words.expect("enddef")
        with np.errstate(over="ignore"):  # an overflow becomes inf, which the table refuses
            scaled: Floats = values.reshape(psi, sigma, phi, theta) * factors[:, :, None, None]
        return scaled
