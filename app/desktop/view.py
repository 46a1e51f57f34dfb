"""The contents of the window: the screens with their navigation, and what is always in sight around them.

Always in sight are the banner of a simulated rig, safety orders, an open question, devices and axes at the top; progress,
status, Start, Pause and Stop at the bottom. Between them each screen has the same room; it scrolls where it needs more.
"""

from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from PySide6.QtCore import Qt, Signal, Slot
from PySide6.QtGui import QResizeEvent
from PySide6.QtWidgets import QFrame, QHBoxLayout, QLabel, QScrollArea, QStackedWidget, QVBoxLayout, QWidget

from goniotwin.app.desktop.bench.screen import BenchScreen
from goniotwin.app.desktop.campaigns.screen import CampaignsScreen
from goniotwin.app.desktop.events.panels import NoticeBar, OrdersPanel, QuestionBar
from goniotwin.app.desktop.events.screen import EventsScreen
from goniotwin.app.desktop.navigation import Navigation
from goniotwin.app.desktop.results.screen import ResultsScreen
from goniotwin.app.desktop.rig.screen import RigScreen
from goniotwin.app.desktop.rig.strip import RigStrip
from goniotwin.app.desktop.run.panel import RunPanel
from goniotwin.app.desktop.run.screen import RunScreen
from goniotwin.app.desktop.screen import Screen
from goniotwin.app.desktop.setup.screen import SetupScreen
from goniotwin.app.desktop.theme import Colours
from goniotwin.app.desktop.tolerances.screen import TolerancesScreen

if TYPE_CHECKING:  # pyqtgraph is loaded after the window has been shown
    from goniotwin.app.desktop.run.hemisphere import HemisphereMap
    from goniotwin.app.desktop.run.live_plot import ScanPlot

SCREENS: tuple[type[Screen], ...] = (
    RigScreen,
    BenchScreen,
    SetupScreen,
    RunScreen,
    CampaignsScreen,
    ResultsScreen,
    EventsScreen,
    TolerancesScreen,
)
"""The screens in the order of the navigation. A new one is a line here."""
FIRST = RunScreen
"""The screen of the first start."""
NARROW, LOW = 800, 450
"""Width and height in logical pixels below which the window does without some texts. A screen of 1280 x 800 has 640 x 400 of
them at 200 %.
"""
AnyScreen = TypeVar("AnyScreen", bound=Screen)


