"""The controls of a run: Start, Pause, Finish cut, Stop; its progress, the time left and the simulation speed."""

from typing import TYPE_CHECKING

from PySide6.QtCore import Qt, Signal, Slot
from PySide6.QtGui import QGuiApplication, QKeySequence, QShortcut
from PySide6.QtWidgets import (
    QComboBox,
    QHBoxLayout,
    QLabel,
    QProgressBar,
    QPushButton,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from goniotwin.app.campaign.wording import rounded_duration_text
from goniotwin.app.desktop.held_key import HeldKeyFilter
from goniotwin.app.desktop.theme import Colours

if TYPE_CHECKING:  # the window shows itself before the engine is loaded
    from goniotwin.app.desktop.model.permissions import Permissions
    from goniotwin.app.desktop.model.time_left import Wait

START_KEY, PAUSE_KEY, FINISH_KEY, REHEARSE_KEY = "Ctrl+R", "Ctrl+P", "Ctrl+Shift+F", "Ctrl+Shift+R"
REHEARSE, CANCEL = "Rehearse", "Cancel\nrehearsal"
PAUSE, RESUME, FINISH = "&Pause\nafter row", "Res&ume", "Finish\ncu&t"
"""Texts of the button that pauses and resumes, and of that which ends the run after the cut."""
SPEEDS = (1.0, 10.0, 20.0, 60.0)
STOP_KEY = "Ctrl+."
"""Stops at once. Enter and Space never stop, so that a key pressed by accident ends no run."""
HOLD_KEY = "Esc"
HOLD_MS = 1000
"""Time for which HOLD_KEY has to be held."""


class RunPanel(QWidget):
    """The controls of a run. The window connects their signals. `lines` is the place for lines of text below the progress."""

    start = Signal()
    rehearse = Signal()
    """Rehearse the schedule, or cancel the rehearsal in progress."""
    pause = Signal()
    resume = Signal()
    stop = Signal()
    finish_cut = Signal()
    resume_journal = Signal()
    """Continue the unfinished campaign that `set_unfinished` has named."""
    speed_chosen = Signal(float)

    def __init__(self, speed: float, colours: Colours) -> None:
        super().__init__()
        self._resumes = self._continues = False
        self._speed = speed
        self._left_s: float | None = None
        self._wait: Wait | None = None
        self._clock_texts = ""
        self._unfinished, self._rehearsal = "", ""
        self._permissions: Permissions | None = None
        self.start_button = _button("&Start", "Start the run")
        self.rehearse_button = _button(REHEARSE, "Rehearse the schedule")
        self.pause_button = _button(PAUSE, "Pause the run")
        self.finish_button = _button(FINISH, "Finish the cut and end the run")
        self.stop_button = _button("STOP", "Stop all axes and the run")
        self.stop_button.setToolTip(f"All axes come to rest and the run ends (hold {HOLD_KEY} for a second, or {STOP_KEY})")
        self.stop_button.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Expanding)
        self.stop_button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._stop_keys = QLabel()
        self._stop_keys.setAlignment(Qt.AlignmentFlag.AlignCenter)
        self.hold = HeldKeyFilter(self, Qt.Key.Key_Escape, HOLD_MS)
        self.progress = QProgressBar()
        self.progress.setAccessibleName("Rows done")
        self.progress.setMinimumWidth(120)
        self.left = QLabel()
        self.left.setAccessibleName("Time left")
        self.speeds = QComboBox()
        self.speeds.setAccessibleName("Simulation speed")
        self.speeds.setToolTip("Simulation speed")
        for each in sorted({*SPEEDS, speed}):
            self.speeds.addItem(f"{each:g}×", each)
        self.speeds.setCurrentIndex(self.speeds.findData(speed))
        self._speed_label = QLabel("Simu&lation speed")
        self._speed_label.setBuddy(self.speeds)
        self.lines = QVBoxLayout()
        self._bar = QVBoxLayout()
        self._virtual = True
        self._compact = self._low = True  # the window grows from its least size
        self._lay_out()
        self.start_button.clicked.connect(self.start)
        self.rehearse_button.clicked.connect(self.rehearse)
        self.stop_button.clicked.connect(self.stop)
        self.pause_button.clicked.connect(self._pause_or_resume)
        self.finish_button.clicked.connect(self.finish_cut)
        self.speeds.currentIndexChanged.connect(self._choose_speed)
        self.hold.begun.connect(self._show_hold)
        self.hold.held.connect(self._stop_held)
        self.hold.ended.connect(self._show_no_hold)
        # In every window of the program, and also while the key repeats. The press of HOLD_KEY is for the hold alone: it
        # would close a question at once.
        stop, _ = (
            QShortcut(QKeySequence(key), self, context=Qt.ShortcutContext.ApplicationShortcut) for key in (STOP_KEY, HOLD_KEY)
        )
        stop.activated.connect(self.stop_button.click)
        application = QGuiApplication.instance()
        assert isinstance(application, QGuiApplication)
        application.applicationStateChanged.connect(self._forget_hold)  # another program may get the release
        self._show_no_hold()
        self._show_speeds()
        self._show_texts()
        self.set_colours(colours)
        self.set_progress(0, 0, None)

    def set_permissions(self, permissions: "Permissions") -> None:
        """Enable the permitted controls; the tool tip of Start has the reason why it is disabled."""
        self.start_button.setEnabled(not permissions.no_start)
        refused = f"Disabled: {permissions.no_start}" if permissions.no_start else ""
        self.start_button.setToolTip(refused or f"Measure the schedule, into a new journal ({START_KEY})")
        self._permissions = permissions
        self.rehearse_button.setEnabled(not permissions.no_rehearsal)
        self.rehearse_button.setToolTip(
            f"Disabled: {permissions.no_rehearsal}"
            if permissions.no_rehearsal
            else f"Run the schedule on the digital twin, beside the window; no device moves ({REHEARSE_KEY})"
        )
        self._show_pause()
        self.finish_button.setEnabled(permissions.finish_cut)
        self.finish_button.setToolTip(
            f"Measure the rest of this cut at all wavelengths, then end the run in good order ({FINISH_KEY}); Start or Resume "
            "goes on with the next cut"
        )
        self.stop_button.setEnabled(permissions.stop)
        self.speeds.setEnabled(not permissions.watching)
        self.speeds.setToolTip(permissions.watching or "Simulation speed")

    def set_rehearsal(self, progress: str) -> None:
        """Show the progress of a rehearsal in place of the run's; empty where there is none."""
        self._rehearsal = progress
        self.rehearse_button.setText((CANCEL if not self._low else "Cancel") if progress else REHEARSE)
        self.rehearse_button.setAccessibleName("Cancel the rehearsal" if progress else "Rehearse the schedule")
        self._show_progress()

    def set_unfinished(self, text: str) -> None:
        """Offer to resume an unfinished campaign of this schedule; `text` names it, empty where there is none."""
        self._unfinished = text
        self._show_pause()

    def _show_pause(self) -> None:
        """Show what the pause button does now: pause or resume the run, or resume an unfinished campaign."""
        permissions = self._permissions
        if permissions is None:
            return
        idle = not permissions.pause and not permissions.resume
        self._continues = idle and bool(self._unfinished) and not permissions.refusals["continue"]
        self._resumes = permissions.resume or self._continues
        self.pause_button.setEnabled(not idle or self._continues)
        self._show_texts()
        if self._continues:
            what = f"Continue {self._unfinished}"
        elif permissions.resume:
            what = "Continue with the next row"
        else:
            what = "Pause after this row, with the shutter closed"
        self.pause_button.setToolTip(f"{what} ({PAUSE_KEY})")
        self.pause_button.setAccessibleName("Resume the run" if self._resumes else "Pause the run after this row")

    @property
    def resumes(self) -> bool:
        """Whether the pause button resumes now."""
        return self._resumes

    def set_progress(self, done: int, of: int, left_s: float | None) -> None:
        """Show the rows done and planned, and the instrument time of the rest, s."""
        self._rows = f"{done} of {of} rows, {100 * done // of} %" if of else "no rows"
        self.progress.setRange(0, max(of, 1))
        self.progress.setValue(done)
        self._show_progress()
        self._left_s = left_s
        self._wait, self._clock_texts = None, ""
        self._show_left()

    def _show_progress(self) -> None:
        self.progress.setFormat(self._rehearsal or self._rows)

    def set_wait(self, wait: "Wait", clock_texts: str) -> None:
        """Show the time to wait, as learnt from the pace so far; `clock_texts`: the calendar times of end and next mounting."""
        self._wait, self._clock_texts = wait, clock_texts
        self._show_left()

    def show_speed(self, speed: float) -> None:
        """Show the simulation speed of the station, which another client may have set."""
        self.speeds.blockSignals(True)
        if self.speeds.findData(speed) < 0:
            self.speeds.addItem(f"{speed:g}×", speed)
        self.speeds.setCurrentIndex(self.speeds.findData(speed))
        self.speeds.blockSignals(False)
        if self._virtual:
            self._speed = speed
        self._show_left()

    def set_virtual(self, virtual: bool) -> None:
        """Show the simulation speed for a virtual rig, and hide it for a real one."""
        self._virtual = virtual
        self._show_speeds()
        self._speed = float(self.speeds.currentData()) if virtual else 1.0
        self._show_left()

    def set_compact(self, compact: bool) -> None:
        """Take less width: the simulation speed without its name, and no Rehearse."""
        if compact != self._compact:
            self._compact = compact
            self.rehearse_button.setHidden(compact)  # the menu Run has it
            self._show_speeds()

    def set_low(self, low: bool) -> None:
        """Take less height: one line for each text, the calendar times in the tool tip only."""
        if low != self._low:
            self._low = low
            self.left.setWordWrap(not low)
            self._show_texts()
            self._show_left()

    def _show_texts(self) -> None:
        pause = RESUME if self._resumes else PAUSE
        self.pause_button.setText(pause.partition("\n")[0] if self._low else pause)
        self.finish_button.setText(FINISH.replace("\n", " ") if self._low else FINISH)

    def _show_speeds(self) -> None:
        self._speed_label.setVisible(self._virtual and not self._compact)
        self.speeds.setVisible(self._virtual)

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme. No other control looks like Stop."""
        self.stop_button.setStyleSheet(
            f"QPushButton {{ background: {colours.stop}; color: white; font-weight: bold; font-size: 17pt;"
            f" border: 2px solid {colours.stop}; border-radius: 6px; padding: 6px 26px }}"
            f"QPushButton:pressed {{ background: {colours.stop_pressed} }}"
            f"QPushButton:focus {{ border-color: {colours.text} }}"
            f"QPushButton:disabled {{ background: {colours.button}; color: {colours.dim}; border-color: {colours.line} }}"
        )

    def _lay_out(self) -> None:
        bar = self._bar
        bar.setSpacing(4)
        bar.addWidget(self.progress)
        bar.addWidget(self.left)
        texts = QVBoxLayout()
        texts.setSpacing(4)
        texts.addLayout(bar)
        texts.addLayout(self.lines, 1)
        buttons = QHBoxLayout()
        self.rehearse_button.setHidden(self._compact)
        for each in (self.start_button, self.rehearse_button, self.pause_button, self.finish_button):
            each.setMinimumWidth(66)
            each.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
            buttons.addWidget(each)
        speed = QHBoxLayout()
        speed.addWidget(self._speed_label)
        speed.addWidget(self.speeds)
        controls = QVBoxLayout()
        controls.setSpacing(4)
        controls.addLayout(buttons, 1)
        controls.addLayout(speed)
        stop = QVBoxLayout()
        stop.setSpacing(2)
        stop.addWidget(self.stop_button)
        stop.addWidget(self._stop_keys)
        layout = QHBoxLayout(self)
        layout.setContentsMargins(12, 6, 10, 8)
        layout.setSpacing(14)
        layout.addLayout(texts, 1)
        layout.addLayout(controls)
        layout.addLayout(stop)

    def _show_left(self) -> None:
        if not self._left_s:
            self.left.setText("")
            return
        # Never "0 s": there is something left.
        seconds = self._left_s / self._speed if self._wait is None else self._wait.seconds
        wait = rounded_duration_text(max(seconds, 1.0))
        band = "" if self._wait is None else f" ± {rounded_duration_text(max(self._wait.band, 1.0))}"
        simulated = "" if self._speed == 1.0 else f" ({rounded_duration_text(max(self._left_s, 1.0))} simulated)"
        self.left.setToolTip(" · ".join(each for each in (simulated.strip(" ()"), self._clock_texts) if each))
        if self._low:
            self.left.setText(f"{wait}{band} " + ("to wait" if simulated else "left"))
            return
        more = f" · {self._clock_texts}" if self._clock_texts else ""
        # Without a known pace the estimate lacks the program's own time, which does not go faster with the simulation speed.
        about = "at least" if self._wait is None else "about"
        self.left.setText((f"{about} {wait}{band} to wait{simulated}" if simulated else f"{wait}{band} left") + more)

    @Slot()
    def _show_hold(self) -> None:
        if self.stop_button.isEnabled():
            self.stop_button.setDown(True)
            self._stop_keys.setText(f"keep {HOLD_KEY} down …")

    @Slot()
    def _show_no_hold(self) -> None:
        self.stop_button.setDown(False)
        self._stop_keys.setText(f"hold {HOLD_KEY}, or {STOP_KEY}")

    @Slot()
    def _stop_held(self) -> None:
        self._show_no_hold()
        self.stop_button.click()

    @Slot()
    def _forget_hold(self) -> None:
        self.hold.forget()
        self._show_no_hold()

    @Slot()
    def _pause_or_resume(self) -> None:
        (self.resume_journal if self._continues else self.resume if self._resumes else self.pause).emit()

    @Slot(int)
    def _choose_speed(self, _index: int) -> None:
        self._speed = float(self.speeds.currentData())
        self._show_left()
        self.speed_chosen.emit(self._speed)


def _button(text: str, name: str) -> QPushButton:
    button = QPushButton(text)
    button.setAccessibleName(name)
    button.setAutoDefault(False)
    return button
