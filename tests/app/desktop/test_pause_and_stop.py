"""Pause and Stop in the window: in the middle of a run, and before its start or the rig's opening is done."""

import sqlite3
import threading
from pathlib import Path

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QSignalSpy
from PySide6.QtWidgets import QWidget
from pytestqt.qtbot import QtBot

from goniotwin.app.campaign.running.events import Positions, RowCommitted, State
from goniotwin.app.campaign.schedule.file import ScheduleDescription, read_schedule
from goniotwin.app.desktop import MainWindow
from goniotwin.app.desktop.model import connection
from goniotwin.app.station.messages import BUSY
from goniotwin.app.station.server import StationServer
from goniotwin.drivers import DeviceError, Rig
from tests.app.desktop.conftest import READY_MS, ROWS, WindowOpener, click, ready, wait_for_end
from tests.app.desktop.keyboard import press
from tests.app.desktop.local_stations import LocalStations
from tests.app.desktop.run_bench import row_counts, slow_down, wait_for_journal


def test_pause_waits_and_resume_measures_no_row_twice(qtbot: QtBot, open_window: WindowOpener) -> None:
    window = ready(qtbot, open_window(speed=20.0))
    with qtbot.waitSignal(
        window.presenter.message_shown, timeout=READY_MS, check_params_cb=lambda m: isinstance(m, RowCommitted)
    ):
        click(window.view.run.start_button)
    qtbot.waitUntil(window.view.run.pause_button.isEnabled)
    click(window.view.run.pause_button)
    qtbot.waitUntil(lambda: window.presenter.state is State.PAUSED, timeout=READY_MS)
    assert "Paused" in window.view.status
    assert window.view.run.stop_button.isEnabled()
    done = row_counts(window)[0]
    assert 0 < done < ROWS
    window.connection.set_speed(200.0)
    click(window.view.run.pause_button)
    wait_for_end(qtbot, window, State.DONE)
    assert row_counts(window) == (ROWS, ROWS)
    assert window.presenter.journal is not None
    with sqlite3.connect(window.presenter.journal) as db:
        assert db.execute("SELECT MAX(attempt) FROM attempt").fetchone() == (1,)
    db.close()


def test_stop_in_the_middle_of_a_move_brings_the_axes_to_rest_and_loses_no_row(
    qtbot: QtBot, open_window: WindowOpener, stations: LocalStations
) -> None:
    window = ready(qtbot, open_window(speed=20.0))
    slow_down(stations.station, 0.1, from_deg=2.0)
    committed: list[RowCommitted] = []
    positions: list[dict[str, float]] = []

    def listen(message: object) -> None:
        if isinstance(message, RowCommitted):
            committed.append(message)
        if isinstance(message, Positions):
            positions.append(message.degrees)

    window.presenter.message_shown.connect(listen)
    click(window.view.run.start_button)
    qtbot.waitUntil(lambda: bool(positions) and 2.0 < positions[-1]["sigma"] < 20.0, timeout=READY_MS)
    click(window.view.run.stop_button)
    window.connection.set_speed(4.0)  # taken after the stop
    wait_for_end(qtbot, window, State.IDLE)
    assert "Stopped after 2 of 10 rows" in window.view.status
    assert row_counts(window) == (len(committed), ROWS) == (2, ROWS)
    positions.clear()
    # From 10 deg/s at 10 deg/s2 it rests within 1 s of simulated time: before the second reading from now.
    qtbot.waitUntil(lambda: len(positions) >= 3, timeout=READY_MS)
    assert positions[-1] == positions[-2]
    assert 2.0 < positions[-1]["sigma"] < 29.0
    assert window.view.run.start_button.isEnabled()


def test_the_window_does_not_wait_for_a_stop_that_takes_long(
    qtbot: QtBot, open_window: WindowOpener, monkeypatch: pytest.MonkeyPatch
) -> None:
    window = ready(qtbot, open_window(speed=1.0))
    click(window.view.run.start_button)
    qtbot.waitUntil(lambda: window.presenter.journal is not None, timeout=READY_MS)
    arrived, answered, stop = threading.Event(), threading.Event(), Rig.stop

    def slow(rig: Rig) -> list[DeviceError]:
        arrived.set()
        answered.wait(READY_MS / 1000.0)
        return stop(rig)

    monkeypatch.setattr(Rig, "stop", slow)
    click(window.view.run.stop_button)
    qtbot.waitUntil(arrived.is_set)
    assert window.presenter.state in BUSY
    answered.set()
    wait_for_end(qtbot, window, State.IDLE)


