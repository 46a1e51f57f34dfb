"""`goniotwin ARGUMENTS` in a process of its own, in which Start is pressed as soon as the window allows it.

Prints a line for each row that is in the journal: how many rows are, and how often the plot was painted until then.
"""

import pyqtgraph as pg
from PySide6.QtCore import QEvent, QObject, QTimer, Slot
from PySide6.QtWidgets import QApplication

from goniotwin.app.campaign.running.events import RowCommitted
from goniotwin.app.cli.main import main
from goniotwin.app.desktop import MainWindow

LOOK_MS = 10


class Start(QObject):
    """Presses Start once, then reports."""

    def __init__(self, application: QApplication) -> None:
        super().__init__()
        self._paints = 0
        self._application = application
        self._timer = QTimer(self, interval=LOOK_MS)
        self._timer.timeout.connect(self._look)
        self._timer.start()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Counts what the plot paints."""
        self._paints += event.type() is QEvent.Type.Paint
        return super().eventFilter(watched, event)

    @Slot()
    def _look(self) -> None:
        for window in self._application.topLevelWidgets():
            if isinstance(window, MainWindow) and window.view.run.start_button.isEnabled():
                self._timer.stop()
                shown = window.view.plot.findChild(pg.PlotWidget)
                assert shown is not None
                shown.viewport().installEventFilter(self)
                window.presenter.message_shown.connect(self._report)
                window.view.run.start_button.click()

    @Slot(object)
    def _report(self, message: object) -> None:
        if isinstance(message, RowCommitted):
            print(message.done, self._paints, flush=True)


if __name__ == "__main__":
    application = QApplication(["goniotwin"])
    start = Start(application)
    main()
