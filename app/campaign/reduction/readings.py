"""Signals of the measured rows, read from the journal on demand, a few rows at a time.

A campaign may have a hundred thousand rows. Memory holds their list (about fifty bytes a row), the means of the dark readings
and the results of the drift checks. The signals of the etalon and of the instrument signature are computed again for each
block that needs them.
"""

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from goniotwin.app.campaign.geometry.directions import scan_plane_deg
from goniotwin.app.campaign.journal.reading import JournalReader
from goniotwin.app.campaign.readout import saturation
from goniotwin.app.campaign.reduction.components import Estimate, Signal
from goniotwin.app.campaign.reduction.drift_checks import DriftInterval, drift_intervals, insensitive_photodiodes
from goniotwin.app.campaign.reduction.etalon import PoseKey, RowSignal, mean_row
from goniotwin.app.campaign.reduction.pipeline import reduce_readings
from goniotwin.app.campaign.reduction.points import PLACE
from goniotwin.app.campaign.reduction.signals import (
    check_reading,
    dark_current_loss_s,
    dark_readings_by_gain,
    middle_s,
    subtract_dark,
)
from goniotwin.app.campaign.row import CommittedRow
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigFile
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import round_deg

RowTable = npt.NDArray[np.void]


class DarkHistory:
    """All dark readings of a campaign so far, and what they make of the readings of any row. Raises UserError if too few."""

    def __init__(self, dark_rows: list[CommittedRow], rig: RigFile) -> None:
        self._rig = rig
        self._settings = rig.photodiodes
        self._dark = dark_readings_by_gain(dark_rows, self._settings)
        self._loss_s = dark_current_loss_s(dark_rows, self._settings)

    def signal(self, row: CommittedRow) -> Signal:
        """The signal of a row with readings. Raises UserError where it cannot be reduced."""
        return reduce_readings(row.data, self._dark, self._settings, self._rig)

    def volts(self, row: CommittedRow, gain_v_per_a: float) -> Estimate | None:
        """Voltages (photodiodes,) of a row above the dark reading at one gain, NaN where saturated; None if not read there."""
        for reading in row.data.readings:
            if reading.gain_v_per_a == gain_v_per_a and gain_v_per_a in self._dark:
                check_reading(reading, self._settings)
                volts = subtract_dark(reading, self._dark[gain_v_per_a], self._settings)
                return replace(volts, value=np.where(saturation(reading.counts, self._settings.range), np.nan, volts.value))
        return None

    def row_signal(self, row: CommittedRow, signal: Signal, intervals: Sequence[DriftInterval]) -> RowSignal:
        """The signal of a row, with the photodiodes that drifted, and those that have lost their dark current."""
        none = np.zeros(self._settings.count, dtype=bool)
        drifted = np.any([none, *(drift.flagged_at(row.data.started_s) for drift in intervals)], axis=0)
        return RowSignal(row.row, signal, drifted, self._loss_s < middle_s(row.data.readings[0]))


class Measurements:
    """All measured rows of a journal. Raises UserError where there are no dark readings, or a row cannot be reduced."""

    def __init__(self, journal: JournalReader, schedule: ScheduleFile, rig: RigFile) -> None:
        self._journal = journal
        with self._path_in_errors():
            self._dark = DarkHistory(list(journal.rows("dark")), rig)
        self._table, self._names = journal.row_index()
        limit = None if schedule.drift is None else schedule.drift.limit
        self.insensitive = insensitive_photodiodes(journal.rows("drift"), self._signal)
        some = next(journal.rows("drift"), None) is not None
        rows = journal.rows("mount", "measure", "drift") if some else iter(())
        self.drift_intervals = drift_intervals(rows, self._signal, rig, limit)

    def row_table(self, sample: str) -> RowTable:
        """The measured rows of a sample, in order of time."""
        code = self._names.index(sample) if sample in self._names else -1
        rows: RowTable = self._table[self._table["sample"] == code]
        return rows

    def row_signals(self, numbers: Iterable[int]) -> Iterator[RowSignal]:
        """The signals of rows, by the rows' numbers."""
        for each in self._journal.rows_of(numbers):
            yield self._dark.row_signal(each, self._signal(each), self.drift_intervals)

    def volts(self, numbers: Iterable[int], gain_v_per_a: float) -> Iterator[Estimate]:
        """Voltages of the rows that were read at a gain, by the rows' numbers."""
        for each in self._journal.rows_of(numbers):
            with self._path_in_errors():
                found = self._dark.volts(each, gain_v_per_a)
            if found is not None:
                yield found

    @contextlib.contextmanager
    def _path_in_errors(self) -> Iterator[None]:
        try:
            yield
        except UserError as error:
            raise UserError(f"{self._journal.path}: {error}") from None

    def _signal(self, row: CommittedRow) -> Signal:
        with self._path_in_errors():
            return self._dark.signal(row)


