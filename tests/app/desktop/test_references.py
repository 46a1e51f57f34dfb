"""Repaints and signals of the window lose no references.

PySide6 6.12.0 on Python 3.11 loses references to None: after some hundred rows none is left, and the interpreter aborts.
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
from goniotwin.app.desktop.model.live_scan import ScanData, ScanPoints
from goniotwin.app.desktop.model.run_points import match
from goniotwin.app.desktop.run.live_plot import ScanPlot
from goniotwin.app.desktop.theme import LIGHT

NEW_SCAN_EVERY = 10
MOST_LOST = 0.1
"""References per repaint."""
RESERVE = 1_000_000
"""References that the test holds, so that a loss fails the test and does not abort the interpreter."""


class PaintCounter(QObject):
    """Counts how often a widget is painted."""

    count = 0

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Count an event; Qt calls it."""
        self.count += event.type() is QEvent.Type.Paint
        return super().eventFilter(watched, event)


def scan_data(points: int) -> ScanData:
    x = np.arange(float(points))
    no_marks, at = np.zeros(x.size, dtype=np.uint16), np.zeros((points, 4))
    scan = ScanPoints(x, x + 1.0, 0.1 * (x + 1.0), x == 3.0, x == 3.0, x == 1.0, x == 2.0, x < 0.0, no_marks, at)
    return ScanData("a scan", "x", "y", (-90.0, 90.0), ((2.5, 3.5),), scan)


def reference_counts() -> tuple[int, int]:
    """References to None and to True, without those of unreachable objects."""
    gc.collect()
    return sys.getrefcount(None), sys.getrefcount(True)


@pytest.mark.skipif(sys.version_info >= (3, 12), reason="None and True are immortal: their references are not counted")
@pytest.mark.parametrize("repaints", [pytest.param(50, id="50"), pytest.param(2000, id="2000", marks=pytest.mark.long)])
def test_repaints_and_signals_lose_no_references(qtbot: QtBot, qapp: QApplication, window: MainWindow, repaints: int) -> None:
    """The plot is a separate small one, which repaints faster; the signals are those of a hidden window."""
    held: list[object] = [None, True] * RESERVE
    window.hide()
    plot = ScanPlot(LIGHT)
    qtbot.addWidget(plot)
    plot.resize(240, 180)
    plot.show()
    shown = plot.findChild(pg.GraphicsView)
    assert shown is not None
    view = shown.viewport()
    paints = PaintCounter()
    view.installEventFilter(paints)
    plot.show_cut(match(scan_data(2), None))
    view.repaint()
    before = reference_counts()
    for k in range(repaints):
        if k % NEW_SCAN_EVERY == 0:
            plot.show_cut(match(scan_data(2 + k % 7), None))
        view.repaint()
        window.presenter.message_received.emit(Positions({"sigma": float(k)}))
        qapp.processEvents()
    lost = [then - now for then, now in zip(before, reference_counts(), strict=True)]
    assert len(held) == 2 * RESERVE
    assert paints.count > repaints
    assert max(lost) < MOST_LOST * repaints, f"{lost[0]} of None, {lost[1]} of True"
