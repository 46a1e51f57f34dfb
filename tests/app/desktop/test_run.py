"""A run in the window: it goes to its end, waits, stops, and nothing that is shown can disturb it."""

import gc
import signal
import sqlite3
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from PySide6.QtCore import Qt, QTimer
from PySide6.QtWidgets import QApplication, QFileDialog, QPushButton
from pytestqt.qtbot import QtBot

from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.running.events import Positions, RowCommitted, State
from goniotwin.app.campaign.running.operator import VirtualOperator
from goniotwin.app.desktop import STOPPED, MainWindow, run_desktop
from goniotwin.app.desktop.model import rig_thread as rigthread
from goniotwin.app.desktop.model.live_scan import Cut, LiveCut
from goniotwin.app.desktop.model.permissions import BUSY
from goniotwin.app.end_signals import END_SIGNALS
from goniotwin.app.rig import OpenRig, RigFile
from goniotwin.drivers import Axis, DeviceError, Rig
from goniotwin.drivers.errors import NoAnswer
from tests.app.desktop.conftest import READY_MS, WindowOpener, ready
from tests.conftest import RIG

ROWS = 10


def click(button: QPushButton) -> None:
    """As a person would: only what is enabled."""
    assert button.isEnabled()
    button.click()


def ended(qtbot: QtBot, window: MainWindow, state: State) -> None:
    """Waits until a run has ended, which must be so."""
    qtbot.waitUntil(lambda: window.session.state not in BUSY and "Saved in" in window.parts.saved, timeout=READY_MS)
    assert window.session.state is state, window.parts.status


def counted(window: MainWindow) -> tuple[int, int]:
    assert window.session.journal is not None
    with Journal.open(window.session.journal) as journal:
        return journal.row_counts()


def test_a_run_goes_to_its_end_and_all_of_it_is_in_the_journal(qtbot: QtBot, window: MainWindow, journals: Path) -> None:
    click(window.parts.run.start_button)
    assert not window.parts.run.start_button.isEnabled()
    assert not window.parts.rig.open_button.isEnabled()
    ended(qtbot, window, State.DONE)
    assert window.parts.run.progress.value() == window.parts.run.progress.maximum() == ROWS
    assert "100 %" in window.parts.run.progress.text()
    assert list(journals.iterdir()) == [journals / "small-001.journal"]
    assert counted(window) == (ROWS, ROWS)
    assert window.parts.trouble == ""
    qtbot.waitUntil(lambda: "gaussian-5" in window.parts.plot.title)
    assert "SIMULATED" in window.parts.plot.title
    assert "measured" in window.parts.plot.summary


def test_a_second_run_gets_a_journal_of_its_own(qtbot: QtBot, window: MainWindow, journals: Path) -> None:
    for _ in range(2):
        ready(qtbot, window)
        click(window.parts.run.start_button)
        ended(qtbot, window, State.DONE)
    assert sorted(path.name for path in journals.iterdir()) == ["small-001.journal", "small-002.journal"]


def test_the_positions_move_while_an_axis_does(qtbot: QtBot, open_window: WindowOpener) -> None:
    window = ready(qtbot, open_window(speed=20.0))
    seen: set[str] = set()
    window.session.heard.connect(lambda _message: seen.add(window.parts.axes.position("sigma")))
    click(window.parts.run.start_button)
    qtbot.waitUntil(lambda: window.parts.axes.position("sigma") == "30.00°", timeout=READY_MS)
    assert len(seen) >= 4  # more than where it began and where it ends


def test_pause_waits_and_resume_goes_on_without_a_row_twice(qtbot: QtBot, open_window: WindowOpener) -> None:
    window = ready(qtbot, open_window(speed=20.0))
    with qtbot.waitSignal(window.session.heard, timeout=READY_MS, check_params_cb=lambda m: isinstance(m, RowCommitted)):
        click(window.parts.run.start_button)
    qtbot.waitUntil(window.parts.run.pause_button.isEnabled)
    click(window.parts.run.pause_button)
    qtbot.waitUntil(lambda: window.session.state is State.PAUSED, timeout=READY_MS)
    assert "Paused" in window.parts.status
    assert window.parts.run.stop_button.isEnabled()
    done = counted(window)[0]
    assert 0 < done < ROWS
    window.rig_thread.set_speed(200.0)
    click(window.parts.run.pause_button)
    ended(qtbot, window, State.DONE)
    assert counted(window) == (ROWS, ROWS)
    assert window.session.journal is not None
    with sqlite3.connect(window.session.journal) as db:
        assert db.execute("SELECT MAX(attempt) FROM attempt").fetchone() == (1,)
    db.close()


