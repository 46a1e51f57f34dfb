"""The watch of a run in progress: its rows in a journal of this process, and what their residuals show. No Qt.

The journal of the station is left alone: a reader that stays would keep it from becoming one file at its end.
"""

import math
import tempfile
from pathlib import Path

from goniotwin.app.campaign.geometry.open_beam import scan_wavelength_nm
from goniotwin.app.campaign.journal.writing import Journal, software_versions
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.running.events import RowCommitted
from goniotwin.app.campaign.studies.journals import watch_journal
from goniotwin.app.campaign.studies.watch import LOOKS, Misalignment
from goniotwin.app.errors import UserError

MOST_ROWS = 5000
"""Campaigns with more rows at the wavelength of the watch are not watched in progress: a look takes some milliseconds a row."""
LEAST_BETWEEN = 16
"""Least number of rows between two looks."""


class RunWatch:
    """The rows of a run so far, and looks at their residuals: LOOKS at most, evenly over the plan's rows.

    The watch compares values of one wavelength, and needs the rows at others no more than a journal that has none of them.
    """

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._rows: list[RowCommitted] = []
        self._wavelength = scan_wavelength_nm(plan.schedule.file)
        count = sum(map(self._is_needed, plan.rows))
        self._watched = count <= MOST_ROWS
        self._every = max(LEAST_BETWEEN, math.ceil(count / LOOKS))
        self._seen, self._looks = 0, 0
        self._named: set[str] = set()

    def add_row(self, event: RowCommitted) -> None:
        """Add a row."""
        if self._watched and self._is_needed(event.row):
            self._rows.append(event)

    def _is_needed(self, row: Row) -> bool:
        return row.wavelength_nm is None or row.wavelength_nm == self._wavelength

    @property
    def due(self) -> bool:
        """Whether there are enough new rows for the next look."""
        return len(self._rows) - self._seen >= self._every and self._looks < LOOKS

    def look(self) -> list[Misalignment]:
        """What the residuals show now, of samples for which nothing was found before."""
        self._seen, self._looks = len(self._rows), self._looks + 1
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            path = Path(folder) / "watch.journal"
            with Journal.create(path, self._plan, software_versions(), durable=False) as journal:
                session, now = journal.begin_session(0.0, self._plan.rig.text, software_versions()), 0.0
                for each in self._rows:
                    if each.row.unplanned:
                        journal.add_rows([each.row])
                    journal.commit(each.row, each.data)
                    now = each.data.ended_s
                journal.end_session(session, now, "stopped")
            try:
                found = watch_journal(path).misalignments
            except UserError:  # before the etalon has been measured there are no values
                return []
        new = [each for each in found if each.sample not in self._named]
        self._named |= {each.sample for each in new}
        return new
