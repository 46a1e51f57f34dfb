"""Text of pab's goniophotometers (pgII, "Mountain"), by description. Read; a folder of files is one table.

    #sample_name "blind"
    #format: theta phi BSDF
    #incident_angle 30 0
    #upphi 0
    15 180 0.25

One file for each incidence; lines are in any order. Keywords and their meaning are those of Radiance's readers (pabopto2bsdf.c,
pabopto2xyz.c): light and observation in one spherical system about the front's normal, polar angles beyond 90 deg behind the
sample; BSDF, BRDF and BTDF are values in 1/sr, DSF has the cosine in it; `intheta` and `inphi` may stand for `incident_angle`,
and of CIE-XYZ a line has three values. `upphi` is the azimuth of the sample's upper edge. No measured file was seen.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from goniotwin.app.formats.content import BsdfFile, ScatteredBsdf
from goniotwin.app.formats.file import FormatError, name_file, quote_word
from goniotwin.app.formats.lists import BEYOND_DEG, Lines, by_channel, files_of
from goniotwin.app.formats.numerals import NotANumber, parse_number
from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.coordinates import wrap_azimuth

KEYWORDS = "sample_?name|format|incident_?angle|intheta|inphi|upphi|colorimetry"
KEYWORD = re.compile(rf"#\s*({KEYWORDS})\b[\s:]*(.*)", re.IGNORECASE)
FORMAT = re.compile(rb"(?:^|[\r\n])#[ \t]*format[ \t:]*theta[ \t]+phi[ \t]+(?:BSDF|B[RT]DF|DSF)", re.IGNORECASE)
QUANTITIES = ("BSDF", "BRDF", "BTDF", "DSF")
XYZ = ("X", "Y", "Z")


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` has a line of its columns, theta and phi first."""
    return bool(FORMAT.search(head))


def read(path: Path) -> BsdfFile:
    """Read a file, or all files of a folder: one part for each sample. Raises FormatError."""
    found: dict[str, list[ScatteredBsdf]] = {}
    for file in files_of(path, recognise):
        with name_file(file):
            values = _Reader(Lines(file)).values()
        found.setdefault(values.sample, []).append(values)
    lists = [ScatteredBsdf.join(parts) for parts in found.values()]
    return BsdfFile(tuple(replace(each, isotropic=np.unique(each.psi_deg).size == 1) for each in lists))


@dataclass
class _Reader:
    lines: Lines
    sample: str = ""
    quantity: str = ""
    colorimetry: str = ""
    angles: dict[str, float] = field(default_factory=dict)
    comments: list[str] = field(default_factory=list)

    def values(self) -> ScatteredBsdf:
        """The values of the file."""
        marked = (line.lstrip().startswith("#") for line in self.lines.lines)
        is_header = np.fromiter(marked, np.bool_, len(self.lines.lines))
        for at in np.flatnonzero(is_header).tolist():
            self._header(at, self.lines.lines[at].strip())
        if missing := [each for each in ("intheta", "inphi") if each not in self.angles]:
            wrong = f"{' and '.join(missing)} of the light are not given"
            raise FormatError(self.lines.path, wrong, "add #incident_angle 30 0")
        if not self.quantity:
            raise FormatError(self.lines.path, "the line of its format is missing", "add #format: theta phi BSDF")
        return self._list(np.flatnonzero(~is_header & (self.lines.counts > 0)))

    def _header(self, at: int, line: str) -> None:
        found = KEYWORD.match(line)
        if found is None:
            self.comments.append(line.lstrip("# "))
            return
        key, value = found[1].lower().replace("_", ""), found[2].strip()
        take: dict[str, Callable[[], None]] = {
            "samplename": lambda: setattr(self, "sample", value.strip('"').strip()),
            "format": lambda: self._format(at, value),
            "incidentangle": lambda: self._angles(at, ("intheta", "inphi"), value),
            "colorimetry": lambda: setattr(self, "colorimetry", value.upper()),
        }
        take.get(key, lambda: self._angles(at, (key,), value))()

    def _format(self, at: int, value: str) -> None:
        words = value.upper().split()
        if len(words) < 3 or words[:2] != ["THETA", "PHI"] or words[2] not in QUANTITIES:
            wrong = f"the columns {quote_word(value)} are not known"
            raise self.lines.error(at, wrong, "give theta phi, and BSDF, BRDF, BTDF or DSF")
        self.quantity = words[2]

    def _angles(self, at: int, names: tuple[str, ...], value: str) -> None:
        words = value.replace(",", " ").split()
        if len(words) != len(names):
            raise self.lines.error(at, f"{quote_word(value)} are not the angles {' and '.join(names)}", "correct this line")
        for name, word in zip(names, words, strict=True):
            try:
                self.angles[name] = parse_number(word)
            except NotANumber as error:
                raise self.lines.error(at, error.wrong, error.remedy) from None

    def _list(self, data: np.ndarray) -> ScatteredBsdf:
        channels = XYZ if "XYZ" in self.colorimetry else ("",)
        if not data.size:
            raise FormatError(self.lines.path, "it has no values", "it is cut short: copy it again")
        found = self.lines.numbers(data, 2 + len(channels))
        theta = self.lines.within("theta", found[:, 0], 0.0, 180.0, data)
        self.lines.within("phi", found[:, 1], -360.0, 720.0, data)
        light, phi_light = self.angles["intheta"], self.angles["inphi"]
        if not 0.0 <= light <= 180.0:
            raise FormatError(self.lines.path, f"the light comes from theta {light:g} deg", "give 0 to 180")
        back = light > 90.0
        behind = theta > 90.0 + BEYOND_DEG
        polar = np.where(behind, 180.0 - theta, np.minimum(theta, 90.0))
        # The frame of light on the back is that of the sample turned about x.
        psi, azimuth = (wrap_azimuth(np.negative(each) if back else each) for each in (np.asarray(phi_light), found[:, 1]))
        transmitted = behind != back
        if self.quantity == "BTDF" and not transmitted.any():
            transmitted = ~transmitted
            self.comments.append("a BTDF: polar angles are taken from the normal of the other side")
        if self.angles.get("upphi"):
            self.comments.append(f"the upper edge of the sample is at azimuth {self.angles['upphi']:g} deg of the file")
        values = found[:, 2:] if self.quantity != "DSF" else self._without_cosine(found[:, 2:], polar)
        columns: dict[str, Floats] = {
            "sigma_deg": np.full(polar.size, 180.0 - light if back else light),
            "psi_deg": np.full(polar.size, float(psi)),
            "polar_deg": polar,
            "azimuth_deg": azimuth,
        }
        return ScatteredBsdf(
            **by_channel(columns, values, channels),
            transmitted=np.tile(transmitted, len(channels)),
            back=np.full(polar.size * len(channels), back),
            sample=self.sample,
            comments=tuple(self.comments),
        )

    def _without_cosine(self, values: Floats, polar_deg: Floats) -> Floats:
        cosine = np.cos(np.radians(polar_deg))[:, None]
        horizon = cosine < 1e-9
        if horizon.any():
            self.comments.append("a DSF states no BSDF at 90 deg: these values are missing")
        return np.where(horizon, np.nan, values / np.where(horizon, 1.0, cosine))
