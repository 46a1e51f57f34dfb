"""Statistics of a rehearsal's rows, updated at each commit: sums and extremes; no row is kept."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from goniotwin.app.campaign.readout import GainSequence
from goniotwin.app.campaign.row import Row, RowData
from goniotwin.app.campaign.running.events import Event, RowCommitted
from goniotwin.app.rig import AXES
from goniotwin.arrays import Flags, Floats
from goniotwin.drivers import ConverterDescription


@dataclass
class MountingBlock:
    """Rows and duration of one mounted sample, from its mounting to the next."""

    name: str
    rows: int = 0
    duration_s: float = 0.0


class RowStatistics:
    """A listener of the engine. `relevant` gives for a row the photodiodes (n,) that may not be saturated.

    `axes_deg` is the range of each axis. `largest` is the largest count by gain, `steps` by sample and gain the largest mean
    count above zero of each photodiode (n,). `saturated` is the number of saturated values, `flagged` that of rows by flag.
    """

    def __init__(self, settings: ConverterDescription, relevant: Callable[[Row], Flags]) -> None:
        self._settings = settings
        self._relevant = relevant
        self._zero = round(settings.range.zero)
        self.span = settings.range.highest - self._zero
        self.blocks: list[MountingBlock] = []
        self.axes_deg: dict[str, list[float]] = {}
        self.largest: dict[float, int] = {}
        self.saturated = 0
        self.steps: dict[tuple[str, float], Floats] = {}
        self.flagged: dict[str, int] = {}

    def __call__(self, event: Event) -> None:
        """Take a committed row; other events are ignored."""
        if isinstance(event, RowCommitted):
            row, data = event.row, event.data
            if row.kind == "mount" or not self.blocks:
                self.blocks.append(MountingBlock(row.sample))
            block = self.blocks[-1]
            block.rows += 1
            block.duration_s += data.ended_s - data.started_s
            for flag in data.flags:
                self.flagged[flag] = self.flagged.get(flag, 0) + 1
            self._add_positions(data)
            if row.kind == "measure":
                self._add_counts(row, data)

    def _add_positions(self, data: RowData) -> None:
        for axis in AXES:
            angle = None if data.positions is None else data.positions.get(axis)
            if angle is not None:
                low, high = self.axes_deg.get(axis, (angle, angle))
                self.axes_deg[axis] = [min(low, angle), max(high, angle)]

    def _add_counts(self, row: Row, data: RowData) -> None:
        if not data.readings:
            return
        gains = GainSequence(row, self._settings, None)
        for reading in data.readings:
            gains.add(reading.counts)
            gain = reading.gain_v_per_a
            highest = reading.counts.max(axis=0)
            self.largest[gain] = max(self.largest.get(gain, 0), int(highest.max()))
            steps = np.abs(reading.counts.mean(axis=0) - self._zero)
            self.steps[row.sample, gain] = np.maximum(self.steps.get((row.sample, gain), steps), steps)
        self.saturated += int((gains.saturated & self._relevant(row)).sum())

    @property
    def share_of_range(self) -> dict[float, float]:
        """By gain, the largest count as a share of the range above zero."""
        return {gain: (count - self._zero) / self.span for gain, count in sorted(self.largest.items())}