def test_stop_in_the_middle_of_a_move_brings_the_axes_to_rest_and_loses_no_row(qtbot: QtBot, open_window: WindowOpener) -> None:
    window = ready(qtbot, open_window(speed=4.0))
    heard: list[RowCommitted] = []
    places: list[dict[str, float]] = []

    def listen(message: object) -> None:
        if isinstance(message, RowCommitted):
            heard.append(message)
        if isinstance(message, Positions):
            places.append(message.degrees)

    window.session.heard.connect(listen)
    click(window.parts.run.start_button)
    qtbot.waitUntil(lambda: bool(places) and 2.0 < places[-1]["sigma"] < 20.0, timeout=READY_MS)
    click(window.parts.run.stop_button)
    ended(qtbot, window, State.IDLE)
    assert "Stopped after 2 of 10 rows" in window.parts.status
    assert counted(window) == (len(heard), ROWS) == (2, ROWS)
    places.clear()
    # From 10 deg/s at 10 deg/s2 it rests within a second of the rig's time: before the second look that follows.
    qtbot.waitUntil(lambda: len(places) >= 3, timeout=READY_MS)
    assert places[-1] == places[-2]
    assert 2.0 < places[-1]["sigma"] < 29.0
    assert window.parts.run.start_button.isEnabled()


@pytest.mark.parametrize("key", [Qt.Key.Key_Escape, Qt.Key.Key_F12])
def test_stop_has_keys(qtbot: QtBot, open_window: WindowOpener, key: Qt.Key) -> None:
    window = ready(qtbot, open_window(speed=1.0))
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    click(window.parts.run.start_button)
    qtbot.waitUntil(lambda: window.session.journal is not None, timeout=READY_MS)
    qtbot.keyClick(window, key)  # type: ignore[no-untyped-call]
    ended(qtbot, window, State.IDLE)


def test_the_window_does_not_wait_for_a_stop_that_takes_long(
    qtbot: QtBot, open_window: WindowOpener, monkeypatch: pytest.MonkeyPatch
) -> None:
    window = ready(qtbot, open_window(speed=1.0))
    click(window.parts.run.start_button)
    qtbot.waitUntil(lambda: window.session.journal is not None, timeout=READY_MS)
    arrived, answered, stop = threading.Event(), threading.Event(), Rig.stop

    def slow(rig: Rig) -> list[DeviceError]:
        arrived.set()
        answered.wait(READY_MS / 1000.0)
        return stop(rig)

    monkeypatch.setattr(Rig, "stop", slow)
    click(window.parts.run.stop_button)
    qtbot.waitUntil(arrived.is_set)
    assert window.session.state in BUSY
    answered.set()
    ended(qtbot, window, State.IDLE)


def test_an_axis_that_could_not_be_told_to_stop_is_the_last_word(
    qtbot: QtBot, open_window: WindowOpener, monkeypatch: pytest.MonkeyPatch
) -> None:
    window = ready(qtbot, open_window(speed=1.0))
    click(window.parts.run.start_button)
    qtbot.waitUntil(lambda: window.session.journal is not None, timeout=READY_MS)
    monkeypatch.setattr(Rig, "stop", lambda _rig: [NoAnswer("sigma", "MST", "nothing")])
    click(window.parts.run.stop_button)
    ended(qtbot, window, State.IDLE)
    qtbot.waitUntil(lambda: "main switch" in window.parts.status, timeout=READY_MS)
    assert "sigma: MST: nothing" in window.parts.status


def test_axes_that_fall_silent_are_shown_so_and_nothing_can_be_started(
    qtbot: QtBot, window: MainWindow, monkeypatch: pytest.MonkeyPatch
) -> None:
    def silent(_axis: Axis) -> float:
        raise NoAnswer("gamma", "GAP", "0 of 9 bytes")

    monkeypatch.setattr(Axis, "position_deg", silent)
    qtbot.waitUntil(lambda: "does not answer" in window.parts.devices.text("axes"), timeout=READY_MS)
    assert window.parts.axes.position("gamma") == "–"
    assert not window.parts.run.start_button.isEnabled()
    assert window.parts.run.stop_button.isEnabled()


