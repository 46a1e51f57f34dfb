"""A run in the window: to the end, paused, stopped; and the plot cannot disturb it."""

import gc
import os
import signal
import sqlite3
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PySide6.QtCore import Qt, QTimer
from PySide6.QtTest import QSignalSpy
from PySide6.QtWidgets import QApplication, QWidget
from pytestqt.qtbot import QtBot

from goniotwin.app.campaign.journal.following import JournalFollower
from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.running.events import Positions, RowCommitted, RowStarted, State
from goniotwin.app.campaign.running.question import Answer
from goniotwin.app.campaign.schedule.file import ScheduleDescription, read_schedule
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.desktop import STOPPED, MainWindow, run_desktop
from goniotwin.app.desktop.bench.screen import BenchScreen
from goniotwin.app.desktop.close_question import KEEP_MEASURING, KEEP_OPEN, STOP_AND_CLOSE
from goniotwin.app.desktop.dialogs import FileDialog
from goniotwin.app.desktop.events.event_log import EventLog
from goniotwin.app.desktop.model import connection, planner
from goniotwin.app.desktop.model.connection import StationProcesses
from goniotwin.app.desktop.model.live_scan import LiveScan, ScanData
from goniotwin.app.desktop.model.time_left import Wait
from goniotwin.app.desktop.rig.screen import RigScreen
from goniotwin.app.end_signals import END_SIGNALS
from goniotwin.app.rig import RigDescription
from goniotwin.app.station.connection_file import connection_folder
from goniotwin.app.station.messages import BUSY, RowSaved, SpeedChanged
from goniotwin.app.station.server import StationServer
from goniotwin.app.station.station import Station
from goniotwin.drivers import DeviceError, Rig, TmclAxis
from goniotwin.drivers.errors import NoAnswer
from tests.app.desktop.conftest import READY_MS, ROWS, WindowOpener, click, named_label, ready, wait_for_end
from tests.app.desktop.keyboard import press
from tests.app.desktop.local_stations import Host, LocalStations
from tests.conftest import RIG, SMALL, Writer


def row_counts(window: MainWindow) -> tuple[int, int]:
    assert window.presenter.journal is not None
    with Journal.open(window.presenter.journal) as journal:
        return journal.row_counts()


def test_a_run_measures_all_rows_into_the_journal(qtbot: QtBot, window: MainWindow, journals: Path) -> None:
    click(window.view.run.start_button)
    assert not window.view.run.start_button.isEnabled()
    assert not window.view.rig.open_button.isEnabled()
    assert not window.view.rig.person.isEnabled()
    wait_for_end(qtbot, window, State.DONE)
    assert not any("Question" in entry.what for entry in window.view.log.entries)  # the program mounts
    assert window.view.run.progress.value() == window.view.run.progress.maximum() == ROWS
    assert "100 %" in window.view.run.progress.text()
    assert list(journals.iterdir()) == [journals / "small-001.journal"]
    assert row_counts(window) == (ROWS, ROWS)
    assert window.view.plot_error == ""
    qtbot.waitUntil(lambda: "gaussian-5" in window.view.plot.title)
    assert "SIMULATED" in window.view.plot.title
    assert "measured" in window.view.plot.summary
    facts = window.view.screen_of(RigScreen).facts.facts()
    assert facts.monitor is not None
    assert facts.monitor.times_s  # of the run's rows: the lamp is known
    assert facts.monitor_age_s is not None
    window.view.show_screen(window.view.screens.index(window.view.screen_of(BenchScreen)))
    light = window.view.screen_of(BenchScreen).light
    assert light.sample.currentText() == "gaussian-5"
    assert light.gain.currentData() in (1e8, 1e10)


def test_flags_of_a_scan_are_one_event(window: MainWindow) -> None:
    rows = [
        Row(number, f"row {number}", "measure", "satin", pose=(0.0, 30.0, 180.0 * (number == 3), 0.0)) for number in range(4)
    ]
    log = EventLog(window.view.log, window)
    for row in rows:
        log.count_flags(RowSaved(row, ("under-range",) if row.number < 2 else (), row.number + 1, 4, 1.0))
    assert [(each.what, each.where) for each in window.view.log.entries if "flagged" in each.what] == [
        ("Rows flagged: under-range (2)", "satin σ 30° β 0°")
    ]


