"""What was done before each row of a journal: mountings, moves of axes, dark readings; and when. Rows share errors by it."""

from array import array
from collections import Counter
from collections.abc import Iterable, Iterator
from functools import cached_property
from typing import Protocol

import numpy as np

from goniotwin.app.campaign.journal.reading import ExecutedRow
from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import round_deg

SECONDS = 3600.0
"""Of an hour."""
AXES = 4
"""Gamma, sigma, beta and shift, the angles of a pose in their order."""


class ExecutedRows(Protocol):
    """What has rows in order of time: a journal, or a plan as it is expected to be executed."""

    def executed_rows(self) -> Iterator[ExecutedRow]:
        """The rows."""
        ...

    def row_lights(self) -> Iterator[tuple[float, float, float]]:
        """Number, start in s and the monitor's mean current in A of each row that was read."""
        ...


class RowHistory:
    """The history of a journal's rows as far as it goes; read when it is first asked for. Rows are named by their numbers."""

    def __init__(self, journal: ExecutedRows) -> None:
        self._journal = journal

    def read(self) -> None:
        """Read all of it now, so that the journal can be closed."""
        _ = self._read, self._lights

    def mounted(self, rows: Ints) -> tuple[list[str], Ints]:
        """The mountings in which rows were measured, and for each row (n,) which of these: `paint#2` is the sample's second."""
        names, table, _ = self._read
        some, which = np.unique(table[self._places(rows), 1], return_inverse=True)
        return [names[k] for k in some.tolist()], which.ravel()

    def moves(self, rows: Ints) -> Ints:
        """For each row (n, 4) the number of moves of each axis so far: rows with one number have one position in common."""
        return self._read[1][self._places(rows), 3 : 3 + AXES]

    def dark_readings(self, rows: Ints) -> Ints:
        """For each row (n,) the number of dark readings before it."""
        before: Ints = self._read[1][self._places(rows), 2]
        return before

    def hours(self, rows: Ints) -> Floats:
        """When rows (n,) began, in hours on the rig's clock."""
        begun: Floats = self._lights[self._places(rows), 0]
        return begun / SECONDS

    def monitor_decades(self, rows: Ints) -> Floats:
        """Logarithms of base ten of the monitor's mean current in rows (n,), in A; 0 where it was not read."""
        decades: Floats = self._lights[self._places(rows), 1]
        return decades

    def dark_share(self, rows: Ints) -> Floats:
        """For each row (n,) how far it is from the dark reading before it, 0, to the one after it, 1; 0 after the last one."""
        share: Floats = self._read[2][self._places(rows)]
        return share

    def _places(self, rows: Ints) -> Ints:
        places: Ints = np.searchsorted(self._read[1][:, 0], rows)
        return places

    @cached_property
    def _lights(self) -> Floats:
        """Begin in s and logarithm of the monitor's current (rows, 2), in the order of `_read`."""
        found: Floats = np.fromiter(self._journal.row_lights(), dtype=np.dtype((np.float64, 3)))
        found = found[np.argsort(found[:, 0], kind="stable"), 1:]
        current = found[:, 1]
        found[:, 1] = np.log10(np.where(current > 0.0, current, 1.0))
        return found

    @cached_property
    def _read(self) -> tuple[list[str], Ints, Floats]:
        return history_of(self._journal.executed_rows())


def history_of(rows: Iterable[ExecutedRow]) -> tuple[list[str], Ints, Floats]:
    """Names of the mountings, a table (rows, 7), and each row's `dark_share` (rows,).

    By row: number, mounting, dark readings before it, moves of each axis. Rows are in order of time. Every axis counts as moved
    where a sample is mounted, by hand, and in a further session of a campaign, for it may have been referenced.
    """
    names, times = ["before any mounting"], array("d")
    found: Ints = np.fromiter(_counts(rows, names, times), dtype=np.dtype((np.int64, 3 + AXES)))
    order = np.argsort(found[:, 0], kind="stable")
    return names, found[order], _dark_share(found[:, 2], np.array(times))[order]


def _dark_share(dark_readings: Ints, started_s: Floats) -> Floats:
    """How far rows are from the dark reading before them to the one after, by their starts; in order of time."""
    of_dark = started_s[np.diff(dark_readings, prepend=0) > 0]
    last = len(of_dark)
    if not last:
        return np.zeros(dark_readings.size)
    before = of_dark[np.maximum(dark_readings - 1, 0)]
    after = of_dark[np.minimum(dark_readings, last - 1)]
    share = np.clip((started_s - before) / np.where(after > before, after - before, np.inf), 0.0, 1.0)
    return np.where(dark_readings == 0, 1.0, share)


def _counts(rows: Iterable[ExecutedRow], names: list[str], times: "array[float]") -> Iterator[tuple[int, ...]]:
    """The lines of that table in order of time; adds the mountings to the names, and the rows' starts to the times."""
    mounted, dark_readings, session = Counter[str](), 0, -1
    moves, last = [0] * AXES, (np.nan,) * AXES
    for row in rows:
        if row.kind == "mount":
            mounted[row.sample] += 1
            names.append(f"{row.sample}#{mounted[row.sample]}")
            last = (np.nan,) * AXES
        dark_readings += row.kind == "dark"
        if row.session != session:
            session, last = row.session, (np.nan,) * AXES
        if row.pose is not None:
            pose = tuple(round_deg(row.pose).tolist())
            moves = [count + (now != before) for count, now, before in zip(moves, pose, last, strict=True)]
            last = pose
        times.append(row.started_s)
        yield (row.number, len(names) - 1, dark_readings, *moves)