def hold_start(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """The event before which no start is sent: the connection reads the schedule."""
    go_on = threading.Event()

    def wait_and_read(path: Path) -> ScheduleDescription:
        go_on.wait(READY_MS / 1000.0)
        return read_schedule(path)

    monkeypatch.setattr(connection, "read_schedule", wait_and_read)
    return go_on


@pytest.mark.parametrize("command", ["pause", "stop"])
def test_what_is_pressed_right_after_start_is_not_lost(
    qtbot: QtBot, open_window: WindowOpener, journals: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    """The start has not even been sent."""
    window = ready(qtbot, open_window(speed=20.0))
    busy = hold_start(monkeypatch)
    click(window.view.run.start_button)
    click(window.view.run.pause_button if command == "pause" else window.view.run.stop_button)
    busy.set()
    if command == "pause":
        qtbot.waitUntil(lambda: window.presenter.state is State.PAUSED, timeout=READY_MS)
        assert row_counts(window) == (0, ROWS)
        click(window.view.run.stop_button)
        wait_for_end(qtbot, window, State.IDLE)
    else:
        qtbot.waitUntil(lambda: any("stopped before" in each.what for each in window.view.log.entries), timeout=READY_MS)
        assert window.presenter.state is State.IDLE
        assert not journals.exists()


def test_a_stop_right_after_the_letter_of_start(qtbot: QtBot, window: MainWindow, journals: Path) -> None:
    """Qt clicks a button 0.1 s after its letter: that is after the stop."""
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    clicked = QSignalSpy(window.view.run.start_button.clicked)
    press("Alt+S", "Ctrl+.")
    qtbot.wait(250)
    assert clicked.count() == 0
    assert not journals.exists()
    press("Alt+S")
    qtbot.waitUntil(lambda: clicked.count() == 1, timeout=READY_MS)


@pytest.mark.long
def test_a_stop_of_another_window_cancels_a_start_that_waits(
    qtbot: QtBot, open_window: WindowOpener, journals: Path, stations: LocalStations, monkeypatch: pytest.MonkeyPatch
) -> None:
    window, other = ready(qtbot, open_window(speed=20.0)), open_window()
    busy = hold_start(monkeypatch)
    click(window.view.run.start_button)
    qtbot.waitUntil(other.view.run.stop_button.isEnabled, timeout=READY_MS)
    click(other.view.run.stop_button)
    qtbot.waitUntil(lambda: stations.station.snapshot.stops == 1, timeout=READY_MS)
    busy.set()
    qtbot.waitUntil(lambda: any("stopped before" in each.what for each in window.view.log.entries), timeout=READY_MS)
    assert window.presenter.state is State.IDLE
    assert not journals.exists()


@pytest.mark.parametrize("resumes", [False, True])
def test_a_stop_cancels_an_opening_and_the_resume_that_waits_for_it(
    qtbot: QtBot, open_window: WindowOpener, stations: LocalStations, journals: Path, resumes: bool
) -> None:
    stations.coming_up.clear()
    window = open_window()
    if resumes:
        window.connection.resume_journal(journals / "none.journal")
    window.connection.stop()
    qtbot.waitUntil(lambda: any("stopped before the rig" in each.what for each in window.view.log.entries), timeout=READY_MS)
    if resumes:
        qtbot.waitUntil(lambda: any("stopped before the st" in each.what for each in window.view.log.entries), timeout=READY_MS)
    assert stations.hosts == []
    stations.coming_up.set()
    click(window.view.rig.again_button)
    ready(qtbot, window)


def test_the_status_keeps_the_question_and_the_pause_key_takes_its_pause_back(qtbot: QtBot, open_window: WindowOpener) -> None:
    window = ready(qtbot, open_window())
    click(window.view.rig.person)
    click(window.view.run.start_button)
    qtbot.waitUntil(lambda: window.question.box is not None, timeout=READY_MS)
    seen: list[State] = []
    window.presenter.message_shown.connect(lambda _message: seen.append(window.presenter.station.state))
    for _ in range(2):
        click(window.view.run.pause_button)
    qtbot.waitUntil(lambda: State.PAUSING in seen and seen[-1] is State.RUNNING, timeout=READY_MS)
    assert window.view.status.startswith("Waiting for the operator: Mount")
    click(window.view.run.finish_button)
    assert window.view.status.startswith("Waiting for the operator: Mount")
    assert window.view.status.endswith("The run ends after this cut.")
    press("Ctrl+Q")  # the focus is in the question
    closing = window.close_question.box
    assert closing is not None
    assert all(each.accessibleName() for each in closing.findChildren(QWidget) if each.focusPolicy() & Qt.FocusPolicy.TabFocus)
    closing.activateWindow()
    qtbot.waitUntil(closing.isActiveWindow)
    press("Esc")
    qtbot.waitUntil(lambda: window.close_question.box is None)
    assert window.isVisible()
    press("Ctrl+Q", "Ctrl+Q")
    assert not window.isVisible()


def test_a_stop_that_does_not_get_through_names_the_main_switch(
    qtbot: QtBot, open_window: WindowOpener, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The station receives nothing: as a process that is frozen."""
    window = ready(qtbot, open_window(speed=1.0))
    wait_for_journal(qtbot, window)
    monkeypatch.setattr(StationServer, "_obey", lambda *_: None)
    press("Ctrl+.")
    assert window.view.status == "Stop sent to all axes."
    qtbot.waitUntil(lambda: "use the main switch" in window.view.status, timeout=READY_MS)
