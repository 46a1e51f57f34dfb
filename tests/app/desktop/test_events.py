"""What must not be missed: the log of events, safety orders, questions; and no key ends a run by accident."""

import os
import sqlite3
import threading

import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QApplication, QPushButton, QWidget
from pytestqt.qtbot import QtBot

from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.row import SKIPPED
from goniotwin.app.campaign.running.events import State, StateChanged
from goniotwin.app.campaign.running.stop import StopRequest
from goniotwin.app.desktop import MainWindow
from goniotwin.app.desktop.close_question import ACKNOWLEDGE, KEEP_OPEN, STOP_AND_CLOSE
from goniotwin.app.desktop.events.panels import MAX_ENTRIES, EventModel, LogEntry
from goniotwin.app.desktop.events.question import QuestionBox
from goniotwin.app.desktop.theme import LIGHT
from goniotwin.app.guardian.guard import RigGuard
from goniotwin.app.rig.left import left_unsafe
from goniotwin.app.station.messages import BUSY
from goniotwin.drivers import DeviceError, Rig, TmclAxis
from goniotwin.drivers.errors import NoAnswer
from goniotwin.drivers.guard import LastWill
from goniotwin.drivers.monochromator import Monochromator
from goniotwin.protocols.clock import RealClock
from tests.app.desktop.conftest import READY_MS, ROWS, WindowOpener, click, ready, wait_for_end
from tests.app.desktop.local_stations import LocalStations
from tests.conftest import SMALL, Writer

ASK = '\n[faults]\nwire = "ask"\n'
ACCIDENTS = (Qt.Key.Key_Return, Qt.Key.Key_Enter, Qt.Key.Key_Space)


def journal_events(window: MainWindow) -> list[tuple[str, str]]:
    """Kinds and texts of the events in the journal, read while the program may write."""
    assert window.presenter.journal is not None
    db = sqlite3.connect(window.presenter.journal)
    found = db.execute("SELECT kind, text FROM event WHERE session = 1 ORDER BY id").fetchall()
    db.close()
    return found


MODULE = "Photodiodes module 2 (ADAM-6017) is not responding"


def wait_for_question(qtbot: QtBot, window: MainWindow, text: str) -> QuestionBox:
    """Wait for a question with this text in it; return its box."""

    def asked() -> bool:  # one that is answered is there, hidden, until the station has closed it
        return window.question.box is not None and window.question.box.isVisible() and text in window.question.box.text

    qtbot.waitUntil(asked, timeout=READY_MS)
    assert window.question.box is not None
    return window.question.box


def answer(window: MainWindow, label: str) -> None:
    """Give an answer to the open question."""
    assert window.question.box is not None
    click(window.question.box.buttons[label])


def break_photodiodes(stations: LocalStations, *, broken: bool = True) -> None:
    """Let the third module of the photodiodes answer to another address, so that the driver gets no reply."""
    stations.virtual.modbus["adc-2"].units = (9,) if broken else (1,)


def button_of(shown: QWidget) -> QPushButton:
    """The button of a line at the top of the window."""
    button = shown.findChild(QPushButton)
    assert button is not None
    return button


def acknowledge(window: MainWindow) -> None:
    """Acknowledge the safety order."""
    click(button_of(window.view.orders))


def start_with_person(window: MainWindow) -> None:
    click(window.view.rig.person)
    click(window.view.run.start_button)


@pytest.fixture
def asking(qtbot: QtBot, open_window: WindowOpener, write_schedule: Writer) -> MainWindow:
    """A window whose schedule asks the operator about faults; a run has started, with a person as the operator."""
    window = ready(qtbot, open_window(schedule=write_schedule(text=SMALL + ASK)))
    start_with_person(window)
    return window


