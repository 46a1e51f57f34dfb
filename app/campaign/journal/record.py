"""Recorded data of a row: raw counts with their times, positions of the axes, flags."""

from dataclasses import dataclass

from goniotwin.app.campaign.row import Row
from goniotwin.arrays import Counts


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
