"""A run in the window: to the end, at any speed, or failed; and the plot cannot disturb it."""

import sqlite3
import threading
from pathlib import Path

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from goniotwin.app.campaign.journal.following import JournalFollower
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.schedule.file import ScheduleDescription
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.desktop import MainWindow
from goniotwin.app.desktop.bench.screen import BenchScreen
from goniotwin.app.desktop.events.event_log import EventLog
from goniotwin.app.desktop.model import planner
from goniotwin.app.desktop.model.live_scan import LiveScan, ScanData
from goniotwin.app.desktop.model.time_left import Wait
from goniotwin.app.desktop.rig.screen import RigScreen
from goniotwin.app.rig import RigDescription
from goniotwin.app.station.messages import RowSaved, SpeedChanged
from goniotwin.drivers import TmclAxis
from goniotwin.drivers.errors import NoAnswer
from tests.app.desktop.conftest import READY_MS, ROWS, WindowOpener, click, ready, wait_for_end
from tests.app.desktop.local_stations import LocalStations
from tests.app.desktop.run_bench import row_counts, slow_down, wait_for_journal
from tests.conftest import SMALL, Writer


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


@pytest.mark.long
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
