"""Signals of the measured rows, read from the journal on demand, a few rows at a time.

A campaign may have a hundred thousand rows. Memory holds their list (about fifty bytes a row), the means of the dark readings
and the results of the drift checks. The signals of the etalon and of the instrument signature are computed again for each
block that needs them.
"""

import contextlib
import copy
import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from goniotwin.app.campaign.geometry.directions import scan_plane_deg
from goniotwin.app.campaign.journal.reading import JournalReader
from goniotwin.app.campaign.measurement_model.quantity import Quantity
from goniotwin.app.campaign.reduction.components import Signal
from goniotwin.app.campaign.reduction.drift_checks import (
    DriftChange,
    DriftInterval,
    drift_changes,
    drift_intervals,
    insensitive_photodiodes,
)
from goniotwin.app.campaign.reduction.evidence import EvidenceSums, RunningEvidence, SignalEvidence, stated
from goniotwin.app.campaign.reduction.pipeline import reduce_readings
from goniotwin.app.campaign.reduction.points import PLACE
from goniotwin.app.campaign.reduction.row_signals import (
    PlaceIndex,
    PoseKey,
    RowSignal,
    RowSignals,
    mean_row,
    mean_rows,
    rows_in_columns,
)
from goniotwin.app.campaign.reduction.signals import (
    COPY,
    LATEST_S,
    check_reading,
    contradictory_dark_intervals,
    dark_current_loss_s,
    dark_readings_by_gain,
    group_readings,
    middles_s,
    signals_of_rows,
    subtract_dark,
)
from goniotwin.app.campaign.row import CONTRADICTION, CommittedRow, ReadingTable, RecordedRows, RowKind, reading_table
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigFile
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import round_deg

MOST_COUNTS = 1 << 22
"""Counts from which on fewer rows than the sizes of blocks state are in memory together."""
LIT: tuple[RowKind, ...] = ("measure", "drift")
"""Kinds of rows with light on the photodiodes."""
END_OF_RANGE = 0.98
"""From this share of its range on the monitor may not follow the light."""
MOST_REPEATED = 12
"""Repeated poses of a sample that are read for the repeatability, before all others."""
FEWEST_REPEATS, FEWEST_CLEAR = 10, 3
"""Degrees of freedom, and photodiodes with light in a row, from which repeats are evidence."""
CLEAR = 20.0
"""Such a photodiode's signal is above so many of its standard uncertainties."""
SIGNIFICANT = 3.0
RowTable = npt.NDArray[np.void]


