"""Order-sorting filters: which stands in the beam at which wavelength, so that no light of higher orders passes the grating.

This is the one place that decides: engine, planner and warnings all ask it.
"""

from dataclasses import dataclass

import numpy as np

from goniotwin.arrays import Floats, Ints


@dataclass(frozen=True)
class OrderFilter:
    """What stands in a position of the wheel, for wavelengths from `from_nm` on; below `cut_on_nm` it lets nothing through.

    None for `cut_on_nm`: nobody has said that it holds anything back.
    """

    position: int
    name: str
    from_nm: float
    cut_on_nm: float | None = None

    def blocks(self, wavelength_nm: float) -> bool:
        """Whether it is known to hold back light of this wavelength."""
        return self.cut_on_nm is not None and wavelength_nm < self.cut_on_nm


@dataclass(frozen=True)
class FilterWheel:
    """The filters by ascending wavelength; without any the wheel is never turned."""

    filters: tuple[OrderFilter, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.filters)

    def at(self, wavelength_nm: float) -> OrderFilter | None:
        """The filter for a wavelength; None where there are no filters. Where two meet it is the upper one."""
        return self.filters[int(self.numbers(np.array([wavelength_nm]))[0])] if self.filters else None

    def numbers(self, wavelengths_nm: Floats) -> Ints:
        """Which of the filters, counted from 0, each of wavelengths (n,) has; all 0 where there are none."""
        begins = np.array([each.from_nm for each in self.filters[1:]])
        return np.searchsorted(begins, wavelengths_nm, side="right").astype(np.int64)

    def positions(self, wavelengths_nm: Floats) -> Ints:
        """The wheel's positions (n,) for wavelengths (n,). Raises IndexError where there are no filters."""
        return np.array([each.position for each in self.filters], dtype=np.int64)[self.numbers(wavelengths_nm)]
