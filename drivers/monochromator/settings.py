"""Settings of the monochromator and its order-sorting filters, and the durations that follow from them."""

from dataclasses import dataclass, field

import numpy as np

from goniotwin.arrays import Floats, Ints

UNIT_LATENCY_S = 2.0e-3


@dataclass(frozen=True)
class OrderFilter:
    """A filter in a position of the wheel, for wavelengths from `from_nm` on; it blocks wavelengths below `cut_on_nm`.

    `cut_on_nm` is None if it is not stated.
    """

    position: int
    name: str
    from_nm: float
    cut_on_nm: float | None = None

    def blocks(self, wavelength_nm: float) -> bool:
        """True if the filter is known to block this wavelength."""
        return self.cut_on_nm is not None and wavelength_nm < self.cut_on_nm


@dataclass(frozen=True)
class FilterWheel:
    """Order-sorting filters by ascending wavelength: they block the higher orders of the grating.

    Engine, planner and warnings take the filter of a wavelength from here. A wheel without filters is never turned.
    """

    filters: tuple[OrderFilter, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.filters)

    def at(self, wavelength_nm: float) -> OrderFilter | None:
        """The filter for a wavelength; None without filters. At a limit between two filters it is the upper one."""
        return self.filters[int(self.numbers(np.array([wavelength_nm]))[0])] if self.filters else None

    def numbers(self, wavelengths_nm: Floats) -> Ints:
        """Index (n,) of the filter for each of wavelengths (n,); all 0 without filters."""
        limits = np.array([each.from_nm for each in self.filters[1:]])
        return np.searchsorted(limits, wavelengths_nm, side="right").astype(np.int64)

    def positions(self, wavelengths_nm: Floats) -> Ints:
        """Positions of the wheel (n,) for wavelengths (n,). Raises IndexError without filters."""
        return np.array([each.position for each in self.filters], dtype=np.int64)[self.numbers(wavelengths_nm)]


@dataclass(frozen=True)
class MonochromatorSettings:
    """The monochromator, as configured by the operator.

    `tolerance_nm` is the largest deviation of a grating at rest from its target. `filter_s` is how long the filter wheel
    takes from one position to the next; `wheel` has its filters.
    """

    baudrate: int = 9600
    lowest_nm: float = 380.0
    highest_nm: float = 780.0
    slew_nm_per_s: float = 175.0
    slew_settle_s: float = 0.1
    shutter_s: float = 0.15
    filter_s: float = 1.0
    grating_s: float = 8.0
    slit_um_per_s: float = 500.0
    tolerance_nm: float = 0.05
    wheel: FilterWheel = field(default_factory=FilterWheel)

    def slew_seconds(self, distance_nm: float) -> float:
        """Duration of a change of wavelength, s."""
        return abs(distance_nm) / self.slew_nm_per_s + self.slew_settle_s if distance_nm else 0.0

    def statement_seconds(self, text: str) -> float:
        """Transmission time of a statement, its echo and its status, s."""
        return 10.0 * (2 * len(text) + len("\n\r\n00\r\n")) / self.baudrate

    def query_seconds(self, text: str, reply: str) -> float:
        """Duration of a query with echo, reply and status, s."""
        return self.statement_seconds(text) + 10.0 * len(reply + "\r\n") / self.baudrate + UNIT_LATENCY_S
