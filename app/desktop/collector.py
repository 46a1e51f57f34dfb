"""Python's garbage collector, kept in the window's thread.

The collector runs in whichever thread happens to allocate. In the rig's it would destroy widgets that were left in a
cycle, and Qt crashes when a widget is destroyed outside of the window's thread. (As pyqtgraph's `GarbageCollector`,
which cannot be ended.)
"""

import gc

from PySide6.QtCore import QObject, QTimer, Slot

INTERVAL_MS = 500


class GuiCollector(QObject):
    """From `begin` to `end` collection is done by a timer of this object's thread, and by nobody else."""

    _begun = 0

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self._timer = QTimer(self, interval=INTERVAL_MS)
        self._timer.timeout.connect(self._collect)

    def begin(self) -> None:
        """Before there is another thread."""
        GuiCollector._begun += 1
        gc.disable()
        self._timer.start()

    def end(self) -> None:
        """When there is none any more."""
        self._timer.stop()
        GuiCollector._begun -= 1
        if not GuiCollector._begun:  # of several windows the last one
            gc.enable()

    @Slot()
    def _collect(self) -> None:
        """As far as the interpreter itself would: the old are looked at more rarely than the young."""
        full = [count > limit for count, limit in zip(gc.get_count(), gc.get_threshold(), strict=True)]
        if full[0]:
            gc.collect(2 if full[1] and full[2] else 1 if full[1] else 0)
