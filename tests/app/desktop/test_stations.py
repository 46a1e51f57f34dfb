"""Windows and the stations that they show: one that comes, one that dies, and one with two windows."""

import os
from pathlib import Path

import pytest
from pytestqt.qtbot import QtBot

from goniotwin.app import log_file
from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.running.question import Answer
from goniotwin.app.desktop import MainWindow
from goniotwin.app.desktop.model.connection import StationProcesses
from goniotwin.app.station.connection_file import connection_folder
from tests.app.desktop.conftest import READY_MS, ROWS, WindowOpener, click, named_label, ready, wait_for_end
from tests.app.desktop.keyboard import press
from tests.app.desktop.local_stations import Host, LocalStations
from tests.app.desktop.run_bench import wait_for_journal
from tests.conftest import RIG, Writer


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


def test_a_window_without_a_station_shows_the_one_that_comes(
    qtbot: QtBot, open_window: WindowOpener, stations: LocalStations
) -> None:
    """As after `goniotwin run --speed 1` in a terminal; nothing is started by the window."""
    stations.look_s = 0.02
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
    qtbot: QtBot, open_window: WindowOpener, stations: LocalStations
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
    stations.look_s = 0.02
    stations.hosts.append(Host(RIG, 60.0))
    ready(qtbot, one)
    assert one.view.notice.text == ""


def test_the_windows_log_has_what_its_station_says(
    qtbot: QtBot, open_window: WindowOpener, stations: LocalStations, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(log_file, "log_folder", lambda: tmp_path / "log")
    with log_file.own_log("window"):
        window = ready(qtbot, open_window())
        stations.hosts[0].kill()
        qtbot.waitUntil(lambda: "The station has ended" in window.view.notice.text, timeout=READY_MS)
    text = (tmp_path / "log" / "window.log").read_text(encoding="utf-8")
    assert text.index("attached to the station of") < text.index("the connection to the station has ended unexpectedly")
    assert "monitor: connected: Thorlabs,PM100D" in text