def test_the_pace_of_a_virtual_rig_can_be_chosen_while_it_runs(qtbot: QtBot, open_window: WindowOpener) -> None:
    window = ready(qtbot, open_window(speed=1.0))
    click(window.parts.run.start_button)
    speeds = window.parts.run.speeds
    speeds.setCurrentIndex(speeds.findData(60.0))
    assert "at 60×" in window.parts.run.left.text()
    ended(qtbot, window, State.DONE)


def test_the_desktop_ends_with_its_window(qapp: QApplication, tmp_path: Path) -> None:
    timer = QTimer(interval=20)
    timer.timeout.connect(qapp.closeAllWindows)
    timer.start()
    assert run_desktop(RIG, None, tmp_path, 10.0) == 0
    timer.stop()


@pytest.fixture
def handlers(qapp: QApplication) -> Iterator[None]:
    """A request to end leaves its handlers in place; they are restored. A desktop that does not end is ended, with status 1."""
    before = {number: signal.getsignal(number) for number in END_SIGNALS}
    patience = QTimer(interval=READY_MS, singleShot=True)
    patience.timeout.connect(lambda: qapp.exit(1))
    patience.start()
    yield
    patience.stop()
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", END_SIGNALS)
@pytest.mark.usefixtures("handlers")
def test_a_signal_ends_the_desktop(qapp: QApplication, tmp_path: Path, number: int) -> None:
    QTimer.singleShot(0, lambda: signal.raise_signal(number))
    assert run_desktop(RIG, None, tmp_path) == STOPPED
    assert [thread.name for thread in threading.enumerate() if thread.name in ("rig", "stop")] == []


@pytest.mark.usefixtures("handlers")
def test_a_signal_before_the_event_loop_ends_the_desktop(
    qapp: QApplication, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    show = MainWindow.show

    def interrupted(window: MainWindow) -> None:
        signal.raise_signal(signal.SIGINT)
        show(window)

    monkeypatch.setattr(MainWindow, "show", interrupted)
    assert run_desktop(RIG, None, tmp_path) == STOPPED


@pytest.mark.usefixtures("handlers")
def test_a_signal_while_a_file_is_chosen_ends_the_desktop(qapp: QApplication, tmp_path: Path) -> None:
    """A dialog for files has an event loop of its own inside the window's."""

    def press() -> None:
        for window in qapp.topLevelWidgets():
            if isinstance(window, MainWindow) and window.isVisible() and window.parts.rig.open_button.isEnabled():
                window.parts.rig.open_button.click()

    def look() -> None:
        if isinstance(qapp.activeModalWidget(), QFileDialog):
            timer.stop()
            signal.raise_signal(signal.SIGINT)
        else:
            QTimer.singleShot(0, press)

    timer = QTimer(interval=20)
    timer.timeout.connect(look)
    timer.start()
    assert run_desktop(RIG, None, tmp_path) == STOPPED
    assert qapp.activeModalWidget() is None


def test_widgets_are_never_destroyed_in_the_rigs_thread(qtbot: QtBot, window: MainWindow) -> None:
    """Qt crashes on it; so garbage is collected in the window's thread, for as long as there is another."""
    collected_in: set[str] = set()

    def note(phase: str, _info: dict[str, int]) -> None:
        if phase == "start":
            collected_in.add(threading.current_thread().name)

    gc.callbacks.append(note)
    try:
        click(window.parts.run.start_button)
        ended(qtbot, window, State.DONE)
        other = threading.Thread(target=leave_cycles)
        other.start()
        other.join()
        qtbot.waitUntil(lambda: bool(collected_in), timeout=READY_MS)
    finally:
        gc.callbacks.remove(note)
    assert collected_in == {threading.main_thread().name}
    window.shut_down()
    assert gc.isenabled()


@pytest.mark.parametrize("broken", ["drawing", "reducing"])
def test_a_plot_that_fails_does_not_stop_the_run(
    qtbot: QtBot, window: MainWindow, monkeypatch: pytest.MonkeyPatch, broken: str
) -> None:
    def fail(*_: object) -> Cut | None:
        raise ZeroDivisionError("no paint")

    if broken == "drawing":
        monkeypatch.setattr(window.parts.plot, "show_cut", fail)
    else:
        monkeypatch.setattr(LiveCut, "heed", fail)
    click(window.parts.run.start_button)
    ended(qtbot, window, State.DONE)
    assert counted(window) == (ROWS, ROWS)
    qtbot.waitUntil(lambda: "no paint" in window.parts.trouble, timeout=READY_MS)
    assert "the run is not affected" in window.parts.trouble


def test_a_fault_that_the_engine_does_not_know_is_told_and_ends_the_run(
    qtbot: QtBot, window: MainWindow, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise sqlite3.OperationalError("database or disk is full")

    monkeypatch.setattr(Journal, "commit", full)
    click(window.parts.run.start_button)
    ended(qtbot, window, State.FAILED)
    assert "disk is full" in window.parts.status


def test_a_folder_that_cannot_be_made_is_told_and_nothing_moves(qtbot: QtBot, window: MainWindow, journals: Path) -> None:
    journals.write_text("a file, not a folder", encoding="utf-8")
    click(window.parts.run.start_button)
    qtbot.waitUntil(lambda: "Not started" in window.parts.status, timeout=READY_MS)
    ready(qtbot, window)
    assert window.session.journal is None


def test_closing_during_a_run_asks_and_keeps_it_or_stops_it(qtbot: QtBot, open_window: WindowOpener) -> None:
    window = ready(qtbot, open_window(speed=1.0))
    click(window.parts.run.start_button)
    qtbot.waitUntil(lambda: window.session.journal is not None, timeout=READY_MS)
    assert not window.close()
    assert window.leaving is not None
    window.leaving.no_button.click()
    assert window.isVisible()
    assert window.session.state is State.RUNNING
    assert not window.close()
    assert window.leaving is not None
    window.leaving.yes_button.click()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=READY_MS)
    assert [thread.name for thread in threading.enumerate() if thread.name in ("rig", "stop")] == []
    assert window.session.journal is not None
    with Journal.open(window.session.journal) as journal:
        assert journal.row_counts()[0] < ROWS


def test_a_request_to_end_stops_the_run_and_asks_nothing(qtbot: QtBot, open_window: WindowOpener) -> None:
    window = ready(qtbot, open_window(speed=1.0))
    click(window.parts.run.start_button)
    qtbot.waitUntil(lambda: window.session.journal is not None, timeout=READY_MS)
    assert not window.close()
    asked = window.leaving
    assert asked is not None
    window.stop_and_close()
    assert window.leaving is None
    assert not asked.isVisible()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=READY_MS)
    assert window.session.journal is not None
    assert campaign_summary(window.session.journal).state == "stopped"


