"""Run `goniotwin ARGUMENTS` and press Start as soon as it is enabled, unless a run is in progress already.

Prints a line for each row in the journal, and for a run that is in progress already: the number of rows, and the number of
repaints of the plot so far; after each `COUNT_EVERY` rows also the references to None and to True, the blocks of memory that
Python has allocated, and the widgets.
"""

import gc
import sys

import pyqtgraph as pg
from PySide6.QtCore import QEvent, QObject, QTimer, Slot
from PySide6.QtWidgets import QApplication

from goniotwin.app.campaign.running.events import RowCommitted
from goniotwin.app.cli.main import main
from goniotwin.app.desktop import MainWindow

POLL_MS = 10
COUNT_EVERY = 250


class WindowStarter(QObject):
    """Presses Start once, then prints the progress."""

    def __init__(self, application: QApplication) -> None:
        super().__init__()
        self._paints = 0
        self._application = application
        self._timer = QTimer(self, interval=POLL_MS)
        self._timer.timeout.connect(self._poll)
        self._timer.start()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Count the repaints of the plot; Qt calls it."""
        self._paints += event.type() is QEvent.Type.Paint
        return super().eventFilter(watched, event)

    @Slot()
    def _poll(self) -> None:
        for window in self._application.topLevelWidgets():
            if not isinstance(window, MainWindow) or not hasattr(window, "presenter"):
                continue
            if window.presenter.busy or window.view.run.start_button.isEnabled():
                self._timer.stop()
                shown = window.view.plot.findChild(pg.GraphicsView)
                assert shown is not None
                shown.viewport().installEventFilter(self)
                window.presenter.message_shown.connect(self._print)
                if window.presenter.busy:  # it is attached to a run, whose rows so far may be shown already
                    print(window.presenter.station.done, self._paints, flush=True)
                else:
                    window.view.run.start_button.click()

    @Slot(object)
    def _print(self, message: object) -> None:
        if isinstance(message, RowCommitted):
            # A row that is read before it is reported has no number yet.
            counts = self._counts() if message.done and not message.done % COUNT_EVERY else []
            print(message.done, self._paints, *counts, flush=True)

    def _counts(self) -> list[int]:
        gc.collect()
        # gc.get_objects would hand out the unfinished tuples of other threads, which then fail.
        return [sys.getrefcount(None), sys.getrefcount(True), sys.getallocatedblocks(), len(self._application.allWidgets())]


if __name__ == "__main__":
    application = QApplication(["goniotwin"])
    starter = WindowStarter(application)
    main()
