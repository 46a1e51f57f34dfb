"""What ends a run before its last row, in good order: the schedule's `[stop]`, and a drift beyond its limit."""

from goniotwin.app.campaign.journal.record import RowData
from goniotwin.app.campaign.reduction.drift_checks import DriftWatch
from goniotwin.app.campaign.row import SKIPPED, Row
from goniotwin.app.campaign.schedule.file import ScheduleFile, StopTable
from goniotwin.app.rig import RigFile


class StopConditions:
    """Looks at each row that has been committed. It is told of those of earlier sessions, too, by `recall`."""

    def __init__(self, schedule: ScheduleFile, rig: RigFile) -> None:
        self._table = schedule.stop or StopTable()
        self._drift = DriftWatch(schedule.drift, rig)
        self._ends_by_drift = schedule.drift is not None and schedule.drift.on_excess == "stop"
        self._lamp_a: dict[float | None, float] = {}
        self._skipped = 0
        self.begun_s = 0.0

    def recall(self, row: Row, data: RowData) -> None:
        """A row of an earlier session."""
        self._drift.add(row, data)
        self._lamp(row, data)

    def look(self, row: Row, data: RowData) -> tuple[str, str] | None:
        """What there is to say of a row, as a kind and a text for the journal; of the kind `stop` where it ends the run.

        Raises UserError where a drift row has no dark.
        """
        table = self._table
        self._skipped += SKIPPED in data.flags
        if table.skipped_rows is not None and self._skipped >= table.skipped_rows:
            return "stop", f"{self._skipped} rows of this session were skipped for faults; mend what fails, then go on"
        share = self._lamp(row, data)
        if table.lamp_below is not None and share is not None and share < table.lamp_below:
            return "stop", f"{row.identity}: the lamp is at {100 * share:.1f} % of what it was; look after it, then go on"
        if table.longest_s is not None and data.ended_s - self.begun_s >= table.longest_s:
            return "stop", f"the session has lasted {data.ended_s - self.begun_s:.0f} s, as long as it may; go on when you like"
        check = self._drift.add(row, data)
        if check is None:
            return None
        ends = check.beyond_limit and self._ends_by_drift
        beyond = "beyond the limit: " if check.beyond_limit else ""
        return "stop" if ends else "drift", f"{row.identity}: {beyond}{check}"

    def _lamp(self, row: Row, data: RowData) -> float | None:
        """The monitor's current over its first at this wavelength."""
        if row.wavelength_nm is None or not data.readings:
            return None
        current = data.readings[0].monitor_a
        first = self._lamp_a.setdefault(row.wavelength_nm, current)
        return current / first if first > 0.0 else None
