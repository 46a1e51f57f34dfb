"""How many readings a row needs so that its photodiodes are known to a relative uncertainty.

Asked after each lot of readings, and answered from their counts and the last dark's alone, so that the answer can be found
again from the journal. The reduction does not use this scatter, which was looked at to decide when to stop.
"""

import math

import numpy as np

from goniotwin.arrays import Counts, Flags, Floats

LEAST = 4
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
