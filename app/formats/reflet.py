"""Text exports of a REFLET goniophotometer (STIL; J&C RT-300S): intensities in a table of angles. Read.

    Name / Comment :     OJN / ART-90-050B-87106_long
    Data file type :     Intensity BRDF
    Phi measure beginning :     -90
    Phi measure end :     -80
    Phi measure step :     10
    Theta Lighting     60
    -30     -33840.56     -28943.84
    0     -29921.04     -25360.4

A file has several measurements, each with its keywords; line ends may be CR. After them come lines of theta and a value at
each phi. theta is signed, and phi the azimuth of the scan: theta 30 at phi -90 is the specular ray of an incidence of 30 (the
file's own "Calibration Value" is taken there; ua-loft/bsdf-tools, rt300s_frame_to_fred.m, has the same turn of 90 deg). The
values are the instrument's: the file states no unit, nor whether a cosine is in them, so that they stay as they are, negative
ones included.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from goniotwin.app.formats.content import BsdfFile, ScatteredBsdf
from goniotwin.app.formats.file import FormatError, name_file, quote_word
from goniotwin.app.formats.lists import Lines, numbered, observed
from goniotwin.app.formats.numerals import NotANumber, parse_number
from goniotwin.arrays import Floats

FIRST_LINE = re.compile(rb"\A(?:\xef\xbb\xbf)?\s*Name\s*/\s*Comment\s*:", re.IGNORECASE)
SEPARATOR = re.compile(r":|\t|\s\s")
SPECULAR_PHI_DEG = -90.0
"""phi of the half plane of the specular ray, for positive theta."""
AS_THEY_STAND = "intensities of the instrument, as they stand: neither unit nor cosine is stated"
MOST_COLUMNS = 3601


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` begins with the name and comment of a measurement."""
    return bool(FIRST_LINE.match(head))


def directions(theta_deg: Floats, phi_deg: Floats) -> tuple[Floats, Floats]:
    """Polar angles and azimuths from the light, of the instrument's signed theta and phi."""
    return observed(theta_deg, phi_deg - SPECULAR_PHI_DEG + 180.0)


def read(path: Path) -> BsdfFile:
    """Read a file: a part for each measurement of a sample, with all of its incidences. Raises FormatError."""
    lines = Lines(path)
    starts = [at for at, line in enumerate(lines.lines) if line.lower().lstrip().startswith("name / comment")]
    if not starts or any(line.strip() for line in lines.lines[: starts[0]]):
        raise FormatError(path, "it does not begin with Name / Comment", "give the text export of the instrument")
    with name_file(path):
        blocks = [
            _Block(lines, start, stop).values() for start, stop in zip(starts, [*starts[1:], len(lines.lines)], strict=True)
        ]
    return BsdfFile(tuple(_by_measurement(blocks)))


def _by_measurement(blocks: list[ScatteredBsdf]) -> list[ScatteredBsdf]:
    """Blocks of one sample joined, until an incidence is there again: that is another measurement."""
    groups: list[list[ScatteredBsdf]] = []
    for block in blocks:
        if groups and groups[-1][0].sample == block.sample and block.sigma_deg[0] not in [b.sigma_deg[0] for b in groups[-1]]:
            groups[-1].append(block)
        else:
            groups.append([block])
    names = numbered(group[0].sample for group in groups)
    return [
        ScatteredBsdf(**{**vars(ScatteredBsdf.join(group)), "sample": name}) for group, name in zip(groups, names, strict=True)
    ]


@dataclass
class _Block:
    """One measurement: the lines from `start` to before `stop`."""

    lines: Lines
    start: int
    stop: int
    stated: dict[str, tuple[int, str]] = field(default_factory=dict)

    def values(self) -> ScatteredBsdf:
        """Its values. Raises FormatError."""
        table = []
        for at in range(self.start, self.stop):
            line = self.lines.lines[at].lstrip().removeprefix("'")
            if line[:1].isalpha() and (found := SEPARATOR.search(line)):
                value = line[found.end() :].strip().removeprefix(":").strip()
                self.stated[" ".join(line[: found.start()].lower().split())] = (at, value)
            elif self.lines.counts[at]:
                table.append(at)
        self._refuse_unknown()
        phi, rows = self._axis("phi"), np.array(table, dtype=np.int64)
        found_numbers = self.lines.numbers(rows, 1 + phi.size)
        theta = self.lines.within("theta", found_numbers[:, 0], -90.0, 90.0, rows)
        wanted = self._axis("theta")
        if theta.size != wanted.size or not np.allclose(theta, wanted, atol=1e-3):
            wrong = f"{theta.size} lines of theta, and the keywords announce {wanted.size}, {wanted[0]:g} to {wanted[-1]:g} deg"
            raise self.lines.error(self.start, wrong, "it is cut short or damaged: export it again")
        polar, azimuth = directions(np.repeat(theta, phi.size), np.tile(phi, theta.size))
        light = self._number("theta lighting")
        if not 0.0 <= light <= 90.0:
            raise self.lines.error(self.stated["theta lighting"][0], f"the light comes from {light:g} deg", "give 0 to 90")
        texts = [self.lines.lines[at].strip() for at in range(self.start, self.stop) if at not in set(table)]
        comments = [" ".join(text.split()) for text in texts if text]
        return ScatteredBsdf(
            np.full(polar.size, light),
            np.zeros(polar.size),
            polar,
            azimuth,
            found_numbers[:, 1:].ravel(),
            sample=self.stated.get("name / comment", (0, ""))[1],
            comments=(AS_THEY_STAND, *comments),
        )

    def _refuse_unknown(self) -> None:
        for name, allowed, what in (
            ("data file type", "BRDF", "is not a BRDF"),
            ("spectral mode", "0", "is a spectral measurement"),
            ("theta sample", "0", "has a sample that is turned, in an unknown sense"),
        ):
            at, value = self.stated.get(name, (self.start, allowed))
            same = allowed in value.upper() if name == "data file type" else self._number(name, 0.0) == 0.0
            if not same:
                raise self.lines.error(at, f"it {what}: {quote_word(value)}", "export an intensity BRDF of one wavelength")

    def _number(self, name: str, default: float | None = None) -> float:
        at, value = self.stated.get(name, (self.start, ""))
        if not value and default is not None:
            return default
        try:
            return parse_number(value)
        except NotANumber as error:
            wrong = f"{name}: {error.wrong}" if value else f"{name} is not stated"
            raise self.lines.error(at, wrong, "export it again") from None

    def _axis(self, name: str) -> Floats:
        first, last, step = (self._number(f"{name} measure {each}") for each in ("beginning", "end", "step"))
        count = (last - first) / step if step else (0.0 if first == last else np.inf)
        if not 0.0 <= count < MOST_COLUMNS or abs(count - round(count)) > 1e-3:
            wrong = f"{name} from {first:g} to {last:g} in steps of {step:g} deg is not possible"
            raise self.lines.error(self.stated[f"{name} measure step"][0], wrong, "export it again")
        return np.asarray(first + step * np.arange(round(count) + 1), dtype=np.float64)
