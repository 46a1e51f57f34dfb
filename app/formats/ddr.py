"""Lumicept .ddr and .ddt files: luminance factors over specular coordinates; grey, of three colours, or spectral.

A .ddr is a BRDF, a .ddt a BTDF. Words are separated by white space; `;;` begins a comment. A luminance factor is v = pi * f,
f in 1/sr, so an ideal white diffuser is 1 everywhere; the number in the file is v / kbdf (`TypeData Luminance Absolute`, which
is written). Relative values are a shape: each incidence is scaled so that its reflectance is kbdf. An intensity is divided by
the cosine of the observed direction, and not by pi. The zero of phi is in the plane of incidence, from the specular direction
towards the normal. `sigmat` are polar angles of a refracted axis; such a file has no grid on specular coordinates, and is read
as scattered values.

No specification is public. These facts are those of libbsdf (https://github.com/KimuraRyo/libbsdf: src/Reader/DdrReader.cpp,
src/Writer/DdrWriter.cpp). Reading is stricter: other programs accept wrong counts and lists without a message, and interpolate
wrong values. They also extrapolate linearly outside the lists, so a table is written with sigma 0..90 and theta 0..180.
"""

import difflib
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from goniotwin.app.formats.content import HORIZON_DEG, BsdfFile, ScatteredBsdf
from goniotwin.app.formats.coverage import covered, held, share_weights, uncovered
from goniotwin.app.formats.file import FormatError, StrPath, name_file, quote_word
from goniotwin.app.formats.notes import HALF, noted, read_notes
from goniotwin.app.formats.numerals import NUMBER, ascending_array, finite_array, format_angles, format_number, format_row
from goniotwin.app.formats.table import BsdfTable
from goniotwin.app.formats.text import Words, comment_lines, header_words, mark_comments, write_text
from goniotwin.arrays import Floats
from goniotwin.twin.optics import from_specular
from goniotwin.twin.optics.geometry.coordinates import wrap_azimuth, zenith_and_azimuth

SOURCES = ("Measured", "Generated", "Edited", "Morphed")
SYMMETRIES = ("PlaneSymmetrical", "ASymmetrical", "ASymmetrical 4D")
LAST_DEG = {"psi": 360.0, "sigma": 90.0, "phi": 360.0, "theta": 180.0}
"""Highest angle of each list, deg."""
HEADER = ("Source", "TypeSym", "TypeColorModel", "TypeData", *LAST_DEG)
DEFAULTS = {"Source", "TypeSym", "TypeColorModel", "TypeData", "psi"}
"""What a file need not state: it is then PlaneSymmetrical, RGB, Luminance Absolute, of one psi."""
RGB = ("red", "green", "blue")
SPELLINGS = {"red": ("red",), "green": ("gre", "green"), "blue": ("blu", "blue")}
"""Keywords of the colours; the short ones are written."""
BLOCKS = ("bw", "wl", "red", "gre", "green", "blu", "blue")
IN_BLOCK = {*BLOCKS, "kbdf", "def", "enddef"}
LEAST_COSINE = 1e-6
"""An intensity further down is of a direction at the horizon, and has no meaning."""
Channel = float | str | None
"""A wavelength in nm, the name of a colour, or None for a grey table."""


