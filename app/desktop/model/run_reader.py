"""The reader of a run: its rows with their values, from its journal, in a thread of its own. No Qt.

The station reports that a row is saved, and this process finds the values in the journal.
"""

import contextlib
import queue
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path

from goniotwin.app.campaign.journal.following import JournalFollower
from goniotwin.app.campaign.journal.mounting import event_words
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.running.events import EventLogged, RowCommitted
from goniotwin.app.campaign.running.resume import recorded_rig
from goniotwin.app.campaign.schedule.file import ScheduleDescription, parse_schedule
from goniotwin.app.campaign.studies.journals import journal_findings
from goniotwin.app.desktop.model.messages import Message, PastRead, RunStarted, ValuesMissing
from goniotwin.app.desktop.model.rig_facts import DarkAges, is_drift
from goniotwin.app.desktop.model.time_left import mountings
from goniotwin.app.errors import UserError
from goniotwin.app.station.messages import Message as StationMessage
from goniotwin.app.station.messages import RowSaved, RunBegun, RunEnded, Snapshot

MOST_HEARD = 50
"""Events of a station that are kept, to know them in the journal."""


class RunReader:
    """Reads the rows of a station's runs. `send` gets them in its thread; `made` gives the plan that this window has made."""

    def __init__(self, send: Callable[[Message], None], made: Callable[[], Plan | None]) -> None:
        self._send = send
        self._made = made
        self._rows: queue.SimpleQueue[Snapshot | RunBegun | RowSaved | RunEnded | None] = queue.SimpleQueue()
        self._heard: deque[EventLogged] = deque(maxlen=MOST_HEARD)
        self._follower: JournalFollower | None = None
        self._dark_ages: DarkAges | None = None
        self._closed = False
        # A daemon: a disk that hangs keeps no window open.
        self._thread = threading.Thread(target=self._read_rows, name="journal", daemon=True)
        self._thread.start()

    def attach(self, snapshot: Snapshot) -> None:
        """Read the journal of a station that has just been attached to."""
        self._heard.clear()
        self._rows.put(snapshot)

    def take(self, message: StationMessage) -> None:
        """Take an event of the station."""
        match message:
            case RunBegun() | RowSaved() | RunEnded():
                self._rows.put(message)
            case EventLogged():
                self._heard.append(message)

    def close(self) -> None:
        """Send no further row, and end the thread."""
        self._closed = True
        self._rows.put(None)

    def join(self, timeout_s: float) -> None:
        """Wait for the end of the thread."""
        self._thread.join(timeout_s)

    def _read_rows(self) -> None:
        """Send the rows of a run with their values, from its journal, as many at once as have been reported."""
        while (event := self._rows.get()) is not None:
            events = [event]
            while not self._rows.empty():
                if (more := self._rows.get()) is None:
                    return
                events.append(more)
            saved = {each.row.number: each for each in events if isinstance(each, RowSaved)}
            for each in events:
                if self._closed:
                    return
                if isinstance(each, Snapshot):
                    self._read_past(each)
                if isinstance(each, RunBegun) or (isinstance(each, Snapshot) and each.busy):
                    self._begin(each)
            self._send_rows(saved)
            for each in events:
                if isinstance(each, RunEnded):
                    self._send(each)
                    self._report_findings(each.journal)

    def _read_past(self, attached: Snapshot) -> None:
        """Send what the journal has of the time before. Events that are in both are those that were heard since."""
        assert attached.journal is not None
        try:
            with JournalFollower(attached.journal).reading() as journal:
                logged, dark, drift = journal.events(), journal.last_of("dark"), journal.last_of("drift")
        except (UserError, OSError):  # reported with the values
            return
        events = []
        for _t, kind, text in logged:
            where = drift[0] if drift is not None and text.startswith(f"{drift[0]}: ") else ""
            events.append(EventLogged(kind, event_words(kind, text).removeprefix(f"{where}: "), where))
        checks = [each for each in events if is_drift(each)]
        heard = [each.what for each in self._heard]
        past = tuple(each for each in events if attached.busy and not any(what in each.what for what in heard))
        self._send(PastRead(past, None if dark is None else dark[1], checks[-1] if checks else None))

    def _begin(self, begun: RunBegun | Snapshot) -> None:
        """Send the plan of a run; where it is the one that this window has made, that one."""
        assert begun.journal is not None
        self._follower = JournalFollower(begun.journal)
        try:
            with self._follower.reading() as journal:
                schedule, rig = journal.value("schedule"), journal.value("rig")
                plan = self._made()
                if plan is None or (plan.schedule.text, plan.rig.text) != (schedule, rig):
                    parsed = parse_schedule(schedule, f"{begun.journal} (schedule)")
                    certificate = None if parsed.file.certificate is None else journal.value("certificate")
                    described = ScheduleDescription(parsed.text, parsed.file, parsed.name, certificate)
                    plan = Plan(described, recorded_rig(journal), journal.planned_rows())
            self._dark_ages = DarkAges(plan)
            self._send(RunStarted(plan, begun.journal, mountings(plan.rows)))
        except Exception as error:  # noqa: BLE001  (of any library: reported, and the end of the run is shown in its time)
            self._give_up_values(error)

    def _send_rows(self, saved: dict[int, RowSaved]) -> None:
        if self._follower is None:
            return
        try:
            for each in self._follower.new_rows():
                if self._closed:
                    return
                known = saved.get(each.row.number)
                progress = (0, 1, 0.0) if known is None else (known.done, known.total, known.seconds_left)
                self._send(RowCommitted(each.row, each.data, *progress))
                if self._dark_ages is not None and (event := self._dark_ages.add(each.row, each.data)) is not None:
                    self._send(event)
        except Exception as error:  # noqa: BLE001  (of any library: reported, and the end of the run is shown in its time)
            self._give_up_values(error)

    def _give_up_values(self, error: Exception) -> None:
        self._follower = None
        known = isinstance(error, UserError | OSError)
        self._send(ValuesMissing(str(error) if known else f"{type(error).__name__}: {error}"))

    def _report_findings(self, journal: Path) -> None:
        """Send what the data of a run show of the instrument, if they are enough for a reduction."""
        with contextlib.suppress(UserError, OSError):
            for finding in journal_findings(journal):
                self._send(EventLogged("finding", finding, journal.name, "see goniotwin verify"))