@pytest.mark.long
def test_findings_on_the_instrument_are_in_the_log_and_under_the_plot(
    qtbot: QtBot, open_window: WindowOpener, write_rig: Writer, write_schedule: Writer
) -> None:
    """Gains that the rig file does not state."""
    spread = write_rig(("[twin.light]", "[twin.electronics]\ngain_spread = 0.02\n\n[twin.light]"))
    more = write_schedule(("shift_deg = [0, 1]", "shift_deg = [0, 1, 2, 3, 4]"), ("[1e8, 1e10]", "[1e10, 1e11]"))
    window = ready(qtbot, open_window(spread, more))
    click(window.view.run.start_button)
    wait_for_end(qtbot, window, State.DONE)
    finding = "the gains are not those of the rig file"
    qtbot.waitUntil(lambda: any(each.serious and finding in each.what for each in window.view.log.entries), timeout=READY_MS)
    qtbot.waitUntil(lambda: finding in window.view.plot.summary, timeout=READY_MS)


@pytest.mark.long
def test_a_second_run_gets_a_journal_of_its_own(qtbot: QtBot, window: MainWindow, journals: Path) -> None:
    for _ in range(2):
        ready(qtbot, window)
        click(window.view.run.start_button)
        wait_for_end(qtbot, window, State.DONE)
    assert sorted(path.name for path in journals.iterdir()) == ["small-001.journal", "small-002.journal"]


def slow_down(station: Station, speed: float, from_deg: float) -> None:
    """Slow a station down, by its own thread, when sigma has passed an angle: however late the window is, it still moves."""

    def listen(_number: int, message: object) -> None:
        if isinstance(message, RowStarted) and message.row.pose is not None:
            station.speed(1.0)
        if isinstance(message, Positions) and from_deg < message.degrees["sigma"] < 20.0:
            station.speed(speed)
            station.board.unsubscribe(listen)

    station.board.subscribe(listen)


def test_the_positions_move_while_an_axis_does(qtbot: QtBot, open_window: WindowOpener, stations: LocalStations) -> None:
    """Each position is awaited before the next one: the station is fast again only when some of the way have been shown."""
    window = ready(qtbot, open_window(speed=20.0))
    slow_down(stations.station, 0.5, from_deg=1.0)
    seen: set[str] = set()
    window.presenter.message_shown.connect(lambda _message: seen.add(window.view.axes.position("sigma")))
    click(window.view.run.start_button)
    qtbot.waitUntil(lambda: len(seen - {"0.00°", "30.00°"}) >= 3, timeout=READY_MS)  # and two more: at the ends
    window.connection.set_speed(200.0)
    qtbot.waitUntil(lambda: window.view.axes.position("sigma") == "30.00°", timeout=READY_MS)


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


def test_axes_that_stop_responding_are_shown_and_no_run_can_start(
    qtbot: QtBot, window: MainWindow, monkeypatch: pytest.MonkeyPatch
) -> None:
    def silent(_axis: TmclAxis) -> float:
        raise NoAnswer("gamma", "GAP", "0 of 9 bytes")

    monkeypatch.setattr(TmclAxis, "position_deg", silent)
    qtbot.waitUntil(lambda: "✗ disconnected" in window.view.devices.text("axes"), timeout=READY_MS)
    assert window.view.axes.position("gamma") == "–"
    assert not window.view.run.start_button.isEnabled()
    assert window.view.run.stop_button.isEnabled()


