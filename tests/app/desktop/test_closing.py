"""The end of a window: by a person or a signal, during a run or while its station starts; and of its widgets."""

import gc
import signal
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from PySide6.QtCore import QTimer
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.campaign.running.events import State
from goniotwin.app.desktop import STOPPED, MainWindow, run_desktop
from goniotwin.app.desktop.close_question import CLOSE_WINDOW, KEEP_OPEN, STOP_AND_CLOSE
from goniotwin.app.desktop.dialogs import FileDialog
from goniotwin.app.desktop.rig.screen import RigScreen
from goniotwin.app.end_signals import END_SIGNALS
from goniotwin.drivers import Rig
from goniotwin.drivers.errors import NoAnswer
from tests.app.desktop.conftest import READY_MS, ROWS, WindowOpener, click, ready, wait_for_end
from tests.app.desktop.local_stations import LocalStations
from tests.app.desktop.run_bench import row_counts, wait_for_journal
from tests.conftest import RIG


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


@pytest.mark.long
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
        close_with(window, CLOSE_WINDOW)
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


def leave_cycles() -> None:
    """Create more reference cycles than the threshold of the collector, which would otherwise run here."""
    for _ in range(10 * gc.get_threshold()[0]):
        cycle: list[object] = []
        cycle.append(cycle)
