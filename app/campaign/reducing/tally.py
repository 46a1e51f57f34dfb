"""What a sample's points come to when they themselves are gone: how many there are, how many are good, what the others lack."""

from dataclasses import dataclass, field

import numpy as np

from goniotwin.app.campaign.reducing.points import BsdfPoints

FIRST = ("shadowed", "uncertified", "no-etalon", "clipped", "dead", "drift")
"""Flags by which a point is counted: the first that it has."""


@dataclass
class Tally:
    """`under_range` are good ones lost in their noise; `flagged` how many of all have a flag, by the first; `trusted` the
    photodiodes of good values that are not lost in noise; `freed` whether the instrument's own light was subtracted anywhere.
    """

    directions: int = 0
    good: int = 0
    under_range: int = 0
    flagged: dict[str, int] = field(default_factory=dict)
    trusted: set[int] = field(default_factory=set)
    transmitted: bool = False
    freed: bool = False

    def add(self, points: BsdfPoints) -> None:
        """Some more points."""
        good = points.good
        self.directions += points.bsdf.size
        self.good += int(good.sum())
        self.under_range += int((good & points.under_range).sum())
        self.trusted.update(np.unique(points.photodiode[good & ~points.under_range]).tolist())
        self.transmitted |= bool(points.transmitted.any())
        self.freed |= bool(np.isfinite(points.signature).any())
        left = np.ones(points.bsdf.size, dtype=bool)
        for flag in FIRST:
            here = left & points.flags[flag]
            self.flagged[flag] = self.flagged.get(flag, 0) + int(here.sum())
            left &= ~here