class DarkHistory:
    """All dark readings of a campaign so far, and what they make of the readings of any row. Raises UserError if too few.

    `evidence` is what the rows so far show of the signals.
    """

    def __init__(self, dark_rows: list[CommittedRow], rig: RigFile) -> None:
        self._rig = rig
        self._settings = rig.photodiodes
        self.evidence = stated(rig)
        self._dark = dark_readings_by_gain(dark_rows, self._settings)
        self._loss_s = dark_current_loss_s(dark_rows, self._settings)
        self._contradictory = contradictory_dark_intervals(dark_rows)

    @property
    def freedom(self) -> list[float]:
        """The degrees of freedom of the dark readings' scatter, by gain; infinite at one without."""
        return [self._dark[gain].freedom if gain in self._dark else math.inf for gain in self._settings.gains_v_per_a]

    def sums(self) -> EvidenceSums:
        """Sums for the evidence of rows, none of which is added yet."""
        return EvidenceSums(self._dark, self._rig)

    def up_to_date(self, evidence: RunningEvidence) -> "DarkHistory":
        """The same with the evidence of a run so far."""
        return self.with_evidence(evidence.renewed(self._dark))

    def with_evidence(self, evidence: SignalEvidence) -> "DarkHistory":
        """The same with other evidence."""
        history = copy.copy(self)
        history.evidence = evidence
        return history

    def signal(self, row: CommittedRow) -> Signal:
        """The signal of a row with readings. Raises UserError where it cannot be reduced."""
        return self.signals([row])[0]

    def signals(self, rows: Sequence[CommittedRow]) -> list[Signal]:
        """The signals of rows with readings. Raises UserError where one cannot be reduced."""
        numbers = np.array([row.row.number for row in rows])
        return signals_of_rows(self._reduced(reading_table(row.data.readings for row in rows), numbers))

    def _reduced(self, table: ReadingTable, numbers: Ints) -> Signal:
        return reduce_readings(table, numbers, self._dark, self._settings, self._rig, self.evidence)

    def volts(self, row: CommittedRow, gain_v_per_a: float) -> Quantity | None:
        """Voltages (photodiodes,) of a row above the dark reading at one gain, NaN where saturated; None if not read there."""
        for reading in row.data.readings:
            if reading.gain_v_per_a == gain_v_per_a and gain_v_per_a in self._dark:
                check_reading(reading, self._settings)
                readings = next(group_readings(reading_table([[reading]]), np.array([row.row.number])))
                volts = subtract_dark(readings, self._dark[gain_v_per_a], self._settings)
                value = np.where(readings.saturated(self._settings), np.nan, volts.value)
                return replace(volts, value=value).each(lambda array: array[0])
        return None

    def row_signal(self, row: CommittedRow, signal: Signal, intervals: Sequence[DriftInterval]) -> RowSignal:
        """The signal of a row with readings, with its flags: see `RowSignal`. Raises UserError."""
        table = reading_table([row.data.readings])
        recorded = RecordedRows(np.array([row.row.number]), np.array([row.data.started_s]), table)
        contradictory = np.array([CONTRADICTION in row.data.flags])
        flags, hours, decades = self._describe(recorded, contradictory, intervals)
        return RowSignal(row.row, signal, {name: each[0] for name, each in flags.items()}, float(hours[0]), float(decades[0]))

    def rows_in_columns(self, rows: RecordedRows, of_rows: RowTable, intervals: Sequence[DriftInterval]) -> RowSignals:
        """The signals of rows with readings; `of_rows` are their entries in the journal's index. Raises UserError."""
        signal = self._reduced(rows.readings, of_rows["number"])
        described = self._describe(rows, of_rows["contradiction"], intervals)
        return RowSignals(of_rows["number"], row_places(of_rows), of_rows["mirrored"], signal, *described)

    def _describe(
        self, rows: RecordedRows, contradictory: Flags, intervals: Sequence[DriftInterval]
    ) -> tuple[dict[str, Flags], Floats, Floats]:
        """The flags (rows, photodiodes) of rows with readings, their starts in hours, and the monitor's decades.

        `contradictory` (rows,) are those with that flag in the journal.
        """
        started_s, table = rows.started_s, rows.readings
        for k in np.flatnonzero(~(np.abs(started_s) < LATEST_S))[:1].tolist():
            raise UserError(f"row {rows.numbers[k]} began at the time {started_s[k]:g} s: {COPY}")
        drifted = np.zeros((table.rows, self._settings.count), dtype=bool)
        for drift in intervals:
            drifted |= drift.flagged_at(started_s)
        for begin_s, end_s in self._contradictory:
            contradictory = contradictory | ((started_s > begin_s) & (started_s < end_s))
        first = np.flatnonzero(np.diff(table.row, prepend=-1))
        monitor_a = table.monitor_a
        largest = np.maximum.reduceat(monitor_a, first)
        light = np.add.reduceat(monitor_a, first) / np.diff(first, append=monitor_a.size)
        flags = {
            "drift": drifted,
            "dead": self._loss_s < middles_s(table)[first, None],
            "module": np.broadcast_to(self.evidence.unsound, drifted.shape),
            "contradiction": np.broadcast_to(contradictory[:, None], drifted.shape),
            "monitor": np.broadcast_to((largest > END_OF_RANGE * self._rig.monitor.largest_a)[:, None], drifted.shape),
        }
        return flags, started_s / 3600.0, np.log10(np.where(light > 0.0, light, 1.0))


