"""What ends a run before its last row: a stop request, from any thread, and the stop conditions of the schedule."""

import threading
from collections.abc import Callable
from typing import TypeVar

from goniotwin.app.campaign.row import SKIPPED, Row, RowData
from goniotwin.app.campaign.running.drift_watch import DriftWatch
from goniotwin.app.campaign.schedule.file import ScheduleFile, StopTable
from goniotwin.app.rig import RigFile
from goniotwin.drivers import DeviceError, Rig
from goniotwin.protocols.clock import VirtualClock

T = TypeVar("T")
BEYOND_LIMIT = "beyond the limit"
"""What the event of a drift check has where it is so, whether or not it ends the run."""


class Stopped(Exception):
    """The run was stopped by a stop request."""


class StopRequest:
    """Stop request of one run on a rig, checked before every motion and between polls.

    `requested` is whether the run was asked to stop; `steps` changes with the begin and the end of each stop.
    """

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._motion = threading.RLock()
        self.requested = False
        self.steps = 0

    def stop(self) -> list[DeviceError]:
        """Stop all axes now and allow no further motion; return the errors of axes that did not confirm. From any thread.

        A virtual clock belongs to one thread: a stop from another one is carried out by that thread, at its next check.
        """
        self.requested = True
        self.steps += 1
        try:
            if isinstance(self._rig.clock, VirtualClock) and self._rig.clock.elsewhere:
                return []
            failures = self._rig.stop()
            with self._motion:  # a motion that was being started in another thread has started by now, and is stopped here
                return self._rig.stop() or failures
        finally:
            self.steps += 1

    def check(self) -> None:
        """Raise Stopped if the run was asked to stop."""
        if self.requested:
            raise Stopped

    def start(self, motion: Callable[[], T]) -> T:
        """Start a motion unless the run was asked to stop. Raises Stopped, DeviceError."""
        with self._motion:
            self.check()
            return motion()


class EndedBySchedule(Exception):
    """A stop condition ended the run; the message gives the reason."""


class EndedByOperator(Exception):
    """The operator ended the run after a part of it; the message gives the part."""


class StopConditions:
    """Stop conditions of one session: the schedule's table `[stop]`, and a drift beyond its limit.

    `session_start_s` is the start of the session on the rig's clock.
    Rows of earlier sessions are added with `add_earlier_row`, so that lamp and drift are compared with the whole campaign.
    """

    def __init__(self, schedule: ScheduleFile, rig: RigFile) -> None:
        self._table = schedule.stop or StopTable()
        self._drift = DriftWatch(schedule.drift, rig)
        self._drift_stops = schedule.drift is not None and schedule.drift.on_excess == "stop"
        self._first_monitor_a: dict[float | None, float] = {}
        self._skipped = 0
        self.session_start_s = 0.0

    def add_earlier_row(self, row: Row, data: RowData) -> None:
        """Add a row of an earlier session."""
        self._drift.add(row, data)
        self._lamp_ratio(row, data)

    def check(self, row: Row, data: RowData) -> tuple[str, str] | None:
        """Check a committed row; return an event for the journal as (kind, text), or None. The kind `stop` ends the run.

        Raises UserError where a drift check has no dark reading.
        """
        table = self._table
        self._skipped += SKIPPED in data.flags
        if table.skipped_rows is not None and self._skipped >= table.skipped_rows:
            return "stop", f"{self._skipped} rows of this session were skipped because of faults; fix the cause, then resume"
        ratio = self._lamp_ratio(row, data)
        if table.lamp_below is not None and ratio is not None and ratio < table.lamp_below:
            return "stop", f"{row.identity}: the lamp is at {100 * ratio:.1f} % of its first value; check the lamp, then resume"
        if table.longest_s is not None and data.ended_s - self.session_start_s >= table.longest_s:
            duration_s = data.ended_s - self.session_start_s
            return "stop", f"the session has lasted {duration_s:.0f} s, the limit is {table.longest_s:g} s; resume at any time"
        check = self._drift.add(row, data)
        if check is None:
            return None
        stops = check.beyond_limit and self._drift_stops
        beyond = f"{BEYOND_LIMIT}: " if check.beyond_limit else ""
        return "stop" if stops else "drift", f"{row.identity}: {beyond}{check}"

    def _lamp_ratio(self, row: Row, data: RowData) -> float | None:
        """Monitor current of a row over the first one at this wavelength."""
        if row.wavelength_nm is None or not data.readings:
            return None
        current = data.readings[0].monitor_a
        first = self._first_monitor_a.setdefault(row.wavelength_nm, current)
        return current / first if first > 0.0 else None
