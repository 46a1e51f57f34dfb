"""Settings of the monochromator and its order-sorting filters, and the durations that follow from them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Protocol

import numpy as np
from annotated_types import MinLen

from goniotwin.arrays import Floats, Ints
from goniotwin.keys import Count, NonNegative, Positive, WheelPosition
from goniotwin.protocols.cornerstone import Statement, encode_nm

UNIT_LATENCY_S = 2.0e-3
STATUS_MARGIN_S = 3.0e-3
"""Time from the expected status of a statement until it is read."""
POSITION_AFTER_POWER_UP = 1
"""Position of the filter wheel after a power-up."""
TINY_NM = 1e-6


@dataclass(frozen=True)
class OrderFilter:
    """An order-sorting filter, and the wavelengths for which it is used.

    `position`: its position in the wheel. `name`: its name in messages. `from_nm`: first wavelength, included. `to_nm`: last
    wavelength, included if no other band begins there. `cut_on_nm`: wavelength from which on the filter transmits. Without it,
    as for an empty position, the filter is assumed to block nothing.

    Raises ValueError for a band without wavelengths, or a blocked one.
    """

    position: WheelPosition
    name: Annotated[str, MinLen(1)]
    from_nm: Positive
    to_nm: Positive
    cut_on_nm: Positive | None = None

    def __post_init__(self) -> None:
        if not self.from_nm < self.to_nm:
            raise ValueError(f"from_nm {self.from_nm:g} is not below to_nm {self.to_nm:g}; exchange them")
        if self.blocks(self.from_nm):
            raise ValueError(
                f"cut_on_nm {self.cut_on_nm:g} is above from_nm {self.from_nm:g}, so the filter blocks a part of its own band; "
                "let the band begin higher, or use another filter"
            )

    def blocks(self, wavelength_nm: float) -> bool:
        """True if the filter is known to block this wavelength."""
        return self.cut_on_nm is not None and wavelength_nm < self.cut_on_nm

    def __str__(self) -> str:
        return f"{self.name!r} ({self.from_nm:g} to {self.to_nm:g} nm)"


@dataclass(frozen=True)
class FilterWheel:
    """Order-sorting filters by ascending wavelength: they block the higher orders of the grating. A step takes `step_s`.

    Engine, planner and warnings take the filter of a wavelength from here. A wheel without filters is never turned.
    """

    filters: tuple[OrderFilter, ...] = ()
    step_s: float = 0.0

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
        """Positions of the wheel (n,) for wavelengths (n,); that after a power-up for an unknown one (NaN).

        Raises IndexError without filters.
        """
        positions = np.array([each.position for each in self.filters], dtype=np.int64)[self.numbers(wavelengths_nm)]
        return np.where(np.isnan(wavelengths_nm), np.int64(POSITION_AFTER_POWER_UP), positions)

    def steps(self, start_nm: Floats, stop_nm: Floats) -> Ints:
        """Number of positions (n,) by which the wheel turns from wavelengths (n,) to others; 0 without filters."""
        if not self.filters:
            return np.zeros(len(stop_nm), dtype=np.int64)
        return np.asarray(np.abs(self.positions(stop_nm) - self.positions(start_nm)))

    def seconds(self, start_nm: Floats, stop_nm: Floats) -> Floats:
        """Seconds (n,) in which the wheel turns from wavelengths (n,) to others."""
        return np.asarray(self.steps(start_nm, stop_nm) * self.step_s)


def refuse_repeated_positions(positions: Sequence[int]) -> None:
    """Raise ValueError if a position of a filter wheel is given twice."""
    for position in positions:
        if (count := positions.count(position)) > 1:
            raise ValueError(f"filters: position {position} is given {count} times; keep one, a position has one filter")


class MonochromatorDescription(Protocol):
    """A monochromator of any make as its driver knows it without a wire: the operator's table of it.

    Wavelengths are from `lowest_nm` to `highest_nm`. A `wheel` without filters is never turned.
    """

    @property
    def lowest_nm(self) -> float: ...
    @property
    def highest_nm(self) -> float: ...
    @property
    def wheel(self) -> FilterWheel: ...

    def wavelength_seconds(self, start_nm: Floats, stop_nm: Floats) -> Floats:
        """Seconds (n,) of changes from wavelengths (n,) to others; NaN is an unknown start."""

    def shutter_seconds(self, *, opened: bool) -> float:
        """Duration of opening or closing the shutter, s."""


@dataclass(frozen=True)
class MonochromatorSettings:
    """The monochromator's range, and the durations of what it does.

    `baudrate`: speed of the serial line. `lowest_nm`: shortest wavelength. `highest_nm`: longest wavelength. `slew_nm_per_s`:
    speed of the grating. `slew_settle_s`: time until the grating rests after its motion. `shutter_s`: duration of opening or
    closing the shutter. `filter_s`: time in which the filter wheel turns by one position. `grating_s`: duration of a change of
    the grating. `slit_um_per_s`: speed of the slits, in micrometres per second. `tolerance_nm`: largest deviation of a grating
    at rest from its target. `filters`: the order-sorting filters. Without them the wheel is never turned.

    Raises ValueError for filters whose bands overlap or leave a gap.
    """

    baudrate: Count = 9600
    lowest_nm: Positive = 380.0
    highest_nm: Positive = 780.0
    slew_nm_per_s: Positive = 175.0
    slew_settle_s: NonNegative = 0.1
    shutter_s: NonNegative = 0.15
    filter_s: NonNegative = 1.0
    grating_s: NonNegative = 8.0
    slit_um_per_s: Positive = 500.0
    tolerance_nm: Positive = 0.05
    filters: tuple[OrderFilter, ...] = ()

    def __post_init__(self) -> None:
        if self.filters:
            refuse_repeated_positions([each.position for each in self.filters])
            self._check_bands()

    def _check_bands(self) -> None:
        """Raise ValueError, with the keys to correct, if bands overlap or leave a gap from `lowest_nm` to `highest_nm`."""
        ordered = self.wheel.filters
        for below, above in pairwise(ordered):
            if above.from_nm < below.to_nm - TINY_NM:
                raise ValueError(
                    f"filters: the bands of {below} and {above} overlap; make to_nm of one the from_nm of the other"
                )
        ends = [(0.0, ordered[0].from_nm), *((a.to_nm, b.from_nm) for a, b in pairwise(ordered)), (ordered[-1].to_nm, math.inf)]
        for end, begin in ends:
            missing = max(end, self.lowest_nm), min(begin, self.highest_nm)
            if missing[1] - missing[0] > TINY_NM:
                raise ValueError(
                    f"filters: there is no filter for {missing[0]:g} to {missing[1]:g} nm; widen a band with from_nm or to_nm, "
                    "give the empty position for it, or narrow lowest_nm and highest_nm"
                )

    @property
    def wheel(self) -> FilterWheel:
        """The filter wheel, its filters by ascending wavelength."""
        return FilterWheel(tuple(sorted(self.filters, key=lambda each: each.from_nm)), self.filter_s)

    def slew_seconds(self, distance_nm: Floats | float) -> Floats:
        """Seconds (n,) in which the grating turns over distances (n,) of any sign."""
        distance_nm = np.abs(distance_nm)
        return np.where(distance_nm > 0.0, distance_nm / self.slew_nm_per_s + self.slew_settle_s, 0.0)

    def statement_seconds(self, text: str) -> float:
        """From sending a statement that moves nothing until its status is read, s."""
        return self._transmission_s(text) + STATUS_MARGIN_S

    def query_seconds(self, text: str, reply: str) -> float:
        """Duration of a query with echo, reply and status, s."""
        return self._transmission_s(text) + 10.0 * len(reply + "\r\n") / self.baudrate + UNIT_LATENCY_S

    def shutter_seconds(self, *, opened: bool) -> float:
        """Duration of opening or closing the shutter, s: a statement and a query."""
        letter = "O" if opened else "C"
        return self.shutter_s + self.statement_seconds(f"SHUTTER {letter}") + self.query_seconds("SHUTTER?", letter)

    def wavelength_seconds(self, start_nm: Floats, stop_nm: Floats) -> Floats:
        """Seconds (n,) of changes from wavelengths (n,) to others: the filter wheel turns first, then the grating.

        An unknown wavelength (NaN) has the filter that the wheel has after a power-up, and no way for the grating.
        """
        target = encode_nm(self.highest_nm)  # the longest text
        exchanges = self.statement_seconds(str(Statement("GOWAVE", parameter=target))) + self.query_seconds("WAVE?", target)
        slewing = self.slew_seconds(np.nan_to_num(stop_nm - start_nm))
        return np.asarray(self._filter_seconds(start_nm, stop_nm) + (slewing + exchanges))

    def _filter_seconds(self, start_nm: Floats, stop_nm: Floats) -> Floats:
        """The filter wheel: queried, turned where it is elsewhere, and queried again; unknown replies are queried twice."""
        if not self.wheel:
            return np.zeros(len(stop_nm))
        steps, unknown, query_s = self.wheel.steps(start_nm, stop_nm), np.isnan(start_nm), self.query_seconds("FILTER?", "1")
        turned = query_s + (self.statement_seconds("FILTER 1") + query_s) + self.wheel.seconds(start_nm, stop_nm)
        queried = np.where(unknown, query_s * (1 + (steps == 0)), 0.0)
        return np.where(steps > 0, turned, 0.0) + queried

    def _transmission_s(self, text: str) -> float:
        """Transmission time of a statement, its echo and its status, s."""
        return 10.0 * (2 * len(text) + len("\n\r\n00\r\n")) / self.baudrate
