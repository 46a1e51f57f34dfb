"""Start, Pause, Stop, how far the run is and how long it will take."""

from PySide6.QtCore import Qt, Signal, Slot
from PySide6.QtGui import QKeySequence, QShortcut
from PySide6.QtWidgets import QComboBox, QHBoxLayout, QLabel, QProgressBar, QPushButton, QSizePolicy, QVBoxLayout, QWidget

from goniotwin.app.desktop.model.permissions import Allowed
from goniotwin.app.desktop.theme import Colours

SPEEDS = (1.0, 10.0, 60.0)
STOP_KEYS = ("Esc", "F12")


class RunPanel(QWidget):
    """The controls of a run. What they mean is the window's to decide."""

    start = Signal()
    pause = Signal()
    resume = Signal()
    stop = Signal()
    speed_chosen = Signal(float)

    def __init__(self, speed: float, colours: Colours) -> None:
        super().__init__()
        self._resumes = False
        self._speed = speed
        self._left_s: float | None = None
        self.start_button = _button("&Start", "Start the run", "Ctrl+R")
        self.pause_button = _button("&Pause", "Pause the run", "Ctrl+P")
        self.stop_button = _button("STOP", "Stop all axes and the run", "")
        self.stop_button.setToolTip(f"All axes come to rest and the run ends ({' or '.join(STOP_KEYS)})")
        self.stop_button.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Expanding)
        self.progress = QProgressBar()
        self.progress.setAccessibleName("Rows done")
        self.progress.setMinimumWidth(160)
        self.left = QLabel()
        self.left.setAccessibleName("Time left")
        self.speeds = QComboBox()
        self.speeds.setAccessibleName("How fast the virtual rig's time passes")
        self.speeds.setToolTip("How fast the virtual rig's time passes")
        for each in sorted({*SPEEDS, speed}):
            self.speeds.addItem(f"{each:g}×", each)
        self.speeds.setCurrentIndex(self.speeds.findData(speed))
        self._pace = QLabel("Rig's time at")
        self._pace.setBuddy(self.speeds)
        self._lay_out()
        self.start_button.clicked.connect(self.start)
        self.stop_button.clicked.connect(self.stop)
        self.pause_button.clicked.connect(self._pause_or_resume)
        self.speeds.currentIndexChanged.connect(self._choose_speed)
        for key in STOP_KEYS:
            # Whichever of the program's windows has the focus, and however often the key repeats.
            shortcut = QShortcut(QKeySequence(key), self, context=Qt.ShortcutContext.ApplicationShortcut)
            shortcut.activated.connect(self.stop_button.click)
        self.set_colours(colours)
        self.set_progress(0, 0, None)

    def set_allowed(self, allowed: Allowed) -> None:
        """Enables what may be done, and says why not."""
        self.start_button.setEnabled(not allowed.no_start)
        self.start_button.setToolTip(
            f"Not now: {allowed.no_start}" if allowed.no_start else "Measure the schedule into a new journal (Ctrl+R)"
        )
        self.pause_button.setEnabled(allowed.pause or allowed.resume)
        self._resumes = allowed.resume
        self.pause_button.setText("&Resume" if allowed.resume else "&Pause")
        self.pause_button.setShortcut("Ctrl+P")  # Qt forgets it with the text
        self.pause_button.setAccessibleName("Resume the run" if allowed.resume else "Pause the run")
        self.stop_button.setEnabled(allowed.stop)

    def set_progress(self, done: int, of: int, left_s: float | None) -> None:
        """Rows done and planned, and the rig's time that the rest will take, s."""
        self.progress.setRange(0, max(of, 1))
        self.progress.setValue(done)
        self.progress.setFormat(f"{done} of {of} rows, {100 * done // of} %" if of else "no rows")
        self._left_s = left_s
        self._show_left()

    def set_paced(self, paced: bool) -> None:
        """Whether the rig's time may be made to pass faster."""
        self._pace.setVisible(paced)
        self.speeds.setVisible(paced)
        self._speed = float(self.speeds.currentData()) if paced else 1.0
        self._show_left()

    def set_colours(self, colours: Colours) -> None:
        """Follows the scheme. Stop looks like nothing else in the window."""
        self.stop_button.setStyleSheet(
            f"QPushButton {{ background: {colours.stop}; color: white; font-weight: bold; font-size: 17pt;"
            f" border: 2px solid {colours.stop}; border-radius: 6px; padding: 6px 26px }}"
            f"QPushButton:pressed {{ background: {colours.stop_pressed} }}"
            f"QPushButton:focus {{ border-color: {colours.text} }}"
            f"QPushButton:disabled {{ background: {colours.button}; color: {colours.dim}; border-color: {colours.line} }}"
        )

    def _lay_out(self) -> None:
        buttons = QHBoxLayout()
        for each in (self.start_button, self.pause_button):
            each.setMinimumWidth(96)
            buttons.addWidget(each)
        buttons.addStretch(1)
        buttons.addWidget(self._pace)
        buttons.addWidget(self.speeds)
        bar = QHBoxLayout()
        bar.addWidget(self.progress, 1)
        bar.addWidget(self.left)
        rows = QVBoxLayout()
        rows.setSpacing(8)
        rows.addLayout(bar)
        rows.addLayout(buttons)
        layout = QHBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addLayout(rows, 1)
        layout.addSpacing(8)
        layout.addWidget(self.stop_button)

    def _show_left(self) -> None:
        if not self._left_s:
            self.left.setText("")
            return
        text = f"{in_words(self._left_s)} left"
        if self._speed != 1.0:
            text = f"rig's {in_words(self._left_s)} left, {in_words(self._left_s / self._speed)} at {self._speed:g}×"
        self.left.setText(text)

    @Slot()
    def _pause_or_resume(self) -> None:
        (self.resume if self._resumes else self.pause).emit()

    @Slot(int)
    def _choose_speed(self, _index: int) -> None:
        self._speed = float(self.speeds.currentData())
        self._show_left()
        self.speed_chosen.emit(self._speed)


def in_words(seconds: float) -> str:
    """A duration for people: `4 s`, `2 min 05 s`, `3 h 07 min`."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


def _button(text: str, name: str, shortcut: str) -> QPushButton:
    button = QPushButton(text)
    button.setAccessibleName(name)
    button.setAutoDefault(False)
    if shortcut:
        button.setShortcut(shortcut)
    return button
