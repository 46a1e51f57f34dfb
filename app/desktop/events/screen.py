"""The events screen: the log of the window, all of it or what a person should look at."""

from PySide6.QtCore import Signal, Slot
from PySide6.QtWidgets import QCheckBox, QHBoxLayout, QLabel, QVBoxLayout

from goniotwin.app.desktop.events.panels import EventModel, EventTable, LogEntry, SeriousOnly
from goniotwin.app.desktop.screen import Screen
from goniotwin.app.desktop.theme import Colours


class EventsScreen(Screen):
    """The events, the latest first. `serious_changed` has the number of the marked ones."""

    title = "Events"
    icon = "format-list-bulleted"

    serious_changed = Signal(int)

    def __init__(self, colours: Colours) -> None:
        super().__init__(colours)
        self.model = EventModel(self, colours)
        self._shown = SeriousOnly(self)
        self._shown.setSourceModel(self.model)
        self._heading = QLabel()
        self._only = QCheckBox("O&nly those marked ✗")
        self._only.setAccessibleName("Show only the marked events")
        self._only.toggled.connect(self._show_only)
        self._table = EventTable(self._shown, "Events")
        self._table.setObjectName("events")
        top = QHBoxLayout()
        top.addWidget(self._heading, 1)
        top.addWidget(self._only)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addLayout(top)
        layout.addWidget(self._table)
        self._show_heading()

    @property
    def entries(self) -> list[LogEntry]:
        """The entries, the latest first."""
        return self.model.entries

    def add(self, entry: LogEntry) -> None:
        """Add an entry, now."""
        self.model.add(entry)
        self._show_heading()

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        super().set_colours(colours)
        self.model.set_colours(colours)

    @Slot(bool)
    def _show_only(self, only: bool) -> None:
        self._shown.set_only(only)

    def _show_heading(self) -> None:
        serious = self.model.serious
        look = f" · {serious} marked ✗" if serious else ""
        self._heading.setText(f"<b>Events</b>, the latest first{look}")
        self.serious_changed.emit(serious)