class ReferenceMeasurements:
    """Measurements of the etalon, or without a sample, by wavelength and pose; repeats of one pose are averaged."""

    def __init__(self, measurements: Measurements, sample: str) -> None:
        self._measurements = measurements
        table = measurements.row_table(sample)
        self.places = row_places(table)
        self._columns = [np.unique(column) for column in round_deg(self.places).T]
        codes = self._codes(self.places)
        order = np.argsort(codes, kind="stable")
        self._sorted, self._numbers = codes[order], table["number"][order]

    def __len__(self) -> int:
        return len(self._numbers)

    def at(self, keys: Iterable[PoseKey]) -> dict[PoseKey, RowSignal]:
        """The signals at those keys that were measured."""
        signals = {}
        for key, numbers in self._rows_at(keys):
            if numbers:
                signals[key] = mean_row(list(self._measurements.row_signals(numbers)))
        return signals

    def numbers_at(self, keys: Iterable[PoseKey]) -> list[int]:
        """The numbers of the rows at those keys that were measured."""
        return [number for _, numbers in self._rows_at(keys) for number in numbers]

    def _rows_at(self, keys: Iterable[PoseKey]) -> Iterator[tuple[PoseKey, list[int]]]:
        """Each of the keys once, with the numbers of its rows."""
        wanted = list(dict.fromkeys(keys))
        if not wanted or not len(self):
            return
        codes = self._codes(np.array([(wavelength, *pose) for wavelength, pose in wanted]))
        first, last = (np.searchsorted(self._sorted, codes, side=side) for side in ("left", "right"))
        for key, begin, end in zip(wanted, first.tolist(), last.tolist(), strict=True):
            yield key, self._numbers[begin:end].tolist()

    def measured(self, places: Floats) -> Flags:
        """Which of the places (n, 5) were measured."""
        return np.asarray(self._codes(places) >= 0)

    def meets(self, other: "ReferenceMeasurements") -> bool:
        """Whether both have a measurement at the same wavelength and pose."""
        return bool(np.any(self.measured(other.places))) if len(self) else False

    def _codes(self, places: Floats) -> Ints:
        """A number for each of the places (n, 5), which are rounded as in `pose_key`; -1 where nothing was measured."""
        codes, known = np.zeros(len(places), dtype=np.int64), np.ones(len(places), dtype=bool)
        for column, values in zip(round_deg(places).T, self._columns, strict=True):
            at = np.minimum(np.searchsorted(values, column), max(values.size - 1, 0))
            known &= values[at] == column if values.size else False
            codes = codes * values.size + at
        return np.where(known, codes, -1)


def row_places(table: RowTable) -> Floats:
    """Wavelengths and poses (n, 5) of rows, in the order of PLACE. Not rounded."""
    return np.stack([table[name] for name in PLACE], axis=1)


def order_by_setting(table: RowTable) -> tuple[Ints, Ints]:
    """Indices of the rows in the order of wavelength, sigma, gamma and half planes, each in order of time; and the edges.

    The edges are the places in that order where wavelength, sigma or gamma changes, with 0 first and the number of rows last.
    All neighbours of a value, and all overlaps of photodiodes, lie between two edges.
    """
    keys = [table[name] for name in ("gamma_deg", "sigma_deg", "wavelength_nm")]
    order = np.lexsort([scan_plane_deg(table["beta_deg"]), *keys])
    changes = np.any([key[order][1:] != key[order][:-1] for key in keys], axis=0) if len(order) else np.zeros(0, dtype=bool)
    return order, np.concatenate([[0], 1 + np.flatnonzero(changes), [len(order)]])
