"""A jammed axis, in the window: found, stated where it is, and measured on; no more than four actions."""

import pytest
from pytestqt.qtbot import QtBot

from goniotwin.app.campaign.running.events import State
from goniotwin.app.desktop import MainWindow
from goniotwin.app.desktop.bench.position_entry import NO_ANGLE, PositionEntry
from goniotwin.app.desktop.events.question import QuestionBox
from goniotwin.app.rig import AXES
from tests.app.campaign.campaign_bench import QUIET
from tests.app.campaign.jam import ASK, AXIS, COUNTED_DEG, HOMES, JAMMED_DEG, check_undisturbed
from tests.app.desktop.conftest import READY_MS, WindowOpener, click, named_label, ready, wait_for_end
from tests.app.desktop.local_stations import LocalStations
from tests.app.desktop.test_events import answer, start_with_person, wait_for_question
from tests.conftest import Writer


def jam(stations: LocalStations, jammed: bool = True) -> None:
    """Jam the arc, or free it."""
    with stations.virtual.lock:
        stations.virtual.plant.shafts[AXIS].jam(stations.opened.rig.clock.now(), jammed)


def place_of(question: QuestionBox) -> PositionEntry:
    """Where the question states that the axis is."""
    entry = question.findChild(PositionEntry)
    assert entry is not None
    return entry


def jammed_question(qtbot: QtBot, window: MainWindow, stations: LocalStations) -> QuestionBox:
    """Run until the jammed axis is asked about."""
    start_with_person(window)
    wait_for_question(qtbot, window, "etalon")
    answer(window, "Mounted")
    wait_for_question(qtbot, window, "gaussian-5")
    jam(stations)
    answer(window, "Mounted")
    return wait_for_question(qtbot, window, "Position of beta unknown")


@pytest.mark.long
def test_a_jammed_axis_is_stated_by_its_encoder_and_the_values_are_those_of_an_undisturbed_rig(
    qtbot: QtBot, open_window: WindowOpener, stations: LocalStations, write_rig: Writer, write_schedule: Writer
) -> None:
    rig, schedule = write_rig(*QUIET), write_schedule(text=ASK)
    window = ready(qtbot, open_window(rig, schedule=schedule))
    question = jammed_question(qtbot, window, stations)
    entry = place_of(question)
    assert entry.field.text() == ""
    qtbot.waitUntil(lambda: "150.000°, 180.000°, 30.000°" in entry.place, timeout=READY_MS)
    assert list(question.buttons) == ["Set position", "Retry", "Skip row", "Pause", "Stop"]
    assert "Set position is an answer of its question" in window.presenter.permissions.refusals["set_position"]
    strip = [named_label(window.view.strip, f"{axis} position").text() for axis in AXES]
    assert [each for each in strip if "✗" in each] == ["β ✗ 150.00° | 180.00°"]
    jam(stations, False)

    click(question.buttons["Set position"])  # nothing is in the field: no answer
    assert NO_ANGLE in question.problem
    entry.field.setText("400")
    click(question.buttons["Set position"])
    qtbot.waitUntil(lambda: "soft limits" in question.problem and question.isVisible(), timeout=READY_MS)

    click(entry.take)
    click(question.buttons["Set position"])
    wait_for_end(qtbot, window, State.DONE)
    assert window.presenter.journal is not None
    check_undisturbed(window.presenter.journal, rig, schedule)
    rig_now = stations.opened.rig
    assert rig_now.axes[AXIS].position_deg() == pytest.approx(COUNTED_DEG, abs=0.001)
    assert stations.virtual.plant.angle_deg(AXIS, rig_now.clock.now()) == pytest.approx(COUNTED_DEG, abs=0.01)
    assert JAMMED_DEG != COUNTED_DEG


@pytest.mark.long
def test_a_jammed_axis_that_can_home_is_homed(
    qtbot: QtBot, open_window: WindowOpener, stations: LocalStations, write_rig: Writer, write_schedule: Writer
) -> None:
    rig, schedule = write_rig(*QUIET, *HOMES), write_schedule(text=ASK)
    window = ready(qtbot, open_window(rig, schedule=schedule))
    question = jammed_question(qtbot, window, stations)
    assert next(iter(question.buttons)) == "Home"
    jam(stations, False)
    click(question.buttons["Home"])
    wait_for_end(qtbot, window, State.DONE)
    assert window.presenter.journal is not None
    check_undisturbed(window.presenter.journal, rig, schedule)
