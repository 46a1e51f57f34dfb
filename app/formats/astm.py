"""Lists in the style of ASTM E1392: one direction of light and observation a line, with a value for each wavelength or colour.

    (any lines)
    NUM_POINTS 2
    VARS theta_i,phi_i,theta_s,phi_s,450nm,550nm
    0.52359877560,0.00000000000,0.52359877560,3.14159265359,0.31,0.32

Angles are radians about the normal, values are 1/sr, in no order. The standard itself (ASTM E1392-96, withdrawn) was not
seen: this is the layout of Cornell's measurements, as the public reader of libbsdf has it (AstmReader.cpp, commit 232971f):
names R,G,B or X,Y,Z are colours, names with nm wavelengths, any other single name is grey. No file states whether it is a BRDF
or a BTDF, unless a line of the header has that word; this writer writes it. Polar angles beyond pi / 2: transmitted light.
"""

import itertools
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np

from goniotwin.app.formats.content import ANGLES, BsdfFile, ScatteredBsdf
from goniotwin.app.formats.file import FormatError, StrPath, name_file, quote_word
from goniotwin.app.formats.lists import (
    ASSUMED_REFLECTED,
    BEYOND_DEG,
    Lines,
    by_channel,
    degrees_of,
    observed,
    one_list,
    refuse_mixture,
)
from goniotwin.app.formats.numerals import NotANumber, format_number, parse_number
from goniotwin.app.formats.text import comment_lines, write_text
from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import wrap_azimuth

TITLE = "ASTM list"
OWN_LINE = "goniotwin list of a "
VARS = re.compile(rb"(?:^|[\r\n])[ \t]*VARS[ \t,]+\"?theta_i", re.IGNORECASE)
KEYWORD = re.compile(r"[ \t]*(NUM_POINTS|VARS)(?![^\s,:=])[\s,:=]*(.*)", re.IGNORECASE)
VARIABLES = (("theta_i",), ("phi_i",), ("theta_s", "theta_r", "theta_o"), ("phi_s", "phi_r", "phi_o"))
COLOURS = {
    "r": "red",
    "g": "green",
    "b": "blue",
    "x": "X",
    "y": "Y",
    "z": "Z",
    "red": "red",
    "green": "green",
    "blue": "blue",
}