def test_the_simulation_speed_can_be_changed_during_a_run(
    qtbot: QtBot, open_window: WindowOpener, monkeypatch: pytest.MonkeyPatch
) -> None:
    window = ready(qtbot, open_window(speed=1.0))
    speeds, presenter = window.view.run.speeds, window.presenter
    presenter.countdown.pace.begin(0.0, 2, 4.0)  # as after another run, whose rows take a second more than estimated
    for done in (1, 2):
        presenter.countdown.pace.add_row(3.0 * done, 2.0, 2 - done, 4.0 - 2.0 * done)

    def choose(speed: float) -> None:
        set_to = window.presenter.message_shown
        with qtbot.waitSignal(set_to, timeout=READY_MS, check_params_cb=lambda message: message == SpeedChanged(speed)):
            speeds.setCurrentIndex(speeds.findData(speed))

    assert not window.view.run.left.text().startswith(("about", "at least"))
    choose(10.0)
    assert window.view.run.left.text().startswith("about")
    choose(1.0)
    wait_for_journal(qtbot, window)
    presenter.countdown.show()
    before = presenter.countdown.wait.seconds
    shown: list[float] = []
    set_wait = window.view.run.set_wait

    def note(wait: Wait, texts: str) -> None:
        shown.append(wait.seconds)
        set_wait(wait, texts)

    monkeypatch.setattr(window.view.run, "set_wait", note)
    choose(60.0)  # no row is done in between
    assert shown[-1] < 0.5 * before
    assert "to wait" in window.view.run.left.text()
    assert " 0 s" not in window.view.run.left.text()
    wait_for_end(qtbot, window, State.DONE)


def test_the_desktop_ends_with_its_window(qapp: QApplication, tmp_path: Path, stations: LocalStations) -> None:
    timer = QTimer(interval=20)
    timer.timeout.connect(qapp.closeAllWindows)
    timer.start()
    assert run_desktop(RIG, None, tmp_path, 10.0, stations) == 0
    timer.stop()


@pytest.fixture
def handlers(qapp: QApplication) -> Iterator[None]:
    """Restore the handlers after a signal, which leaves its own. A desktop that does not end gets status 1."""
    before = {number: signal.getsignal(number) for number in END_SIGNALS}
    limit = QTimer(interval=READY_MS, singleShot=True)
    limit.timeout.connect(lambda: qapp.exit(1))
    limit.start()
    yield
    limit.stop()
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", END_SIGNALS)
@pytest.mark.usefixtures("heard_hangup", "handlers")
def test_a_signal_ends_the_desktop(qapp: QApplication, tmp_path: Path, stations: LocalStations, number: int) -> None:
    QTimer.singleShot(0, lambda: signal.raise_signal(number))
    assert run_desktop(RIG, None, tmp_path, stations=stations) == STOPPED
    assert [thread.name for thread in threading.enumerate() if thread.name in ("connection", "journal")] == []


