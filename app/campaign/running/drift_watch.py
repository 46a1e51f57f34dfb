"""The drift checks of a run: each committed row is held against the first check since the mounting."""

import contextlib

import numpy as np

from goniotwin.app.campaign.reduction.components import Signal
from goniotwin.app.campaign.reduction.drift_checks import DriftCheck, DriftReference
from goniotwin.app.campaign.reduction.evidence import RunningEvidence
from goniotwin.app.campaign.reduction.pipeline import reduce_readings
from goniotwin.app.campaign.reduction.signals import DarkReadings, dark_readings_by_gain, signals_of_rows
from goniotwin.app.campaign.row import CommittedRow, Row, RowData, reading_table
from goniotwin.app.campaign.schedule.file import DriftTable
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigFile


class DriftWatch:
    """Drift checks during a run, with the dark readings committed so far."""

    def __init__(self, table: DriftTable | None, rig: RigFile) -> None:
        self._reference = DriftReference(rig, None if table is None else table.limit)
        self._rig = rig
        self._settings = rig.photodiodes
        self._dark_rows: list[CommittedRow] = []
        self._dark: dict[float, DarkReadings] | None = None
        self._evidence = RunningEvidence(rig)

    def add(self, row: Row, data: RowData) -> DriftCheck | None:
        """Take a committed row; give the comparison for a drift row that has a reference. Raises UserError."""
        committed = CommittedRow(row, data)
        if row.kind == "dark":
            self._dark_rows.append(committed)
            self._dark = None
        self._evidence.add(committed)
        if self._evidence.full:
            with contextlib.suppress(UserError):  # too few dark readings: a drift check would report it
                self._evidence.count(self._dark_readings())
        if row.kind == "mount" or data.readings:
            return self._reference.check(row, lambda: self._signal(row, data))
        return None

    def _dark_readings(self) -> dict[float, DarkReadings]:
        if self._dark is None:
            self._dark = dark_readings_by_gain(self._dark_rows, self._settings)
        return self._dark

    def _signal(self, row: Row, data: RowData) -> Signal:
        dark, table = self._dark_readings(), reading_table([data.readings])
        evidence = self._evidence.renewed(dark)
        reduced = reduce_readings(table, np.array([row.number]), dark, self._settings, self._rig, evidence)
        return signals_of_rows(reduced)[0]
