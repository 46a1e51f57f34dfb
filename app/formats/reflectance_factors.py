"""Lists of reflectance factors in bands, as the black laboratory of the University of Arizona writes them. Read.

    BRF Values
    RSG Spectralon 7, (2 inch dia) aperture in wall
    src_z   src_a   view_z   view_a   385.65nm   413.91nm
      0.000   0.000   45.000   180.000   0.999567   1.006003

Polar angles and azimuths of source and view in deg, both counted from the same mark; a value is pi times the BSDF. That is how
the public reader of such files takes them (ua-loft/bsdf-tools, load_single_blacklab.m, blacklab_frame_to_fred.m). A direction
may be there several times: each is a measurement.
"""

import re
from pathlib import Path

import numpy as np

from goniotwin.app.formats.content import BsdfFile, ScatteredBsdf
from goniotwin.app.formats.file import FormatError, name_file, quote_word
from goniotwin.app.formats.lists import Lines, by_channel, observed
from goniotwin.app.formats.numerals import NotANumber, parse_number
from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.coordinates import wrap_azimuth

ANGLES = ("src_z", "src_a", "view_z", "view_a")
NAMES = re.compile(rb"(?:^|[\r\n])[ \t]*src_z[ \t]+src_a[ \t]+view_z[ \t]+view_a\s", re.IGNORECASE)
FACTOR = re.compile(r"\bBRF\b|reflectance factor", re.IGNORECASE)
BAND = re.compile(r"([0-9.]+)(nm|um)", re.IGNORECASE)


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` has the names of the four angles in a line."""
    return bool(NAMES.search(head))


def read(path: Path) -> BsdfFile:
    """Read a list: one part. Raises FormatError."""
    lines = Lines(path)
    with name_file(path):
        return BsdfFile((_list(lines),))


def _list(lines: Lines) -> ScatteredBsdf:
    at = next((k for k, line in enumerate(lines.lines) if line.lower().split()[:4] == list(ANGLES)), None)
    if at is None:
        raise FormatError(lines.path, f"it has no line of the names {' '.join(ANGLES)}", "add it before the numbers")
    title = [line.strip() for line in lines.lines[:at] if line.strip()]
    if not FACTOR.search(" ".join(title)):
        wrong = "the lines at the top do not state that the values are reflectance factors (BRF)"
        raise FormatError(lines.path, wrong, "add a line such as: BRF Values")
    bands = [_band(lines, at, word) for word in lines.lines[at].split()[4:]]
    if not bands or not all(np.diff(sorted(bands)) > 0.0):
        raise lines.error(at, "no band follows the angles, or one is there twice", "name each, such as 550nm")
    data = np.flatnonzero(lines.counts[at + 1 :]) + at + 1
    lines.separate(data, ",;")
    found = lines.numbers(data, 4 + len(bands), missing=True)
    if not data.size:
        raise FormatError(lines.path, "it has no values", "it is cut short: copy it again")
    sigma = lines.within("src_z", found[:, 0], -90.0, 90.0, data)
    view = lines.within("view_z", found[:, 2], -90.0, 90.0, data)
    for name, column in (("src_a", 1), ("view_a", 3)):
        lines.within(name, found[:, column], -360.0, 360.0, data)
    sigma, psi = observed(sigma, found[:, 1])
    polar, azimuth = observed(view, found[:, 3])
    columns: dict[str, Floats] = {"sigma_deg": sigma, "psi_deg": psi, "polar_deg": polar, "azimuth_deg": wrap_azimuth(azimuth)}
    values: Floats = found[:, 4:] / np.pi
    comments = (*title, "values of the file are reflectance factors, pi times the BSDF")
    sample = title[1] if len(title) > 1 else ""
    return ScatteredBsdf(
        **by_channel(columns, values, bands), sample=sample, comments=comments, isotropic=np.unique(psi).size == 1
    )


def _band(lines: Lines, at: int, word: str) -> float:
    found = BAND.fullmatch(word)
    if found is None:
        raise lines.error(at, f"{quote_word(word)} is not the name of a band", "name it by its wavelength, such as 550nm")
    try:
        return parse_number(found[1]) * (1.0 if found[2].lower() == "nm" else 1000.0)
    except NotANumber as error:
        raise lines.error(at, error.wrong, error.remedy) from None
