"""Settings of the monitor photodiode's instrument, and the durations that follow."""

from dataclasses import dataclass
from typing import Literal, Protocol

from goniotwin.keys import Fraction, Positive, Width

ANSWER_MARGIN_S = 2.0e-3
TRANSFER_S = 0.8e-3
"""Typical duration of a USB transfer."""
TRANSFERS_AT_END = 5
"""Number of USB transfers at the end of a mean: request and reply of the value; query, request and reply of the canary."""


class MonitorDescription(Protocol):
    """A monitor of any make as its driver knows it without a wire: the operator's table of it.

    `relative_uncertainty` is the standard one of a reading, `largest_a` the end of its range in A, inf where it has none. A
    mean is read and checked `fetching_seconds` after its end.
    """

    @property
    def relative_uncertainty(self) -> float: ...
    @property
    def largest_a(self) -> float: ...
    @property
    def fetching_seconds(self) -> float: ...


@dataclass(frozen=True)
class MonitorSettings:
    """The instrument of the monitor photodiode.

    `range_a`: largest current of its range. `samples_per_s`: samples of the current in a second. `relative_uncertainty`:
    relative standard uncertainty of one reading. `wavelength_nm`: wavelength for which it is set to give power. `dialect`: its
    commands: those of a Thorlabs PM100D, or of a Keysight B2980.
    """

    range_a: Positive = 500e-9
    samples_per_s: Positive = 3000.0
    relative_uncertainty: Fraction = Width(3.0e-4)
    wavelength_nm: Positive = 550.0
    dialect: Literal["pm100d", "b2980"] = "pm100d"

    @property
    def largest_a(self) -> float:
        """The end of its range, A."""
        return self.range_a

    @property
    def fetching_seconds(self) -> float:
        """From the end of a mean until it is read and checked, s."""
        return ANSWER_MARGIN_S + TRANSFERS_AT_END * TRANSFER_S