@pytest.mark.usefixtures("handlers")
def test_after_a_signal_the_open_orders_are_the_last_lines(
    qapp: QApplication,
    tmp_path: Path,
    stations: LocalStations,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def step() -> None:
        for window in qapp.topLevelWidgets():
            if (
                isinstance(window, MainWindow)
                and window.isVisible()
                and hasattr(window, "presenter")
                and window.presenter.rig is not None
            ):
                window.connection.stop()
                if window.view.orders.orders:
                    timer.stop()
                    window.close()  # the question is answered with waiting
                    signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr(Rig, "stop", lambda _rig: [NoAnswer("sigma", "MST", "nothing")])
    timer = QTimer(interval=20)
    timer.timeout.connect(step)
    timer.start()
    assert run_desktop(RIG, None, tmp_path, stations=stations) == STOPPED
    *_, last = capsys.readouterr().err.splitlines()
    assert last.startswith("goniotwin: SAFETY: Cut the motors' power: the stop is not confirmed by sigma")


@pytest.mark.usefixtures("handlers")
def test_a_signal_before_the_event_loop_ends_the_desktop(
    qapp: QApplication, tmp_path: Path, stations: LocalStations, monkeypatch: pytest.MonkeyPatch
) -> None:
    show = MainWindow.show

    def interrupted(window: MainWindow) -> None:
        signal.raise_signal(signal.SIGINT)
        show(window)

    monkeypatch.setattr(MainWindow, "show", interrupted)
    assert run_desktop(RIG, None, tmp_path, stations=stations) == STOPPED


@pytest.mark.usefixtures("handlers")
def test_a_signal_while_a_file_is_chosen_ends_the_desktop(qapp: QApplication, tmp_path: Path, stations: LocalStations) -> None:

    def dialogs() -> list[FileDialog]:
        return [each for each in qapp.topLevelWidgets() if isinstance(each, FileDialog) and each.isVisible()]

    def press_open() -> None:
        for window in qapp.topLevelWidgets():
            if isinstance(window, MainWindow) and window.isVisible() and window.view.rig.open_button.isEnabled():
                window.view.rig.open_button.click()

    def check_dialog() -> None:
        if dialogs():
            timer.stop()
            signal.raise_signal(signal.SIGINT)
        else:
            QTimer.singleShot(0, press_open)

    timer = QTimer(interval=20)
    timer.timeout.connect(check_dialog)
    timer.start()
    assert run_desktop(RIG, None, tmp_path, stations=stations) == STOPPED
    assert dialogs() == []


def test_widgets_are_destroyed_in_the_windows_thread_alone(qtbot: QtBot, window: MainWindow) -> None:
    """Qt would crash; so garbage is collected in the window's thread while there is another thread."""
    collected_in: set[str] = set()

    def note(phase: str, _info: dict[str, int]) -> None:
        if phase == "start":
            collected_in.add(threading.current_thread().name)

    gc.callbacks.append(note)
    try:
        click(window.view.run.start_button)
        wait_for_end(qtbot, window, State.DONE)
        other = threading.Thread(target=leave_cycles)
        other.start()
        other.join()
        qtbot.waitUntil(lambda: bool(collected_in), timeout=READY_MS)
    finally:
        gc.callbacks.remove(note)
    assert collected_in == {threading.main_thread().name}
    window.shut_down()
    assert gc.isenabled()


@pytest.mark.long
def test_after_a_run_the_plot_has_the_highest_value_of_the_journal(
    qtbot: QtBot, open_window: WindowOpener, write_schedule: Writer, tmp_path: Path
) -> None:
    """With a certificate of 0.50; the rig file's is 0.99."""
    (tmp_path / "certificate.csv").write_text("radiance_factor,relative_uncertainty\n0.50,0.01\n", encoding="utf-8")
    table = '[certificate]\nfile = "certificate.csv"\nexpires = 2999-12-31\n'
    window = ready(qtbot, open_window(schedule=write_schedule(text=SMALL + table)))
    click(window.view.run.start_button)
    wait_for_end(qtbot, window, State.DONE)
    assert window.presenter.journal is not None
    with Journal.open(window.presenter.journal) as journal:
        points = reduce_journal(journal).samples["gaussian-5"]
    highest = float(np.max(points.bsdf[points.good]))
    qtbot.waitUntil(lambda: f"highest {highest:.3g} at" in window.view.plot.summary, timeout=READY_MS)
    assert window.view.plot.y_label == "BRDF, 1/sr"


@pytest.mark.parametrize(
    "broken",
    [pytest.param("drawing", marks=pytest.mark.long), pytest.param("reducing", marks=pytest.mark.long), "reading"],
)
def test_a_plot_that_fails_does_not_stop_the_run(
    qtbot: QtBot, window: MainWindow, monkeypatch: pytest.MonkeyPatch, broken: str
) -> None:
    def fail(*_: object) -> ScanData | None:
        raise ZeroDivisionError("no paint")

    if broken == "drawing":
        monkeypatch.setattr(window.view.plot, "show_cut", fail)
    elif broken == "reducing":
        monkeypatch.setattr(LiveScan, "add_row", fail)
    else:
        monkeypatch.setattr(JournalFollower, "new_rows", fail)
    click(window.view.run.start_button)
    wait_for_end(qtbot, window, State.DONE)
    assert row_counts(window) == (ROWS, ROWS)
    qtbot.waitUntil(lambda: "no paint" in window.view.plot_error, timeout=READY_MS)
    assert "the run is not affected" in window.view.plot_error


def test_an_exception_that_is_not_a_device_fault_is_shown_and_ends_the_run(
    qtbot: QtBot, window: MainWindow, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise sqlite3.OperationalError("database or disk is full")

    monkeypatch.setattr(Journal, "commit", full)
    click(window.view.run.start_button)
    wait_for_end(qtbot, window, State.FAILED)
    assert "disk is full" in window.view.status


def test_a_folder_that_cannot_be_created_is_shown_and_nothing_moves(qtbot: QtBot, window: MainWindow, journals: Path) -> None:
    journals.write_text("a file, not a folder", encoding="utf-8")
    click(window.view.run.start_button)
    qtbot.waitUntil(lambda: "Not started" in window.view.status, timeout=READY_MS)
    ready(qtbot, window)
    assert window.presenter.journal is None


def wait_for_journal(qtbot: QtBot, window: MainWindow) -> Path:
    """Start a run and wait for its journal."""
    click(window.view.run.start_button)
    qtbot.waitUntil(lambda: window.presenter.journal is not None, timeout=READY_MS)
    assert window.presenter.journal is not None
    return window.presenter.journal


def close_with(window: MainWindow, choice: str) -> None:
    """Close a window during a run, and give an answer to its question."""
    assert not window.close()
    assert window.close_question.box is not None
    window.close_question.box.buttons[choice].click()


def test_closing_during_a_run_asks_and_stops_the_run(qtbot: QtBot, open_window: WindowOpener) -> None:
    window = ready(qtbot, open_window(speed=1.0))
    journal = wait_for_journal(qtbot, window)
    close_with(window, KEEP_OPEN)
    assert window.isVisible()
    assert window.presenter.state is State.RUNNING
    close_with(window, STOP_AND_CLOSE)
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=READY_MS)
    assert [thread.name for thread in threading.enumerate() if thread.name in ("connection", "journal")] == []
    assert campaign_summary(journal).state == "stopped"
    assert campaign_summary(journal).rows < ROWS


@pytest.mark.long
@pytest.mark.parametrize("by", ["person", "signal"])
def test_the_run_goes_on_without_its_window_and_the_next_one_shows_it(
    qtbot: QtBot, open_window: WindowOpener, stations: LocalStations, by: str
) -> None:
    """The second window has what the first one had, and the values of all rows."""
    window = ready(qtbot, open_window(speed=20.0))
    journal = wait_for_journal(qtbot, window)
    qtbot.waitUntil(lambda: window.view.run.progress.value() >= 3, timeout=READY_MS)
    if by == "person":
        close_with(window, KEEP_MEASURING)
    else:
        assert not window.close()  # the question is answered with waiting
        window.close_unattended()
        assert window.close_question.box is None
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=READY_MS)
    assert stations.station.snapshot.busy
    record = stations.station.runs.record
    assert record is not None
    record.event("drift", "satin/drift: beyond the limit: +2 %")
    again = open_window(speed=1.0)
    qtbot.waitUntil(lambda: again.presenter.busy, timeout=READY_MS)
    known = again.view.screen_of(RigScreen).facts
    qtbot.waitUntil(lambda: known.facts().drift_beyond, timeout=READY_MS)  # from the journal, as what follows
    assert [each.what for each in again.view.log.entries].count("satin/drift: beyond the limit: +2 %") == 1
    assert known.facts().dark_age_s is not None
    assert again.presenter.journal == journal
    assert again.view.run.progress.value() >= 3
    assert again.view.run.speeds.currentData() == 20.0  # that of the station
    again.connection.set_speed(200.0)
    wait_for_end(qtbot, again, State.DONE)
    assert row_counts(again) == (ROWS, ROWS)
    assert len(stations.hosts) == 1
    qtbot.waitUntil(lambda: "gaussian-5" in again.view.plot.title, timeout=READY_MS)  # after the etalon
    qtbot.waitUntil(lambda: "measured" in again.view.plot.summary, timeout=READY_MS)


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


