"""Rehearse beside Start: its verdict, its cancel, and the question of Start."""

import queue

import pytest
from PySide6.QtGui import QAction
from PySide6.QtWidgets import QTextBrowser
from pytestqt.qtbot import QtBot

from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.rehearsal.report import RehearsalPage
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.desktop import MainWindow
from goniotwin.app.desktop.dialogs import TextBox
from goniotwin.app.desktop.events.question import CANCEL
from goniotwin.app.desktop.model.rehearsal import RehearsalProgress, Rehearsals
from goniotwin.app.desktop.run.panel import CANCEL as CANCEL_REHEARSAL
from goniotwin.app.desktop.run.panel import REHEARSE
from goniotwin.app.desktop.run.rehearsal import START_ANYWAY
from goniotwin.app.rig import read_rig
from tests.app.desktop.conftest import READY_MS, WindowOpener, click, ready, wait_for_end
from tests.conftest import RIG, Writer

PROCESS_S = 120.0
"""Limit for a process that starts, and on a fresh machine compiles."""
FAINT = ("[1e8, 1e10]", "[1e8]")
"""A legal schedule: it runs to its end without a fault, with 20 of 30 values below the detection limit."""
BELOW = "gaussian-5: 20 of 30 directions are below the detection limit at 550 nm, sigma 30 deg. Add 1e11 V/A to gains_v_per_a"


@pytest.fixture
def faint(qtbot: QtBot, open_window: WindowOpener, write_schedule: Writer) -> MainWindow:
    return ready(qtbot, open_window(schedule=write_schedule(FAINT, name="faint.toml")))


def rehearse(qtbot: QtBot, window: MainWindow) -> None:
    """Press Rehearse and wait for the verdict."""
    click(window.view.run.rehearse_button)
    assert window.view.run.rehearse_button.text() == CANCEL_REHEARSAL
    assert window.view.run.progress.format().startswith("Rehearsal: ")
    qtbot.waitUntil(lambda: not window.rehearsal.rehearsing, timeout=READY_MS)


def test_a_schedule_that_misses_most_of_its_directions_starts_after_a_yes_only(qtbot: QtBot, faint: MainWindow) -> None:
    rehearse(qtbot, faint)
    found = faint.rehearsal.rehearsed
    assert found is not None
    assert [each.startswith(BELOW) for each in found.missed] == [True]
    assert faint.view.status.startswith(f"✗ Rehearsed small: {BELOW}")
    assert faint.view.run.rehearse_button.text() == REHEARSE
    assert "rows" in faint.view.run.progress.format()
    (box,) = faint.findChildren(TextBox)
    shown = box.findChild(QTextBrowser)
    assert shown is not None
    page = shown.toPlainText()
    for words in (BELOW, "20 of 30 values are below the detection limit", "0 values are saturated", "1e+0 to 1e-1"):
        assert words in page
    box.close()

    click(faint.view.run.start_button)
    question = faint.rehearsal.question
    assert question is not None
    assert BELOW in question.text
    click(question.buttons[CANCEL])
    assert faint.presenter.state is State.IDLE
    click(faint.view.run.start_button)
    assert faint.rehearsal.question is not None
    click(faint.rehearsal.question.buttons[START_ANYWAY])
    wait_for_end(qtbot, faint, State.DONE)


def test_the_verdict_is_of_the_schedule_that_was_rehearsed(qtbot: QtBot, faint: MainWindow, write_schedule: Writer) -> None:
    rehearse(qtbot, faint)
    faint.files.schedule_chosen.emit(write_schedule(("readings = 2", "readings = 3"), name="other.toml"))
    qtbot.waitUntil(
        lambda: faint.presenter.plan is not None and "other" in faint.presenter.plan.schedule.name, timeout=READY_MS
    )
    ready(qtbot, faint)
    assert faint.rehearsal.rehearsed is None
    click(faint.view.run.start_button)
    assert faint.rehearsal.question is None
    wait_for_end(qtbot, faint, State.DONE)


def test_a_rehearsal_is_cancelled_by_its_button_by_start_and_by_another_schedule(
    qtbot: QtBot, window: MainWindow, write_schedule: Writer
) -> None:
    run = window.view.run
    click(run.rehearse_button)
    click(run.rehearse_button)
    assert window.view.status == "The rehearsal is cancelled."
    assert run.rehearse_button.text() == REHEARSE
    click(run.rehearse_button)
    window.files.schedule_chosen.emit(write_schedule(FAINT, name="faint.toml"))
    qtbot.waitUntil(lambda: not window.rehearsal.rehearsing, timeout=READY_MS)
    ready(qtbot, window)
    click(run.rehearse_button)
    click(run.start_button)
    assert not window.rehearsal.rehearsing
    assert not run.rehearse_button.isEnabled()
    assert "a run is" in run.rehearse_button.toolTip()
    wait_for_end(qtbot, window, State.DONE)
    assert window.rehearsal.rehearsed is None


def test_a_small_window_rehearses_by_its_menu(qtbot: QtBot, window: MainWindow) -> None:
    window.resize(640, 400)
    assert window.view.run.rehearse_button.isHidden()
    (action,) = [each for each in window.menuBar().findChildren(QAction) if "hearse" in each.text()]
    action.trigger()
    assert action.text() == "Cancel re&hearsal"
    action.trigger()
    assert action.text() == "Re&hearse"


@pytest.mark.long
def test_a_worker_rehearses_in_a_process_of_its_own_and_leaves_nothing(write_schedule: Writer) -> None:
    answers: queue.SimpleQueue[object] = queue.SimpleQueue()
    rehearsals = Rehearsals(answers.put)
    plan = make_plan(read_schedule(write_schedule(FAINT)), read_rig(RIG))
    rehearsals.rehearse(plan)
    assert rehearsals.is_of(plan)
    found = [answers.get(timeout=PROCESS_S)]
    while isinstance(found[-1], tuple) and isinstance(found[-1][1], RehearsalProgress):
        found.append(answers.get(timeout=PROCESS_S))
    rehearsals.end()
    assert isinstance(found[-1], tuple)
    number, answer = found[-1]
    assert number == 1
    assert isinstance(answer, RehearsalPage), answer
    assert answer.summary.startswith(f"Rehearsed small: {BELOW}")
    assert len(found) > 1  # with its progress
