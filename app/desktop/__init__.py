"""The desktop: a window on a rig and its campaign. The only package that imports Qt.

`model` is the client of the station that has the rig, with the window's planner and its reader of the run's journal, without
Qt. `presenter` receives its messages through one signal and shows them in the panels of `view`. `window` passes on what the
operator does; files, the open question and the question at the end are objects of their own. Each screen has a folder (rig,
bench, setup, run, campaigns, results, events, tolerances) and a line in `SCREENS` of the view.
"""

import contextlib
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QApplication

from goniotwin.app.desktop.event_loop import end_signal_notifier
from goniotwin.app.desktop.remembered import Remembered
from goniotwin.app.desktop.theme import Theme as Theme
from goniotwin.app.desktop.window import MainWindow as MainWindow
from goniotwin.app.errors import UserError

if TYPE_CHECKING:
    from goniotwin.app.desktop.model.connection import Stations

DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")
"""Variables one of which Qt needs on Linux; the last one may name a platform without a display."""
STOPPED = 130
"""Exit status after Ctrl-C: 128 + SIGINT, as of a shell."""


def check_display() -> None:
    """Raise UserError where Linux has no display: Qt then ends the process with a text of its own."""
    if sys.platform == "linux" and not any(os.environ.get(name) for name in DISPLAYS):
        raise UserError(
            "the window needs a display, and DISPLAY and WAYLAND_DISPLAY are not set; start it in a desktop session or through "
            "ssh -X, or use the commands: goniotwin --help"
        )


def run_desktop(
    rig_path: Path,
    schedule_path: Path | None,
    out: Path | None = None,
    speed: float = 1.0,
    stations: "Stations | None" = None,
) -> int:
    """Open the window with a rig and, if given, a schedule; return the exit status when it is closed.

    Journals are written to the folder `out`, by default that of the last start, or `goniotwin` in the user's home.
    `speed` is the simulation speed of a virtual rig; `stations` is how its station is found or started. Errors in the files
    are shown in the window.

    Ctrl-C in the terminal, SIGTERM and SIGHUP close the window without a question; a run goes on in its station. The exit
    status is then 130, as for the other commands. The safety orders that are not acknowledged are the last lines on standard
    error.
    Raises UserError where there is no display.
    """
    application = QApplication.instance()
    if not isinstance(application, QApplication):
        check_display()
        application = QApplication(["goniotwin"])
    application.setApplicationName("goniotwin")
    remembered = Remembered.of_user()
    folder = out or remembered.folder or Path.home() / "goniotwin"
    with end_signal_notifier() as (notifier, handlers):
        theme = Theme(application, remembered.scheme)
        window = MainWindow(theme, rig_path, schedule_path, folder, speed, remembered, stations)
        notifier.received.connect(window.close_unattended, Qt.ConnectionType.QueuedConnection)
        try:
            window.show()
            status = application.exec()
        finally:
            window.shut_down()
    for order in window.open_orders:
        with contextlib.suppress(OSError):  # a closed terminal
            print(f"goniotwin: SAFETY: {order.text}", file=sys.stderr)
    return STOPPED if handlers.received else status
