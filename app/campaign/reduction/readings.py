"""What was measured, as signals: read from the journal where it is wanted, few rows at a time.

A campaign may have a hundred thousand rows. What stays in memory is their list (half a hundred bytes a row), the means of the
darks, and what drift checks have said; the etalon's and the signature's signals are made again where a block needs them.
"""

import contextlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from goniotwin.app.campaign.geometry.directions import Pose
from goniotwin.app.campaign.journal.record import CommittedRow
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.reduction.drift_checks import drifts, unseen
from goniotwin.app.campaign.reduction.signals import (
    Signal,
    darks_by_gain,
    dead_since,
    mean_signal,
    middle,
    signal,
    with_tracing_error,
)
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, photodiode_settings
from goniotwin.arrays import Flags, Floats, Ints

DECIMALS = 6
HALF_TURN_DEG = 180.0
PLACE = ("wavelength_nm", "gamma_deg", "sigma_deg", "beta_deg", "shift_deg")
Key = tuple[float, Pose]
Listed = npt.NDArray[np.void]


@dataclass(frozen=True)
class Measured:
    """A row, or the mean of several of one pose: its signal, and which of its photodiodes (n,) had drifted, or were dead."""

    row: Row
    signal: Signal
    drifted: Flags
    dead: Flags


def key_of(row: Row, pose: Pose) -> Key:
    """A row's wavelength with a pose; 180 deg - sigma is not always what a planner has rounded."""
    assert row.wavelength_nm is not None
    gamma, sigma, beta, shift = (round(angle, DECIMALS) for angle in pose)
    return (row.wavelength_nm, (gamma, sigma, beta, shift))


class Measurements:
    """All of a journal. Raises UserError where there are no darks, or something cannot be reduced."""

    def __init__(self, journal: Journal, schedule: ScheduleFile, rig: RigDescription) -> None:
        self._journal = journal
        self._rig = rig
        self._settings = photodiode_settings(rig.file)
        darks = list(journal.rows("dark"))
        with self._told():
            self._darks = darks_by_gain(darks, self._settings)
        self._dead_since = dead_since(darks, self._settings)
        del darks
        self._listed, self._names = journal.row_index()
        limit = None if schedule.drift is None else schedule.drift.limit
        self.unseen = unseen(journal.rows("drift"), self._signal)
        some = next(journal.rows("drift"), None) is not None
        rows = journal.rows("mount", "measure", "drift") if some else iter(())
        self.drifts = drifts(rows, self._signal, rig.file, limit)

    def listed(self, sample: str) -> Listed:
        """The measurements of a sample, in order of time."""
        code = self._names.index(sample) if sample in self._names else -1
        chosen: Listed = self._listed[self._listed["sample"] == code]
        return chosen

    def of(self, numbers: Iterable[int]) -> Iterator[Measured]:
        """Rows by their numbers."""
        none = np.zeros(self._settings.count, dtype=bool)
        for each in self._journal.rows_of(numbers):
            drifted = np.any([none, *(drift.of(each.data.started_s) for drift in self.drifts)], axis=0)
            yield Measured(each.row, self._signal(each), drifted, self._dead_since < middle(each.data.readings[0]))

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except UserError as error:
            raise UserError(f"{self._journal.path}: {error}") from None

    def _signal(self, row: CommittedRow) -> Signal:
        with self._told():
            return with_tracing_error(signal(row.data, self._darks, self._settings), self._rig.file)


class References:
    """The measurements of the etalon, or of nothing mounted, by wavelength and pose: each the mean of all that there are."""

    def __init__(self, measurements: Measurements, sample: str) -> None:
        self._measurements = measurements
        listed = measurements.listed(sample)
        self.places: Floats = np.stack([np.round(listed[name], DECIMALS) for name in PLACE], axis=1)
        self._columns = [np.unique(column) for column in self.places.T]
        codes = self._codes(self.places)
        order = np.argsort(codes, kind="stable")
        self._sorted, self._numbers = codes[order], listed["number"][order]

    def __len__(self) -> int:
        return len(self._numbers)

    def of(self, keys: Iterable[Key]) -> dict[Key, Measured]:
        """Those of the keys that were measured."""
        wanted = list(dict.fromkeys(keys))
        if not wanted or not len(self):
            return {}
        codes = self._codes(np.array([(wavelength, *pose) for wavelength, pose in wanted]))
        first, last = (np.searchsorted(self._sorted, codes, side=side) for side in ("left", "right"))
        found = {}
        for key, begin, end in zip(wanted, first.tolist(), last.tolist(), strict=True):
            if end > begin:
                found[key] = _mean(list(self._measurements.of(self._numbers[begin:end].tolist())))
        return found

    def meets(self, other: "References") -> bool:
        """Whether anything was measured at a wavelength and pose of the other's."""
        return bool(np.any(self._codes(other.places) >= 0)) if len(self) else False

    def _codes(self, places: Floats) -> Ints:
        """A number for each of the places (n, 5); -1 where nothing was measured."""
        codes, known = np.zeros(len(places), dtype=np.int64), np.ones(len(places), dtype=bool)
        for column, values in zip(places.T, self._columns, strict=True):
            at = np.minimum(np.searchsorted(values, column), max(values.size - 1, 0))
            known &= values[at] == column if values.size else False
            codes = codes * values.size + at
        return np.where(known, codes, -1)


def in_settings(listed: Listed) -> tuple[Ints, Ints]:
    """Measurements in the order of wavelength, sigma, gamma and half planes, each in order of time: their places in the list;
    and where in that order another wavelength, sigma or gamma begins, ending with the number of all.

    All that tells of a value what its neighbours are lies in one such stretch, and so does what two photodiodes have seen.
    """
    plane = np.round(np.mod(listed["beta_deg"], HALF_TURN_DEG), DECIMALS)
    keys = [listed[name] for name in ("gamma_deg", "sigma_deg", "wavelength_nm")]
    order = np.lexsort([plane, *keys])
    changes = np.any([key[order][1:] != key[order][:-1] for key in keys], axis=0) if len(order) else np.zeros(0, dtype=bool)
    return order, np.concatenate([[0], 1 + np.flatnonzero(changes), [len(order)]])


def _mean(group: list[Measured]) -> Measured:
    return Measured(
        group[0].row,
        mean_signal([each.signal for each in group]),
        np.any([each.drifted for each in group], axis=0),
        np.any([each.dead for each in group], axis=0),
    )
