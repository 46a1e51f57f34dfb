"""Points to measure as ranks on their grids: what orders are made of, counted and compared with."""

from functools import cached_property

import numpy as np

from goniotwin.arrays import Floats, Ints

WAVELENGTH = 4
"""The column of the wavelength; before it come gamma, sigma, beta, shift."""
FILTER = 5
"""The column of the order-sorting filter, which the wavelength decides: a loop of it goes around that of the wavelength."""
TABLE_FACTOR = 8
"""A table of so many places a point finds the distinct numbers faster than sorting does."""


class ScanGrid:
    """All pairs of `poses` (n, 4) and `wavelengths` (w,); a point's number is its pose's times w, and its wavelength's.

    `filters` (w,) are the numbers of the filters that the wavelengths have; all one where they are not given.
    """

    def __init__(self, poses: Floats, wavelengths_nm: Floats, filters: Ints | None = None) -> None:
        self.poses = poses
        self.wavelengths_nm = wavelengths_nm
        filters = np.zeros(len(wavelengths_nm), dtype=np.int64) if filters is None else filters
        found = [np.unique(column, return_inverse=True) for column in (*poses.T, wavelengths_nm, filters)]
        self.values = [values for values, _ in found]
        self._pose_ranks = [np.asarray(ranks, dtype=np.int64) for _, ranks in found[:WAVELENGTH]]
        self._wavelength_ranks, self._filter_ranks = (np.asarray(ranks, dtype=np.int64) for _, ranks in found[WAVELENGTH:])

    def __len__(self) -> int:
        return len(self.poses) * len(self.wavelengths_nm)

    @cached_property
    def points(self) -> Floats:
        """All of them, (n, 5)."""
        points = np.empty((len(self), 5))
        points[:, :WAVELENGTH] = np.repeat(self.poses, len(self.wavelengths_nm), axis=0)
        points[:, WAVELENGTH] = np.tile(self.wavelengths_nm, len(self.poses))
        return points

    @cached_property
    def ranks(self) -> list[Ints]:
        """By column, the place of each point's value among the column's."""
        outer = [np.repeat(ranks, len(self.wavelengths_nm)) for ranks in self._pose_ranks]
        return [*outer, *(np.tile(ranks, len(self.poses)) for ranks in (self._wavelength_ranks, self._filter_ranks))]

    @property
    def varying_columns(self) -> tuple[int, ...]:
        """The columns that change at all; the filter is none of them, for it changes with the wavelength."""
        return tuple(column for column, values in enumerate(self.values[:FILTER]) if len(values) > 1)

    @property
    def has_filter_groups(self) -> bool:
        """Whether there are several filters, and several wavelengths to one of them."""
        return 1 < len(self.values[FILTER]) < len(self.values[WAVELENGTH])

    def count_distinct(self, labels: dict[int, Ints]) -> int:
        """How many points differ in some column, where the values of each have the `labels`; other columns do not count."""
        light = WAVELENGTH if WAVELENGTH in labels else FILTER  # the wavelength has told the filter
        waves = int(labels[light].max()) + 1 if light in labels else 1
        columns = [column for column in labels if column < WAVELENGTH]
        sizes = [int(labels[column].max()) + 1 for column in columns]
        if len(self.poses) == int(np.prod([len(values) for values in self.values[:WAVELENGTH]])):
            return int(np.prod(sizes)) * waves  # a whole grid
        key = np.zeros(len(self.poses), dtype=np.int64)
        room = 1
        for column, size in zip(columns, sizes, strict=True):
            key, room = key * size + labels[column][self._pose_ranks[column]], room * size
        return len(unique_ranks(key, room)[0]) * waves


def unique_ranks(key: Ints, room: int) -> tuple[Ints, Ints]:
    """The distinct numbers of `key` (each below `room`) in order, and the place of each among them."""
    if room > TABLE_FACTOR * len(key):
        found, places = np.unique(key, return_inverse=True)
        return found, places
    there = np.zeros(room, dtype=bool)
    there[key] = True
    found = np.flatnonzero(there)
    places = np.empty(room, dtype=np.int64)
    places[found] = np.arange(len(found))
    return found, places[key]
