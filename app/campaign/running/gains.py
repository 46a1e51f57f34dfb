"""At which gains a row is read: all that are planned, or, where gains are automatic, those that some photodiode needs.

A photodiode needs its highest gain at which it is not clipped. So a row with automatic gains is read from the highest gain
downwards until nothing is clipped any more, or nothing lower is left. What is decided follows from the counts of the row
alone, so that a resumed campaign decides the same.
"""

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from app.campaign.journal.recorded import Counts
from app.campaign.row import Row
from protocols import adam

Flags = npt.NDArray[np.bool_]
SATURATED = "saturated"
"""The flag of a row in which some photodiode is clipped at each gain."""


def clipped(counts: Counts) -> Flags:
    """Which photodiodes stand at an end of the range in any of the readings (readings, photodiodes)."""
    ends: Flags = np.any((counts == 0) | (counts == adam.FULL_SCALE), axis=0)
    return ends


class Gains:
    """Those of one row, in the order in which it is read. `waiting` are the photodiodes that were clipped so far."""

    def __init__(self, row: Row, photodiodes: int) -> None:
        self._row = row
        self.waiting: Flags = np.ones(photodiodes, dtype=bool)

    def __iter__(self) -> Iterator[int]:
        row = self._row
        # Averaging has to know for whom: a photodiode that is done at a higher gain needs nothing at a lower one.
        downwards = row.automatic or row.target is not None
        for gain in sorted(row.gains, reverse=downwards):
            if row.automatic and not self.waiting.any():
                return
            yield gain

    def read(self, counts: Counts) -> None:
        """What came of the gain that was just given."""
        self.waiting &= clipped(counts)

    @property
    def flags(self) -> tuple[str, ...]:
        """Of the row."""
        return (SATURATED,) if self._row.gains and self.waiting.any() else ()