def test_of_two_openings_the_second_holds(
    qtbot: QtBot, open_window: WindowOpener, stations: LocalStations, write_rig: Writer
) -> None:
    stations.coming_up.clear()
    window = open_window(rig=RIG.with_name("none.toml"))
    window.files.rig_chosen.emit(rig := write_rig())
    stations.coming_up.set()
    ready(qtbot, window)
    assert [each.rig for each in stations.hosts] == [rig]
    assert not [each.what for each in window.view.log.entries if "none.toml" in each.what]


def test_a_window_is_gone_at_once_though_its_station_is_still_starting(
    open_window: WindowOpener, stations: LocalStations
) -> None:
    """The test would wait for ever; the station is never asked for anything."""
    stations.coming_up.clear()
    window = open_window()
    assert window.close()
    assert not window.isVisible()
    assert [thread.name for thread in threading.enumerate() if thread.name in ("connection", "journal")] == []
    assert stations.hosts == []


def test_a_window_without_a_station_shows_the_one_that_comes(
    qtbot: QtBot, open_window: WindowOpener, stations: LocalStations, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As after `goniotwin run --speed 1` in a terminal; nothing is started by the window."""
    monkeypatch.setattr(connection, "LOOK_S", 0.02)
    window = ready(qtbot, open_window())
    stations.hosts[0].kill()
    qtbot.waitUntil(lambda: "The station has ended" in window.view.notice.text, timeout=READY_MS)
    stations.hosts.append(Host(RIG, 60.0))
    ready(qtbot, window)
    assert window.view.notice.text == ""
    assert window.view.run.speeds.currentData() == 60.0
    assert len(stations.hosts) == 2


def test_a_look_for_stations_reads_no_file_while_the_folder_is_as_it_was(tmp_path: Path) -> None:
    stations = StationProcesses()
    folder = connection_folder()
    folder.mkdir(parents=True, exist_ok=True)
    os.utime(folder, (1.0, 1.0))
    assert [stations.changed() for _ in range(3)] == [True, False, False]
    (folder / "new.json").write_text("{}", encoding="utf-8")
    assert [stations.changed() for _ in range(3)] == [True, True, True]  # too new: another may come within the same tick
    os.utime(folder, (2.0, 2.0))
    assert [stations.changed() for _ in range(3)] == [True, False, False]


@pytest.mark.long
def test_two_windows_one_operates_both_can_stop(qtbot: QtBot, open_window: WindowOpener, stations: LocalStations) -> None:
    one = ready(qtbot, open_window(speed=2.0))
    two = open_window(speed=2.0)
    journal = wait_for_journal(qtbot, one)
    qtbot.waitUntil(lambda: "operates this rig" in two.view.notice.text, timeout=READY_MS)
    assert not two.view.run.pause_button.isEnabled()
    assert not two.view.rig.open_button.isEnabled()
    click(two.view.notice.button)
    qtbot.waitUntil(lambda: "operates this rig" in one.view.notice.text, timeout=READY_MS)
    qtbot.waitUntil(two.view.run.pause_button.isEnabled, timeout=READY_MS)
    assert not one.view.run.pause_button.isEnabled()
    assert one.view.run.stop_button.isEnabled()
    click(one.view.run.stop_button)
    for each in (one, two):
        wait_for_end(qtbot, each, State.IDLE)
        assert each.presenter.journal == journal
    assert len(stations.hosts) == 1


@pytest.mark.long
def test_a_watcher_sees_the_question_and_the_speed_and_changes_neither(
    qtbot: QtBot, open_window: WindowOpener, stations: LocalStations
) -> None:
    one, two = ready(qtbot, open_window()), open_window()
    click(one.view.rig.person)
    click(one.view.run.start_button)
    qtbot.waitUntil(lambda: two.question.box is not None and bool(two.presenter.permissions.watching), timeout=READY_MS)
    question = two.question.box
    assert question is not None
    assert not question.buttons["Mounted"].isEnabled()
    assert not two.view.run.speeds.isEnabled()
    asked = two.presenter.station.question
    assert asked is not None
    two.connection.answer(asked.number, Answer.MOUNTED)  # refused by the station as well
    question.hide()
    qtbot.waitUntil(lambda: "operates this rig" in two.view.status, timeout=READY_MS)
    assert two.question.box is question
    assert question.isVisible()
    assert "Mount" in two.view.question.text
    click(two.view.notice.button)
    qtbot.waitUntil(question.buttons["Mounted"].isEnabled, timeout=READY_MS)
    assert two.view.run.speeds.isEnabled()
    assert one.question.box is not None
    qtbot.waitUntil(lambda: not one.question.box.buttons["Mounted"].isEnabled(), timeout=READY_MS)  # type: ignore[union-attr]
    shown = one.question.box
    click(question.buttons["Mounted"])
    qtbot.waitUntil(lambda: one.question.box is not shown and two.question.box is not question, timeout=READY_MS)


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


@pytest.mark.long
def test_a_station_that_dies_is_reported_and_the_run_is_resumed_with_one_key(
    qtbot: QtBot, open_window: WindowOpener, stations: LocalStations
) -> None:
    window = ready(qtbot, open_window(speed=20.0))
    journal = wait_for_journal(qtbot, window)
    qtbot.waitUntil(lambda: window.view.run.progress.value() >= 3, timeout=READY_MS)
    stations.hosts[0].kill()
    qtbot.waitUntil(lambda: "has ended during the run" in window.view.notice.text, timeout=READY_MS)
    for text in ("rows are kept in small-001.journal", "heartbeat", "the shutter may be open"):
        assert text in window.view.notice.text
    assert "SIMULATED" in window.view.banner  # as long as its values are shown
    assert "SIMULATED" in window.view.plot.title
    assert window.view.run.left.text() == ""
    assert named_label(window.view.axes, "sigma target").text() == "–"
    assert not window.view.run.start_button.isEnabled()
    press("Ctrl+.")
    qtbot.waitUntil(lambda: "use the main switch" in window.view.status, timeout=READY_MS)
    before = campaign_summary(journal)
    assert 3 <= before.rows < ROWS
    click(window.view.notice.button)
    assert window.view.notice.text == ""
    assert window.view.status == "Starting a station …"
    wait_for_end(qtbot, window, State.DONE)
    assert window.view.notice.text == ""
    after = campaign_summary(journal)
    assert (after.rows, after.sessions, after.state) == (ROWS, 2, "done")
    qtbot.waitUntil(lambda: "measured" in window.view.plot.summary, timeout=READY_MS)


def test_a_station_that_dies_at_rest_is_connected_again(qtbot: QtBot, window: MainWindow, stations: LocalStations) -> None:
    stations.hosts[0].kill()
    qtbot.waitUntil(lambda: "The station has ended" in window.view.notice.text, timeout=READY_MS)
    click(window.view.notice.button)
    ready(qtbot, window)
    assert window.view.notice.text == ""
    assert len(stations.hosts) == 2


@pytest.mark.long
def test_a_rig_that_another_window_gives_back_is_no_emergency(
    qtbot: QtBot, open_window: WindowOpener, stations: LocalStations, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As by Connect again there: this window names the other one, and shows the next station."""
    one, two = open_window(), open_window()
    for each in (one, two):
        ready(qtbot, each)
    for command in ("operate", "disconnect"):
        two.connection.command(command)
    qtbot.waitUntil(lambda: "The rig is free" in one.view.notice.text, timeout=READY_MS)
    assert f"given back by {two.presenter.name}" in one.view.notice.text
    assert "✗" not in one.view.status
    assert not any(each.serious for each in one.view.log.entries)
    assert not one.view.run.stop_button.isEnabled()
    monkeypatch.setattr(connection, "LOOK_S", 0.02)
    stations.hosts.append(Host(RIG, 60.0))
    ready(qtbot, one)
    assert one.view.notice.text == ""


def test_a_schedule_that_takes_long_blocks_nothing(
    qtbot: QtBot, window: MainWindow, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The plan of the schedule that was opened last counts, and an error of another one goes at once."""
    small, go_on, made = window.presenter.plan, threading.Event(), []

    def make(schedule: ScheduleDescription, rig: RigDescription) -> Plan:
        if Path(schedule.name).name == "large.toml":
            go_on.wait(READY_MS / 1000.0)
        made.append(Path(schedule.name).name)
        return make_plan(schedule, rig)

    monkeypatch.setattr(planner, "make_plan", make)
    assert small is not None
    (tmp_path / "large.toml").write_text(small.schedule.text, encoding="utf-8")
    window.connection.load(tmp_path / "missing.toml")
    qtbot.waitUntil(lambda: "missing.toml" in window.view.status and "✗" in window.view.status, timeout=READY_MS)
    window.connection.load(tmp_path / "large.toml")
    qtbot.waitUntil(lambda: window.view.status == "Reading large.toml …", timeout=READY_MS)
    assert not window.view.run.start_button.isEnabled()
    window.connection.load(Path(small.schedule.name))
    ready(qtbot, window)
    go_on.set()
    qtbot.waitUntil(lambda: len(made) == 2, timeout=READY_MS)
    qtbot.wait(50)
    assert window.presenter.plan is not None
    assert window.presenter.plan.schedule.name == small.schedule.name


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


def leave_cycles() -> None:
    """Create more reference cycles than the threshold of the collector, which would otherwise run here."""
    for _ in range(10 * gc.get_threshold()[0]):
        cycle: list[object] = []
        cycle.append(cycle)