class Measurements:
    """All measured rows of a journal. Raises UserError where there are no dark readings, or a row cannot be reduced.

    What they show of themselves is computed when it is first asked for.
    """

    def __init__(self, journal: JournalReader, schedule: ScheduleFile, rig: RigFile) -> None:
        self._journal, self._schedule, self._rig = journal, schedule, rig
        self._sizes = journal.sizes
        self._kept: dict[int, RowSignal] = {}
        self._in_memory = journal.all_recorded(self._sizes.kept_bytes, *LIT)
        self._table, self._names = journal.row_index()
        self._by_number = np.argsort(self._table["number"], kind="stable")

    @cached_property
    def _dark(self) -> DarkHistory:
        """The dark readings, with the evidence of all rows."""
        with self._path_in_errors():
            dark = DarkHistory(list(self._journal.rows("dark")), self._rig)
            lit = self._journal.row_numbers(*LIT)
            rows = self._sizes.rows
            blocks = (lit[begin : begin + rows] for begin in range(0, lit.size, rows))
            tables = (each.readings for block in blocks for each in self._recorded(block, rows))
            return dark.with_evidence(collect(dark.sums(), tables))

    @cached_property
    def insensitive(self) -> dict[str, Flags]:
        """By the mounted sample, the photodiodes (n,) for which a drift check could not detect a loss."""
        return insensitive_photodiodes(self._journal.rows("drift"), self._signal)

    @cached_property
    def drift_intervals(self) -> list[DriftInterval]:
        """The times between drift checks of which one is beyond the limit."""
        limit = None if self._schedule.drift is None else self._schedule.drift.limit
        checked = self._journal.rows_of(self._journal.drift_row_numbers())
        return drift_intervals(checked, self._signal, self._rig, limit)

    @cached_property
    def drift_changes(self) -> list[DriftChange]:
        """The changes of the light that the drift checks of the schedule have seen."""
        if self._schedule.drift is None:
            return []
        checked = self._journal.rows_of(self._journal.drift_row_numbers())
        return drift_changes(checked, self._signal, self._rig, self._schedule.drift.limit)

    @property
    def evidence(self) -> SignalEvidence:
        """What the rows show of the signals."""
        return self._dark.evidence

    @property
    def noise_freedom(self) -> tuple[float, ...]:
        """The degrees of freedom of a photodiode's noise, by gain: of its dark readings, and of the lit ones' scatter.

        The latter are a factor on the former: the relative variances of both, 2 over their degrees of freedom, add up.
        """
        spread = [1.0 / each + 1.0 / self.evidence.freedom for each in self._dark.freedom]
        return tuple(1.0 / each if each > 0.0 else math.inf for each in spread)

    def row_table(self, sample: str) -> RowTable:
        """The measured rows of a sample, in order of time."""
        code = self._names.index(sample) if sample in self._names else -1
        rows: RowTable = self._table[self._table["sample"] == code]
        return rows

    def row_signals(self, numbers: Iterable[int]) -> Iterator[RowSignal]:
        """The signals of rows, by the rows' numbers: of a few: many are faster in columns."""
        left = iter(numbers)
        while block := list(itertools.islice(left, self._sizes.recorded)):
            rows = list(self._journal.rows_of(block))
            with self._path_in_errors():
                signals = self._dark.signals(rows)
                yield from (
                    self._dark.row_signal(row, signal, self.drift_intervals) for row, signal in zip(rows, signals, strict=True)
                )

    def rows_in_columns(self, numbers: Sequence[int]) -> RowSignals | None:
        """The signals of rows, by the rows' numbers and in their order; None where none of them has been measured."""
        found = {number: self._kept.pop(number) for number in numbers if number in self._kept}
        kept = rows_in_columns(list(found.values()))
        left = [number for number in numbers if number not in found] if found else numbers
        parts = [self._reduced(each) for each in self._recorded(np.array(left, dtype=np.int64), self._sizes.recorded)]
        if kept is None:
            return RowSignals.join(parts) if parts else None
        rows = RowSignals.join([kept, *parts])
        place = {number: k for k, number in enumerate(rows.numbers.tolist())}
        return rows.where(np.array([place[number] for number in numbers if number in place]))

    def _reduced(self, rows: RecordedRows) -> RowSignals:
        found = np.searchsorted(self._table["number"], rows.numbers, sorter=self._by_number)
        with self._path_in_errors():
            return self._dark.rows_in_columns(rows, self._table[self._by_number[found]], self.drift_intervals)

    def _recorded(self, numbers: Ints, rows: int) -> Iterator[RecordedRows]:
        """The readings of rows with light, of so many rows at once, or fewer where they have many counts."""
        if self._in_memory is not None:
            found = (self._in_memory.of(numbers[begin : begin + rows]) for begin in range(0, numbers.size, rows))
            yield from (each for each in found if each.numbers.size)
            return
        together: RecordedRows | None = None
        for each in self._journal.recorded(numbers.tolist()):
            together = each if together is None else together.joined(each)
            if together.numbers.size >= rows or together.readings.counts.size >= MOST_COUNTS:
                yield together
                together = None
        if together is not None and together.numbers.size:
            yield together

    def keep_signals(self, numbers: Iterable[int]) -> list[RowSignal]:
        """The signals of a few rows, which are then known when they are next asked for: no row is reduced twice for it."""
        found = list(self.row_signals(numbers))
        self._kept.update({each.row.number: each for each in found})
        return found

    def volts(self, numbers: Iterable[int], gain_v_per_a: float) -> Iterator[Quantity]:
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
        self._index = PlaceIndex(self.places)
        self._numbers = table["number"][self._index.order]

    def __len__(self) -> int:
        return len(self._numbers)

    def at(self, keys: Iterable[PoseKey]) -> dict[PoseKey, RowSignal]:
        """The signals at those keys that were measured."""
        measured = [(key, numbers) for key, numbers in self._rows_at(keys) if numbers]
        signals = self._measurements.row_signals(number for _, numbers in measured for number in numbers)
        return {key: mean_row(list(itertools.islice(signals, len(numbers)))) for key, numbers in measured}

    def at_places(self, places: Floats) -> RowSignals | None:
        """The signals at those places (n, 5) that were measured, each place once; None where there are none."""
        if not len(places) or not len(self):
            return None
        begin, end = self._index.range_of(places)
        measured = end > begin
        if not measured.any():
            return None
        begin, first = np.unique(begin[measured], return_index=True)
        end = end[measured][first]
        numbers = np.concatenate([self._numbers[one:other] for one, other in zip(begin.tolist(), end.tolist(), strict=True)])
        signals = self._measurements.rows_in_columns(numbers.tolist())
        return None if signals is None else mean_rows(signals, end - begin)

    def numbers_at(self, keys: Iterable[PoseKey]) -> list[int]:
        """The numbers of the rows at those keys that were measured."""
        return [number for _, numbers in self._rows_at(keys) for number in numbers]

    def _rows_at(self, keys: Iterable[PoseKey]) -> Iterator[tuple[PoseKey, list[int]]]:
        """Each of the keys once, with the numbers of its rows."""
        wanted = list(dict.fromkeys(keys))
        if not wanted or not len(self):
            return
        first, last = self._index.range_of(np.array([(wavelength, *pose) for wavelength, pose in wanted]))
        for key, begin, end in zip(wanted, first.tolist(), last.tolist(), strict=True):
            yield key, self._numbers[begin:end].tolist()

    def measured(self, places: Floats) -> Flags:
        """Which of the places (n, 5) were measured."""
        return self._index.has(places)

    def meets(self, other: "ReferenceMeasurements") -> bool:
        """Whether both have a measurement at the same wavelength and pose."""
        return bool(np.any(self.measured(other.places))) if len(self) else False


