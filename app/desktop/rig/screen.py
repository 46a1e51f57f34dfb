"""The rig screen: the rig file, the devices, the axes, and the preflight list."""

from typing import TYPE_CHECKING

from PySide6.QtCore import QEvent, QObject, QTimer, Slot
from PySide6.QtGui import QShowEvent
from PySide6.QtWidgets import QHBoxLayout, QVBoxLayout, QWidget

from goniotwin.app.desktop.rig.panels import AxesPanel, DevicesPanel, RigPanel
from goniotwin.app.desktop.rig.preflight_panel import PreflightPanel
from goniotwin.app.desktop.screen import Screen
from goniotwin.app.desktop.theme import Colours

if TYPE_CHECKING:  # the window shows itself before the engine is loaded
    from pathlib import Path

    from goniotwin.app.campaign.planning.plan import Plan
    from goniotwin.app.desktop.model.rig_facts import RigFacts
    from goniotwin.app.rig import RigFile

LOOK_MS = 1000
"""Time between two looks at what ages: the devices' last answers, the dark reading, the disk."""
HIGH = 520
"""Height of the room from which on the axes are shown here; they are always in the strip above the screens."""


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
        left = QVBoxLayout()
        left.setSpacing(4)
        for panel in (self.rig, self.devices, self.axes):
            left.addWidget(panel)
        left.addStretch(1)
        right = QVBoxLayout()
        right.addWidget(self.preflight)
        right.addStretch(1)
        layout = QHBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(12)
        layout.addLayout(left, 4)
        layout.addLayout(right, 5)
        self._timer = QTimer(self, interval=LOOK_MS)
        self._timer.timeout.connect(self._look)
        self._room: QWidget | None = None
        self.devices.reconnect.connect(self._reconnect)

    def complete(self) -> None:
        """Begin to look at the rig."""
        from goniotwin.app.desktop.model.rig_facts import RigFacts

        self._facts = RigFacts()
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
        self.devices.set_addresses({
            name: found[0] if len(found) == 1 else f"{found[0]} and {len(found) - 1} more" for name, found in addresses.items()
        })  # fmt: skip
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
        from goniotwin.app.desktop.model.messages import Attached, NotAttached, RigRead, StationLost
        from goniotwin.app.station import messages

        before = self.facts.station.rig
        match message:
            case RigRead(rig):
                self.set_rig(rig)
            case Attached(_name, snapshot):
                self.facts.take(snapshot)
            case NotAttached() | StationLost():
                self.set_rig(None)
                self.facts.take(messages.Snapshot())
            case _ if isinstance(message, messages.Message):
                self.facts.take(message)
        now = self.facts.station.rig
        if now is not before:
            self.devices.set_devices(now.devices if now is not None else {})
        self.devices.set_errors(self.facts.last_errors)

    def set_refusals(self, refusals: dict[str, str]) -> None:
        """Disable what the station refuses now, and say why."""
        self.devices.set_refusal(refusals["connect"])

    @Slot()
    def _look(self) -> None:
        if self._facts is None or not self.isVisible():
            return
        from goniotwin.app.desktop.model.preflight import preflight

        self.devices.refresh()
        self.preflight.set_checks(preflight(self._facts.facts()))

    @Slot(str)
    def _reconnect(self, device: str) -> None:
        self.command.emit("connect", {"device": device})

    def showEvent(self, event: QShowEvent) -> None:
        """Look at once; Qt calls it."""
        super().showEvent(event)
        parent = self.parentWidget()
        if parent is not None and parent is not self._room:
            self._room = parent
            parent.installEventFilter(self)
        self._fit()
        self._look()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Leave out the axes where the room is low; Qt calls it."""
        if watched is self._room and event.type() == QEvent.Type.Resize:
            self._fit()
        return super().eventFilter(watched, event)

    def _fit(self) -> None:
        self.axes.setVisible(self._room is None or self._room.height() >= HIGH)

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        super().set_colours(colours)
        self.devices.set_colours(colours)
        self.preflight.set_colours(colours)
