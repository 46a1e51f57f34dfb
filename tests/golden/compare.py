"""What is found now, held against the golden files: exactly, or to 1e-12; a difference is named by file, column and rows.

Numba compiles for the processor that it finds, and processors add the terms of a sum in different orders. So a value that is
the small difference of large ones, as an uncertainty is, may differ by rounding: it is held against the largest of its column.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from goniotwin.arrays import Floats
from tests.golden.files import Table, Tables, number

RELATIVE = 1e-12
ANGLE_DEG = 1e-10
"""Angles may be zero but for the last digit."""
TABLE = 2e-9
"""Files have nine significant digits."""
PROCESSOR = 1e-6
"""Difference of a simulated value between an AVX2 and an AVX-512 processor, relative; found: 2e-7."""
U_PROCESSOR = 1e-9
"""That of an uncertainty, as part of the largest of its column: a small one is what is left of large terms."""
U_FIT = 1e-10
"""That of an uncertainty of a campaign, for its fits are of the processor's own LAPACK; found: 4e-12 by AVX-512 from AVX2."""


@dataclass(frozen=True)
class Bound:
    """By how much a number may differ: relative, absolute, or as part of the largest of its column, whichever is most."""

    relative: float = 0.0
    absolute: float = 0.0
    of_largest: float = 0.0


EXACT, TIME = Bound(), Bound(RELATIVE)
VALUE, ANGLE, UNCERTAINTY = Bound(RELATIVE, 0.0, RELATIVE), Bound(RELATIVE, ANGLE_DEG), Bound(RELATIVE, 0.0, U_FIT)
Bounds = Mapping[str, Bound]
"""Those of the columns that are not exact."""
POINTS: Bounds = {
    **dict.fromkeys(("wavelength_nm", "bsdf", "signature"), VALUE),
    **dict.fromkeys(("sigma_deg", "gamma_deg", "beta_deg", "shift_deg", "zenith_deg", "azimuth_deg"), ANGLE),
    **dict.fromkeys(("theta_deg", "phi_deg"), ANGLE),
    **dict.fromkeys(("u_bsdf", "u_field"), UNCERTAINTY),
}
ROWS: Bounds = dict.fromkeys(("started_s", "ended_s", "first_s", "period_s", "monitor_a"), TIME)
PLAN: Bounds = {"seconds": TIME}
TABLE_3: Bounds = dict.fromkeys(("2 deg", "5 deg", "15 deg", "30 deg"), TIME)
BOUNDS: Bounds = {**POINTS, **ROWS, **PLAN}
"""Of all tables of campaigns and plans: a column of a name is of one quantity in all of them."""
FILE: Bounds = {"": Bound(TABLE)}
SIMULATED: Bounds = {"": Bound(PROCESSOR), "standard_error": Bound(PROCESSOR, 0.0, U_PROCESSOR)}


@dataclass(frozen=True)
class Difference:
    """The cells of a column that differ, by their rows, as they are now and in the golden file."""

    column: str
    size: int
    rows: list[int]
    found: list[str]
    golden: list[str]

    @property
    def relative(self) -> Floats:
        """The relative changes of those that are numbers, of the larger magnitude."""
        now, then = (np.array([number(each) for each in cells]) for cells in (self.found, self.golden))
        known = np.isfinite(now) & np.isfinite(then)
        largest = np.maximum(np.abs(now[known]), np.abs(then[known]))
        changes: Floats = np.abs(now[known] - then[known]) / np.where(largest > 0.0, largest, 1.0)
        return changes

    def __str__(self) -> str:
        sizes, first = self.relative, f"row {self.rows[0]}: {self.found[0]!r}, golden {self.golden[0]!r}"
        much = f", by {np.median(sizes):.2g} in the median, at most {sizes.max():.2g}" if sizes.size else ""
        return f"{self.column}: {len(self.rows)} of {self.size} differ{much}; the first in {first}"


def differences(found: Table, golden: Table, bounds: Bounds) -> list[Difference]:
    """The columns that differ by more than their bounds. Raises AssertionError for other columns or another number of rows."""
    assert list(found.columns) == list(golden.columns), f"its columns are {list(found.columns)}, not {list(golden.columns)}"
    assert len(found) == len(golden), f"it has {len(found)} rows, golden are {len(golden)}"
    result = []
    for name, column in found.columns.items():
        then = golden.columns[name]
        rows = differing(column, then, bounds.get(name, bounds.get("", EXACT)))
        if rows:
            result.append(Difference(name, len(column), rows, [column[k] for k in rows], [then[k] for k in rows]))
    return result


def differing(found: Sequence[str], golden: Sequence[str], bound: Bound) -> list[int]:
    """The rows in which two columns differ by more than a bound; words, and empty cells, are the same or differ."""
    rows = [k for k, (now, then) in enumerate(zip(found, golden, strict=True)) if now != then]
    if not rows or bound == EXACT:
        return rows
    absolute = max(bound.absolute, bound.of_largest * largest(golden) if bound.of_largest else 0.0)
    allowed = [max(bound.relative * abs(number(golden[k])), absolute) for k in rows]
    return [k for k, most in zip(rows, allowed, strict=True) if not abs(number(found[k]) - number(golden[k])) <= most]


def largest(column: Sequence[str]) -> float:
    """The largest magnitude of the finite values of a column."""
    values = np.abs([number(each) for each in column])
    return float(np.max(values[np.isfinite(values)], initial=0.0))


def check_table(found: Table, golden: Table, where: str, bounds: Bounds = BOUNDS) -> None:
    """A table is the golden one; else all columns that differ are named."""
    try:
        wrong = differences(found, golden, bounds)
    except AssertionError as other:
        raise AssertionError(f"{where}: {other}") from None
    assert not wrong, "\n".join([f"{where}:", *map(str, wrong)])


def check_tables(found: Tables, golden: Tables, where: str) -> None:
    """The tables are the golden ones."""
    assert found.keys() == golden.keys(), where
    for name, each in found.items():
        check_table(each, golden[name], f"{where}/{name}.csv")


def check_lines(found: list[str], golden: list[str], where: str, *, simulated: bool = False) -> None:
    """A file's lines, without comments, are the golden ones: words exactly, numbers but for their last digit.

    `simulated` numbers but for the processor.
    """
    check_table(words_table(found), words_table(golden), where, SIMULATED if simulated else FILE)


def words_table(lines: list[str]) -> Table:
    """The words of lines: those of a CSV by the titles in its first line, those of another file by line and place."""
    if lines and "," in lines[0]:
        rows = [line.split(",") for line in lines]
        assert {len(row) for row in rows} == {len(rows[0])}, "lines of different lengths"
        return Table({title: [row[k] for row in rows[1:]] for k, title in enumerate(rows[0])})
    words = [(f"{k + 1}", f"{j + 1}", word) for k, line in enumerate(lines) for j, word in enumerate(line.split())]
    return Table({title: [each[k] for each in words] for k, title in enumerate(("line", "place", "word"))})