WAVELENGTH = re.compile(r"([0-9.]+)[ \t]*nm", re.IGNORECASE)
ROWS_AT_ONCE = 1 << 16


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` has a line of variables that begins with theta_i."""
    return bool(VARS.search(head))


# ---- reading ----


def read(path: Path) -> BsdfFile:
    """Read a list: one part. Raises FormatError."""
    lines = Lines(path)
    with name_file(path):
        return BsdfFile((_list(lines),))


def _list(lines: Lines) -> ScatteredBsdf:
    count, names, start, header = _header(lines)
    channels = _channels(lines, names, start - 1)
    data = np.flatnonzero(lines.counts[start:]) + start
    if count is not None and data.size < count:
        wrong = f"NUM_POINTS is {count}, but {data.size} lines of numbers follow"
        raise FormatError(lines.path, wrong, "it is cut short: copy it again, or correct the count")
    if not data.size:
        raise FormatError(lines.path, "no line of numbers follows VARS", "it is cut short: copy it again")
    lines.separate(data, ",")  # with blanks around them, or blanks alone
    found = lines.numbers(data, 4 + len(channels))
    angles = degrees_of(found[:, :4])
    remedy = "write radians, or correct it"
    sigma = lines.within("theta_i", angles[:, 0], 0.0, 90.0, data, remedy)
    out = lines.within("theta_s", angles[:, 2], -180.0, 180.0, data, remedy)
    for name, at in (("phi_i", 1), ("phi_s", 3)):
        lines.within(name, angles[:, at], -361.0, 361.0, data, remedy)
    comments, stated = _stated(header)
    polar, azimuth = observed(out, angles[:, 3])
    beyond = polar > 90.0 + BEYOND_DEG
    columns = {
        "sigma_deg": sigma,
        "psi_deg": wrap_azimuth(angles[:, 1]),
        "polar_deg": np.where(beyond, 180.0 - polar, np.minimum(polar, 90.0)),
        "azimuth_deg": azimuth,
    }
    whole = " ".join(header)
    btdf, brdf = (re.search(rf"\b{word}\b", whole, re.IGNORECASE) is not None for word in ("BTDF", "BRDF"))
    transmitted = beyond | (btdf and not brdf)
    if btdf == brdf and not beyond.any():
        comments.append(ASSUMED_REFLECTED)
    if count is not None and data.size > count:
        comments.append(f"NUM_POINTS is {count}, and {data.size} lines of numbers follow, which are all read")
    isotropic = "anisotropic" not in stated if stated else np.unique(columns["psi_deg"]).size == 1
    return ScatteredBsdf(
        **by_channel(columns, found[:, 4:], channels),
        transmitted=np.tile(transmitted, len(channels)),
        back=np.full(found.shape[0] * len(channels), "back" in stated),
        sample=_sample(header),
        isotropic=isotropic,
        generated="simulated" in stated,
        comments=tuple(comments),
    )


def _header(lines: Lines) -> tuple[int | None, list[str], int, list[str]]:
    """NUM_POINTS, the names of VARS, the index of the line after it, and the other lines."""
    count = None
    header = []
    for at, line in enumerate(lines.lines):
        found = KEYWORD.match(line)
        if found is None:
            header.append(line)
        elif found[1].upper() == "NUM_POINTS":
            if not re.fullmatch(r"[0-9]{1,9}", found[2].strip()):
                raise lines.error(
                    at, f"NUM_POINTS {quote_word(found[2])} is not a count", "write the number of lines that follow"
                )
            count = int(found[2])
        else:
            split = "," if "," in found[2] else None
            return count, [name.strip().strip('"') for name in found[2].split(split)], at + 1, header
    raise FormatError(lines.path, "it has no line of VARS", "add it before the numbers: VARS theta_i,phi_i,theta_s,phi_s,550nm")


def _channels(lines: Lines, names: Sequence[str], at: int) -> list[float | str]:
    """The wavelength, nm, or the name of the colour of each column after the angles; an empty name for grey."""
    angles = [name.lower() for name in names[:4]]
    if len(angles) < 4 or not all(name in known for name, known in zip(angles, VARIABLES, strict=True)):
        raise lines.error(at, f"VARS begins with {','.join(map(quote_word, names[:4]))}", "write theta_i,phi_i,theta_s,phi_s")
    rest = [name for name in names[4:] if name]
    if not rest or len(rest) != len(names) - 4:
        raise lines.error(at, "VARS has no name for each column of values", "add it, such as 550nm")
    spectral = [WAVELENGTH.fullmatch(name) for name in rest]
    if all(spectral):
        try:
            wavelengths = [parse_number(each[1]) for each in spectral if each]
        except NotANumber as error:
            raise lines.error(at, error.wrong, error.remedy) from None
        if len(set(wavelengths)) != len(wavelengths) or min(wavelengths) <= 0.0:
            raise lines.error(at, "VARS has a wavelength of 0, or one twice", "correct the names")
        return list(wavelengths)
    colours = [COLOURS.get(name.lower(), "") for name in rest]
    if colours in (["red", "green", "blue"], ["X", "Y", "Z"]):
        return list(colours)
    if len(rest) == 1 and not spectral[0]:
        return [""]
    wrong = f"the columns {', '.join(map(quote_word, rest[:9]))} are not known"
    raise lines.error(at, wrong, "name them 450nm,550nm or R,G,B or X,Y,Z")


def _stated(header: Iterable[str]) -> tuple[list[str], str]:
    """The comments, and what a list of this program states about itself."""
    lines = [line.strip().removeprefix("#").removeprefix(" ").rstrip() for line in header]
    own = next((line for line in lines if line.startswith(OWN_LINE)), "")
    return [line for line in lines if line and line != own and not (own and line.startswith("sample: "))], own


def _sample(header: Iterable[str]) -> str:
    found = (re.match(r"[\s#]*sample\s*[:=]\s*(.*)", line, re.IGNORECASE) for line in header)
    return next((each[1].strip() for each in found if each), "")


# ---- writing ----


def write(path: Path, content: BsdfFile) -> None:
    """Write the values of one sample, side and kind of light; not those that are missing. Raises FormatError."""
    values = one_list(path, content, TITLE)
    transmitted = refuse_mixture(path, TITLE, values.transmitted, "reflected light", "transmitted light")
    back = refuse_mixture(path, TITLE, values.back, "light on the front", "light on the back")
    measured = values.where(np.isfinite(values.values))
    if not measured.size:
        raise FormatError(path, "there is no value to write", "write values that were measured")
    rows, table, channels = _by_direction(path, measured)
    about = [
        "BTDF" if transmitted else "BRDF",
        *(["lit on the back"] if back else []),
        *(["simulated"] if values.generated else []),
        "isotropic sample" if values.isotropic else "anisotropic sample",
    ]
    without = values.size - measured.size
    comments = [
        OWN_LINE + ", ".join(about),
        *([f"sample: {values.sample}"] if values.sample else []),
        "light and observed directions about the normal, rad; values in 1/sr",
        *([f"{without} directions without a value are not written"] if without else []),
        *content.heading(values.comments),
    ]
    head = [f"# {_safe(line)}".rstrip() for line in comment_lines(comments, ascii_only=True)]
    head += [f"NUM_POINTS {table.shape[1]}", f"VARS theta_i,phi_i,theta_s,phi_s,{','.join(channels)}\n"]
    write_text(path, itertools.chain(["\n".join(head)], _rows(rows, table)))


def _safe(line: str) -> str:
    """A comment without the words that a reader looks for anywhere."""
    return re.sub(r"(?<!\S)(VARS|NUM_POINTS)(?!\S)", lambda found: found[0].lower(), line)


def _by_direction(path: StrPath, values: ScatteredBsdf) -> tuple[Floats, Floats, list[str]]:
    """Angles in rad (4, rows), values (channels, rows) and the channels' names. Each direction has all channels.

    A direction that was measured twice is there twice.
    """
    names, of_value = _named_channels(path, values)
    counts = np.bincount(of_value, minlength=len(names))
    order = np.lexsort((values.azimuth_deg, values.polar_deg, values.psi_deg, values.sigma_deg, of_value))
    directions = np.array([getattr(values, each)[order] for each in ANGLES])
    blocks = directions.reshape(4, len(names), -1) if (counts == counts[0]).all() else None
    if blocks is None or not bool((blocks == blocks[:, :1]).all()):
        wrong = f"an {TITLE} has a value of each wavelength at each direction, and some are missing"
        raise FormatError(path, wrong, "write one wavelength a file, or leave these directions out")
    table = values.values[order].reshape(len(names), -1)
    in_file = np.argsort(order[: counts[0]], kind="stable")
    return np.radians(blocks[:, 0, in_file]), table[:, in_file], names


def _named_channels(path: StrPath, values: ScatteredBsdf) -> tuple[list[str], Ints]:
    """The names of the channels as VARS has them, and the index of each value's channel."""
    wavelengths, of_value = np.unique(values.wavelength_nm, return_inverse=True)
    colours_there = values.channel
    if not (colours_there != "").any():
        names = ["BSDF" if np.isnan(each) else f"{format_number(each)}nm" for each in wavelengths.tolist()]
        if len(set(names)) == len(names) and (len(names) == 1 or "BSDF" not in names):
            return names, of_value
        raise FormatError(path, f"an {TITLE} has no room for {', '.join(names[:9])} together", "write them in several files")
    for colours in (("red", "green", "blue"), ("X", "Y", "Z")):
        of_value = np.argmax(np.array(colours)[:, None] == colours_there, axis=0)
        if set(colours_there.tolist()) == set(colours):
            return [next(name for name, each in COLOURS.items() if each == colour).upper() for colour in colours], of_value
    known = np.unique(colours_there)[:9].tolist()
    wrong = f"an {TITLE} has no room for the colours {', '.join(map(quote_word, known))}"
    raise FormatError(path, wrong, "write red, green and blue, or X, Y and Z, or wavelengths")


def _rows(angles: Floats, table: Floats) -> Iterator[str]:
    # With eleven decimals pi / 2 is not above itself, as it is with nine.
    line = ",".join(["%.11f"] * len(angles) + ["%.9g"] * len(table)) + "\n"
    for start in range(0, angles.shape[1], ROWS_AT_ONCE):
        some = np.concatenate([each[:, start : start + ROWS_AT_ONCE] for each in (angles, table)]).T
        yield line * len(some) % tuple(some.ravel().tolist())  # one call for many rows
