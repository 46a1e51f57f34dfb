"""The desktop: a window on a rig and its campaign. The one package that knows Qt.

`rigthread` owns the rig and runs the engine, without Qt; `session` hears it through one signal and has it shown by the
parts of `layout`; `window` passes on what the person wants.
"""

from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QApplication

from goniotwin.app.desktop.event_loop import interrupts
from goniotwin.app.desktop.theme import Theme
from goniotwin.app.desktop.window import MainWindow

__all__ = ["MainWindow", "Theme", "run_desktop"]

STOPPED = 130
"""Exit status after Ctrl-C, 128 + SIGINT as of a shell."""


def run_desktop(rig_path: Path, schedule_path: Path | None, out: Path | None = None, speed: float = 1.0) -> int:
    """Opens the window on a rig and, where one is given, a schedule; returns the exit status when it is closed.

    Journals go into the folder `out`, without it into `goniotwin` in the person's own. `speed` is how much faster than
    ours the time of a virtual rig passes. Files that will not do are named in the window.

    Ctrl-C in the terminal, SIGTERM and SIGHUP stop a run in good order and close the window, without a question. The exit
    status then is 130, as of the other commands.
    """
    application = QApplication.instance()
    if not isinstance(application, QApplication):
        application = QApplication(["goniotwin"])
    application.setApplicationName("goniotwin")
    with interrupts() as (interrupt, requests):
        window = MainWindow(Theme(application), rig_path, schedule_path, out or Path.home() / "goniotwin", speed)
        interrupt.requested.connect(window.stop_and_close, Qt.ConnectionType.QueuedConnection)
        try:
            window.show()
            status = application.exec()
        finally:
            window.shut_down()
    return STOPPED if requests.received else status