@dataclass(frozen=True, eq=False)
class DdrTable:
    """Luminance factors (pi times the BSDF in 1/sr) in specular coordinates.

    `values` has the axes [channel, psi, sigma, phi, theta]; the lists of angles, deg, ascend. `channels` has a wavelength, nm,
    for each channel, ascending, or is `RGB`, or (None,) for a black and white table. `psi_deg` is [0] unless the symmetry is
    "ASymmetrical 4D"; PlaneSymmetrical has phi 0..180. `sigmat_deg`, if any, has the polar angle of the axis for each sigma.
    `comments` are at the top of the file. Raises ValueError where these do not fit together.
    """

    source: str
    symmetry: str
    psi_deg: Floats
    sigma_deg: Floats
    phi_deg: Floats
    theta_deg: Floats
    channels: tuple[Channel, ...]
    values: Floats
    comments: tuple[str, ...] = ()
    sigmat_deg: Floats | None = None

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
        if self.channels not in ((None,), RGB):
            wavelengths = [nm if isinstance(nm, float | int) else math.nan for nm in self.channels]
            ascending_array("channels", wavelengths, 1e-3, 1e9)
        lists = (self.psi_deg, self.sigma_deg, self.phi_deg, self.theta_deg)
        shape = (len(self.channels), *(angles.size for angles in lists))
        keep(self, "values", finite_array("values", self.values, shape))
        keep(self, "comments", tuple(self.comments))
        if self.sigmat_deg is not None:
            axis = finite_array("sigmat", self.sigmat_deg, self.sigma_deg.shape)
            if axis.min() < 0.0 or axis.max() > 90.0:
                raise ValueError("sigmat has numbers outside 0 to 90; correct them")
            keep(self, "sigmat_deg", axis)


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` is a .ddr or a .ddt file; a .sdr has neither symmetry nor theta."""
    words = header_words(head, ";;", ("kbdf", "def"))
    return not {"typesym", "typedata"}.isdisjoint(words) or {"sigma", "phi", "theta"} <= words


def read(path: Path) -> BsdfFile:
    """Read a .ddr file, or a .ddt file, which is of transmitted light by its suffix alone. Raises FormatError."""
    table = read_ddr(path)
    notes = read_notes(table.comments)
    half = table.symmetry.startswith("ASymmetrical") and table.phi_deg[-1] <= 180.0
    part = BsdfTable(
        sigma_deg=table.sigma_deg,
        phi_deg=table.phi_deg,
        theta_deg=table.theta_deg,
        values=bsdf(table),
        wavelengths_nm=tuple(nm for nm in table.channels if isinstance(nm, float)) or None,
        psi_deg=table.psi_deg,
        transmitted=path.suffix.lower() == ".ddt",
        generated=table.source == "Generated",
        comments=(*notes.comments, *((HALF,) if half else ())),
        colours=RGB if table.channels == RGB else (),
        back=notes.back,
        sample=notes.sample,
    )
    refracted = table.sigmat_deg is not None and not np.array_equal(table.sigmat_deg, table.sigma_deg)
    if refracted and table.sigmat_deg is not None:
        return BsdfFile((about_axis(part, table.sigmat_deg),))
    return BsdfFile((uncovered(part),))


def about_axis(table: BsdfTable, axis_deg: Floats) -> ScatteredBsdf:
    """The values of a table whose theta and phi are about an axis that is not the specular direction, one for each sigma.

    `axis_deg` (sigma,) are its polar angles. Directions above the horizon, with the mirror image of a plane-symmetric table.
    """
    mirrored = table.phi_deg[-1] <= 180.0
    between = (table.phi_deg > 0.0) & (table.phi_deg < 180.0) & mirrored
    phi = np.concatenate([table.phi_deg, 360.0 - table.phi_deg[between]])
    values = np.concatenate([table.values, table.values[:, :, :, between]], axis=3)
    axes = (np.arange(values.shape[0]), table.psi_deg, np.arange(table.sigma_deg.size), phi, table.theta_deg)
    channel, psi, n, phi, theta = (each.ravel() for each in np.meshgrid(*axes, indexing="ij"))
    polar, azimuth = zenith_and_azimuth(from_specular(axis_deg[n], theta, phi))
    above = polar <= HORIZON_DEG
    wavelengths = np.array(table.wavelengths_nm or (math.nan,) * values.shape[0])
    columns = {
        "sigma_deg": table.sigma_deg[n],
        "psi_deg": psi,
        "polar_deg": np.minimum(polar, 90.0),
        "azimuth_deg": wrap_azimuth(azimuth + psi),
        "values": values.ravel(),
        "wavelength_nm": wavelengths[channel],
        "channel": np.array(table.colours or ("",) * values.shape[0])[channel],
        "transmitted": np.full(n.size, table.transmitted),
        "back": np.full(n.size, table.back),
    }
    axis = ", ".join(f"{angle:g}" for angle in axis_deg)
    about = f"theta and phi are about an axis at the polar angles {axis} deg, one for each sigma"
    found = ScatteredBsdf(**{name: each[above] for name, each in columns.items()}, comments=(*table.comments, about))
    return replace(found, sample=table.sample, isotropic=table.psi_deg.size == 1, generated=table.generated)


def write(path: Path, content: BsdfFile) -> None:
    """Write the one table of a file as .ddr or .ddt, completely or not at all. Raises FormatError."""
    with name_file(path, "write its parts in files of their own"):
        table = content.only_table()
    if table.colours not in ((), RGB):
        raise FormatError(path, f"it has the colours {', '.join(table.colours)}, and a .ddr has RGB", "use .ssdd")
    anisotropic = table.psi_deg.tolist() != [0.0]
    table = covered(table, whole_turn=anisotropic)  # no type of symmetry states both
    symmetry = "PlaneSymmetrical" if table.phi_deg[-1] <= 180.0 else "ASymmetrical"
    written = DdrTable(
        source="Generated" if table.generated else "Measured",
        symmetry="ASymmetrical 4D" if anisotropic else symmetry,
        psi_deg=table.psi_deg,
        sigma_deg=table.sigma_deg,
        phi_deg=table.phi_deg,
        theta_deg=table.theta_deg,
        channels=table.wavelengths_nm or table.colours or (None,),
        values=np.pi * table.values,
        comments=tuple(content.heading(noted(table))),
    )
    write_ddr(path, written)


def bsdf(table: DdrTable) -> Floats:
    """The BSDF in 1/sr, [channel, psi, sigma, phi, theta]."""
    return table.values / np.pi


def write_ddr(path: StrPath, table: DdrTable) -> None:
    """Write a .ddr (or .ddt) file with nine significant digits, completely or not at all. Raises FormatError.

    Comments are written only where every reader accepts them: at the top, and before a row of data.
    """
    models: dict[tuple[Channel, ...], str] = {(None,): "BW", RGB: "RGB"}
    lines = [
        *mark_comments(comment_lines(table.comments, ascii_only=True), ";;"),
        f"Source {table.source}",
        f"TypeSym {table.symmetry}",
        f"TypeColorModel {models.get(table.channels, f'spectral {len(table.channels)}')}",
        "TypeData Luminance Absolute",
    ]
    for name in LAST_DEG:
        if name != "psi" or table.symmetry == "ASymmetrical 4D":
            angles: Floats = getattr(table, f"{name}_deg")
            lines += [f"{name} {angles.size}", f" {format_angles(path, name, angles)}"]
        if name == "sigma" and table.sigmat_deg is not None:
            lines += ["sigmat", f" {format_row(table.sigmat_deg)}"]
    if table.channels not in models:
        format_angles(path, "wl", np.array(table.channels, dtype=np.float64))
    write_text(path, itertools.chain(["\n".join(lines) + "\n"], _blocks(table)))


def _blocks(table: DdrTable) -> Iterator[str]:
    factors = "  " + " ".join(["1.0"] * table.sigma_deg.size) + "\n"
    row = f" {' '.join(['%.9g'] * table.theta_deg.size)}\n" * table.phi_deg.size
    for name, channel in zip(table.channels, table.values, strict=True):
        keyword = f"wl {format_number(name)}" if isinstance(name, float | int) else SPELLINGS[name][0] if name else "bw"
        yield f"{keyword}\n kbdf\n{factors * table.psi_deg.size} def\n"
        for psi, of_psi in zip(table.psi_deg, channel, strict=True):
            for sigma, of_sigma in zip(table.sigma_deg, of_psi, strict=True):
                title = f"Psi = {format_number(psi)}, " if table.symmetry == "ASymmetrical 4D" else ""
                yield f";; {title}Sigma = {format_number(sigma)}\n{row % tuple(of_sigma.ravel().tolist())}"
        yield " enddef\n"


def read_ddr(path: StrPath) -> DdrTable:
    """Read a .ddr or .ddt file; the values become luminance factors, whatever TypeData and kbdf are.

    Raises FormatError for anything else, and for any inconsistency in the file: wrong counts, too few or too many numbers,
    a missing or an extra block, lists that do not ascend, unknown words.
    """
    with name_file(path):
        return _Reader(Words(path, ";;")).table()


def take_channel(words: Words, model: str, before: Sequence[Channel], count: int, *, stated: bool) -> Channel:
    """Take the keyword of the next of `count` channels of a colour model, which the file has `stated`. Raises FormatError."""
    if words.peek() is None:
        wrong = f"the file ends after {len(before)} of the {count} blocks of TypeColorModel"
        raise words.error(wrong, "it is cut short: copy it again, or correct TypeColorModel")
    if model == "BW":
        words.expect("bw")
        return None
    if model == "RGB":
        colour = RGB[len(before)]
        word = words.take(colour)
        if word.lower() not in SPELLINGS[colour]:
            default = "" if stated else "TypeColorModel is missing, which means RGB; "
            raise words.error(f"{default}expected {SPELLINGS[colour][0]}, found {quote_word(word)}", "correct the file")
        return colour
    words.expect("wl")
    wavelength_nm = words.number("wl")
    last = before[-1] if before else None
    if wavelength_nm <= 0 or (isinstance(last, float) and wavelength_nm <= last):
        raise words.error(f"wl {wavelength_nm:g} does not ascend", "sort the blocks by their wavelength, nm")
    return wavelength_nm


def channel_name(channel: Channel) -> str:
    """A channel in a message."""
    return f"wl {channel:g}" if isinstance(channel, float) else channel or "bw"


class _Reader:
    def __init__(self, words: Words) -> None:
        self.words = words
        self.seen: set[str] = set()
        self.source = "Measured"
        self.symmetry = "PlaneSymmetrical"
        self.model = "RGB"
        self.wavelengths = 1
        self.intensity = self.relative = False
        self.angles_of = {"psi": np.zeros(1)}
        self.sigmat: Floats | None = None
        self.comments: dict[str, None] = {}  # each once

    def table(self) -> DdrTable:
        self._header()
        channels: list[Channel] = []
        values = []
        count = {"BW": 1, "RGB": 3}.get(self.model, self.wavelengths)
        for _ in range(count):
            channels.append(take_channel(self.words, self.model, channels, count, stated="TypeColorModel" in self.seen))
            values.append(self._values(channels[-1]))
        if self.words.peek() is not None:
            word = self.words.take("the end")
            wrong = f"{quote_word(word)} follows the last of the {len(channels)} blocks of TypeColorModel"
            raise self.words.error(wrong, "remove it, or correct TypeColorModel")
        phi, factors = self.angles_of["phi"], np.array(values)
        if self.symmetry == "AxiSymmetrical":  # one row, whatever phi is
            phi, factors, self.symmetry = np.array([0.0, 180.0]), np.repeat(factors, 2, axis=3), "PlaneSymmetrical"
        return DdrTable(
            source=self.source,
            symmetry=self.symmetry,
            psi_deg=self.angles_of["psi"],
            sigma_deg=self.angles_of["sigma"],
            phi_deg=phi,
            theta_deg=self.angles_of["theta"],
            channels=tuple(channels),
            values=factors,
            comments=(*self.words.top_comments, *self.comments),
            sigmat_deg=self.sigmat,
        )

    def _header(self) -> None:
        while (word := self.words.peek()) is not None and word not in IN_BLOCK:
            self._keyword(self.words.take("a keyword"))
        missing = [name for name in HEADER if name not in self.seen | DEFAULTS]
        if missing:
            wrong = f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing"
            raise FormatError(self.words.path, wrong, "add it before the data")
        if self.symmetry != "ASymmetrical 4D" and self.angles_of["psi"].tolist() != [0.0]:
            wrong = "psi is [0] unless the symmetry is ASymmetrical 4D"
            raise FormatError(self.words.path, wrong, "correct psi or TypeSym")
        if self.symmetry == "AxiSymmetrical" and self.angles_of["phi"].size != 1:
            wrong = f"TypeSym AxiSymmetrical with {self.angles_of['phi'].size} phi is not supported: its meaning is not public"
            raise FormatError(self.words.path, wrong, "export it as PlaneSymmetrical or ASymmetrical")

    def _keyword(self, word: str) -> None:
        name = {known.lower(): known for known in (*HEADER, "sigmat")}.get(word.lower())
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
        elif name == "sigmat":
            if "sigma" not in self.seen:
                raise self.words.error("sigmat comes before sigma", "put it after the list of sigma")
            self.sigmat = self.words.block("sigmat", 1, self.angles_of["sigma"].size, {*IN_BLOCK, *map(str.lower, HEADER)})[0]
        elif name == "Source":
            self.source = self._one_of(name, self.words.take("the source"), SOURCES)
        elif name == "TypeSym":
            word = self.words.take("the symmetry")
            if word.lower() == "asymmetrical" and self.words.peek() == "4d":
                word += " " + self.words.take("4D")
            self.symmetry = self._one_of(name, word, (*SYMMETRIES, "AxiSymmetrical"))
        elif name == "TypeColorModel":
            self.model = self._one_of(name, self.words.take("the colour model"), ("BW", "RGB", "spectral"))
            self.wavelengths = self.words.count("wavelengths") if self.model == "spectral" else 1
        else:
            quantity = self._one_of(name, self.words.take("Luminance"), ("Luminance", "Intensity"))
            scale = self._one_of(name, self.words.take("Absolute"), ("Absolute", "Relative"))
            self.intensity, self.relative = quantity == "Intensity", scale == "Relative"
            if self.intensity or self.relative:
                self.comments[f"TypeData {quantity} {scale} of the file, as luminance factors"] = None

    def _one_of(self, name: str, word: str, known: tuple[str, ...]) -> str:
        spelled = {each.lower(): each for each in known}.get(word.lower())
        if spelled is None:
            raise self.words.error(f"{name} {quote_word(word)} is not supported", f"export it as {' or '.join(known)}")
        return spelled

    def _values(self, channel: Channel) -> Floats:
        psi, sigma, phi, theta = (self.angles_of[name].size for name in LAST_DEG)
        factors: Floats | None = None
        name = channel_name(channel)
        if self.words.peek() == "kbdf":
            self.words.expect("kbdf")
            factors = self.words.block(f"kbdf of {name}", psi, sigma, IN_BLOCK)
            if factors.min() < 0:
                raise self.words.error(f"kbdf of {name} has a negative factor", "correct it")
        self.words.expect("def")
        values = self.words.block(f"def of {name}", psi * sigma * phi, theta, IN_BLOCK).reshape(psi, sigma, phi, theta)
        self.words.expect("enddef")
        with np.errstate(over="ignore", invalid="ignore"):  # an overflow becomes inf, which the table refuses
            if self.intensity:
                values = self._over_cosine(values)
            if factors is None:
                if self.relative:
                    self.comments["no kbdf: the scale of the values is not known"] = None
                return values
            if self.relative:
                factors = self._scales(values, factors, name)
            scaled: Floats = values * factors[:, :, None, None]
        return scaled

    def _axis(self) -> Floats:
        return self.angles_of["sigma"] if self.sigmat is None else self.sigmat

    def _over_cosine(self, values: Floats) -> Floats:
        """Luminance factors of intensities: v = pi I / cos; at the horizon and below it that of the next node above it."""
        sigma, phi, theta = np.meshgrid(self._axis(), self.angles_of["phi"], self.angles_of["theta"], indexing="ij")
        cosine = from_specular(sigma, theta, phi)[..., 2]
        above = cosine > LEAST_COSINE
        luminance = np.pi * values / np.where(above, cosine, 1.0)
        if not above.all():
            self.comments["not in the data: the values at the horizon and below it, where those above are repeated"] = None
        return held(np.where(above, luminance, np.nan))[0]

    def _scales(self, values: Floats, reflectance: Floats, name: str) -> Floats:
        """The factors (psi, sigma) that give each incidence its reflectance."""
        weights = [share_weights(float(axis), self.angles_of["phi"], self.angles_of["theta"]) for axis in self._axis()]
        found = np.einsum("psft,sft->ps", values, np.array(weights)) / np.pi
        wrong = ~np.isfinite(found) | ((found <= 0.0) & (reflectance > 0.0))
        if wrong.any():
            sigma = self.angles_of["sigma"][np.argwhere(wrong)[0][1]]
            raise self.words.error(
                f"def of {name}: the relative values at sigma {sigma:g} have no positive sum", "correct them"
            )
        return np.where(reflectance > 0.0, reflectance / np.where(found > 0.0, found, 1.0), 0.0)