def test_a_safety_order_stays_until_it_is_acknowledged(
    qtbot: QtBot, open_window: WindowOpener, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next readings of the positions fail, and their message follows that of the stop within 0.2 s."""

    def silent(_axis: TmclAxis) -> float:
        raise NoAnswer("gamma", "GAP", "0 of 9 bytes")

    window = ready(qtbot, open_window(speed=1.0))
    click(window.view.run.start_button)
    qtbot.waitUntil(lambda: window.presenter.journal is not None, timeout=READY_MS)
    monkeypatch.setattr(Rig, "stop", lambda _rig: [NoAnswer("sigma", "MST", "nothing")])
    click(window.view.run.stop_button)
    wait_for_end(qtbot, window, State.IDLE)
    monkeypatch.setattr(TmclAxis, "position_deg", silent)
    qtbot.waitUntil(lambda: "Axis gamma (TMCM-6214) is not responding" in window.view.status, timeout=READY_MS)
    (order,) = window.view.orders.orders
    assert order.order == "Cut the motors' power"
    assert order.reason == "the stop is not confirmed by sigma"
    assert window.view.orders.isVisible()
    assert window.windowTitle().startswith("SAFETY ORDER")
    texts = [entry.what for entry in window.view.log.entries if entry.serious]
    assert any(text.startswith("Axis gamma (TMCM-6214) is not responding") for text in texts)
    assert any("Cut the motors' power" in text for text in texts)

    acknowledge(window)
    assert window.view.orders.isHidden()
    assert not window.windowTitle().startswith("SAFETY ORDER")
    qtbot.waitUntil(lambda: ("acknowledged", order.text) in journal_events(window), timeout=READY_MS)
    assert ("order", order.text) in journal_events(window)
    qtbot.waitUntil(lambda: not list(window.presenter.journal.parent.glob("*-wal")))  # type: ignore[union-attr]


def test_an_order_is_acknowledged_during_a_run(qtbot: QtBot, asking: MainWindow, monkeypatch: pytest.MonkeyPatch) -> None:
    """The shutter cannot be closed while the operator is asked about a fault."""

    def stuck(_monochromator: Monochromator, *, opened: bool) -> None:
        raise NoAnswer("monochromator", "SHUTTER", f"no reply, {opened}")

    wait_for_question(qtbot, asking, "etalon")
    with monkeypatch.context() as patch:
        answer(asking, "Mounted")
        wait_for_question(qtbot, asking, "gaussian-5")
        patch.setattr(Monochromator, "start_shutter", stuck)
        answer(asking, "Mounted")
        wait_for_question(qtbot, asking, "Monochromator (Cornerstone 260) is not responding")
        (order,) = asking.view.orders.orders
        assert order.order == "Close the shutter by hand"
        acknowledge(asking)
        qtbot.waitUntil(lambda: ("acknowledged", order.text) in journal_events(asking), timeout=READY_MS)
    assert asking.presenter.busy
    answer(asking, "Retry")
    wait_for_end(qtbot, asking, State.DONE)


def test_a_window_shows_at_its_start_what_a_program_that_died_has_left_until_it_is_acknowledged(
    qtbot: QtBot, open_window: WindowOpener
) -> None:
    """Of any rig of this computer; this one has no shutter open."""
    guard = RigGuard("the other rig")
    guard.device("left", "socket://127.0.0.1:1").arm(
        LastWill("monochromator", 9600, b"", b"", b"", "C", "the shutter may be open", "Close the shutter by hand", "closed")
    )
    guard.close()
    window = ready(qtbot, open_window())
    (order,) = window.view.orders.orders
    assert order.order == "Close the shutter by hand"
    assert f"process {os.getpid()} (the other rig) ended without making sure" in order.reason
    acknowledge(window)
    qtbot.waitUntil(lambda: left_unsafe() == [], timeout=READY_MS)
    assert window.view.orders.orders == []


def test_an_order_without_a_run_is_in_the_window_only(
    qtbot: QtBot, window: MainWindow, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(_rig: Rig) -> list[DeviceError]:
        return [NoAnswer("monochromator", "ABORT", "nothing")]

    monkeypatch.setattr(Rig, "stop", failing)
    click(window.view.run.stop_button)
    qtbot.waitUntil(lambda: any(entry.detail == "ABORT: nothing" for entry in window.view.log.entries), timeout=READY_MS)
    assert window.view.orders.orders == []  # a grating that turns on is no danger
    monkeypatch.setattr(Rig, "stop", lambda _rig: [NoAnswer("beta", "MST", "nothing")])
    click(window.view.run.stop_button)
    qtbot.waitUntil(lambda: len(window.view.orders.orders) == 1, timeout=READY_MS)
    acknowledge(window)
    assert any(entry.what.startswith("Acknowledged") for entry in window.view.log.entries)


def refuse_to_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let no stop be confirmed from here on."""
    monkeypatch.setattr(Rig, "stop", lambda _rig: [NoAnswer("sigma", "MST", "nothing")])


def wait_for_close_question(qtbot: QtBot, window: MainWindow, text: str) -> QuestionBox:
    """Wait for a question about closing the window with this text in it; return its box."""
    qtbot.waitUntil(lambda: window.close_question.box is not None and text in window.close_question.box.text, timeout=READY_MS)
    assert window.close_question.box is not None
    return window.close_question.box


def run_that_cannot_stop(qtbot: QtBot, open_window: WindowOpener, monkeypatch: pytest.MonkeyPatch) -> MainWindow:
    """A window with a run in progress, whose stop gives a safety order."""
    window = ready(qtbot, open_window(speed=1.0))
    click(window.view.run.start_button)
    qtbot.waitUntil(lambda: window.presenter.journal is not None, timeout=READY_MS)
    refuse_to_stop(monkeypatch)
    return window


def test_a_person_closes_the_window_only_after_acknowledging_the_order(
    qtbot: QtBot, open_window: WindowOpener, monkeypatch: pytest.MonkeyPatch
) -> None:
    window = run_that_cannot_stop(qtbot, open_window, monkeypatch)
    window.close()
    click(wait_for_close_question(qtbot, window, "A run is in progress").buttons[STOP_AND_CLOSE])
    box = wait_for_close_question(qtbot, window, "Cut the motors' power")
    assert "the stop is not confirmed by sigma" in box.text
    assert not window.presenter.busy
    assert window.isVisible()
    assert len(window.view.orders.orders) == 1
    for key in ACCIDENTS:
        press(qtbot, box.focusWidget(), key)
        assert window.close_question.box is None  # Keep open
        assert not window.close()
        box = wait_for_close_question(qtbot, window, "Cut the motors' power")
    assert [kind for kind, _ in journal_events(window) if kind in ("order", "acknowledged")] == ["order"]
    click(box.buttons[ACKNOWLEDGE])
    assert not window.isVisible()
    assert window.connection.open_orders == []
    assert [kind for kind, _ in journal_events(window) if kind in ("order", "acknowledged")] == ["order", "acknowledged"]


def test_a_close_without_a_run_waits_for_every_order(qtbot: QtBot, window: MainWindow, monkeypatch: pytest.MonkeyPatch) -> None:
    """One order is acknowledged at the top of the window, the other in the question."""
    refuse_to_stop(monkeypatch)
    click(window.view.run.stop_button)
    qtbot.waitUntil(lambda: len(window.view.orders.orders) == 1, timeout=READY_MS)
    monkeypatch.setattr(Rig, "stop", lambda _rig: [NoAnswer("beta", "MST", "nothing")])
    click(window.view.run.stop_button)
    qtbot.waitUntil(lambda: len(window.view.orders.orders) == 2, timeout=READY_MS)
    assert not window.close()
    wait_for_close_question(qtbot, window, "confirmed by sigma")
    acknowledge(window)
    box = wait_for_close_question(qtbot, window, "confirmed by beta")
    click(box.buttons[KEEP_OPEN])
    assert window.isVisible()
    assert not window.close()
    click(wait_for_close_question(qtbot, window, "confirmed by beta").buttons[ACKNOWLEDGE])
    assert not window.isVisible()


def test_a_signal_closes_the_window_and_leaves_the_order_open(
    qtbot: QtBot, open_window: WindowOpener, monkeypatch: pytest.MonkeyPatch
) -> None:
    window = run_that_cannot_stop(qtbot, open_window, monkeypatch)
    click(window.view.run.stop_button)
    wait_for_end(qtbot, window, State.IDLE)
    window.close_unattended()
    qtbot.waitUntil(lambda: not window.isVisible(), timeout=READY_MS)
    (order,) = window.connection.open_orders
    assert window.presenter.journal is not None
    assert campaign_summary(window.presenter.journal).orders == [order.text]


def test_a_run_ends_after_its_stop(
    qtbot: QtBot, open_window: WindowOpener, stations: LocalStations, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The stop of a person fails after the engine has ended with a stop of its own that is confirmed."""
    window = ready(qtbot, open_window(speed=1.0))
    click(window.view.run.start_button)
    qtbot.waitUntil(lambda: window.presenter.journal is not None, timeout=READY_MS)
    engine = stations.station.runs.engine
    assert engine is not None
    ended: list[int] = []
    window.presenter.run_ended.connect(lambda: ended.append(len(window.view.orders.orders)))
    clock = RealClock()

    def stop(_rig: Rig) -> list[DeviceError]:
        if threading.current_thread().name == "engine":
            return []
        while engine.state is not State.IDLE:
            clock.sleep_until(clock.now() + 0.01)
        clock.sleep_until(clock.now() + 0.2)  # if nothing waits for this, the journal is closed by now
        return [NoAnswer("sigma", "MST", "nothing")]

    def request(_stop: StopRequest) -> list[DeviceError]:
        _stop.requested = True
        return stop(stations.opened.rig)

    monkeypatch.setattr(Rig, "stop", stop)
    monkeypatch.setattr(StopRequest, "stop", request)
    click(window.view.run.stop_button)
    wait_for_end(qtbot, window, State.IDLE)
    assert ended == [1]
    assert "order" in [kind for kind, _ in journal_events(window)]


def test_each_answer_to_a_fault(qtbot: QtBot, asking: MainWindow, stations: LocalStations) -> None:
    """Retry asks again as long as the fault is there, Skip row goes to the next one, Pause waits for Resume."""
    wait_for_question(qtbot, asking, "etalon")
    answer(asking, "Mounted")
    box = wait_for_question(qtbot, asking, "gaussian-5")
    assert list(box.buttons) == ["Mounted", "Wait", "Stop"]
    break_photodiodes(stations)
    answer(asking, "Mounted")
    first = wait_for_question(qtbot, asking, MODULE)
    assert list(first.buttons) == ["Retry", "Skip row", "Pause", "Stop"]
    assert "Device fault" in first.windowTitle()
    title, row, *_ = first.text.split(": ")
    answer(asking, "Retry")
    again = wait_for_question(qtbot, asking, MODULE)
    assert again.text.startswith(f"{title}: {row}: ")
    answer(asking, "Skip row")
    following = wait_for_question(qtbot, asking, MODULE)
    assert not following.text.startswith(f"{title}: {row}: ")
    answer(asking, "Pause")
    qtbot.waitUntil(lambda: asking.presenter.state is State.PAUSED, timeout=READY_MS)
    assert asking.view.question.text == ""
    break_photodiodes(stations, broken=False)
    click(asking.view.run.pause_button)
    wait_for_end(qtbot, asking, State.DONE)
    assert asking.presenter.journal is not None
    with Journal.open(asking.presenter.journal) as journal:
        flags = [each.data.flags for each in journal.rows() if each.data.flags]
    assert flags == [(SKIPPED,)]
    answers = [text.split(" (at ")[0] for kind, text in journal_events(asking) if kind == "answer"]
    assert answers == ["Retry", "Skip row", "Pause"]
    log = asking.view.log.entries
    faults = [entry for entry in log if MODULE in entry.what and entry.consequence]
    assert len(faults) == 3
    assert all(entry.serious and entry.where and entry.consequence == "ask the operator" for entry in faults)
    assert LogEntry("Run ended: done after 9 of 10 rows", asking.presenter.journal.name, "measured rows are saved") in log


@pytest.mark.parametrize("question", ["etalon", MODULE])
def test_stop_ends_the_wait_for_an_answer(qtbot: QtBot, asking: MainWindow, stations: LocalStations, question: str) -> None:
    """For one question with its own button, for the other with that of the window."""
    wait_for_question(qtbot, asking, "etalon")
    if question == "etalon":
        answer(asking, "Stop")
    else:
        break_photodiodes(stations)
        answer(asking, "Mounted")
        wait_for_question(qtbot, asking, question)
        answer(asking, "Retry")
        wait_for_question(qtbot, asking, question)
        click(asking.view.run.stop_button)
    wait_for_end(qtbot, asking, State.IDLE)
    assert asking.view.run.start_button.isEnabled() == (
        question == "etalon"
    )  # photodiodes that were lost are no longer "ready"
    assert asking.question.box is None
    assert asking.view.question.text == ""
    assert "Stopped after" in asking.view.status
    assert asking.view.run.left.text() == ""  # the next Start begins at the first row
    assert any(entry.what == "Shutter closed after the stop" for entry in asking.view.log.entries) == (question != "etalon")


def test_a_question_can_wait_and_no_key_answers_it_by_accident(
    qtbot: QtBot, asking: MainWindow, stations: LocalStations, open_window: WindowOpener
) -> None:
    mount = wait_for_question(qtbot, asking, "etalon")
    for key in ACCIDENTS:
        press(qtbot, mount.focusWidget(), key)
        assert not mount.isVisible()  # Wait
        assert "Mount etalon" in asking.view.question.text
        click(button_of(asking.view.question))
        assert mount.isVisible()
    mount.close()
    assert asking.question.box is mount
    asking.presenter.countdown.show()
    assert "mount gaussian-5" in asking.view.run.left.text()  # the next one, not that which waits
    with qtbot.waitSignal(asking.presenter.message_shown, check_params_cb=lambda m: m == StateChanged(State.PAUSING)):
        click(asking.view.run.pause_button)
    waiting = "Waiting for the operator: Mount etalon."
    assert asking.view.status.startswith(waiting)
    later = open_window()
    qtbot.waitUntil(lambda: later.view.status.startswith(waiting), timeout=READY_MS)
    later.presenter.countdown.show()
    assert "mount gaussian-5" in later.view.run.left.text() or not later.presenter.countdown.mountings
    asking.connection.resume()
    assert [each.text() for each in tab_order(mount) if isinstance(each, QPushButton)] == ["&Mounted", "Wait"]
    break_photodiodes(stations)
    answer(asking, "Mounted")
    fault = wait_for_question(qtbot, asking, MODULE)
    for key in ACCIDENTS:
        press(qtbot, fault.focusWidget(), key)
    assert fault.isVisible()
    assert asking.question.box is fault
    assert [each.text() for each in tab_order(fault) if isinstance(each, QPushButton)] == ["Retry", "Skip row", "Pause"]
    assert asking.presenter.busy


def press(qtbot: QtBot, widget: QWidget | None, key: Qt.Key) -> None:
    """Press and release a key in a widget."""
    assert widget is not None
    qtbot.keyClick(widget, key)


def tab_order(window: QWidget) -> list[QWidget]:
    """The widgets of a window that Tab reaches."""
    found: list[QWidget] = []
    each = window.nextInFocusChain()
    while each is not None and each is not window:
        if each.focusPolicy() & Qt.FocusPolicy.TabFocus and each.window() is window:
            found.append(each)
        each = each.nextInFocusChain()
    return found


def test_enter_and_space_never_stop_a_run(qtbot: QtBot, open_window: WindowOpener) -> None:
    """Start is pressed by Space; then it is disabled, and the focus goes elsewhere."""
    window = ready(qtbot, open_window(speed=1.0))
    assert window.view.run.stop_button not in tab_order(window)
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    window.view.run.start_button.setFocus()
    press(qtbot, window.view.run.start_button, Qt.Key.Key_Space)
    qtbot.waitUntil(lambda: window.presenter.journal is not None, timeout=READY_MS)
    for key in ACCIDENTS * 2:
        press(qtbot, QApplication.focusWidget(), key)
    assert window.presenter.state in BUSY
    assert window.presenter.state is not State.STOPPING


def test_esc_has_to_be_held(qtbot: QtBot, open_window: WindowOpener) -> None:
    """Released in time it stops nothing, in the window or in a question, which it closes; held it does, wherever focus is."""
    window = ready(qtbot, open_window(speed=1.0))
    run = window.view.run
    run.hold.rule.hold_ms = READY_MS
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    start_with_person(window)
    box = wait_for_question(qtbot, window, "etalon")
    for widget in (window, box, window.view.log.findChild(QWidget, "events")):
        assert widget is not None
        widget.window().activateWindow()
        qtbot.waitUntil(widget.window().isActiveWindow)
        qtbot.keyPress(widget, Qt.Key.Key_Escape)
        assert run.stop_button.isDown()
        qtbot.keyRelease(widget, Qt.Key.Key_Escape)
        qtbot.waitUntil(lambda: not run.stop_button.isDown())
        assert box.isVisible() == (widget is window)
    assert window.question.box is box
    assert window.presenter.state is State.RUNNING
    run.hold.rule.hold_ms = 1
    qtbot.keyPress(box, Qt.Key.Key_Escape)
    wait_for_end(qtbot, window, State.IDLE)


def test_a_key_stops_at_once(qtbot: QtBot, open_window: WindowOpener) -> None:
    window = ready(qtbot, open_window(speed=1.0))
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    click(window.view.run.start_button)
    qtbot.waitUntil(lambda: window.presenter.journal is not None, timeout=READY_MS)
    qtbot.keyClick(window, Qt.Key.Key_Period, Qt.KeyboardModifier.ControlModifier)
    wait_for_end(qtbot, window, State.IDLE)
    assert window.presenter.journal is not None
    with Journal.open(window.presenter.journal) as journal:
        assert journal.row_counts()[0] < ROWS


def test_the_log_has_the_latest_first_and_is_bounded(window: MainWindow) -> None:
    log = EventModel(window, LIGHT)
    for k in range(MAX_ENTRIES + 5):
        log.add(LogEntry(f"event {k}", serious=k == MAX_ENTRIES + 4))
    assert len(log.entries) == log.rowCount() == MAX_ENTRIES
    assert log.entries[0] == LogEntry(f"event {MAX_ENTRIES + 4}", serious=True)
    assert log.entries[-1] == LogEntry("event 5")
