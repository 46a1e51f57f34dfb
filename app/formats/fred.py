"""FRED's text of a tabulated BSDF. Read.

    type bsdf_data
    format angles=deg bsdf=value scale=1
    10 0
    0 0 0.031984
    5 10 0.033851

After the two lines at the top: the polar angle and azimuth of the specular ray in a line of two numbers, then polar angle,
azimuth and value in 1/sr of each direction, until the next line of two. A negative polar angle is on the other side of the
normal. So Photon Engineering describes it (help.photonengr.com, "Tabulated BSDF"; FRED's own export has columns "Spec Polar,
Spec Azimuth, Scatter Polar, Scatter Azimuth"): azimuths are counted from the specular ray, not from the light. A sample with
one azimuth of incidence is isotropic, and if half of the azimuths are there, the others are their mirror image.
"""

import re
from pathlib import Path

import numpy as np

from goniotwin.app.formats.content import BsdfFile, ScatteredBsdf
from goniotwin.app.formats.coverage import is_one_sided
from goniotwin.app.formats.file import FormatError, name_file, quote_word
from goniotwin.app.formats.lists import ASSUMED_REFLECTED, Lines, incidences, observed, opposite, turned
from goniotwin.app.formats.numerals import NotANumber, parse_number
from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import wrap_azimuth

FIRST_LINE = re.compile(rb"\A(?:\xef\xbb\xbf)?(?:\s*[#!][^\r\n]*[\r\n])*\s*type\s*[= \t]\s*bsdf_data", re.IGNORECASE)
TEXT = re.compile(r"[#!]|[A-Za-z]{2,}")
"""A line of text begins so: a damaged number does not."""


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` names its type, bsdf_data."""
    return bool(FIRST_LINE.match(head))


def read(path: Path) -> BsdfFile:
    """Read a file: one part. Raises FormatError."""
    lines = Lines(path)
    with name_file(path):
        return BsdfFile((_list(lines),))


def _list(lines: Lines) -> ScatteredBsdf:
    scale, comments, data = _header(lines)
    if data.size and lines.counts[data[0]] == 5:
        light, out, values = _five_columns(lines, data)
    else:
        light, out, values = incidences(lines, data)
    psi, azimuth, isotropic = turned(opposite(light[:, 1]), out[:, 1])
    comments = [*comments, ASSUMED_REFLECTED]
    if isotropic and is_one_sided(azimuth - psi):
        comments.append("the directions are on one side of the plane of incidence: the others are their mirror image")
    return ScatteredBsdf(light[:, 0], psi, out[:, 0], azimuth, scale * values, isotropic=isotropic, comments=tuple(comments))


def _header(lines: Lines) -> tuple[float, list[str], Ints]:
    """The factor of the values, the lines of text, and the indices of those of numbers."""
    is_text = np.fromiter((TEXT.match(line.lstrip()) is not None for line in lines.lines), np.bool_, len(lines.lines))
    texts = [(at, lines.lines[at].strip()) for at in np.flatnonzero(is_text).tolist()]
    formats = [(at, line) for at, line in texts if line.lower().startswith("format")]
    if len(formats) != 1:
        wrong = f"it has {len(formats)} lines that begin with format"
        raise FormatError(lines.path, wrong, "write one, such as: format angles=deg bsdf=value scale=1")
    at, line = formats[0]
    scale = 1.0
    words = line.replace("=", " = ").split()
    for k in (k for k, word in enumerate(words) if word == "="):
        name, value = words[k - 1], (words[k + 1 : k + 2] or [""])[0]
        option = (name.lower(), value.lower())
        if option[0] == "scale":
            try:
                scale = parse_number(value)
            except NotANumber as error:
                raise lines.error(at, f"scale: {error.wrong}", error.remedy) from None
        elif option not in (("angles", "deg"), ("bsdf", "value")):
            raise lines.error(at, f"{quote_word(f'{name}={value}')} is not read", "export angles=deg bsdf=value")
    comments = [line.lstrip("#! ") for index, line in texts if index != at and not line.lower().startswith("type")]
    return scale, comments, np.flatnonzero(~is_text & (lines.counts > 0))


def _five_columns(lines: Lines, data: Ints) -> tuple[Floats, Floats, Floats]:
    """FRED's export with the angles of the specular ray in each line."""
    found = lines.numbers(data, 5)
    sigma = lines.within("the polar angle of the specular ray", found[:, 0], 0.0, 90.0, data)
    signed = lines.within("the polar angle of observation", found[:, 2], -90.0, 90.0, data)
    for column in (1, 3):
        lines.within("an azimuth", found[:, column], -360.0, 360.0, data)
    light = np.stack([sigma, wrap_azimuth(found[:, 1])], axis=1)
    return light, np.stack(observed(signed, found[:, 3]), axis=1), found[:, 4]
