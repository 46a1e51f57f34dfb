"""Keeps the plot up with the run, and keeps the plot's failures away from it."""

from PySide6.QtCore import QObject, QTimer, Signal, Slot

from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.running.events import RowCommitted, RowStarted
from goniotwin.app.desktop.model.live_scan import LiveCut
from goniotwin.app.desktop.run.scan_plot import CutPlot

REDRAW_MS = 100
"""Not more often, however fast the rows come: drawing is for eyes."""


class LivePlot(QObject):
    """Between the run's events and the plot. It never raises; `failed` says what went wrong."""

    failed = Signal(str)

    def __init__(self, plot: CutPlot, parent: QObject) -> None:
        super().__init__(parent)
        self._plot = plot
        self._cut: LiveCut | None = None
        self._redraw = QTimer(self, interval=REDRAW_MS, singleShot=True)
        self._redraw.timeout.connect(self._draw)

    def begin(self, plan: Plan | None, mark: str) -> None:
        """An empty plot for the run of a plan, or for none."""
        self._cut = LiveCut(plan) if plan is not None else None
        self._plot.clear(mark)

    def heed(self, event: RowStarted | RowCommitted) -> None:
        """Takes a row in; it is drawn soon."""
        if self._cut is None:
            return
        try:
            self._cut.heed(event)
        except Exception as error:  # noqa: BLE001  (what is shown may fail in any way; what is measured goes on)
            self._fail(error)
        if not self._redraw.isActive():
            self._redraw.start()

    def end(self) -> None:
        """Nothing is drawn any more."""
        self._redraw.stop()

    @Slot()
    def _draw(self) -> None:
        try:
            cut = self._cut.cut() if self._cut is not None else None
            if cut is not None:
                self._plot.show_cut(cut)
        except Exception as error:  # noqa: BLE001  (as above)
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        """It is not tried again in this run: what failed once would fail at every row."""
        self._cut = None
        self.failed.emit(f"The plot failed ({type(error).__name__}: {error}); the run is not affected.")
