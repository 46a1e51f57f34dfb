"""What a row came to: raw counts with their times, positions, flags."""

from dataclasses import dataclass

from goniotwin.app.campaign.row import Row
from goniotwin.arrays import Counts


@dataclass(frozen=True)
class Reading:
    """All photodiodes at one gain: raw `counts` (readings, photodiodes), the monitor's mean current meanwhile."""

    gain_v_per_a: float
    first_s: float
    period_s: float
    monitor_a: float
    counts: Counts


@dataclass(frozen=True)
class RowData:
    """What a row came to: times on the rig's clock, read-back positions and encoders in degrees, readings by gain.

    Among the positions is the filter wheel's, `filter`, where the rig file has filters.
    """

    started_s: float
    ended_s: float
    positions: dict[str, float | None] | None
    readings: tuple[Reading, ...]
    flags: tuple[str, ...] = ()


@dataclass(frozen=True)
class CommittedRow:
    """A row of a journal with what it came to."""

    row: Row
    data: RowData
