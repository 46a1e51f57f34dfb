"""The bench screen: the axes and the light by hand, the instrument in pictures, and readings of all photodiodes."""

from typing import TYPE_CHECKING

from PySide6.QtCore import QSize, Qt, Slot
from PySide6.QtGui import QHideEvent, QShowEvent
from PySide6.QtWidgets import QComboBox, QHBoxLayout, QLabel, QStackedLayout, QTabWidget, QVBoxLayout, QWidget

from goniotwin.app.desktop import model
from goniotwin.app.desktop.bench.axis_controls import AxisControls
from goniotwin.app.desktop.bench.instrument_view import InstrumentView
from goniotwin.app.desktop.bench.light_controls import LightControls
from goniotwin.app.desktop.bench.position_entry import NO_ANGLE, PositionEntry
from goniotwin.app.desktop.bench.readings_view import MonitorTrend, SignalBars
from goniotwin.app.desktop.events.question import Choice, QuestionBox
from goniotwin.app.desktop.model.axes import GREEK
from goniotwin.app.desktop.screen import Screen, WithoutPreferredHeight
from goniotwin.app.desktop.theme import Colours

if TYPE_CHECKING:  # the window shows itself before the engine and the optics are loaded
    from goniotwin.app.desktop.model.readings import BenchReadings
    from goniotwin.app.rig import RigFile
    from goniotwin.app.station.messages import BenchReading, Message, Snapshot

STEPS_DEG = (0.01, 0.1, 0.5, 1.0, 5.0, 10.0, 30.0)
FIRST_STEP = 3
SET_POSITION, CANCEL = "Set position", "Cancel"
CONTROLS_WIDTH = 332
QWIDGETSIZE_MAX = (1 << 24) - 1
"""Qt's width of a widget that has no greatest one."""
WIDE, HIGH = 624, 372
"""Size of a room from which on all parts are shown at once."""
COMMANDS = ("move", "home", "set_position", "wavelength", "shutter", "gain", "mount", "read", "live")
NO_RIG = "no rig is open"
READY = "Ready. Nothing moves before a command."


