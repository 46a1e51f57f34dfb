"""Signals of the measured rows, read from the journal on demand, a few rows at a time.

A campaign may have a hundred thousand rows. Memory holds their list (about fifty bytes a row), the means of the dark readings
and the results of the drift checks. The signals of the etalon and of the instrument signature are computed again for each
block that needs them.
"""

import contextlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from goniotwin.app.campaign.geometry.directions import PoseAngles
from goniotwin.app.campaign.journal.record import CommittedRow
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.reduction.drift_checks import drift_intervals, insensitive_photodiodes
from goniotwin.app.campaign.reduction.signals import (
    Signal,
    add_tracing_error,
    dark_current_loss_s,
    dark_readings_by_gain,
    mean_signal,
    middle_s,
    signal,
)
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.campaign.schedule.grids import DECIMALS, HALF_TURN_DEG
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, photodiode_settings
from goniotwin.arrays import Flags, Floats, Ints

PLACE = ("wavelength_nm", "gamma_deg", "sigma_deg", "beta_deg", "shift_deg")
PoseKey = tuple[float, PoseAngles]
RowTable = npt.NDArray[np.void]


@dataclass(frozen=True)
class RowSignal:
    """A measured row, or the mean of several rows of one pose: its signal, and the photodiodes (n,) that are flagged.

    `drifted`: the row lies in a drift interval of the photodiode. `dead`: the photodiode has lost its dark current.
    """

    row: Row
    signal: Signal
    drifted: Flags
    dead: Flags


def pose_key(row: Row, pose: PoseAngles) -> PoseKey:
    """A row's wavelength with a pose, rounded: 180 deg - sigma may differ in the last bits from the planner's sigma."""
    assert row.wavelength_nm is not None
    gamma, sigma, beta, shift = (round(angle, DECIMALS) for angle in pose)
    return (row.wavelength_nm, (gamma, sigma, beta, shift))


class Measurements:
    """All measured rows of a journal. Raises UserError where there are no dark readings, or a row cannot be reduced."""

    def __init__(self, journal: Journal, schedule: ScheduleFile, rig: RigDescription) -> None:
        self._journal = journal
        self._rig = rig
        self._settings = photodiode_settings(rig.file)
        dark_rows = list(journal.rows("dark"))
        with self._path_in_errors():
            self._dark = dark_readings_by_gain(dark_rows, self._settings)
        self._loss_s = dark_current_loss_s(dark_rows, self._settings)
        del dark_rows
        self._table, self._names = journal.row_index()
        limit = None if schedule.drift is None else schedule.drift.limit
        self.insensitive = insensitive_photodiodes(journal.rows("drift"), self._signal)
        some = next(journal.rows("drift"), None) is not None
        rows = journal.rows("mount", "measure", "drift") if some else iter(())
        self.drift_intervals = drift_intervals(rows, self._signal, rig.file, limit)

    def row_table(self, sample: str) -> RowTable:
        """The measured rows of a sample, in order of time."""
        code = self._names.index(sample) if sample in self._names else -1
        rows: RowTable = self._table[self._table["sample"] == code]
        return rows

    def row_signals(self, numbers: Iterable[int]) -> Iterator[RowSignal]:
        """The signals of rows, by the rows' numbers."""
        none = np.zeros(self._settings.count, dtype=bool)
        for each in self._journal.rows_of(numbers):
            drifted = np.any([none, *(drift.flagged_at(each.data.started_s) for drift in self.drift_intervals)], axis=0)
            yield RowSignal(each.row, self._signal(each), drifted, self._loss_s < middle_s(each.data.readings[0]))

    @contextlib.contextmanager
    def _path_in_errors(self) -> Iterator[None]:
        try:
            yield
        except UserError as error:
            raise UserError(f"{self._journal.path}: {error}") from None

    def _signal(self, row: CommittedRow) -> Signal:
        with self._path_in_errors():
            return add_tracing_error(signal(row.data, self._dark, self._settings), self._rig.file)


class ReferenceMeasurements:
    """Measurements of the etalon, or without a sample, by wavelength and pose; repeats of one pose are averaged."""

    def __init__(self, measurements: Measurements, sample: str) -> None:
        self._measurements = measurements
        table = measurements.row_table(sample)
        self.places: Floats = np.stack([np.round(table[name], DECIMALS) for name in PLACE], axis=1)
        self._columns = [np.unique(column) for column in self.places.T]
        codes = self._codes(self.places)
        order = np.argsort(codes, kind="stable")
        self._sorted, self._numbers = codes[order], table["number"][order]

    def __len__(self) -> int:
        return len(self._numbers)

    def at(self, keys: Iterable[PoseKey]) -> dict[PoseKey, RowSignal]:
        """The signals at those keys that were measured."""
        wanted = list(dict.fromkeys(keys))
        if not wanted or not len(self):
            return {}
        codes = self._codes(np.array([(wavelength, *pose) for wavelength, pose in wanted]))
        first, last = (np.searchsorted(self._sorted, codes, side=side) for side in ("left", "right"))
        signals = {}
        for key, begin, end in zip(wanted, first.tolist(), last.tolist(), strict=True):
            if end > begin:
                signals[key] = _mean(list(self._measurements.row_signals(self._numbers[begin:end].tolist())))
        return signals

    def meets(self, other: "ReferenceMeasurements") -> bool:
        """Whether both have a measurement at the same wavelength and pose."""
        return bool(np.any(self._codes(other.places) >= 0)) if len(self) else False

    def _codes(self, places: Floats) -> Ints:
        """A number for each of the places (n, 5); -1 where nothing was measured."""
        codes, known = np.zeros(len(places), dtype=np.int64), np.ones(len(places), dtype=bool)
        for column, values in zip(places.T, self._columns, strict=True):
            at = np.minimum(np.searchsorted(values, column), max(values.size - 1, 0))
            known &= values[at] == column if values.size else False
            codes = codes * values.size + at
        return np.where(known, codes, -1)


def order_by_setting(table: RowTable) -> tuple[Ints, Ints]:
    """Indices of the rows in the order of wavelength, sigma, gamma and half planes, each in order of time; and the edges.

    The edges are the places in that order where wavelength, sigma or gamma changes, with 0 first and the number of rows last.
    All neighbours of a value, and all overlaps of photodiodes, lie between two edges.
    """
    plane = np.round(np.mod(table["beta_deg"], HALF_TURN_DEG), DECIMALS)
    keys = [table[name] for name in ("gamma_deg", "sigma_deg", "wavelength_nm")]
    order = np.lexsort([plane, *keys])
    changes = np.any([key[order][1:] != key[order][:-1] for key in keys], axis=0) if len(order) else np.zeros(0, dtype=bool)
    return order, np.concatenate([[0], 1 + np.flatnonzero(changes), [len(order)]])


def _mean(group: list[RowSignal]) -> RowSignal:
    return RowSignal(
        group[0].row,
        mean_signal([each.signal for each in group]),
        np.any([each.drifted for each in group], axis=0),
        np.any([each.dead for each in group], axis=0),
    )
