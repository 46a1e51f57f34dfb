"""Runs of a window, for tests: started, slowed down in the middle of a move, and counted in their journals."""

from pathlib import Path

from pytestqt.qtbot import QtBot

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.running.events import Positions, RowStarted
from goniotwin.app.desktop import MainWindow
from goniotwin.app.station.station import Station
from tests.app.desktop.conftest import READY_MS, click


def row_counts(window: MainWindow) -> tuple[int, int]:
    """The numbers of rows that the journal of a window has, and that its plan has."""
    assert window.presenter.journal is not None
    with Journal.open(window.presenter.journal) as journal:
        return journal.row_counts()


def slow_down(station: Station, speed: float, from_deg: float) -> None:
    """Slow a station down, by its own thread, when sigma has passed an angle: however late the window is, it still moves."""

    def listen(_number: int, message: object) -> None:
        if isinstance(message, RowStarted) and message.row.pose is not None:
            station.speed(1.0)
        if isinstance(message, Positions) and from_deg < message.degrees["sigma"] < 20.0:
            station.speed(speed)
            station.board.unsubscribe(listen)

    station.board.subscribe(listen)


def wait_for_journal(qtbot: QtBot, window: MainWindow) -> Path:
    """Start a run and wait for its journal."""
    click(window.view.run.start_button)
    qtbot.waitUntil(lambda: window.presenter.journal is not None, timeout=READY_MS)
    assert window.presenter.journal is not None
    return window.presenter.journal