def collect(sums: EvidenceSums, tables: Iterable[ReadingTable]) -> SignalEvidence:
    """The evidence of rows, in order of time."""
    for table in tables:
        sums.add(table)
    return sums.result()


def row_places(table: RowTable) -> Floats:
    """Wavelengths and poses (n, 5) of rows, in the order of PLACE. Not rounded."""
    return np.stack([table[name] for name in PLACE], axis=1)


@dataclass(frozen=True)
class Repeats:
    """The evidence of rows at one wavelength and pose for the repeatability, pooled over `rows` of them at several poses.

    `scatter` is the relative standard deviation between such rows, of the median photodiode; `expected` what noise and
    monitor make of it. `freedom` are the degrees of freedom.
    """

    rows: int
    freedom: int
    scatter: float
    expected: float

    @property
    def excess(self) -> float:
        """What the scatter has beyond the expected, as a relative standard uncertainty; 0 where it is not significant."""
        limit = 1.0 + SIGNIFICANT * math.sqrt(2.0 / self.freedom)
        beyond = self.scatter**2 - self.expected**2
        return math.sqrt(beyond) if self.scatter**2 > limit * self.expected**2 else 0.0

    def sentence(self, stated: float) -> str:
        """What the repeats show, beside the repeatability that is stated."""
        found = (
            f"repeats: {self.rows} rows at poses that were measured again scatter by {self.scatter:.2%}, where noise and "
            f"monitor make {self.expected:.2%}"
        )
        if self.excess > stated:
            return f"{found}; the rest, {self.excess:.2%}, is in u as repeatability, in place of the stated {stated:.2%}"
        return f"{found}; this agrees with the stated repeatability of {stated:.2%}"


