"""Workers beside the window: one that is ended by another program is reported and replaced."""

import threading
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

import pytest
from PySide6.QtCore import QObject
from pytestqt.qtbot import QtBot

from goniotwin.app.desktop.model.worker import Worker, WorkerEnded
from goniotwin.app.desktop.run.hemisphere import HemisphereMap
from goniotwin.app.desktop.run.live_plot import ENDED, LivePlot, ScanPlot
from goniotwin.app.desktop.theme import LIGHT


def end_at_the_first_request(connection: "Connection[Any, Any]") -> None:
    """A worker that ends by itself."""
    connection.recv()


def test_a_worker_that_is_ended_is_reported(qtbot: QtBot) -> None:
    delivered: list[object] = []
    worker = Worker("values", end_at_the_first_request, delivered.append, process=False)
    worker.put("request")
    qtbot.waitUntil(lambda: delivered == [WorkerEnded("values")])
    worker.close()
    assert delivered == [WorkerEnded("values")]


@pytest.fixture
def live(qtbot: QtBot) -> Iterator[LivePlot]:
    parent = QObject()
    plot, hemisphere = ScanPlot(LIGHT), HemisphereMap(LIGHT)
    qtbot.addWidget(plot)
    qtbot.addWidget(hemisphere)
    made = LivePlot(plot, hemisphere, parent)
    yield made
    made.stop()


def test_the_plot_reports_it_and_has_a_new_one(qtbot: QtBot, live: LivePlot) -> None:
    missing: list[str] = []
    live.prediction_missing.connect(missing.append)
    before = live._values, live._predictions
    with qtbot.waitSignal(live.failed) as failed:
        live._answered.emit(WorkerEnded("predictions"))
        live._answered.emit(WorkerEnded("values"))
    assert ENDED in failed.args[0]
    assert ENDED in missing[0]
    assert live._values is not before[0]
    assert live._predictions is not before[1]


def test_a_worker_that_ended_before_the_window_is_not_replaced_after_it(qtbot: QtBot, live: LivePlot) -> None:
    """The end of a session ends all processes at once: another worker's threads would keep the window's process for ever."""
    before = live._values, live._predictions
    threads = threading.active_count()
    live._answered.emit(WorkerEnded("values"))  # queued, as from the threads of the workers
    live._answered.emit(WorkerEnded("predictions"))
    live.stop()
    qtbot.wait(1)
    assert (live._values, live._predictions) == before
    assert threading.active_count() < threads
