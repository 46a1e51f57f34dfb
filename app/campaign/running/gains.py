"""At which gains a row is read: all that are planned, or, where gains are automatic, those that some photodiode needs.

A photodiode needs its highest gain at which it is not clipped. So a row with automatic gains is read from the highest gain
downwards until nothing is clipped any more, or nothing lower is left. What is decided follows from the counts of the row
alone, so that a resumed campaign decides the same.
"""

from collections.abc import Iterator

import numpy as np

from goniotwin.app.campaign.row import Row
from goniotwin.arrays import Counts, Flags, Floats
from goniotwin.protocols import adam

SATURATED = "saturated"
"""The flag of a row in which some photodiode is clipped at each gain."""
UNDER_RANGE = "under range"
"""The flag of a row in which no photodiode shows light, at the highest of its gains."""
LIGHT_STEPS = 4.0
"""So many steps of the converter over the dark are light."""


def shows_light(counts: Counts, dark: Floats) -> bool:
    """Whether any photodiode's mean of the readings (readings, photodiodes) is another than its dark (photodiodes,)."""
    return bool(np.any(np.abs(counts.mean(axis=0) - dark) >= LIGHT_STEPS))


def clipped(counts: Counts) -> Flags:
    """Which photodiodes stand at an end of the range in any of the readings (readings, photodiodes)."""
    ends: Flags = np.any((counts == 0) | (counts == adam.FULL_SCALE), axis=0)
    return ends


def in_order(row: Row, now: int | None) -> tuple[int, ...]:
    """A row's gains as they are read: beginning with the one that the amplifiers have `now`, where it is an outermost one.

    Every change of gain wears a relay; two rows in turns share one. But from the highest downwards wherever it is up to the
    counts which are needed, or how many readings: a photodiode that is done at a higher gain needs nothing at a lower one.
    """
    downwards = row.automatic or row.target is not None or (bool(row.gains) and now == max(row.gains))
    return tuple(sorted(row.gains, reverse=downwards))


class Gains:
    """Those of one row, in order. `waiting` are the photodiodes that were clipped so far."""

    def __init__(self, row: Row, photodiodes: int, now: int | None) -> None:
        self._row = row
        self._gains = in_order(row, now)
        self.waiting: Flags = np.ones(photodiodes, dtype=bool)

    def __iter__(self) -> Iterator[int]:
        for gain in self._gains:
            if self._row.automatic and not self.waiting.any():
                return
            yield gain

    def read(self, counts: Counts) -> None:
        """What came of the gain that was just given."""
        self.waiting &= clipped(counts)

    @property
    def flags(self) -> tuple[str, ...]:
        """Of the row."""
        return (SATURATED,) if self._row.gains and self.waiting.any() else ()
