"""The time left of a run, from the estimated durations of its rows and the pace of the rows so far. Plain numbers, no Qt.

A row is taken to last as long as estimated, times a factor, and a fixed time more: that of the program, which does not go
faster with the simulation speed. Both are fitted to the rows so far by least squares, from the estimates as they are (a factor
of 1, nothing more) with an uncertainty; late rows count more than early ones, and a single row that takes long counts little.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from goniotwin.app.campaign.row import Row
from goniotwin.arrays import Floats

BLOCK_S = 0.25
"""Rows are fitted together until so much time has passed: they are reported with a delay."""
PRIOR = np.array([1.0, 0.0])
PRIOR_U = np.array([0.1, 0.2])
"""Standard uncertainties of the factor, and of the fixed time of a row in s, before the first row."""
ROW_U_S, RELATIVE_U = 0.01, 0.05
"""Least scatter of a row's duration, in s and relative. The rows show how much larger it is."""
SCATTER_WEIGHT = 0.1
"""Weight of a block in the running mean of its square."""
KEPT = 0.97
"""Weight of a block over that of the next one."""
MOST_U = 4.0
"""A block that deviates by more standard uncertainties counts as if it deviated by these."""
PACE_U = 0.02
"""Relative change of the pace that has to be expected always."""
COVERAGE = 2.0


@dataclass(frozen=True)
class Wait:
    """Seconds to wait, and the half width of their 95 % interval."""

    seconds: float
    band: float


@dataclass(frozen=True)
class Mounting:
    """A row of the plan that mounts a sample: its number, and the seconds and rows of the plan from it on."""

    number: int
    sample: str
    seconds_left: float
    rows_left: int


def mountings(rows: Sequence[Row]) -> tuple[Mounting, ...]:
    """The mountings of a plan."""
    total, count = sum(row.seconds for row in rows), len(rows)
    found, before = [], 0.0
    for done, row in enumerate(rows):
        if row.kind == "mount":
            found.append(Mounting(row.number, row.sample, total - before, count - done))
        before += row.seconds
    return tuple(found)


class TimeLeft:
    """The pace of a run. Times `now` are real time in s, from any origin; estimated durations are on the rig's clock."""

    def __init__(self, speed: float = 1.0) -> None:
        self._speed = speed
        self._since: float | None = None
        self._block = np.zeros(2)
        self._weights = np.zeros((2, 2))
        self._sums = np.zeros(2)
        self._scatter = 1.0
        self._rows_left, self._seconds_left = 0, 0.0

    def begin(self, now: float, rows_left: int, seconds_left: float) -> None:
        """A run begins, or is attached to; nothing is known of its pace."""
        self._weights, self._sums, self._scatter = np.zeros((2, 2)), np.zeros(2), 1.0
        self._rows_left, self._seconds_left = rows_left, seconds_left
        self.interrupt(now)

    def set_speed(self, now: float, speed: float) -> None:
        """The simulation speed is another one from now on: 1 for a real rig."""
        if speed != self._speed:
            self._speed = speed
            self.interrupt(now)

    def interrupt(self, now: float) -> None:
        """The run waits, or goes on after it has waited: the time until the next row is no measure of the pace."""
        self._since, self._block = now, np.zeros(2)

    def add_row(self, now: float, seconds: float, rows_left: int, seconds_left: float) -> None:
        """A row of so many estimated seconds is done; so much is left."""
        self._rows_left, self._seconds_left = rows_left, seconds_left
        if self._since is None:
            self._since = now
            return
        self._block += (seconds / self._speed, 1.0)
        if now - self._since >= BLOCK_S:
            self._fit(now - self._since)
            self._since, self._block = now, np.zeros(2)

    @property
    def known(self) -> bool:
        """Whether the pace of rows is known: of the run in progress, or of the one before."""
        return bool(self._weights.any())

    def of_rows(self, rows: int, seconds: float) -> Wait:
        """Real time of so many rows of so many estimated seconds in all."""
        return self._wait(seconds, rows)

    @property
    def left(self) -> Wait:
        """Real time from the row that was done last until the end of the run."""
        return self._wait(self._seconds_left, self._rows_left)

    def until(self, mounting: Mounting) -> Wait:
        """Real time from the row that was done last until a mounting."""
        return self._wait(self._seconds_left - mounting.seconds_left, self._rows_left - mounting.rows_left)

    def _wait(self, seconds: float, rows: int) -> Wait:
        ahead = np.array([max(seconds, 0.0) / self._speed, float(max(rows, 0))])
        pace, covariance = self._pace()
        wait = float(ahead @ pace)
        variance = float(ahead @ covariance @ ahead) + self._scatter * _variance(ahead) + (PACE_U * wait) ** 2
        return Wait(max(wait, 0.0), COVERAGE * math.sqrt(variance))

    def _pace(self) -> tuple[Floats, Floats]:
        """The factor and the fixed time of a row, with their covariance."""
        prior = np.diag(PRIOR_U**-2.0)
        covariance = np.linalg.inv(prior + self._weights / self._scatter)
        return np.asarray(covariance @ (prior @ PRIOR + self._sums / self._scatter)), np.asarray(covariance)

    def _fit(self, took: float) -> None:
        block, (pace, covariance) = self._block, self._pace()
        variance, expected, unknown = _variance(block), float(block @ pace), float(block @ covariance @ block)
        limit = MOST_U * math.sqrt(unknown + variance * self._scatter)
        deviation = min(max(took - expected, -limit), limit)
        excess = max(deviation**2 - unknown, 0.0) / variance
        self._scatter = max(self._scatter + SCATTER_WEIGHT * (excess - self._scatter), 1.0)
        self._weights = KEPT * self._weights + np.outer(block, block) / variance
        self._sums = KEPT * self._sums + block * ((expected + deviation) / variance)


def _variance(block: Floats) -> float:
    """Least variance of the duration of rows, s^2: of their estimated duration in real time, and their number."""
    seconds, rows = float(block[0]), float(block[1])
    return rows * ROW_U_S**2 + (RELATIVE_U * seconds) ** 2 / max(rows, 1.0)