def test_a_request_to_end_closes_the_window_where_the_run_cannot_begin(
    qtbot: QtBot, window: MainWindow, journals: Path
) -> None:
    journals.write_text("a file, not a folder", encoding="utf-8")
    click(window.parts.run.start_button)
    assert window.session.busy
    window.stop_and_close()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=READY_MS)
    assert window.session.journal is None


def leave_cycles() -> None:
    """More than the collector lets pass: by itself it would begin here."""
    for _ in range(10 * gc.get_threshold()[0]):
        cycle: list[object] = []
        cycle.append(cycle)


class Helped:
    """A person, and the back door that does what the person says to have done."""

    def __init__(self, opened: OpenRig, _rig: RigFile, ask: rigthread.Ask) -> None:
        assert opened.virtual is not None
        self._door = VirtualOperator(opened.virtual)
        self._ask = ask

    def mount(self, sample: str) -> None:
        self._ask(f"Mount {sample!r}")
        self._door.mount(sample)


def test_a_person_is_asked_to_mount_and_the_run_waits(
    qtbot: QtBot, window: MainWindow, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rigthread, "operator_for", Helped)
    click(window.parts.run.start_button)
    for sample in ("etalon", "gaussian-5"):
        qtbot.waitUntil(lambda asked=sample: asks(window, asked), timeout=READY_MS)  # type: ignore[misc]
        assert window.parts.run.stop_button.isEnabled()
        assert window.mounting is not None
        window.mounting.yes_button.click()
    ended(qtbot, window, State.DONE)


def test_stop_ends_the_waiting_for_a_person(qtbot: QtBot, window: MainWindow, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rigthread, "operator_for", Helped)
    click(window.parts.run.start_button)
    qtbot.waitUntil(lambda: asks(window, "etalon"), timeout=READY_MS)
    click(window.parts.run.stop_button)
    ended(qtbot, window, State.IDLE)
    assert counted(window)[0] == 0
    assert window.mounting is None


def asks(window: MainWindow, sample: str) -> bool:
    return window.mounting is not None and sample in window.mounting.text()
