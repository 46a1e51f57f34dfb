"""The points of one sample in a temporary file: an export of a million rows needs no more memory than a part of them.

Blocks come in the order of wavelength and angles, with all points of a row together; a file of points has them in order of
time. Memory holds some 70 bytes a row; the file takes about as much of the disk as the points as text.
"""

import itertools
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import numpy as np
import numpy.typing as npt

from goniotwin.app.campaign.reduction.points import PLACE, BsdfPoints, order_by_light
from goniotwin.app.errors import UserError, unusable
from goniotwin.arrays import Ints

ROW = np.dtype([("rank", "i8"), ("kind", "i4"), ("begin", "i8"), ("count", "i8"), ("place", "f8", len(PLACE))])
"""A row: its place in order of time, the kind of its block, where its points begin in the file, their number, and its pose."""
OF_ROW = "place"
"""The column of points that the table of rows has."""
NO_ROWS: Ints = np.zeros(0, dtype=np.int64)
PART_POINTS = 20_000
"""Points that are read together where all are brought into memory."""
Table = npt.NDArray[np.void]


class PointFile:
    """Points of a sample, a `PointSource`, in a file without a name, which ends with `close`. Raises UserError."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        try:
            self._file: IO[bytes] = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115  (closed by close)
        except OSError as error:
            raise self._unwritable(error) from None
        self._end = 0
        self._kinds: list[np.dtype[Any]] = []
        self._empty: list[BsdfPoints] = []
        self._added: list[Table] = []
        self._sorted: Table | None = None

    def close(self) -> None:
        """Close the file, which is then gone."""
        try:
            self._file.close()
        except OSError:  # the rest of its buffer is not written; nothing is lost
            return

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def add(self, rank: Ints, points: BsdfPoints) -> None:
        """Add points with the place (n,) of each point's row in order of time; those of one row follow each other."""
        columns = _without_place(points)
        records = np.empty(points.size, dtype=[(name, each.dtype, each.shape[1:]) for name, each in columns.items()])
        for name, each in columns.items():
            records[name] = each
        begin = np.flatnonzero(np.diff(rank, prepend=-1))
        rows = np.zeros(begin.size, dtype=ROW)
        if records.dtype not in self._kinds:
            self._kinds.append(records.dtype)
            self._empty.append(replace(points, places=points.places[:0].copy()).where(NO_ROWS))  # copies: views keep all rows
        kind = self._kinds.index(records.dtype)
        rows["rank"], rows["kind"], rows["count"] = rank[begin], kind, np.diff(begin, append=points.size)
        rows["begin"] = self._end + begin * records.itemsize
        rows["place"] = points.places[points.place[begin]]
        try:
            self._file.seek(self._end)
            self._file.write(records.data)
            self._file.flush()
        except OSError as error:
            raise self._unwritable(error) from None
        self._end += records.nbytes
        self._added.append(rows)
        self._sorted = None

    @property
    def size(self) -> int:
        """Number of points."""
        return int(self._rows["count"].sum())

    def parts(self, points: int) -> Iterator[BsdfPoints]:
        """All points in order of time, in parts of so many or up to a row more."""
        part = (np.cumsum(self._rows["count"]) - self._rows["count"]) // points
        edges = [0, *(1 + np.flatnonzero(np.diff(part))).tolist(), len(part)] if len(part) else [0]
        return (self._read(self._rows[begin:end]) for begin, end in itertools.pairwise(edges))

    def everything(self) -> BsdfPoints:
        """All points in order of time, in memory, which takes little more than they do."""
        parts = self.parts(PART_POINTS)
        if len(self._kinds) != 1:
            return BsdfPoints.join(list(parts))
        kind = self._kinds[0]
        columns = {name: np.empty(self.size, dtype=kind[name]) for name in kind.names or ()}
        place = np.empty(self.size, dtype=np.int32)
        end, rows = 0, 0
        for points in parts:
            here = slice(end, end + points.size)
            for name, column in _without_place(points).items():
                columns[name][here] = column
            place[here] = points.place + np.int32(rows)
            end, rows = end + points.size, rows + len(points.places)
        return self._of(0, self._rows, columns | {OF_ROW: place})

    def settings(self, wavelength_nm: float | None = None) -> Iterator[BsdfPoints]:
        """The points of each wavelength, or of one, and sigma, in the order of these."""
        wavelength, sigma = (self._rows["place"][:, PLACE.index(name)] for name in ("wavelength_nm", "sigma_deg"))
        order, edges = order_by_light(wavelength, sigma, wavelength_nm)
        return (self._read(self._rows[order[begin:end]]) for begin, end in itertools.pairwise(edges.tolist()))

    def between(self, first: int, last: int) -> tuple[Ints, BsdfPoints] | None:
        """The points of the rows from the place `first` to before `last`, in this order, with the place (n,) of each.

        None where there are none.
        """
        begin, end = np.searchsorted(self._rows["rank"], [first, last]).tolist()
        rows = self._rows[begin:end]
        return (np.repeat(rows["rank"], rows["count"]), self._read(rows)) if len(rows) else None

    @property
    def _rows(self) -> Table:
        """All rows in order of time."""
        if self._sorted is None:
            rows = np.concatenate([np.zeros(0, dtype=ROW), *self._added])
            self._sorted = rows[np.argsort(rows["rank"], kind="stable")]
            self._added = [self._sorted]
        return self._sorted

    def _read(self, rows: Table) -> BsdfPoints:
        """The points of rows, in their order."""
        pieces, index = [], []
        for kind in np.unique(rows["kind"]).tolist():
            here = np.flatnonzero(rows["kind"] == kind)
            pieces.append(self._points(rows[here], kind))
            index.append(np.repeat(here, rows["count"][here]))
        if len(pieces) == 1:  # as it usually is: all blocks of a sample have the same components
            return pieces[0]
        points = BsdfPoints.join(pieces)
        order = np.concatenate(index)
        return points if np.all(order[1:] >= order[:-1]) else points.where(np.argsort(order, kind="stable"))

    def _points(self, rows: Table, kind: int) -> BsdfPoints:
        record = self._kinds[kind]
        records = np.frombuffer(self._content(rows, record.itemsize), dtype=record)
        columns = {name: np.ascontiguousarray(records[name]) for name in record.names or ()}
        place = np.repeat(np.arange(len(rows), dtype=np.int32), rows["count"])
        return self._of(kind, rows, columns | {OF_ROW: place})

    def _of(self, kind: int, rows: Table, columns: Mapping[str, npt.NDArray[Any]]) -> BsdfPoints:
        return replace(self._empty[kind].of_columns(columns), places=np.ascontiguousarray(rows["place"]))

    def _content(self, rows: Table, size: int) -> bytearray:
        """The records of rows, of so many bytes each; rows that follow each other in the file are read together."""
        content = bytearray()
        end = rows["begin"] + rows["count"] * size
        first = np.flatnonzero(np.append(True, rows["begin"][1:] != end[:-1]))
        last = np.append(first[1:], len(rows)) - 1
        for begin, to in zip(rows["begin"][first].tolist(), end[last].tolist(), strict=True):
            self._file.seek(begin)
            content += self._file.read(to - begin)
        return content

    def _unwritable(self, error: OSError) -> UserError:
        what = "a temporary file with the points cannot be written"
        return unusable(self._folder, what, error, "check the folder and its permissions")


def _without_place(points: BsdfPoints) -> dict[str, npt.NDArray[Any]]:
    """The columns of points that the file has: all but the index of their row."""
    return {name: column for name, column in points.columns().items() if name != OF_ROW}
