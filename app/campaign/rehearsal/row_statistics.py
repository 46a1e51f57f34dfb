"""Statistics of a rehearsal's rows, updated at each commit: sums and extremes; no row is kept."""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from goniotwin.app.campaign.row import Reading, Row, RowData
from goniotwin.app.campaign.running.events import Event, RowCommitted
from goniotwin.app.rig import AXES
from goniotwin.arrays import Counts, Flags, Floats
from goniotwin.drivers import ConverterDescription

ROWS_TOGETHER = 64
"""Rows whose counts are added in one step."""


@dataclass
class MountingBlock:
    """Rows and duration of one mounted sample, from its mounting to the next."""

    name: str
    rows: int = 0
    duration_s: float = 0.0


class RowStatistics:
    """A listener of the engine. `relevant` gives for a row the photodiodes (n,) that may not be saturated.

    `axes_deg` is the range of each axis, `flagged` the number of rows by flag. Some rows wait to be counted together.
    """

    def __init__(self, settings: ConverterDescription, relevant: Callable[[Row], Flags]) -> None:
        self._settings = settings
        self._relevant = relevant
        self._zero = round(settings.range.zero)
        self.span = settings.range.highest - self._zero
        self.blocks: list[MountingBlock] = []
        self.axes_deg: dict[str, list[float]] = {}
        self._largest: dict[float, int] = {}
        self._saturated = 0
        self._steps: dict[tuple[str, float], Floats] = {}
        self._waiting: list[tuple[Row, tuple[Reading, ...]]] = []
        self.flagged: dict[str, int] = {}

    def as_data(self) -> dict[str, Any]:
        """All of it as dictionaries, lists, texts and numbers, for `add`."""
        self._add_waiting()
        return {
            "blocks": [vars(block) for block in self.blocks],
            "axes_deg": self.axes_deg,
            "flagged": self.flagged,
            "largest": list(self._largest.items()),
            "saturated": self._saturated,
            "steps": [(*key, each.tolist()) for key, each in self._steps.items()],
        }

    def add(self, later: dict[str, Any]) -> None:
        """Add the statistics of rows that follow, of `as_data`."""
        self._add_waiting()
        for block in later["blocks"]:
            if self.blocks and self.blocks[-1].name == block["name"]:  # it began within a mounting
                self.blocks[-1].rows += block["rows"]
                self.blocks[-1].duration_s += block["duration_s"]
            else:
                self.blocks.append(MountingBlock(**block))
        for axis, (low, high) in later["axes_deg"].items():
            first, last = self.axes_deg.get(axis, (low, high))
            self.axes_deg[axis] = [min(low, first), max(high, last)]
        for flag, rows in later["flagged"].items():
            self.flagged[flag] = self.flagged.get(flag, 0) + rows
        for gain, count in later["largest"]:
            self._largest[gain] = max(self._largest.get(gain, 0), count)
        self._saturated += later["saturated"]
        for sample, gain, values in later["steps"]:
            steps = np.array(values)
            self._steps[sample, gain] = np.maximum(self._steps.get((sample, gain), steps), steps)

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
            if row.kind == "measure" and data.readings:
                self._waiting.append((row, data.readings))
                if len(self._waiting) >= ROWS_TOGETHER:
                    self._add_waiting()

    def _add_positions(self, data: RowData) -> None:
        for axis in AXES:
            angle = None if data.positions is None else data.positions.get(axis)
            if angle is not None:
                low, high = self.axes_deg.get(axis, (angle, angle))
                self.axes_deg[axis] = [min(low, angle), max(high, angle)]

    def _add_waiting(self) -> None:
        """Add the counts of rows that wait: many at once."""
        rows, self._waiting = self._waiting, []
        alike: dict[tuple[str, float, tuple[int, ...]], list[tuple[int, Counts]]] = defaultdict(list)
        for place, (row, readings) in enumerate(rows):
            for each in readings:
                alike[row.sample, each.gain_v_per_a, each.counts.shape].append((place, each.counts))
        saturated = np.ones((len(rows), self._settings.count), dtype=bool)
        for (sample, gain, _), found in alike.items():
            places, counts = [place for place, _ in found], np.stack([each for _, each in found])
            saturated[places] &= self._settings.range.saturated(counts).any(axis=1)
            self._largest[gain] = max(self._largest.get(gain, 0), int(counts.max()))
            steps = np.abs(counts.mean(axis=1) - self._zero).max(axis=0)
            self._steps[sample, gain] = np.maximum(self._steps.get((sample, gain), steps), steps)
        self._saturated += sum(
            int((flags & self._relevant(row)).sum()) for flags, (row, _) in zip(saturated, rows, strict=True)
        )

    @property
    def largest(self) -> dict[float, int]:
        """The largest count by gain."""
        self._add_waiting()
        return self._largest

    @property
    def steps(self) -> dict[tuple[str, float], Floats]:
        """By sample and gain, the largest mean count above zero of each photodiode (n,)."""
        self._add_waiting()
        return self._steps

    @property
    def saturated(self) -> int:
        """The number of values that are saturated at every gain of their row."""
        self._add_waiting()
        return self._saturated

    @property
    def share_of_range(self) -> dict[float, float]:
        """By gain, the largest count as a share of the range above zero."""
        return {gain: (count - self._zero) / self.span for gain, count in sorted(self.largest.items())}
