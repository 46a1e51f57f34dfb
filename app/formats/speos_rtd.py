"""Speos exports (.rtd, "OPTIS - Anisotropic BSDF surface file v1.0") of a REFLET goniophotometer. Read.

A file has several measurements, each with its header and two tables; cells are between tabs, line ends may be CR. A table has
an empty cell and a list of phi in its first line, then lines of theta and a value at each phi. The first table is what was
measured, with signed theta and the instrument's phi (`reflet`). The second is the export's own: theta upwards, phi from the
specular ray, and means of neighbours among its values; it is kept as a sample of its own, so that no value counts twice. All
this was found by holding a file against the text export of the same measurements (test_real_bsdf.py). The incidences of the
header ("0 45 90") are not those of the tables: the number at the end of the sample's name is. The value type is intensity (0).
"""

import re
from pathlib import Path

import numpy as np

from goniotwin.app.formats.content import BsdfFile, ScatteredBsdf
from goniotwin.app.formats.file import FormatError, name_file, quote_word
from goniotwin.app.formats.lists import Lines, numbered, observed
from goniotwin.app.formats.reflet import AS_THEY_STAND, directions
from goniotwin.arrays import Floats

FIRST_WORD = b"optis"
TITLE = "optis - anisotropic bsdf surface file v1."
OWN_TABLE = "the export's own table, with means of measured neighbours"
NAME = re.compile(r"\s*SampleID[\s:]*(.*)", re.IGNORECASE)
MOST_TABLES = 1000
LAST_NUMBER = re.compile(r"([0-9]+(?:\.[0-9]+)?)\s*$")


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` begins as all files of Speos do; other versions are refused by name."""
    return head.lstrip(b"\xef\xbb\xbf \t\r\n").lower().startswith(FIRST_WORD)


def read(path: Path) -> BsdfFile:
    """Read a file: two parts for each measurement. Raises FormatError."""
    lines = Lines(path)
    starts = [at for at, line in enumerate(lines.lines) if line.lower().lstrip().startswith(TITLE)]
    if not starts:
        title = next((line.strip() for line in lines.lines if line.strip()), "")
        wrong = f"it begins with {quote_word(title)}, and of Speos only exports of anisotropic BSDF, version 1, are read"
        raise FormatError(path, wrong, "convert it to the tabular .bsdf of Zemax")
    with name_file(path):
        blocks = [_block(lines, start, stop) for start, stop in zip(starts, [*starts[1:], len(lines.lines)], strict=True)]
        names = numbered(block[0] for block in blocks)
        parts = [
            _part(name, *block[1:3], table, k)
            for name, block in zip(names, blocks, strict=True)
            for k, table in enumerate(block[3])
        ]
    return BsdfFile(tuple(parts))


Table = tuple[Floats, Floats, Floats]
"""theta (n,), phi (m,) and values (n, m)."""


def _block(lines: Lines, start: int, stop: int) -> tuple[str, float, list[str], list[Table]]:
    """The sample's name, the incidence, the lines of the header, and the tables of one measurement."""
    heads = [at for at in range(start, stop) if lines.counts[at] and lines.lines[at].startswith("\t")]
    header = [at for at in range(start, heads[0] if heads else stop) if lines.counts[at]]
    named = [found[1].strip() for at in header if (found := NAME.match(lines.lines[at]))]
    number = LAST_NUMBER.search(named[0][-20:]) if named else None
    if number is None or not 0.0 <= float(number[1]) <= 90.0:
        wrong = f"the sample's name {quote_word(named[0] if named else '')} does not end with the incidence, 0 to 90 deg"
        raise lines.error(start, wrong, "export it again, as the instrument names it: Sample 60")
    _refuse_unknown(lines, header)
    if not heads or len(heads) > MOST_TABLES:
        wrong = f"more than {MOST_TABLES} tables follow the header" if heads else "no table follows the header"
        raise lines.error(start, wrong, "it is cut short or damaged: export it again")
    texts = [" ".join(lines.lines[at].split()) for at in header]
    ends = [*heads[1:], stop]
    return named[0], float(number[1]), texts, [_table(lines, head, end) for head, end in zip(heads, ends, strict=True)]


def _refuse_unknown(lines: Lines, header: list[int]) -> None:
    """Refuse transmitted light and BSDF values: no file with them was seen. Title, name and anisotropy vector are above."""
    for at, wanted, what in ((3, ["1", "0"], "light that is reflected only"), (4, ["0"], "intensities")):
        if len(header) <= at:
            raise lines.error(header[-1], "the header ends too early", "it is cut short: export it again")
        if (words := lines.lines[header[at]].split()) != wanted:
            wrong = f"{quote_word(' '.join(words))} is not the mark of {what}"
            raise lines.error(header[at], wrong, "this export is not known")


def _table(lines: Lines, head: int, end: int) -> Table:
    rows = np.array([at for at in range(head + 1, end) if lines.counts[at]], dtype=np.int64)
    if not rows.size:
        raise lines.error(head, "no line of theta follows this list of phi", "it is cut short: export it again")
    phi = lines.numbers(np.array([head]), int(lines.counts[head]))[0]
    found = lines.numbers(rows, 1 + phi.size)
    theta = lines.within("theta", found[:, 0], -90.0, 90.0, rows)
    if not (np.all(np.abs(phi) <= 360.0) and np.all(np.diff(phi) > 0.0) and np.all(np.diff(theta) > 0.0)):
        raise lines.error(head, "theta or phi of the table do not ascend", "it is damaged: export it again")
    return theta, phi, found[:, 1:]


def _part(name: str, light: float, header: list[str], table: Table, index: int) -> ScatteredBsdf:
    theta, phi, values = table
    grid = np.repeat(theta, phi.size), np.tile(phi, theta.size)
    # phi of the first table is the instrument's, and of the second the azimuth from the specular ray.
    polar, azimuth = directions(*grid) if index == 0 else observed(grid[0], grid[1] + 180.0)
    comments = (AS_THEY_STAND, *([] if index == 0 else [OWN_TABLE]), *header)
    return ScatteredBsdf(
        np.full(polar.size, light),
        np.zeros(polar.size),
        polar,
        azimuth,
        values.ravel(),
        sample=name if index == 0 else f"{name}, table {index + 1}",
        comments=comments,
    )
