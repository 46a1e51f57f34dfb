"""Whether a lamp is warm: how steady the monitor's current is, from what it was in the last ten minutes."""

from dataclasses import dataclass, field

import numpy as np

EVERY_S = 10.0
"""Between two readings of the monitor."""
WINDOW_S = 600.0
LEAST = 7
"""Readings that a slope is taken from at least: a minute."""


@dataclass
class Trace:
    """The monitor's current against time, of the last ten minutes."""

    times_s: list[float] = field(default_factory=list)
    currents_a: list[float] = field(default_factory=list)

    def add(self, t: float, current_a: float) -> None:
        """A reading; what is older than the window goes."""
        self.times_s.append(t)
        self.currents_a.append(current_a)
        while self.times_s[0] < t - WINDOW_S:
            del self.times_s[0], self.currents_a[0]

    def slope(self) -> tuple[float, float] | None:
        """Relative change in ten minutes and its standard uncertainty, by a straight line; None while there is too little."""
        if len(self.times_s) < LEAST:
            return None
        t = np.array(self.times_s) - np.mean(self.times_s)
        current = np.array(self.currents_a)
        rise = float(np.sum(t * current) / np.sum(t**2))
        left = current - current.mean() - rise * t
        spread = float(np.sqrt(np.sum(left**2) / (len(t) - 2) / np.sum(t**2)))
        per_window = WINDOW_S / float(current.mean())
        return rise * per_window, spread * abs(per_window)

    def steady(self, target: float) -> bool:
        """Whether it changes by no more than the share `target` in ten minutes, with some certainty."""
        found = self.slope()
        return found is not None and abs(found[0]) + 2.0 * found[1] <= target