class BenchScreen(Screen):
    """Controls at the left, pictures at the right."""

    title = "Bench"
    icon = "axis-arrow"

    def __init__(self, colours: Colours) -> None:
        super().__init__(colours)
        self._station: Snapshot | None = None
        self._readings: BenchReadings | None = None
        self._refusals = dict.fromkeys(COMMANDS, NO_RIG)
        self._error = ""
        self.question: QuestionBox | None = None
        self._place: tuple[str, PositionEntry] | None = None
        self.axes = {axis: AxisControls(axis, colours) for axis in ("sigma", "beta", "shift", "gamma")}
        self.light = LightControls()
        self.step = QComboBox()
        self.step.setAccessibleName("Step of a jog")
        for each in STEPS_DEG:
            self.step.addItem(f"{each:g}°", each)
        self.step.setCurrentIndex(FIRST_STEP)
        self.status = QLabel()
        self.status.setWordWrap(True)
        self.status.setTextFormat(Qt.TextFormat.PlainText)
        self.status.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.instrument = InstrumentView(colours)
        self.bars = SignalBars(colours)
        self.reading_text = QLabel()
        self.reading_text.setWordWrap(True)
        self.reading_text.setAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignTop)
        # Two lines always: the pictures do not jump while live readings change its length.
        self.reading_text.setMinimumHeight(2 * self.reading_text.fontMetrics().lineSpacing())
        self.trend = MonitorTrend(colours)
        self._lay_out()
        for controls in self.axes.values():
            controls.command.connect(self._send)
            controls.place_wanted.connect(self._ask_about_position)
            controls.refused.connect(self.show_refusal)
        self.light.command.connect(self._send)
        self.light.refused.connect(self.show_refusal)
        self.instrument.blocked_shown.connect(self.bars.set_blocked)
        self.step.currentIndexChanged.connect(self._take_step)
        self._take_step()
        self._show()

    def _lay_out(self) -> None:
        head = QHBoxLayout()
        label = QLabel("&Jog step")
        label.setBuddy(self.step)
        head.addWidget(QLabel("<b>Axes</b>"))
        head.addStretch(1)
        head.addWidget(label)
        head.addWidget(self.step)
        self._axes_part, self._signals_part = QWidget(), QWidget()
        axes = QVBoxLayout(self._axes_part)
        axes.setContentsMargins(0, 0, 0, 0)
        axes.setSpacing(3)
        axes.addLayout(head)
        for axis in self.axes.values():
            axes.addWidget(axis)
        axes.addStretch(1)
        self._signals = QVBoxLayout(self._signals_part)
        self._signals.setContentsMargins(0, 0, 0, 0)
        self._signals.setSpacing(3)
        self._signals.addWidget(self.bars, 3)
        self._signals.addWidget(self.trend, 1)
        wide = QWidget()
        self._left, self._right = QVBoxLayout(), QVBoxLayout()
        columns = QHBoxLayout(wide)
        columns.setContentsMargins(0, 0, 0, 0)
        columns.setSpacing(10)
        columns.addLayout(self._left)
        columns.addLayout(self._right, 1)
        for column in (self._left, self._right):
            column.setSpacing(3)
        self._left.addStretch(1)
        self._tabs = QTabWidget()
        for tabs in (self._tabs, self._tabs.tabBar()):  # Tab stops at the latter
            tabs.setAccessibleName("Parts of the bench screen")
        self._beside = QWidget()
        self._light_and_signals = QHBoxLayout(self._beside)
        self._light_and_signals.setContentsMargins(0, 0, 0, 0)
        self._light_and_text = QVBoxLayout()
        self._light_and_text.addStretch(1)
        self._light_and_signals.addLayout(self._light_and_text)
        self._pages = QStackedLayout()
        self._pages.addWidget(wide)
        self._pages.addWidget(self._tabs)
        whole = WithoutPreferredHeight()
        layout = QVBoxLayout(whole)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(3)
        layout.addWidget(self.status)
        layout.addLayout(self._pages, 1)
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        outer.addWidget(whole)
        self._compact: bool | None = None
        self._behind = False
        """Whether another screen is shown instead: nothing is drawn then."""
        self.fit(QSize(WIDE, HIGH))

    def fit(self, room: QSize) -> None:
        """Show the parts one at a time where the room is small."""
        compact = room.width() < WIDE or room.height() < HIGH
        if compact == self._compact:
            return
        self._compact = compact
        for axis in self.axes.values():
            axis.set_one_line(compact)
        self._axes_part.setFixedWidth(QWIDGETSIZE_MAX if compact else CONTROLS_WIDTH)
        self.light.setFixedWidth(CONTROLS_WIDTH)
        if compact:
            self._light_and_text.insertWidget(0, self.light)
            self._light_and_text.insertWidget(1, self.reading_text)
            self._light_and_signals.addWidget(self._signals_part, 1)
            parts = (self._axes_part, "Axes"), (self._beside, "Light and readings"), (self.instrument, "Instrument")
            for at, (part, title) in enumerate(parts):
                self._tabs.insertTab(at, part, title)
        else:
            for at, part in enumerate((self._axes_part, self.light)):
                self._left.insertWidget(at, part)
            self._right.addWidget(self.instrument, 5)
            self._right.addWidget(self._signals_part, 4)
            self._signals.insertWidget(1, self.reading_text)
            for part in (self._axes_part, self.light, self.instrument, self._signals_part):
                part.show()
        self._pages.setCurrentIndex(int(compact))

    def complete(self) -> None:
        """Draw nothing before the screen is chosen."""
        self._behind = self.parentWidget() is not None and not self.isVisible()

    # What the station reports.

    def set_rig(self, rig: "RigFile | None") -> None:
        """Take the tables of the open rig."""
        self._readings = None if rig is None else model.BenchReadings(rig)
        self.instrument.set_model(None if rig is None else model.InstrumentModel(rig))
        for name, controls in self.axes.items():
            controls.set_settings(None if rig is None else rig.axes.by_name[name])
            controls.set_position(None)
        self.light.set_gains(() if rig is None else rig.photodiodes.gains_v_per_a)
        self.light.set_samples((*rig.twin.samples, model.NO_SAMPLE) if rig is not None and rig.twin is not None else ())
        if rig is not None:
            self.light.set_wavelengths(rig.monochromator.lowest_nm, rig.monochromator.highest_nm)
        self.bars.set_bars(None)
        self.trend.set_trace(None)
        self.reading_text.setText("")
        if rig is not None and self._station is not None:
            self._take(self._station)
        self._show()

    @Slot(object)
    def show_message(self, message: object) -> None:
        """Show an event of the station, or what the window knows of it."""
        match message:
            case model.RigRead(rig):
                self.set_rig(rig)
            case model.Attached(_name, snapshot):
                self._error = ""
                self._take(snapshot)
            case model.NotAttached() | model.StationLost():
                self.set_rig(None)
                self._take(model.Snapshot())
            case model.CommandRefused(command, reason) if command in COMMANDS:
                self.show_refusal(reason)
            case model.StopReport(confirmed=True) if self._station is not None and not self._station.busy:
                self.show_refusal("stopped")
            case _ if isinstance(message, model.Message):
                self._station = model.advance(self._station or model.Snapshot(), message)
                self._show_event(message)
        if not self._behind:
            self._show()

    def _take(self, snapshot: "Snapshot") -> None:
        self._station = snapshot
        self._show_positions(snapshot.positions)
        if snapshot.reading is not None:
            self._show_reading(snapshot.reading)

    def set_refusals(self, refusals: dict[str, str]) -> None:
        """Disable what the station refuses now, and give the reason."""
        self._refusals = refusals
        if not self._behind:
            self._show()

    @Slot(str)
    def show_refusal(self, reason: str) -> None:
        """Show why a command was refused; an empty reason removes it."""
        self._error = reason
        self._show_status()

    def _show_event(self, message: "Message") -> None:
        match message:
            case model.Positions() | model.DeviceChanged() if self._station is not None:
                self._show_positions(self._station.positions)
            case model.BenchReading():
                self._show_reading(message)
            case model.ActivityChanged(activity, error):
                if activity or error:
                    self._error = "" if activity else error
            case model.RigClosed():
                self._show_positions({})

    def _show_positions(self, degrees: dict[str, float]) -> None:
        if self._behind:  # a run has many a second
            return
        for name, controls in self.axes.items():
            controls.set_position(degrees.get(name))
        self.instrument.set_positions(degrees)
        self._show_place()

    def _show_reading(self, reading: "BenchReading") -> None:
        model, station = self._readings, self._station
        if model is None or station is None:
            return
        if reading.dark:
            model.add_dark(reading.gain_v_per_a, reading.counts)
        elif reading.monitor_a is not None:
            model.add_monitor(reading.t_s, reading.monitor_a, reading.wavelength_nm)
        bars = model.bars(reading.counts, reading.saturated, reading.gain_v_per_a, station.positions.get("shift", 0.0))
        self.bars.set_bars(bars)
        kind = "Dark reading" if reading.dark else "Live" if reading.live else f"Mean of {reading.readings}"
        self.reading_text.setText(f"{kind}: {bars.text}")
        self.trend.set_trace(model.trend)
        saturated = frozenset(bar.channel for bar in bars.bars if bar.state == "saturated")
        self.instrument.set_levels({bar.channel: bars.level(bar) for bar in bars.bars}, saturated)

    def _show(self) -> None:
        station, refusals = self._station, self._refusals
        if station is not None:
            bench = station.bench
            self.light.set_settings(bench.wavelength_nm, bench.shutter_open, bench.gain_v_per_a, bench.sample, bench.live)
            self.instrument.set_shutter(bench.shutter_open)
        unreferenced = station.unreferenced if station is not None else {}
        encoders = station.encoders if station is not None else {}
        self.instrument.set_unreferenced({name: encoders.get(name) for name in unreferenced})
        for name, controls in self.axes.items():
            controls.set_unreferenced(unreferenced.get(name, ""), encoders.get(name))
            controls.set_refusals(refusals["move"], refusals["home"], refusals["set_position"])
        self.light.set_refusals(refusals)
        self._show_status()

    def _show_status(self) -> None:
        station = self._station
        if self._error:
            text = f"✗ {self._error}"
        elif station is None or station.rig is None:
            text = "No rig is open."
        elif station.busy and station.question is not None:
            text = "The run waits for an answer: the bench only shows."
        elif station.busy:
            text = f"A run is {station.state}: the bench only shows."
        elif station.activity:
            text = f"{station.activity[:1].upper()}{station.activity[1:]} …"
        elif station.bench.live:
            text = "Live readings."
        else:
            text = READY
        self.status.setText(text)
        self.status.setAccessibleName(f"Bench: {text}")
        self.status.setStyleSheet(f"color: {self._colours.bad if self._error else self._colours.text}")

    # What the operator does.

    @Slot(str, object)
    def _send(self, command: str, arguments: object) -> None:
        self._error = ""
        self.command.emit(command, arguments)

    @Slot()
    def _take_step(self) -> None:
        for controls in self.axes.values():
            controls.set_step(float(self.step.currentData()))

    @Slot(str)
    def _ask_about_position(self, axis: str) -> None:
        if self.question is not None:
            self.question.dismiss()
        name = f"{GREEK[axis]} ({axis})"
        text = f"Read the angle of {name} from its scale, and enter it. Nothing moves. All later data depend on this angle."
        choices = [
            Choice(SET_POSITION, "The axis is at the angle entered"),
            Choice(CANCEL, "The position stays as it is", default=True),
        ]
        entry = PositionEntry(axis)
        box = QuestionBox(self, f"Set the position of {name}", text, choices, entry)
        self.question, self._place = box, (axis, entry)
        self._show_place()

        def answered(label: str) -> None:
            angle = entry.angle_deg
            if label == SET_POSITION and angle is None:
                box.set_problem(NO_ANGLE)
                return
            box.dismiss()
            self.question = self._place = None
            if label == SET_POSITION:
                self._send("set_position", {"axis": axis, "angle_deg": angle})

        box.chosen.connect(answered)
        box.appear()

    def _show_place(self) -> None:
        """Show counter and encoder of the axis whose position is to be set."""
        if self._place is not None and self._station is not None:
            axis, entry = self._place
            entry.show_place(*self._station.place(axis))

    def showEvent(self, event: QShowEvent) -> None:
        """Show what has come while another screen was shown; Qt calls it."""
        super().showEvent(event)
        self.instrument.set_active(True)
        self._behind = False
        self._show_positions(self._station.positions if self._station is not None else {})
        self._show()

    def hideEvent(self, event: QHideEvent) -> None:
        """Leave the computer to the other screens; Qt calls it."""
        super().hideEvent(event)
        self._behind = True
        self.instrument.set_active(False)

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        super().set_colours(colours)
        for controls in self.axes.values():
            controls.set_colours(colours)
        for view in (self.instrument, self.bars, self.trend):
            view.set_colours(colours)
        self._show_status()

    def shut_down(self) -> None:
        """End the thread of the instrument view."""
        self.instrument.shut_down()