def repeats(measurements: Measurements, samples: Iterable[str], relative_variance: float) -> Repeats | None:
    """The repeats of samples, at some of the poses; None with too few. `relative_variance` is that of a row's monitor."""
    squares = expected = 0.0
    freedom = count = 0
    for sample in samples:
        table = measurements.row_table(sample)
        _, pose, counts = np.unique(round_deg(row_places(table)), axis=0, return_inverse=True, return_counts=True)
        again = np.flatnonzero(counts > 1)
        for each in again[:: max(1, -(-again.size // MOST_REPEATED))].tolist():
            signals = measurements.keep_signals(table["number"][pose.ravel() == each].tolist())
            values = np.stack([signal.signal.value for signal in signals])
            variances = np.stack([signal.signal.reading_variance for signal in signals])
            clear = np.all(values > CLEAR * np.sqrt(variances), axis=0)
            if clear.sum() < FEWEST_CLEAR:
                continue
            ratio = np.median(values[:, clear] / values[:, clear].mean(axis=0), axis=1)
            of_median = 0.5 * np.pi * np.mean(variances[:, clear] / values[:, clear] ** 2) / clear.sum()
            squares += float(np.sum((ratio - ratio.mean()) ** 2))
            expected += (len(signals) - 1) * (float(of_median) + relative_variance)
            freedom, count = freedom + len(signals) - 1, count + len(signals)
    if freedom < FEWEST_REPEATS:
        return None
    return Repeats(count, freedom, math.sqrt(squares / freedom), math.sqrt(expected / freedom))


def order_by_setting(table: RowTable) -> tuple[Ints, Ints, Ints]:
    """Indices of the rows in the order of sigma, gamma, wavelength and half planes, each in order of time; and edges in it.

    The first edges are the places in that order where wavelength, sigma or gamma changes, with 0 first and the number of rows
    last. All neighbours of a value, and all overlaps of photodiodes, lie between two of them. The second edges are those of
    them where sigma or gamma changes: between two lie all wavelengths of a pose.
    """
    keys = [table[name] for name in ("wavelength_nm", "gamma_deg", "sigma_deg")]
    order = np.lexsort([scan_plane_deg(table["beta_deg"]), *keys])
    none = np.zeros(0, dtype=bool)
    changes = [key[order][1:] != key[order][:-1] if len(order) else none for key in keys]
    edges = [np.concatenate([[0], 1 + np.flatnonzero(np.any(each, axis=0)), [len(order)]]) for each in (changes, changes[1:])]
    return order, edges[0], edges[1]


def order_by_pose(table: RowTable) -> tuple[Ints, Ints]:
    """Indices of the rows with all wavelengths of a pose together; and the places in that order where the pose changes."""
    keys = round_deg(row_places(table)).T
    order = np.lexsort(keys)
    changes = np.any(keys[1:, order[1:]] != keys[1:, order[:-1]], axis=0)
    return order, np.concatenate([[0], 1 + np.flatnonzero(changes), [len(order)]])
