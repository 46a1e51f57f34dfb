"""The menus: File, Run, View, Help. An action that is also a button is enabled where the button is."""

import platform
from collections.abc import Callable
from pathlib import Path

from PySide6.QtCore import QObject, Qt, Signal, qVersion
from PySide6.QtGui import QAction, QActionGroup, QKeySequence
from PySide6.QtWidgets import QMainWindow, QMenu

import goniotwin
from goniotwin.app.desktop.remembered import Kind, Remembered
from goniotwin.app.desktop.run.panel import FINISH_KEY, HOLD_KEY, PAUSE_KEY, REHEARSE_KEY, START_KEY, STOP_KEY
from goniotwin.app.desktop.theme import Scheme
from goniotwin.app.desktop.view import MainView

OPEN_SCHEDULE_KEY, OPEN_RIG_KEY, QUIT_KEY, HELP_KEY, FULL_SCREEN_KEY = "Ctrl+O", "Ctrl+Shift+O", "Ctrl+Q", "F1", "F11"
SAVE_KEY = "Ctrl+S"
SILENT = "off"
SCHEMES: tuple[tuple[str, Scheme | None], ...] = (("&Follow the system", None), ("&Light", "light"), ("&Dark", "dark"))


class Menus(QObject):
    """The menus of a window. What a button does, its action does too; for the rest there are signals."""

    recent_chosen = Signal(str, object)
    """Kind and path of a file that was opened before."""
    folder_wanted = Signal()
    """Show the folder of journals in the system's file manager."""
    scheme_chosen = Signal(object)
    help_wanted = Signal()
    about_wanted = Signal()

    def __init__(self, window: QMainWindow, view: MainView, remembered: Remembered) -> None:
        super().__init__(window)
        self._window = window
        self._view = view
        self._remembered = remembered
        bar = window.menuBar()
        bar.setAccessibleName("Menus")
        for text, fill in (
            ("&File", self._fill_file),
            ("&Run", self._fill_run),
            ("&View", self._fill_view),
            ("&Help", self._fill_help),
        ):
            menu = QMenu(text, bar)
            bar.addMenu(menu)
            fill(menu)

    def set_pause(self, resumes: bool) -> None:
        """Name what the pause button does now."""
        self._pause.setText("Res&ume" if resumes else "&Pause after row")

    @property
    def sound(self) -> bool:
        """Whether notices have a sound."""
        return self._sound.isChecked()

    def _remember_sound(self) -> None:
        self._remembered.set_text("sound", "" if self._sound.isChecked() else SILENT)

    def set_rehearsing(self, rehearsing: bool) -> None:
        """Name what the action of the rehearsal does now."""
        self._rehearse.setText("Cancel re&hearsal" if rehearsing else "Re&hearse")

    def refresh(self) -> None:
        """Enable each action as its button is."""
        run, rig, schedule = self._view.run, self._view.rig, self._view.schedule
        for action, button in (
            (self._start, run.start_button),
            (self._rehearse, run.rehearse_button),
            (self._pause, run.pause_button),
            (self._stop, run.stop_button),
            (self._finish, run.finish_button),
            (self._open_rig, rig.open_button),
            (self._again, rig.again_button),
            (self._open_schedule, schedule.open_button),
            (self._save, schedule.save_button),
            (self._save_in, schedule.folder_button),
        ):
            action.setEnabled(button.isEnabled())
        for menu in (self._recent_rigs, self._recent_schedules):
            menu.setEnabled(rig.open_button.isEnabled())

    def _fill_file(self, menu: QMenu) -> None:
        rig, schedule = self._view.rig, self._view.schedule
        self._open_schedule = self._add(menu, "&Open schedule…", schedule.open_button.click, OPEN_SCHEDULE_KEY)
        self._save = self._add(menu, "Sa&ve the schedule", schedule.save_button.click, SAVE_KEY)
        self._recent_schedules = self._recent(menu, "Recent &schedules", "schedule")
        menu.addSeparator()
        self._open_rig = self._add(menu, "Open &rig…", rig.open_button.click, OPEN_RIG_KEY)
        self._recent_rigs = self._recent(menu, "Recent ri&gs", "rig")
        menu.addSeparator()
        self._save_in = self._add(menu, "Save &in…", schedule.folder_button.click)
        self._add(menu, "Open the &folder of journals", self.folder_wanted.emit)
        menu.addSeparator()
        leave = self._add(menu, "&Quit", self._window.close, QUIT_KEY)
        leave.setShortcutContext(Qt.ShortcutContext.ApplicationShortcut)  # also from a question

    def _fill_run(self, menu: QMenu) -> None:
        run = self._view.run
        self._start = self._add(menu, "&Start", run.start_button.click, START_KEY)
        self._rehearse = self._add(menu, "Re&hearse", run.rehearse_button.click, REHEARSE_KEY)
        self._pause = self._add(menu, "&Pause after row", run.pause_button.click, PAUSE_KEY)
        self._finish = self._add(menu, "Finish cu&t, then end", run.finish_button.click, FINISH_KEY)
        # Its keys are those of the panel, which hold in every window of the program.
        self._stop = self._add(menu, f"Stop\t{STOP_KEY}", run.stop_button.click)
        menu.addSeparator()
        self._again = self._add(menu, "&Connect again", self._view.rig.again_button.click)

    def _fill_view(self, menu: QMenu) -> None:
        screens = QActionGroup(self)
        actions = []
        for number, screen in enumerate(self._view.screens):
            action = self._add(menu, f"&{number + 1}  {screen.title}", self._show(number), f"Ctrl+{number + 1}")
            action.setCheckable(True)
            screens.addAction(action)
            actions.append(action)
        self._screens = actions
        self._view.screen_shown.connect(self._check_screen)
        self._check_screen(self._view.shown_screen)
        menu.addSeparator()
        schemes = QActionGroup(self)
        for text, scheme in SCHEMES:
            action = self._add(menu, text, self._choose(scheme))
            action.setCheckable(True)
            action.setChecked(scheme == (self._remembered.text("scheme") or None))
            schemes.addAction(action)
        menu.addSeparator()
        self._sound = self._add(menu, "S&ound at the end, a fault, a mounting", self._remember_sound)
        self._sound.setCheckable(True)
        self._sound.setChecked(self._remembered.text("sound") != SILENT)
        self._add(menu, "F&ull screen", self._toggle_full_screen, FULL_SCREEN_KEY)

    def _fill_help(self, menu: QMenu) -> None:
        self._add(menu, "&Keys and screens", self.help_wanted.emit, HELP_KEY)
        self._add(menu, "&About goniotwin", self.about_wanted.emit)

    def _add(self, menu: QMenu, text: str, act: Callable[[], object], key: str = "") -> QAction:
        # Made here, as menus are, and not by Qt: then Python knows of their end, and never hands out the one of an earlier
        # window that was at the same address.
        action = QAction(text, menu)
        menu.addAction(action)
        action.triggered.connect(lambda _checked=False: act())
        if key:
            action.setShortcut(QKeySequence(key))
        return action

    def _recent(self, menu: QMenu, text: str, kind: Kind) -> QMenu:
        recent = QMenu(text, menu)
        menu.addMenu(recent)
        recent.aboutToShow.connect(lambda: self._list_recent(recent, kind))
        return recent

    def _list_recent(self, menu: QMenu, kind: Kind) -> None:
        menu.clear()
        for number, path in enumerate(self._remembered.recent(kind), start=1):
            action = self._add(menu, f"&{number}  {path.name}   {path.parent}".replace("&&", "&"), self._reopen(kind, path))
            action.setToolTip(str(path))
        if menu.isEmpty():
            menu.addAction("none yet").setEnabled(False)

    def _reopen(self, kind: Kind, path: Path) -> Callable[[], None]:
        return lambda: self.recent_chosen.emit(kind, path)

    def _show(self, number: int) -> Callable[[], None]:
        return lambda: self._view.show_screen(number)

    def _choose(self, scheme: Scheme | None) -> Callable[[], None]:
        return lambda: self.scheme_chosen.emit(scheme)

    def _check_screen(self, number: int) -> None:
        self._screens[number].setChecked(True)

    def _toggle_full_screen(self) -> None:
        if self._window.isFullScreen():
            self._window.showNormal()
        else:
            self._window.showFullScreen()


