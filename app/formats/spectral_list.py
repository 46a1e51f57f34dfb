"""Lists of spectral samples, as Cornell's gonioreflectometer data are distributed with pbrt (mmp/pbrt-v2, scenes/brdfs). Read.

`#` begins a comment. All else is numbers over lines of any length: the count of wavelengths, the wavelengths in nm, and then
samples in no order: theta_i, phi_i, theta_o, phi_o in radians about the normal, and a value in 1/sr at each wavelength. The
light is reflected by an isotropic sample: so pbrt reads it (src/materials/measured.cpp, "IrregIsotropicBRDFSample"). phi_o -
phi_i is pi at the specular ray: that is where mystique.brdf has its peak.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from goniotwin.app.formats.content import BsdfFile, ScatteredBsdf
from goniotwin.app.formats.file import FormatError, StrPath, name_file
from goniotwin.app.formats.lists import BEYOND_DEG, MOST_BYTES, PLAIN, by_channel, degrees_of, observed
from goniotwin.app.formats.numerals import NotANumber, parse_number
from goniotwin.app.formats.text import read_text
from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.coordinates import wrap_azimuth

COMMENT = re.compile(r"#([^\n]*)")
MOST_WAVELENGTHS = 10_000
AT_ONCE = 1_000_000
"""Characters."""
NOT_RADIANS = "it is damaged, or not of this format (radians)"


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` has the count of wavelengths, the wavelengths and further numbers."""
    text = COMMENT.sub("", head[: 1 << 16].decode("latin-1").replace("\r", "\n"))
    if not PLAIN.fullmatch(text):
        return False
    words = text.split()[:-1]  # the last may be cut
    try:
        count, *numbers = (float(word) for word in words[: MOST_WAVELENGTHS + 2])
    except ValueError:
        return False
    wavelengths = numbers[: int(count)] if 1.0 <= count <= MOST_WAVELENGTHS and count.is_integer() else []
    return bool(wavelengths) and len(numbers) > count and wavelengths[0] >= 100.0 and bool(np.all(np.diff(wavelengths) > 0.0))


def read(path: Path) -> BsdfFile:
    """Read a list: one part. Raises FormatError."""
    text = read_text(path, MOST_BYTES).replace("\r\n", "\n").replace("\r", "\n")
    comments = tuple(line for each in COMMENT.findall(text) if (line := each.strip()))
    numbers = np.concatenate([np.empty(0), *_numbers(path, COMMENT.sub("", text))])
    with name_file(path):
        return BsdfFile((_list(path, numbers, comments),))


def _numbers(path: StrPath, text: str) -> Iterator[Floats]:
    """All numbers, some at a time: they are not in lines."""
    start = 0
    while start < len(text):
        stop = start + AT_ONCE
        while stop < len(text) and not text[stop].isspace():
            stop += 1
        words = text[start:stop].split()
        try:
            found = np.array([float(word) for word in words]) if PLAIN.fullmatch(text, start, stop) else np.array([np.nan])
        except ValueError:
            found = np.array([np.nan])
        if not np.isfinite(found).all():
            _name_fault(path, text, start, stop)
        yield found
        start = stop


def _name_fault(path: StrPath, text: str, start: int, stop: int) -> None:
    for found in re.compile(r"\S+").finditer(text, start, stop):
        try:
            parse_number(found[0])
        except NotANumber as error:
            raise FormatError(path, error.wrong, error.remedy, 1 + text.count("\n", 0, found.start())) from None


def _list(path: StrPath, numbers: Floats, comments: tuple[str, ...]) -> ScatteredBsdf:
    count = numbers[0] if numbers.size else 0.0
    if not (1.0 <= count <= MOST_WAVELENGTHS and count.is_integer()):
        raise FormatError(path, f"{count:g} is not a possible number of wavelengths", "it is the first number of the file")
    wavelengths, rest = numbers[1 : 1 + int(count)], numbers[1 + int(count) :]
    per_sample = 4 + int(count)
    if not rest.size or rest.size % per_sample:
        wrong = f"{rest.size} numbers follow the wavelengths, and a sample at {count:g} wavelengths has {per_sample}"
        raise FormatError(path, wrong, "it is cut short or damaged: copy it again")
    if not (np.all(wavelengths > 0.0) and np.all(np.diff(wavelengths) > 0.0)):
        raise FormatError(path, "the wavelengths do not ascend", "correct the list after the first number")
    samples = rest.reshape(-1, per_sample)
    angles = degrees_of(samples[:, :4])
    polar, azimuth = observed(angles[:, 2], angles[:, 3])
    for name, column, low in (
        ("theta_i", angles[:, 0], 0.0),
        ("theta_o", polar, 0.0),
        ("phi_i", angles[:, 1], -361.0),
        ("phi_o", angles[:, 3], -361.0),
    ):
        high = 90.0 + BEYOND_DEG if low == 0.0 else 361.0
        odd = np.flatnonzero(~((column >= low) & (column <= high)))
        if odd.size:
            raise FormatError(path, f"{name} of sample {odd[0] + 1} is {column[odd[0]]:g} deg", NOT_RADIANS)
    columns = {
        "sigma_deg": np.minimum(angles[:, 0], 90.0),
        "psi_deg": wrap_azimuth(angles[:, 1]),
        "polar_deg": np.minimum(polar, 90.0),
        "azimuth_deg": azimuth,
    }
    return ScatteredBsdf(**by_channel(columns, samples[:, 4:], wavelengths.tolist()), comments=comments)
