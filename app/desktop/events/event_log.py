"""The log of events: what happens to rig and run, in the operator's words, and the flags of a scan as one event."""

from collections import Counter

from PySide6.QtCore import QObject, Slot

from goniotwin.app.campaign.running.events import EventLogged, State
from goniotwin.app.desktop.events.panels import LogEntry
from goniotwin.app.desktop.events.screen import EventsScreen
from goniotwin.app.station.messages import RowSaved

SERIOUS = ("fault", "stop", "encoder", "sleep", "finding", "dark")
"""Kinds of events that a person should look at."""


class EventLog(QObject):
    """Writes the entries of the events screen."""

    def __init__(self, screen: EventsScreen, parent: QObject) -> None:
        super().__init__(parent)
        self._screen = screen
        self._flags, self._flagged_scan = Counter[str](), ""

    def add(self, what: str, where: str = "", consequence: str = "", *, serious: bool = False, detail: str = "") -> None:
        """Add an entry; a serious one is marked until a person has looked at it."""
        self._screen.add(LogEntry(what, where, consequence, serious, detail))

    def add_event(self, event: EventLogged) -> None:
        """Add an event of the run's journal."""
        self.add(event.what, event.where, event.consequence, serious=event.kind in SERIOUS, detail=event.detail)

    def add_state(self, before: State, state: State) -> None:
        """Add a change of the run's state, if it is one of a person."""
        if state is State.PAUSED:
            self.add("Paused", "", "the shutter is closed")
        elif state is State.STOPPING:
            self.add("Stop", "", "all axes come to rest")
        elif before is State.PAUSED:
            self.add("Resumed")

    def count_flags(self, saved: RowSaved) -> None:
        """Count the flags of the rows of a scan: one event for each row of a narrow lobe would bury all others."""
        if saved.row.pose is not None:
            _gamma, sigma, beta, _shift = saved.row.pose
            scan = f"{saved.row.sample} σ {sigma:g}° β {beta:g}°"
            if scan != self._flagged_scan:
                self.add_flags()
                self._flagged_scan = scan
        self._flags.update(saved.flags)

    def add_flags(self) -> None:
        """Add the flags that were counted since the last time."""
        if self._flags:
            counts = ", ".join(f"{flag} ({count})" for flag, count in self._flags.items())
            self.add(f"Rows flagged: {counts}", self._flagged_scan)
        self._flags.clear()

    @Slot(str, str)
    def add_alarm(self, what: str, where: str) -> None:
        """Add that values are not those of the twin."""
        self.add(what, where, "look at it: the twin expects another value", serious=True)

    @Slot(str, str)
    def add_misalignment(self, what: str, where: str) -> None:
        """Add that residuals show a displacement; without `what`, that they are not watched."""
        if what:
            self.add(what, where, "values since then are displaced: see goniotwin align --watch", serious=True)
        else:
            self.add(f"The residuals are not watched: {where}", "", "the run is not affected")

    @Slot(str)
    def add_missing_prediction(self, reason: str) -> None:
        """Add why there is no prediction."""
        self.add(f"No prediction: {reason}", "", "no residuals are shown")
