"""What was done before each row of a journal: mountings and moves of axes. Rows share errors by it."""

from collections import Counter
from collections.abc import Iterable, Iterator
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from goniotwin.app.campaign.journal.reading import ExecutedRow
from goniotwin.arrays import Ints
from goniotwin.twin.optics.geometry.coordinates import round_deg

AXES = 4
"""Gamma, sigma, beta and shift, the angles of a pose in their order."""


class ExecutedRows(Protocol):
    """What has rows in order of time: a journal, or a plan as it is expected to be executed."""

    def executed_rows(self) -> Iterator[ExecutedRow]:
        """The rows."""
        ...


class RowHistory:
    """The history of a journal's rows as far as it goes; read when it is first asked for. Rows are named by their numbers."""

    def __init__(self, journal: ExecutedRows) -> None:
        self._journal = journal

    def read(self) -> None:
        """Read all of it now, so that the journal can be closed."""
        _ = self._read

    def __getstate__(self) -> dict[str, Any]:
        """The history without the journal, which is open in one process."""
        return {"_read": self._read}

    def mounted(self, rows: Ints) -> tuple[list[str], Ints]:
        """The mountings in which rows were measured, and for each row (n,) which of these: `paint#2` is the sample's second."""
        names, table = self._read
        some, which = np.unique(table[self._places(rows), 1], return_inverse=True)
        return [names[k] for k in some.tolist()], which.ravel()

    def moves(self, rows: Ints) -> Ints:
        """For each row (n, 4) the number of moves of each axis so far: rows with one number have one position in common."""
        return self._read[1][self._places(rows), 2 : 2 + AXES]

    def _places(self, rows: Ints) -> Ints:
        places: Ints = np.searchsorted(self._read[1][:, 0], rows)
        return places

    @cached_property
    def _read(self) -> tuple[list[str], Ints]:
        return history_of(self._journal.executed_rows())


def history_of(rows: Iterable[ExecutedRow]) -> tuple[list[str], Ints]:
    """Names of the mountings, and a table (rows, 6) by row: its number, its mounting, the moves of each axis so far.

    Rows are in order of time. Every axis counts as moved where a sample is mounted, by hand, and in a further session of a
    campaign, for it may have been referenced.
    """
    names = ["before any mounting"]
    found: Ints = np.fromiter(_counts(rows, names), dtype=np.dtype((np.int64, 2 + AXES)))
    return names, found[np.argsort(found[:, 0], kind="stable")]


def _counts(rows: Iterable[ExecutedRow], names: list[str]) -> Iterator[tuple[int, ...]]:
    """The lines of that table in order of time; adds the mountings to the names."""
    mounted, session = Counter[str](), -1
    moves, last = [0] * AXES, (np.nan,) * AXES
    for row in rows:
        if row.kind == "mount":
            mounted[row.sample] += 1
            names.append(f"{row.sample}#{mounted[row.sample]}")
            last = (np.nan,) * AXES
        if row.session != session:
            session, last = row.session, (np.nan,) * AXES
        if row.pose is not None:
            pose = tuple(round_deg(row.pose).tolist())
            moves = [count + (now != before) for count, now, before in zip(moves, pose, last, strict=True)]
            last = pose
        yield (row.number, len(names) - 1, *moves)
