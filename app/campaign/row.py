"""A row: the work between two commits to the journal. As it is planned, and what was recorded: raw counts, times, positions."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from goniotwin.app.columns import Amperes, ColumnTable, IntegerColumn, Seconds, VoltsPerAmpere
from goniotwin.arrays import Counts, Floats, Ints

RowKind = Literal["mount", "dark", "measure", "drift", "warm-up"]
NO_SAMPLE = "nothing"
"""Sample name of a row that is measured with an empty sample unit."""
MIRRORED_MARK = "/mirrored"
"""Part of the identity of a row that only checks the declared symmetry. Sample names have no slash."""
SKIPPED = "skipped"
"""Flag of a row that was skipped because of a fault."""
CONTRADICTION = "contradiction"
"""Flag of a row with readings that contradict each other in every attempt; also the kind of the events of these."""
RESUME_PREFIX = "resumed "
"""Beginning of the identity of an unplanned row: a resumed session starts with such rows."""
WAKE_PREFIX = "awake "
"""Beginning of the identity of an unplanned dark reading: after a sleep of the computer, or a long wait for a person."""


@dataclass(frozen=True, slots=True)
class Row:
    """One row of a plan.

    `pose` has the angles gamma, sigma, beta, shift in degrees. `gains` are indices of the rig's list of gains: the row is read
    at each of them, or, with `automatic` (auto-range), at those that a photodiode needs. `readings` is the number of readings
    at each gain; with a `target` (relative standard uncertainty) readings follow until the target or the time limit
    `longest_s` is reached. `seconds` is the estimated duration.

    A `drift` row is a drift check. A `warm-up` row waits with the shutter open until the monitor changes by less than
    `target` in ten minutes, at most `longest_s`.
    """

    number: int
    identity: str
    kind: RowKind
    sample: str
    seconds: float = 0.0
    wavelength_nm: float | None = None
    pose: tuple[float, float, float, float] | None = None
    gains: tuple[int, ...] = ()
    readings: int = 0
    automatic: bool = False
    target: float | None = None
    longest_s: float = 0.0

    @property
    def mirrored(self) -> bool:
        """Whether the row only checks the symmetry: it is the mirror image of another row."""
        return MIRRORED_MARK in self.identity

    @property
    def unplanned(self) -> bool:
        """Whether the row belongs to the start of a resumed session, or to the end of a sleep, and not to the plan."""
        return self.identity.startswith((RESUME_PREFIX, WAKE_PREFIX))


@dataclass(frozen=True)
class Reading:
    """Readings of all photodiodes at one gain.

    `counts` (readings, photodiodes) are raw; reading k was taken `first_s` + k `period_s` on the rig's clock; `monitor_a` is
    the mean current of the monitor over the same time.
    """

    gain_v_per_a: float
    first_s: float
    period_s: float
    monitor_a: float
    counts: Counts


@dataclass(frozen=True)
class RowData:
    """Recorded data of a row: times on the rig's clock, read-back positions and encoders in degrees, one reading per gain.

    Where the rig file has order filters, `positions` also has the position of the filter wheel, under `filter`.
    """

    started_s: float
    ended_s: float
    positions: dict[str, float | None] | None
    readings: tuple[Reading, ...]
    flags: tuple[str, ...] = ()


@dataclass(frozen=True)
class CommittedRow:
    """A row of a journal with its recorded data."""

    row: Row
    data: RowData


@dataclass(frozen=True)
class ReadingTable(ColumnTable):
    """The readings of some rows in columns, an element for each `Reading`: there may be a hundred thousand of them.

    `row` (n,) is the index of each reading's row, ascending; `rows` their number. `readings` and `channels` (n,) are the shape
    of each one's counts, which begin at its `begin` (n,) in `counts`; that may have those of other readings, too. The other
    columns are those of `Reading`.
    """

    rows: int
    row: IntegerColumn
    gain_v_per_a: VoltsPerAmpere
    first_s: Seconds
    period_s: Seconds
    monitor_a: Amperes
    readings: IntegerColumn
    channels: IntegerColumn
    begin: IntegerColumn
    counts: Counts

    def counts_of(self, which: Ints, readings: int) -> Counts:
        """The first `readings` counts (k, readings, photodiodes) of some readings, all of which have so many or more."""
        channels = int(self.channels[which[0]]) if which.size else 0
        here = self.begin[which, None] + np.arange(readings * channels)
        found: Counts = self.counts[here]
        return found.reshape(which.size, readings, channels)

    def reading(self, k: int) -> Reading:
        """One of the readings."""
        counts = self.counts_of(np.array([k]), int(self.readings[k]))[0]
        gain, first, period, monitor = (float(getattr(self, name)[k]) for name in OF_READING)
        return Reading(gain, first, period, monitor, counts)

    def of_rows(self, which: Ints) -> "ReadingTable":
        """The readings of some of the rows, by their indices and in that order."""
        first, last = np.searchsorted(self.row, which, side="left"), np.searchsorted(self.row, which, side="right")
        each = last - first
        row = np.repeat(np.arange(which.size), each)
        here = np.arange(row.size) + np.repeat(first - (np.cumsum(each) - each), each)
        return replace(self.where(here), rows=which.size, row=row)

    def joined(self, more: "ReadingTable") -> "ReadingTable":
        """The readings of these rows, and of more after them."""
        more = replace(more, row=self.rows + more.row, begin=self.counts.size + more.begin)
        counts = np.concatenate([self.counts, more.counts])
        return replace(ReadingTable.join([self, more]), rows=self.rows + more.rows, counts=counts)


OF_READING = ("gain_v_per_a", "first_s", "period_s", "monitor_a")
"""The columns that a `Reading` has, too."""


def table_of_columns(rows: int, row: Ints, numbers: Floats, shapes: Ints, counts: Counts) -> ReadingTable:
    """A table of readings: `numbers` (4, n) are gain, first, period, monitor; `shapes` (n, 2); `counts` follow each other."""
    gain, first, period, monitor = numbers
    readings, channels = shapes.T
    begin = np.cumsum(readings * channels) - readings * channels
    return ReadingTable(rows, row, gain, first, period, monitor, readings, channels, begin, counts)


def reading_table(rows: Iterable[Sequence[Reading]]) -> ReadingTable:
    """The readings of rows in columns."""
    every = list(rows)
    found = [each for readings in every for each in readings]
    row = np.repeat(np.arange(len(every)), [len(readings) for readings in every])
    numbers = np.array([[getattr(each, name) for each in found] for name in OF_READING], dtype=np.float64)
    shapes = np.array([each.counts.shape for each in found], dtype=np.int64).reshape(-1, 2)
    counts = np.concatenate([np.zeros(0, dtype=np.uint16), *(each.counts.ravel() for each in found)])
    return table_of_columns(len(every), row, numbers, shapes, counts)


@dataclass(frozen=True)
class RecordedRows:
    """Rows of a journal in columns: their numbers (n,), their starts (n,) in s on the rig's clock, and their readings."""

    numbers: Ints
    started_s: Floats
    readings: ReadingTable

    def of(self, numbers: Ints) -> "RecordedRows":
        """Some of the rows, by their numbers (n,) and in that order, as far as they are here: in the order of their numbers."""
        places = np.searchsorted(self.numbers, numbers)
        there = places < self.numbers.size
        there[there] = self.numbers[places[there]] == numbers[there]
        places = places[there]
        return RecordedRows(self.numbers[places], self.started_s[places], self.readings.of_rows(places))

    def joined(self, more: "RecordedRows") -> "RecordedRows":
        """These rows, and more after them."""
        return RecordedRows(
            np.concatenate([self.numbers, more.numbers]),
            np.concatenate([self.started_s, more.started_s]),
            self.readings.joined(more.readings),
        )
