"""At which gains a row is read: all that are planned, or, where gains are automatic, those that some photodiode needs.

A photodiode needs its highest gain at which it is not clipped. So a row with automatic gains is read from the highest gain
downwards until nothing is clipped any more, or nothing lower is left. What is decided follows from the counts of the row
alone, so that a resumed campaign decides the same.

How many readings a row needs so that its photodiodes are known to a relative uncertainty.

Asked after each lot of readings, and answered from their counts and the last dark's alone, so that the answer can be found
again from the journal. The reduction does not use this scatter, which was looked at to decide when to stop.

Whether a lamp is warm: how steady the monitor's current is, from what it was in the last ten minutes.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

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


LEAST_READINGS = 4
"""Readings that have to be there before their scatter says anything."""
MORE = 4
"""So many times as many as there are, at most, are asked for at once: few readings of the dark may look like much light."""
QUANTISATION = 1.0 / 12.0
"""Variance of a converter's step, in steps squared."""


def readings_needed(counts: Counts, dark: Floats, wanted: Flags, target: float, most: int) -> int:
    """So many readings in all, from what `counts` (LEAST readings or more, photodiodes) are like over the `dark` (n,).

    Of the `wanted` photodiodes those decide that can reach the `target` within `most` readings: where one has no light to
    speak of, no time makes it known to a share of itself, and the others need not wait for it.
    """
    taken = len(counts)
    signal = np.abs(counts.mean(axis=0) - dark)
    variance = np.maximum(counts.var(axis=0, ddof=1), QUANTISATION)
    with np.errstate(divide="ignore", over="ignore"):
        needed = variance / (target * signal) ** 2
    reachable = needed[wanted & (needed <= most)]
    return min(max(taken, math.ceil(float(reachable.max()))), MORE * taken) if reachable.size else taken


WARM_UP_EVERY_S = 10.0
"""Between two readings of the monitor."""
WARM_UP_WINDOW_S = 600.0
LEAST_STEADY = 7
"""Readings that a slope is taken from at least: a minute."""


@dataclass
class WarmUpTrace:
    """The monitor's current against time, of the last ten minutes."""

    times_s: list[float] = field(default_factory=list)
    currents_a: list[float] = field(default_factory=list)

    def add(self, t: float, current_a: float) -> None:
        """A reading; what is older than the window goes."""
        self.times_s.append(t)
        self.currents_a.append(current_a)
        while self.times_s[0] < t - WARM_UP_WINDOW_S:
            del self.times_s[0], self.currents_a[0]

    def slope(self) -> tuple[float, float] | None:
        """Relative change in ten minutes and its standard uncertainty, by a straight line; None while there is too little."""
        if len(self.times_s) < LEAST_STEADY:
            return None
        t = np.array(self.times_s) - np.mean(self.times_s)
        current = np.array(self.currents_a)
        rise = float(np.sum(t * current) / np.sum(t**2))
        left = current - current.mean() - rise * t
        spread = float(np.sqrt(np.sum(left**2) / (len(t) - 2) / np.sum(t**2)))
        per_window = WARM_UP_WINDOW_S / float(current.mean())
        return rise * per_window, spread * abs(per_window)

    def steady(self, target: float) -> bool:
        """Whether it changes by no more than the share `target` in ten minutes, with some certainty."""
        found = self.slope()
        return found is not None and abs(found[0]) + 2.0 * found[1] <= target
