"""The end of a run: a summary with what may come next; and the interrupted campaign that a window offers at its start."""

from pathlib import Path

from pytestqt.qtbot import QtBot

from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.rehearsal.conclusion import conclude
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.desktop import MainWindow
from goniotwin.app.desktop.results.screen import ResultsScreen
from goniotwin.app.desktop.run.conclusion import NEXT, RESULTS
from goniotwin.app.desktop.setup.screen import SetupScreen
from goniotwin.app.rig import read_rig
from tests.app.desktop.conftest import READY_MS, ROWS, WindowOpener, click, ready, wait_for_end
from tests.app.desktop.test_campaigns import killed
from tests.conftest import RIG, Writer


def measured(qtbot: QtBot, window: MainWindow) -> Path:
    """Run to the end, and wait for the summary."""
    click(window.view.run.start_button)
    wait_for_end(qtbot, window, State.DONE)
    qtbot.waitUntil(lambda: window.conclusion.box is not None, timeout=READY_MS)
    assert window.presenter.journal is not None
    return window.presenter.journal


def test_a_run_ends_with_a_summary_that_leads_to_its_results(qtbot: QtBot, window: MainWindow) -> None:
    journal = measured(qtbot, window)
    box = window.conclusion.box
    assert box is not None
    assert not box.isModal()
    lines = conclude(journal).lines
    assert lines[0].startswith("gaussian-5: ")
    assert " of 36 values are above the detection limit. The largest component is " in lines[0]
    assert "directions are below the detection limit at 550 nm, sigma 30 deg. Add 1e11 V/A to gains_v_per_a" in lines[-1]
    assert all(each in box.text for each in lines)
    click(box.buttons[RESULTS])
    assert window.conclusion.box is None
    assert isinstance(window.view.screens[window.view.shown_screen], ResultsScreen)


def test_a_summary_that_comes_after_the_next_start_is_not_shown(qtbot: QtBot, window: MainWindow) -> None:
    journal = measured(qtbot, window)
    control = window.conclusion
    control.begin(journal)
    number = control._conclusions.number
    control.end()  # as the next run begins
    control._answered.emit((number, conclude(journal)))
    qtbot.wait(50)
    assert control.box is None


def test_the_next_sample_has_a_copy_of_the_schedule(qtbot: QtBot, window: MainWindow) -> None:
    measured(qtbot, window)
    box, setup = window.conclusion.box, window.view.screen_of(SetupScreen)
    assert box is not None
    text = setup.text
    click(box.buttons[NEXT])
    assert window.view.screens[window.view.shown_screen] is setup
    assert setup.unsaved
    assert setup.text == text
    assert not window.view.run.start_button.isEnabled()
    assert "Enter the next sample" in window.view.status


def test_an_interrupted_campaign_of_another_schedule_is_offered_by_name_and_rows(
    qtbot: QtBot, open_window: WindowOpener, write_schedule: Writer, journals: Path
) -> None:
    other = write_schedule(('name = "small"', 'name = "paint2"'), name="other.toml")
    killed(make_plan(read_schedule(other), read_rig(RIG)), journals / "paint2-001.journal", 4)
    window = ready(qtbot, open_window())
    notice = window.view.notice
    qtbot.waitUntil(lambda: notice.action == "continue", timeout=READY_MS)
    assert notice.text == f"Interrupted: paint2, 4 of {ROWS} rows. Resume?"
    assert window.view.run.start_button.isEnabled()
    click(notice.button)
    wait_for_end(qtbot, window, State.DONE)
    assert window.presenter.journal == journals / "paint2-001.journal"
    assert notice.action == ""
