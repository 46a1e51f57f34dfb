"""What a text format has no keyword for stands in its comments, one line each: the sample's name, the lit side, a wavelength.

A reader takes these lines back, so that nothing is lost between two files of this program; other programs skip them.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from goniotwin.app.formats.content import RegularTable
from goniotwin.app.formats.numerals import NUMBER, format_number
from goniotwin.app.formats.table import BsdfTable

SAMPLE = "sample: "
BACK = "side: back (the frame is that of the sample turned about x)"
WAVELENGTH, NANOMETRES = "wavelength: ", " nm"

HALF = "the file has half of the azimuths and does not state a symmetry; the other half is taken as the mirror image"


@dataclass(frozen=True)
class Notes:
    """What comments state, and the other `comments`."""

    sample: str
    back: bool
    wavelengths_nm: tuple[float, ...] | None
    comments: tuple[str, ...]


def noted(part: BsdfTable | RegularTable, *, wavelength: bool = False) -> tuple[str, ...]:
    """The comments of a part after those for its name and side, and for its one `wavelength`, if the format has no room."""
    lines = [f"{SAMPLE}{part.sample}"] if part.sample else []
    if part.back:
        lines.append(BACK)
    if wavelength and part.wavelengths_nm:
        lines.append(f"{WAVELENGTH}{format_number(part.wavelengths_nm[0])}{NANOMETRES}")
    return (*lines, *part.comments)


def read_notes(comments: Iterable[str]) -> Notes:
    """What the comments at the top of a file state. A file of another program may have such a line by chance: of several, the
    first counts."""
    sample, back, wavelengths_nm, rest = "", False, None, []
    for line in comments:
        if line.startswith(SAMPLE) and not sample and line.removeprefix(SAMPLE).strip():
            sample = line.removeprefix(SAMPLE).strip()
        elif line == BACK and not back:
            back = True
        elif (nanometres := _wavelength(line)) is not None and wavelengths_nm is None:
            wavelengths_nm = (nanometres,)
        else:
            rest.append(line)
    return Notes(sample, back, wavelengths_nm, tuple(rest))


def _wavelength(line: str) -> float | None:
    number = line.removeprefix(WAVELENGTH).removesuffix(NANOMETRES)
    if f"{WAVELENGTH}{number}{NANOMETRES}" != line or not NUMBER.fullmatch(number) or not 1e-3 <= float(number) <= 1e9:
        return None
    return float(number)
