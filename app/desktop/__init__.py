"""The desktop: a window on a rig and its campaign. The one package that knows Qt.

`rigthread` owns the rig and runs the engine, without Qt; `session` hears it through one signal and has it shown by the
parts of `layout`; `window` passes on what the person wants.
"""

import signal
from pathlib import Path

from PySide6.QtWidgets import QApplication

from goniotwin.app.desktop.theme import Theme
from goniotwin.app.desktop.window import MainWindow

__all__ = ["MainWindow", "Theme", "run_desktop"]


def run_desktop(rig_path: Path, schedule_path: Path | None, out: Path | None = None, speed: float = 1.0) -> int:
    """Opens the window on a rig and, where one is given, a schedule; returns the exit status when it is closed.

    Journals go into the folder `out`, without it into `goniotwin` in the person's own. `speed` is how much faster than
    ours the time of a virtual rig passes. Files that will not do are named in the window. Ctrl-C in
    the terminal stops a run and closes the window.
    """
    application = QApplication.instance()
    if not isinstance(application, QApplication):
        application = QApplication(["goniotwin"])
    application.setApplicationName("goniotwin")
    window = MainWindow(Theme(application), rig_path, schedule_path, out or Path.home() / "goniotwin", speed)
    # Ctrl-C ends the window as it ends any other program; the collector's timer lets Python hear of it.
    before = signal.signal(signal.SIGINT, lambda _number, _frame: application.quit())
    try:
        window.show()
        return application.exec()
    finally:
        signal.signal(signal.SIGINT, before)
        window.shut_down()