def keys_text(view: MainView) -> str:
    """The keys of the window and what each screen is for, as HTML."""
    keys = [
        (f"hold {HOLD_KEY} for a second", "Stop: all axes come to rest and the run ends"),
        (STOP_KEY, "Stop, at once"),
        (START_KEY, "Start the schedule, into a new journal"),
        (REHEARSE_KEY, "Rehearse the schedule on the digital twin, or cancel the rehearsal"),
        (PAUSE_KEY, "Pause after the row, or resume; before a run, resume an unfinished campaign of the schedule"),
        (FINISH_KEY, "Finish the cut in progress, then end the run"),
        (OPEN_SCHEDULE_KEY, "Open a schedule file"),
        (SAVE_KEY, "Save the schedule"),
        (OPEN_RIG_KEY, "Open a rig file"),
        *((f"Ctrl+{number}", f"Screen {screen.title}") for number, screen in enumerate(view.screens, start=1)),
        ("Tab, Shift+Tab", "the next or previous control; arrow keys within a list"),
        ("Alt and the underlined letter", "press that control"),
        (FULL_SCREEN_KEY, "full screen, and back"),
        (QUIT_KEY, "close the window"),
    ]
    rows = "".join(f"<tr><td style='padding-right: 20px'><b>{key}</b></td><td>{what}</td></tr>" for key, what in keys)
    return f"<table>{rows}</table><p>Enter and Space never stop a run.</p>"


def about_text() -> str:
    """Program, version, and what it runs on, as HTML."""
    return (
        f"<h3>goniotwin {goniotwin.__version__}</h3>"
        "<p>BSDF measurement campaigns on a goniophotometer, and their rehearsal on its digital twin.</p>"
        f"<p>Python {platform.python_version()}, Qt {qVersion()}, {platform.platform()}</p>"
        "<p>Licence: MIT</p>"
    )
