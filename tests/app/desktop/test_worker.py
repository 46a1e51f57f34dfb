"""Workers beside the window: one that is ended by another program is reported and replaced."""

import threading
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

import pytest
from PySide6.QtCore import QObject
from pytestqt.qtbot import QtBot

from goniotwin.app.desktop.model.worker import Deliver, Serve, Worker, WorkerEnded
from goniotwin.app.desktop.run import live_plot
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


Made = list[tuple[str, Deliver]]


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Made:
    """The workers that a plot has made, in their order: name, and what delivers their answers."""
    found: Made = []

    def make(name: str, serve: Serve, deliver: Deliver, *, process: bool = True) -> Worker:
        found.append((name, deliver))
        return Worker(name, serve, deliver, process=process)

    monkeypatch.setattr(live_plot, "Worker", make)
    return found


def threads() -> list[str]:
    """The threads of the plot's workers that are alive; no other plot has any now."""
    return sorted(each.name for each in threading.enumerate() if each.name.startswith(("values:", "predictions:")))


@pytest.fixture
def live(qtbot: QtBot, made: Made) -> Iterator[LivePlot]:
    parent = QObject()
    plot, hemisphere = ScanPlot(LIGHT), HemisphereMap(LIGHT)
    qtbot.addWidget(plot)
    qtbot.addWidget(hemisphere)
    live = LivePlot(plot, hemisphere, parent)
    assert [name for name, _ in made] == ["values", "predictions"]
    yield live
    live.stop()


def test_the_plot_reports_it_and_has_a_new_one(qtbot: QtBot, live: LivePlot, made: Made) -> None:
    missing: list[str] = []
    live.prediction_missing.connect(missing.append)
    before = threads()
    with qtbot.waitSignal(live.failed) as failed:
        for name, deliver in reversed(made):
            deliver(WorkerEnded(name))
    assert ENDED in failed.args[0]
    assert ENDED in missing[0]
    assert [name for name, _ in made] == ["values", "predictions", "predictions", "values"]
    assert threads() == before  # the ended ones are closed
    live.stop()
    assert threads() == []  # it was the new ones that were its workers


def test_a_worker_that_ended_before_the_window_is_not_replaced_after_it(qtbot: QtBot, live: LivePlot, made: Made) -> None:
    """The end of a session ends all processes at once: another worker's threads would keep the window's process for ever."""
    for name, deliver in made:
        deliver(WorkerEnded(name))  # queued, as from the threads of the workers
    live.stop()
    qtbot.wait(1)
    assert len(made) == 2
    assert threads() == []
