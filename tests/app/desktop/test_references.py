"""What the window draws and hears gives back no reference that it does not own.

PySide6 6.12.0 does on Python 3.11: after some hundred rows there is no None any more, and the interpreter aborts.
"""

import gc
import sys

import numpy as np
import pyqtgraph as pg
import pytest
from PySide6.QtCore import QEvent, QObject
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from goniotwin.app.campaign.running.events import Positions
from goniotwin.app.desktop import MainWindow
from goniotwin.app.desktop.model.live_scan import Cut, Points
from goniotwin.app.desktop.run.scan_plot import CutPlot
from goniotwin.app.desktop.theme import LIGHT

REPAINTS = 2000
NEW_CUT_EVERY = 10
MOST_LOST = 200
RESERVE = 1_000_000
"""References that the test holds, so that a loss fails it and does not end the interpreter."""


class Paints(QObject):
    """Counts how often a widget is painted."""

    count = 0

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Qt's name for it."""
        self.count += event.type() is QEvent.Type.Paint
        return super().eventFilter(watched, event)


def cut_of(points: int) -> Cut:
    x = np.arange(float(points))
    return Cut("a cut", "x", "y", (-90.0, 90.0), ((2.5, 3.5),), Points(x, x + 1.0, 0.1 * (x + 1.0), x == 3.0))


def counted() -> tuple[int, int]:
    """References to None and to True, without those of unreachable objects."""
    gc.collect()
    return sys.getrefcount(None), sys.getrefcount(True)


@pytest.mark.skipif(sys.version_info >= (3, 12), reason="None and True are immortal: their references are not counted")
def test_repaints_and_signals_lose_no_references(qtbot: QtBot, qapp: QApplication, window: MainWindow) -> None:
    """The plot is a small one of its own, which is painted faster; the signals are those of a window that is not painted."""
    held: list[object] = [None, True] * RESERVE
    window.hide()
    plot = CutPlot(LIGHT)
    qtbot.addWidget(plot)
    plot.resize(240, 180)
    plot.show()
    shown = plot.findChild(pg.PlotWidget)
    assert shown is not None
    view = shown.viewport()
    paints = Paints()
    view.installEventFilter(paints)
    plot.show_cut(cut_of(2))
    view.repaint()
    before = counted()
    for k in range(REPAINTS):
        if k % NEW_CUT_EVERY == 0:
            plot.show_cut(cut_of(2 + k % 7))
        view.repaint()
        window.session.told.emit(Positions({"sigma": float(k)}))
        qapp.processEvents()
    lost = [then - now for then, now in zip(before, counted(), strict=True)]
    assert len(held) == 2 * RESERVE
    assert paints.count > REPAINTS
    assert max(lost) < MOST_LOST, f"{lost[0]} of None, {lost[1]} of True"
