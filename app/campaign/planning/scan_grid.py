"""Scan grid: the points to measure, and the ranks of their values in each column, from which orders are made."""

from functools import cached_property

import numpy as np

from goniotwin.arrays import Floats, Ints

WAVELENGTH = 4
"""Column of the wavelength, after gamma, sigma, beta, shift."""
FILTER = 5
"""Column of the order-sorting filter, which follows from the wavelength: a loop over it is around the loop over wavelengths."""
TABLE_FACTOR = 8
"""Largest ratio of table entries to points at which a table finds distinct numbers faster than sorting."""


class ScanGrid:
    """All pairs of `poses` (n, 4) and `wavelengths_nm` (w,).

    The number of a point is the number of its pose times w, plus the number of its wavelength. `filters` (w,) are the numbers
    of the filters of the wavelengths; without them all wavelengths have the same filter.
    """

    def __init__(self, poses: Floats, wavelengths_nm: Floats, filters: Ints | None = None) -> None:
        self.poses = poses
        self.wavelengths_nm = wavelengths_nm
        filters = np.zeros(len(wavelengths_nm), dtype=np.int64) if filters is None else filters
        columns = [np.unique(column, return_inverse=True) for column in (*poses.T, wavelengths_nm, filters)]
        self.values = [values for values, _ in columns]
        self._pose_ranks = [np.asarray(ranks, dtype=np.int64) for _, ranks in columns[:WAVELENGTH]]
        self._wavelength_ranks, self._filter_ranks = (np.asarray(ranks, dtype=np.int64) for _, ranks in columns[WAVELENGTH:])

    def __len__(self) -> int:
        return len(self.poses) * len(self.wavelengths_nm)

    @cached_property
    def points(self) -> Floats:
        """All points (n, 5): gamma, sigma, beta, shift in degrees, wavelength in nm."""
        points = np.empty((len(self), 5))
        points[:, :WAVELENGTH] = np.repeat(self.poses, len(self.wavelengths_nm), axis=0)
        points[:, WAVELENGTH] = np.tile(self.wavelengths_nm, len(self.poses))
        return points

    @cached_property
    def ranks(self) -> list[Ints]:
        """For each column the rank of each point's value among the values of the column."""
        outer = [np.repeat(ranks, len(self.wavelengths_nm)) for ranks in self._pose_ranks]
        return [*outer, *(np.tile(ranks, len(self.poses)) for ranks in (self._wavelength_ranks, self._filter_ranks))]

    @property
    def varying_columns(self) -> tuple[int, ...]:
        """The columns with more than one value, without the filter, which follows from the wavelength."""
        return tuple(column for column, values in enumerate(self.values[:FILTER]) if len(values) > 1)

    @property
    def has_filter_groups(self) -> bool:
        """Whether there are several filters, and several wavelengths with one of them."""
        return 1 < len(self.values[FILTER]) < len(self.values[WAVELENGTH])

    def count_distinct(self, labels: dict[int, Ints]) -> int:
        """Number of points that differ in their labels.

        `labels` has, for some columns, a label for each value of the column; the other columns do not count.
        """
        spectral = WAVELENGTH if WAVELENGTH in labels else FILTER  # the wavelength determines the filter
        waves = int(labels[spectral].max()) + 1 if spectral in labels else 1
        columns = [column for column in labels if column < WAVELENGTH]
        sizes = [int(labels[column].max()) + 1 for column in columns]
        if len(self.poses) == int(np.prod([len(values) for values in self.values[:WAVELENGTH]])):
            return int(np.prod(sizes)) * waves  # the poses are a full product
        key = np.zeros(len(self.poses), dtype=np.int64)
        table_size = 1
        for column, size in zip(columns, sizes, strict=True):
            key, table_size = key * size + labels[column][self._pose_ranks[column]], table_size * size
        return len(unique_ranks(key, table_size)[0]) * waves


def unique_ranks(key: Ints, table_size: int) -> tuple[Ints, Ints]:
    """The distinct numbers of `key` (each below `table_size`) in ascending order, and the rank of each of `key` among them."""
    if table_size > TABLE_FACTOR * len(key):
        distinct, ranks = np.unique(key, return_inverse=True)
        return distinct, ranks
    present = np.zeros(table_size, dtype=bool)
    present[key] = True
    distinct = np.flatnonzero(present)
    ranks = np.empty(table_size, dtype=np.int64)
    ranks[distinct] = np.arange(len(distinct))
    return distinct, ranks[key]
