"""Rows as their signals: each alone, many in columns, means of repeats; and rows found by wavelength and pose."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.campaign.geometry.directions import PoseAngles
from goniotwin.app.campaign.reduction.components import Signal
from goniotwin.app.campaign.reduction.points import PLACE
from goniotwin.app.campaign.reduction.signals import mean_signals, signals_of_rows, stack_signals
from goniotwin.app.campaign.row import Row
from goniotwin.app.columns import ColumnTable, FlagColumn, Hours, IntegerColumn, NumberColumn, Ratios
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import round_deg

PoseKey = tuple[float, PoseAngles]


@dataclass(frozen=True)
class RowSignal:
    """A measured row, or the mean of several rows of one pose: its signal, and the photodiodes (n,) that are flagged.

    `flags` by their names in files. drift: the row lies in a drift interval of the photodiode. dead: the photodiode has lost
    its dark current. module: its module has not passed the tests of the signals. monitor: this has no range left. `hours` is
    when the row began, on the rig's clock, and `monitor_decades` the logarithm of base ten of the monitor's current in A.
    """

    row: Row
    signal: Signal
    flags: Mapping[str, Flags]
    hours: float
    monitor_decades: float


@dataclass(frozen=True)
class RowSignals(ColumnTable):
    """Rows as `RowSignal`, in columns: `signal` and `flags` are of (rows, photodiodes), all others of (rows,).

    `numbers` are those of the rows; `places` (rows, 5) their wavelengths and poses, in the order of PLACE and not rounded;
    `mirrored` those that only check the symmetry.
    """

    numbers: IntegerColumn
    places: NumberColumn
    mirrored: FlagColumn
    signal: Signal
    flags: Mapping[str, FlagColumn]
    hours: Hours
    monitor_decades: Ratios


def rows_in_columns(rows: Sequence[RowSignal]) -> RowSignals | None:
    """Rows of one sample in columns; None for none."""
    if not rows:
        return None
    return RowSignals(
        np.array([each.row.number for each in rows]),
        np.array([_place(each.row) for each in rows]),
        np.array([each.row.mirrored for each in rows]),
        stack_signals([each.signal for each in rows]),
        {name: np.stack([each.flags[name] for each in rows]) for name in rows[0].flags},
        np.array([each.hours for each in rows]),
        np.array([each.monitor_decades for each in rows]),
    )


def mean_rows(rows: RowSignals, repeats: Ints) -> RowSignals:
    """The means of repeated measurements: of the first so many rows, of so many more after them, and so on."""
    if (repeats == 1).all():
        return rows
    begin, parts, places = np.cumsum(repeats) - repeats, [], []
    for n in np.unique(repeats).tolist():
        here = np.flatnonzero(repeats == n)
        index = begin[here, None] + np.arange(n)
        first = rows.where(index[:, 0])
        mean = replace(
            first,
            signal=mean_signals(rows.signal, index),
            flags={name: each[index].any(axis=1) for name, each in rows.flags.items()},
            hours=rows.hours[index].mean(axis=1),
            monitor_decades=rows.monitor_decades[index].mean(axis=1),
        )
        parts.append(mean)
        places.append(here)
    return RowSignals.join(parts).where(np.argsort(np.concatenate(places)))


def mean_row(rows: Sequence[RowSignal]) -> RowSignal:
    """The mean of repeated measurements of one pose, of which there is at least one."""
    columns = rows_in_columns(rows)
    assert columns is not None
    mean = mean_rows(columns, np.array([len(rows)]))
    (signal,) = signals_of_rows(mean.signal)
    flags = {name: each[0] for name, each in mean.flags.items()}
    return RowSignal(rows[0].row, signal, flags, float(mean.hours[0]), float(mean.monitor_decades[0]))


class PlaceIndex:
    """Finds rows by wavelength and pose: `places` (rows, 5) in the order of PLACE, compared as `pose_key` rounds them."""

    def __init__(self, places: Floats) -> None:
        self._columns = [np.unique(column) for column in round_deg(places).T]
        codes = self._codes(places)
        self.order: Ints = np.argsort(codes, kind="stable")
        self._sorted = codes[self.order]

    def range_of(self, places: Floats) -> tuple[Ints, Ints]:
        """For each of places (n, 5), begin and end (n,) in `order` of the rows there."""
        codes = self._codes(places)
        return np.searchsorted(self._sorted, codes, side="left"), np.searchsorted(self._sorted, codes, side="right")

    def has(self, places: Floats) -> Flags:
        """At which of places (n, 5) there is a row."""
        begin, end = self.range_of(places)
        return np.asarray(end > begin)

    def find(self, places: Floats) -> Ints:
        """For each of places (n, 5) the first row there, -1 for none."""
        begin, end = self.range_of(places)
        return np.where(end > begin, np.append(self.order, -1)[begin], -1)

    def _codes(self, places: Floats) -> Ints:
        """A number for each of the places (n, 5); -1 where a column has not this value, so that no row is there."""
        codes, known = np.zeros(len(places), dtype=np.int64), np.ones(len(places), dtype=bool)
        for column, values in zip(round_deg(places).T, self._columns, strict=True):
            at = np.minimum(np.searchsorted(values, column), max(values.size - 1, 0))
            known &= values[at] == column if values.size else False
            codes = codes * values.size + at
        return np.where(known, codes, -1)


def pose_key(row: Row, pose: PoseAngles) -> PoseKey:
    """A row's wavelength with a pose, rounded: 180 deg - sigma may differ in the last bits from the planner's sigma."""
    assert row.wavelength_nm is not None
    wavelength_nm, gamma, sigma, beta, shift = round_deg([row.wavelength_nm, *pose]).tolist()
    return (wavelength_nm, (gamma, sigma, beta, shift))


def _place(row: Row) -> list[float]:
    """A row's wavelength and pose, in the order of PLACE."""
    assert row.pose is not None
    assert row.wavelength_nm is not None
    columns = dict(zip(("gamma_deg", "sigma_deg", "beta_deg", "shift_deg"), row.pose, strict=True))
    return [{"wavelength_nm": row.wavelength_nm, **columns}[name] for name in PLACE]