class MainView(QWidget):
    """The contents of the window. It only shows."""

    screen_shown = Signal(int)
    """The number of the screen that is shown from now on."""

    def __init__(self, colours: Colours, folder: Path, speed: float) -> None:
        super().__init__()
        self._colours = colours
        self._status_is_error = False
        self._low = False
        self._banner = QLabel()
        self._banner.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.orders = OrdersPanel(colours)
        self.question = QuestionBar(colours)
        self.notice = NoticeBar(colours)
        self.strip = RigStrip(colours)
        self.navigation = Navigation(SCREENS, colours)
        self.screens = tuple(each(colours) for each in SCREENS)
        self._stack = QStackedWidget()
        self.run = RunPanel(speed, colours)
        self._status = _text_label("Status")
        self._saved = _text_label("Journal")
        rig, setup = self.screen_of(RigScreen), self.screen_of(SetupScreen)
        self.log = self.screen_of(EventsScreen)
        self.rig, self.devices, self.axes, self.schedule = rig.rig, rig.devices, rig.axes, setup.schedule
        self.schedule.plan_shown.connect(rig.set_plan)
        self.schedule.folder_shown.connect(rig.set_folder)
        self.schedule.folder_shown.connect(self.screen_of(TolerancesScreen).set_folder)
        self.schedule.folder_shown.connect(self.screen_of(ResultsScreen).set_folder)
        self.schedule.set_folder(folder)
        self.screen_of(RunScreen).set_events(self.log.model)
        self.navigation.chosen.connect(self.show_screen)
        campaigns, results = self.screen_of(CampaignsScreen), self.screen_of(ResultsScreen)
        campaigns.results_wanted.connect(self.show_results)
        results.export_wanted.connect(campaigns.export)
        results.report_wanted.connect(campaigns.report)
        self.log.serious_changed.connect(self._mark_events)
        self.devices.shown.connect(self.strip.set_devices)
        self.devices.shown.connect(self._mark_rig)
        self.axes.positions_shown.connect(self.strip.set_positions)
        self.axes.targets_shown.connect(self.strip.set_targets)
        self._lay_out()
        self.set_colours(colours)
        self.set_simulated(False, None)
        self.set_saved("")
        self.show_status("Starting …")
        self.show_screen(SCREENS.index(FIRST))

    def screen_of(self, kind: type[AnyScreen]) -> AnyScreen:
        """The screen of a class."""
        return next(each for each in self.screens if isinstance(each, kind))

    @property
    def shown_screen(self) -> int:
        """The number of the screen that is shown."""
        return self._stack.currentIndex()

    @Slot(int)
    def show_screen(self, number: int) -> None:
        """Show a screen by its number, from 0."""
        self._stack.setCurrentIndex(number)
        self.navigation.show_chosen(number)
        self.screen_shown.emit(number)
        if SCREENS[number] in (CampaignsScreen, ResultsScreen):
            self.screen_of(ResultsScreen).begin()

    def complete(self) -> None:
        """Make what takes long to load: icons and plots. Called once, after the window has been shown."""
        self.navigation.load_icons()
        for each in self.screens:
            each.complete()

    @Slot(object)
    def show_results(self, journal: Path) -> None:
        """Show a journal on the screen Results."""
        self.show_screen(SCREENS.index(ResultsScreen))
        self.screen_of(ResultsScreen).open_file(journal)

    @property
    def plot(self) -> "ScanPlot":
        """The plot of the run screen; not before `complete`."""
        return self.screen_of(RunScreen).plot

    @property
    def hemisphere(self) -> "HemisphereMap":
        """The hemisphere of the run screen; not before `complete`."""
        return self.screen_of(RunScreen).hemisphere

    @property
    def status(self) -> str:
        """The status line."""
        return self._status.text()

    @property
    def banner(self) -> str:
        """The banner across the top; empty for a real rig."""
        return "" if self._banner.isHidden() else self._banner.text()

    @property
    def saved(self) -> str:
        """The line with the path of the journal."""
        return self._saved.text()

    @property
    def plot_error(self) -> str:
        """The error of the plot; empty without one."""
        return self.screen_of(RunScreen).error

    def show_status(self, text: str, *, error: bool = False) -> None:
        """Show the status line."""
        self._status_is_error = error
        self._status.setText(f"✗ {text}" if error else text)
        self._colour_texts()
        self._show_lines()

    def set_simulated(self, simulated: bool, seed: int | None) -> None:
        """Show or hide the banner of a simulated rig."""
        self._banner.setVisible(simulated)
        self._banner.setText(f"SIMULATED  ·  seed {seed}  ·  not a real measurement")
        self._banner.setAccessibleName(self._banner.text())

    def set_saved(self, text: str) -> None:
        """Show the line with the path of the journal."""
        self._saved.setText(text)
        self._status.setToolTip(text)
        self._show_lines()

    @Slot(str)
    def set_plot_error(self, text: str) -> None:
        """Show an error of the plot; hide it if empty."""
        self.screen_of(RunScreen).show_error(text)

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        self._banner.setStyleSheet(
            f"background: {colours.simulated}; color: {colours.on_simulated}; font-weight: bold; padding: 3px"
        )
        for part in (self.orders, self.question, self.notice, self.strip, self.navigation, self.run):
            part.set_colours(colours)
        for screen in self.screens:
            screen.set_colours(colours)
        self._colour_texts()

    def _colour_texts(self) -> None:
        self._status.setStyleSheet(f"color: {self._colours.bad}; font-weight: bold" if self._status_is_error else "")
        self._saved.setStyleSheet(f"color: {self._colours.dim}")

    @Slot(int)
    def _mark_events(self, serious: int) -> None:
        self.navigation.set_mark(SCREENS.index(EventsScreen), f"✗ {serious}" if serious else "")

    @Slot(object)
    def _mark_rig(self, devices: dict[str, object]) -> None:
        failed = [each for each in devices.values() if not getattr(each, "connected", True)]
        self.navigation.set_mark(SCREENS.index(RigScreen), f"✗ {len(failed)}" if failed else "")

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Do without titles in a small window; Qt calls it."""
        super().resizeEvent(event)
        self.navigation.set_compact(self.width() < NARROW)
        self.run.set_compact(self.width() < NARROW)
        self._low = self.height() < LOW
        self.run.set_low(self._low)
        self.navigation.set_low(self._low)
        self._show_lines()

    def _show_lines(self) -> None:
        """Leave out, in a low window, the path of the journal, and what the notice has already."""
        repeated = bool(self.notice.text) and self._status.text().endswith(self.notice.text)
        self._status.setVisible(not (self._low and repeated))
        self._saved.setVisible(bool(self._saved.text()) and not self._low)

    def _lay_out(self) -> None:
        for each in self.screens:
            scroll = QScrollArea()
            scroll.setWidget(each)
            scroll.setWidgetResizable(True)
            scroll.setFrameShape(QFrame.Shape.NoFrame)
            scroll.setFocusPolicy(Qt.FocusPolicy.NoFocus)
            self._stack.addWidget(scroll)
        self._stack.setContentsMargins(10, 6, 10, 0)
        middle = QHBoxLayout()
        middle.setSpacing(0)
        middle.addWidget(self.navigation)
        middle.addWidget(self._stack, 1)
        self.run.lines.addWidget(self._status)
        self.run.lines.addWidget(self._saved)
        self.run.lines.addStretch(1)
        whole = QVBoxLayout(self)  # Tab follows the order in which the parts are added here
        whole.setContentsMargins(0, 0, 0, 0)
        whole.setSpacing(0)
        for part in (self._banner, self.orders, self.question, self.notice, self.strip):
            whole.addWidget(part)
        whole.addLayout(middle, 1)
        whole.addWidget(self.run)


def _text_label(name: str) -> QLabel:
    """A label for a line of text that wraps and can be selected; `name` for screen readers."""
    label = QLabel()
    label.setWordWrap(True)
    label.setAccessibleName(name)
    label.setTextFormat(Qt.TextFormat.PlainText)
    label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    return label
