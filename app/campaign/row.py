"""A row: the work between two commits to the journal. As it is planned, and what was recorded: raw counts, times, positions."""

from dataclasses import dataclass
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
