"""A row: the work between two commits to the journal. As it is planned, and what was recorded: raw counts, times, positions."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal

from goniotwin.arrays import Counts

RowKind = Literal["mount", "dark", "measure", "drift", "warm-up"]
NO_SAMPLE = "nothing"
"""Sample name of a row that is measured with an empty sample unit."""
MIRRORED_MARK = "/mirrored"
"""Part of the identity of a row that only checks the declared symmetry. Sample names have no slash."""
SKIPPED = "skipped"
"""Flag of a row that was skipped because of a fault."""
RESUME_PREFIX = "resumed "
"""Beginning of the identity of an unplanned row: a resumed session starts with such rows."""
WAKE_PREFIX = "awake "
"""Beginning of the identity of an unplanned row that follows a sleep of the computer."""


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


@dataclass
class ReadingTable:
    """The readings of some rows in columns, an element for each `Reading`: there may be a hundred thousand of them.

    `row` is the index of each reading's row, ascending; `rows` their number. The others are those of `Reading`.
    """

    rows: int = 0
    row: list[int] = field(default_factory=list)
    gain_v_per_a: list[float] = field(default_factory=list)
    first_s: list[float] = field(default_factory=list)
    period_s: list[float] = field(default_factory=list)
    monitor_a: list[float] = field(default_factory=list)
    counts: list[Counts] = field(default_factory=list)

    def begin_row(self) -> None:
        """Begin a further row: `add` adds to it."""
        self.rows += 1

    def add(self, gain_v_per_a: float, first_s: float, period_s: float, monitor_a: float, counts: Counts) -> None:
        """Add a reading to the last row."""
        self.row.append(self.rows - 1)
        self.gain_v_per_a.append(gain_v_per_a)
        self.first_s.append(first_s)
        self.period_s.append(period_s)
        self.monitor_a.append(monitor_a)
        self.counts.append(counts)

    def joined(self, more: "ReadingTable") -> "ReadingTable":
        """The readings of these rows, and of more after them."""
        return ReadingTable(
            self.rows + more.rows,
            self.row + [self.rows + row for row in more.row],
            self.gain_v_per_a + more.gain_v_per_a,
            self.first_s + more.first_s,
            self.period_s + more.period_s,
            self.monitor_a + more.monitor_a,
            self.counts + more.counts,
        )


def reading_table(rows: Iterable[Sequence[Reading]]) -> ReadingTable:
    """The readings of rows in columns."""
    table = ReadingTable()
    for readings in rows:
        table.begin_row()
        for each in readings:
            table.add(each.gain_v_per_a, each.first_s, each.period_s, each.monitor_a, each.counts)
    return table


@dataclass(frozen=True)
class RecordedRows:
    """Rows of a journal in columns: their numbers, their starts in s on the rig's clock, and their readings."""

    numbers: list[int]
    started_s: list[float]
    readings: ReadingTable

    def joined(self, more: "RecordedRows") -> "RecordedRows":
        """These rows, and more after them."""
        return RecordedRows(self.numbers + more.numbers, self.started_s + more.started_s, self.readings.joined(more.readings))
