"""The rig screen: the rig file, the devices, the axes, and the preflight list."""

from typing import TYPE_CHECKING

from PySide6.QtCore import QSize, Qt, QTimer, Slot
from PySide6.QtGui import QShowEvent
from PySide6.QtWidgets import QFrame, QHBoxLayout, QScrollArea, QStackedLayout, QTabWidget, QVBoxLayout, QWidget

from goniotwin.app.desktop import model
from goniotwin.app.desktop.rig.panels import AxesPanel, DevicesPanel, RigPanel
from goniotwin.app.desktop.rig.preflight_panel import PreflightPanel
from goniotwin.app.desktop.screen import Screen, WithoutPreferredHeight
from goniotwin.app.desktop.theme import Colours

if TYPE_CHECKING:  # the window shows itself before the engine is loaded
    from pathlib import Path

    from goniotwin.app.campaign.planning.plan import Plan
    from goniotwin.app.desktop.model.rig_facts import RigFacts
    from goniotwin.app.rig import RigFile

LOOK_MS = 1000
"""Time between two looks at what ages: the devices' last answers, the dark reading, the disk."""
WIDE, HIGH = 600, 330
"""Size of a room from which on all parts are shown at once."""
WITH_AXES = 520
"""Height of a room from which on the axes are shown here; they are always in the strip above the screens."""


class RigScreen(Screen):
    """Rig file, devices and axes at the left, the preflight list at the right."""

    title = "Rig"
    icon = "connection"

    def __init__(self, colours: Colours) -> None:
        super().__init__(colours)
        self._facts: RigFacts | None = None
        self._plan: Plan | None = None
        self._folder: Path | None = None
        self.rig = RigPanel()
        self.devices = DevicesPanel(colours)
        self.axes = AxesPanel()
        self.preflight = PreflightPanel(colours)
        wide = QWidget()
        self._left, self._right = QVBoxLayout(), QVBoxLayout()
        self._left.setSpacing(4)
        columns = QHBoxLayout(wide)
        columns.setContentsMargins(0, 0, 0, 0)
        columns.setSpacing(12)
        for column, share in ((self._left, 4), (self._right, 5)):
            column.addStretch(1)
            columns.addLayout(column, share)
        self._tabs = QTabWidget()
        for tabs in (self._tabs, self._tabs.tabBar()):  # Tab stops at the latter
            tabs.setAccessibleName("Parts of the rig screen")
        self._parts = (self.devices, "Devices"), (self.rig, "Rig file"), (self.preflight, "Preflight")
        self._scrolls = [QScrollArea() for _ in self._parts]
        for each in self._scrolls:
            each.setWidgetResizable(True)
            each.setFrameShape(QFrame.Shape.NoFrame)
            each.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        small = WithoutPreferredHeight()
        page = QVBoxLayout(small)
        page.setContentsMargins(0, 0, 0, 0)
        page.addWidget(self._tabs)
        self._pages = QStackedLayout(self)
        self._pages.addWidget(wide)
        self._pages.addWidget(small)
        self._compact: bool | None = None
        self.fit(QSize(WIDE, WITH_AXES))
        self._timer = QTimer(self, interval=LOOK_MS)
        self._timer.timeout.connect(self._look)
        self.devices.reconnect.connect(self._reconnect)

    def complete(self) -> None:
        """Begin to look at the rig."""
        self._facts = model.RigFacts()
        self._facts.set_plan(self._plan)
        self._facts.set_folder(self._folder)
        self._timer.start()
        self._look()

    @property
    def facts(self) -> "RigFacts":
        """What is known of the rig; not before `complete`."""
        assert self._facts is not None
        return self._facts

    def set_rig(self, rig: "RigFile | None") -> None:
        """Take the tables of the open rig."""
        self.facts.set_rig(rig)
        addresses: dict[str, list[str]] = {}
        for device in rig.devices if rig is not None else ():
            name = "photodiodes" if device.name.startswith("photodiodes-") else device.name
            addresses.setdefault(name, []).append(device.address)
        self.devices.set_addresses(
            {
                name: found[0] if len(found) == 1 else f"{found[0]} and {len(found) - 1} more"
                for name, found in addresses.items()
            }
        )
        self._look()

    @Slot(object)
    def set_plan(self, plan: "Plan | None") -> None:
        """Take the plan of the run that is prepared."""
        self._plan = plan
        if self._facts is not None:
            self._facts.set_plan(plan)
            self._look()

    @Slot(object)
    def set_folder(self, folder: "Path") -> None:
        """Take the folder of data files."""
        self._folder = folder
        if self._facts is not None:
            self._facts.set_folder(folder)
            self._look()

    @Slot(object)
    def show_message(self, message: object) -> None:
        """Show an event of the station, or what the window knows of it."""
        before = self.facts.station.rig
        match message:
            case model.RigRead(rig):
                self.set_rig(rig)
            case model.Attached():
                self.facts.begin(message)
            case model.PastRead():
                self.facts.take_past(message)
            case model.RowCommitted():
                self.facts.add_row(message)
            case model.NotAttached() | model.StationLost():
                self.set_rig(None)
                self.facts.take(model.Snapshot())
            case _ if isinstance(message, model.Message):
                self.facts.take(message)
        now = self.facts.station.rig
        if now is not before:
            self.devices.set_devices(now.devices if now is not None else {})

    def set_refusals(self, refusals: dict[str, str]) -> None:
        """Disable what the station refuses now, and give the reason."""
        self.devices.set_refusal(refusals["connect"])

    @Slot()
    def _look(self) -> None:
        if self._facts is None or not self.isVisible():
            return
        self.devices.refresh()
        self.preflight.set_checks(model.preflight_checks(self._facts.facts()))

    @Slot(str)
    def _reconnect(self, device: str) -> None:
        self.command.emit("connect", {"device": device})

    def showEvent(self, event: QShowEvent) -> None:
        """Look at once; Qt calls it."""
        super().showEvent(event)
        self._look()

    def fit(self, room: QSize) -> None:
        """Show the parts one at a time where the room is small, and the axes where it is high."""
        compact = room.width() < WIDE or room.height() < HIGH
        self.axes.setVisible(not compact and room.height() >= WITH_AXES)
        if compact == self._compact:
            return
        self._compact = compact
        if compact:
            for (part, title), scroll in zip(self._parts, self._scrolls, strict=True):
                scroll.setWidget(part)
                self._tabs.addTab(scroll, title)
        else:
            self._tabs.clear()
            for scroll in self._scrolls:
                scroll.takeWidget()
            for at, panel in enumerate((self.rig, self.devices, self.axes)):
                self._left.insertWidget(at, panel)
                panel.show()
            self._right.insertWidget(0, self.preflight)
            self.preflight.show()
            self.axes.setVisible(room.height() >= WITH_AXES)
        self._pages.setCurrentIndex(int(compact))

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        super().set_colours(colours)
        self.devices.set_colours(colours)
        self.preflight.set_colours(colours)
