"""The golden files: tables as CSV, one line a row, one file a table; other text as it is.

data/quick/points-gaussian-5.csv     the points of a sample, a campaign a folder
data/transmission/points-opal.csv    where there are many rows, some of them,
data/transmission/points-opal-rest.csv    and sums over blocks of all others
"""

import csv
import hashlib
import io
import math
from collections import Counter
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

DATA = Path(__file__).resolve().parent / "data"
FEW_WORDS = 4
"""So many different words of a block are counted; of more the digest alone is stated."""
Tables = dict[str, "Table"]


@dataclass(frozen=True)
class Table:
    """Columns of one length, as text; a number that is none is empty."""

    columns: Mapping[str, list[str]]

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def take(self, rows: Iterable[int]) -> "Table":
        """Some of the rows."""
        chosen = list(rows)
        return Table({name: [column[k] for k in chosen] for name, column in self.columns.items()})


def table(columns: Mapping[str, Iterable[object]], inexact: Container[str] = ()) -> Table:
    """The table of columns of any values; numbers have all their digits, those of `inexact` columns 15."""
    return Table({name: [text(each, name not in inexact) for each in column] for name, column in columns.items()})


def text(value: object, exact: bool = False) -> str:
    """A value as the files have it."""
    match value:
        case None:
            return ""
        case bool() | np.bool_():
            return "yes" if value else "no"
        case float() | np.floating():
            rounded = "" if math.isnan(value) else f"{value:.15g}"
            return repr(float(value)) if exact and rounded and float(rounded) != value else rounded
        case list() | tuple():
            return " ".join(text(each, exact) for each in value)
    return str(value)


def number(cell: str) -> float:
    """The number of a cell; NaN for an empty cell and for words."""
    try:
        return float(cell)
    except ValueError:
        return math.nan


def sampled(whole: Table, every: int, block: int, inexact: Sequence[str] = ()) -> tuple[Table, Table]:
    """Every so many of the rows of a long table, and a row for each block of the others: no value can change unseen.

    A column that is `inexact`, by the processor, has the sum of its magnitudes, each with a weight of its own, and the numbers
    of its finite and of its negative values. Any other one has a digest, with the sum, or the number of each word.
    """
    kept = range(0, len(whole), every)
    some = Table({"row": [str(k) for k in kept], **whole.take(kept).columns})
    starts = range(0, len(whole), block)
    others = [[k for k in range(start, min(start + block, len(whole))) if k % every] for start in starts]
    blocks: dict[str, list[str]] = {"rows": [f"{rows[0]} to {rows[-1]}" for rows in others if rows]}
    for name, column in whole.columns.items():
        parts = [[column[k] for k in rows] for rows in others if rows]
        if name in inexact:
            blocks[name] = [text(weighted_sum(each)) for each in parts]
            blocks[f"{name}: finite, negative"] = [" ".join(map(str, counts(each))) for each in parts]
        else:
            blocks[name] = [f"{in_short(each)} #{digest(each)[:12]}".strip() for each in parts]
    return some, Table(blocks)


def weighted_sum(cells: Sequence[str]) -> float:
    """The sum of the finite magnitudes; no value can change without it, for none is negative."""
    values = np.abs([number(each) for each in cells])
    weights = 1.0 + (0.618033988749895 * np.arange(values.size)) % 1.0
    return math.fsum(np.where(np.isfinite(values), values * weights, 0.0).tolist())


def counts(cells: Sequence[str]) -> tuple[int, int]:
    """The numbers of finite and of negative values."""
    values = np.array([number(each) for each in cells])
    return int(np.isfinite(values).sum()), int((values < 0.0).sum())


def in_short(cells: Sequence[str]) -> str:
    """The weighted sum of numbers, or how often each word is there if they are few."""
    if all(math.isfinite(number(each)) for each in cells):
        return text(weighted_sum(cells))
    words = Counter(cells)
    return ", ".join(f"{count} {word or 'empty'}" for word, count in sorted(words.items())) if len(words) <= FEW_WORDS else ""


def digest(lines: Iterable[str]) -> str:
    """SHA-256 of lines."""
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()


# ---- on the disk ----


def read(folder: str, data: Path = DATA) -> Tables:
    """The tables of a folder."""
    return {path.stem: parsed(path.read_text(encoding="utf-8")) for path in sorted((data / folder).glob("*.csv"))}


def parsed(content: str) -> Table:
    """The table of a CSV."""
    titles, *rows = csv.reader(io.StringIO(content))
    return Table({title: [row[k] for row in rows] for k, title in enumerate(titles)})


def as_csv(of: Table) -> str:
    """The CSV of a table."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(of.columns)
    writer.writerows(zip(*of.columns.values(), strict=True))
    return out.getvalue()


def read_lines(name: str, data: Path = DATA) -> list[str]:
    """The lines of a file of other text."""
    return (data / name).read_text(encoding="utf-8").splitlines()
