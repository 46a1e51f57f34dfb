"""What a rehearsal learns while it runs, row by row: it keeps sums and extremes, and no row."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from goniotwin.app.campaign.journal.record import RowData
from goniotwin.app.campaign.readout import saturation
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.running.events import Event, RowCommitted
from goniotwin.app.rig import AXES
from goniotwin.arrays import Flags, Floats
from goniotwin.drivers import PhotodiodeSettings
from goniotwin.protocols import adam


@dataclass
class Block:
    """What is measured of one mounted sample, from its mounting to the next."""

    name: str
    rows: int = 0
    duration_s: float = 0.0


class Watch:
    """A listener of the engine. `heeded` says of a row which photodiodes may not be over their range."""

    def __init__(self, settings: PhotodiodeSettings, heeded: Callable[[Row], Flags]) -> None:
        self._settings = settings
        self._heeded = heeded
        self._zero = round(-settings.range.low_v / settings.range.lsb_v)
        self.span = adam.FULL_SCALE - self._zero
        self.blocks: list[Block] = []
        self.axes_deg: dict[str, list[float]] = {}
        self.largest: dict[float, int] = {}
        self.saturated = 0
        self.steps: dict[tuple[str, float], Floats] = {}
        self.flagged: dict[str, int] = {}

    def __call__(self, event: Event) -> None:
        """Heeds the rows."""
        if isinstance(event, RowCommitted):
            row, data = event.row, event.data
            if row.kind == "mount" or not self.blocks:
                self.blocks.append(Block(row.sample))
            block = self.blocks[-1]
            block.rows += 1
            block.duration_s += data.ended_s - data.started_s
            for flag in data.flags:
                self.flagged[flag] = self.flagged.get(flag, 0) + 1
            self._see_positions(data)
            if row.kind == "measure":
                self._see_counts(row, data)

    def _see_positions(self, data: RowData) -> None:
        for axis in AXES:
            angle = None if data.positions is None else data.positions.get(axis)
            if angle is not None:
                low, high = self.axes_deg.get(axis, (angle, angle))
                self.axes_deg[axis] = [min(low, angle), max(high, angle)]

    def _see_counts(self, row: Row, data: RowData) -> None:
        if not data.readings:
            return
        for reading in data.readings:
            gain = reading.gain_v_per_a
            highest = reading.counts.max(axis=0)
            self.largest[gain] = max(self.largest.get(gain, 0), int(highest.max()))
            steps = np.abs(reading.counts.mean(axis=0) - self._zero)
            self.steps[row.sample, gain] = np.maximum(self.steps.get((row.sample, gain), steps), steps)
        over = np.all([saturation(reading.counts) for reading in data.readings], axis=0)
        self.saturated += int((over & self._heeded(row)).sum())

    @property
    def share_of_range(self) -> dict[float, float]:
        """By gain, how much of the range above zero the largest count takes."""
        return {gain: (count - self._zero) / self.span for gain, count in sorted(self.largest.items())}
