"""The tolerances screen: a study is shown, computed beside the window, cancelled, and its result shown and saved."""

import json
import math
import multiprocessing
import queue
import shutil
from pathlib import Path
from typing import ClassVar

import pytest
from hypothesis import given
from hypothesis import strategies as st
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from goniotwin.app.campaign.running.events import State, StateChanged
from goniotwin.app.desktop import model
from goniotwin.app.desktop.events.question import REPLACE
from goniotwin.app.desktop.model import tolerances
from goniotwin.app.desktop.model.messages import Attached, NotAttached
from goniotwin.app.desktop.model.tolerances import Studies, StudyAnswer, StudyOutcome, StudyProgress, read_content
from goniotwin.app.desktop.model.worker import ENDED, WorkFailed
from goniotwin.app.desktop.theme import LIGHT
from goniotwin.app.desktop.tolerances.distribution_view import NOTHING, ROOM_OF_VALUE
from goniotwin.app.desktop.tolerances.screen import CANCELLED, FOLDER, IN_RUN, READY, WAITING, TolerancesScreen
from goniotwin.app.figures.scale import linear_ticks
from goniotwin.app.station.messages import Snapshot
from tests.app.desktop.conftest import click
from tests.app.desktop.made_study import made_outcome

SMALL = """
name = "small"
[criterion]
kind = "gaussian"
sigma_deg = [30]
step_deg = 2.0
[[deviations]]
elements = ["sample", "arc"]
angles = ["ry"]
limit_deg = 0.05
[yields]
distributions = ["uniform"]
draws = 100
"""
"""Two tilts of the plane of incidence, nine combinations."""


Answers = queue.Queue[tuple[int, StudyAnswer]]
LONGEST_S = 60.0


def last_of(answers: Answers, *, until_it_waits: bool = False) -> StudyAnswer:
    """The answer of a worker that ends its study, or the one that states that it waits."""
    while True:
        _, answer = answers.get(timeout=LONGEST_S)
        if not isinstance(answer, StudyProgress) or (until_it_waits and answer.waiting):
            return answer


class NoStudies:
    """A worker that computes nothing: the test sends its answers."""

    asked: ClassVar[list[object]] = []
    """The requests to the worker so far."""

    def __init__(self, deliver: object) -> None:
        del deliver
        self.number = 0

    def compute(self, path: Path) -> None:
        """Note the request."""
        self.number += 1
        self.asked.append(path.name)

    def wait(self, wanted: bool) -> None:
        """Note the request."""
        self.asked.append(wanted)

    def end(self) -> None:
        """Note the end."""
        self.asked.append("end")


@pytest.fixture
def screen(qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> TolerancesScreen:
    """The screen with the study of the examples that takes seconds, and no worker."""
    monkeypatch.setattr(model, "Studies", NoStudies)
    monkeypatch.setattr(NoStudies, "asked", [])
    screen = TolerancesScreen(LIGHT)
    qtbot.addWidget(screen)
    screen.complete()
    screen.open_study(FOLDER / "quick.toml")
    return screen


def answer(screen: TolerancesScreen, *answers: StudyAnswer, number: int = 1) -> None:
    for each in answers:
        screen.answered.emit((number, each))
    QApplication.processEvents()


def cells(screen: TolerancesScreen, column: int) -> list[str]:
    items = [screen.deviations.item(row, column) for row in range(screen.deviations.rowCount())]
    return [item.text() for item in items if item is not None]


def test_a_study_is_shown_before_it_is_computed(screen: TolerancesScreen) -> None:
    names = [screen.choice.itemText(at) for at in range(screen.choice.count())]
    assert names == ["quick.toml", "table1.toml", "table2.toml"]
    assert cells(screen, 0) == ["mirror 3 ry", "sample ry", "arc ry", "beam rz"]
    assert cells(screen, 1) == ["±0.05 deg"] * 4
    assert cells(screen, 2) == ["0.025 deg"] * 4
    text = screen.study_text.toPlainText()
    for part in ("relative RMS of formula 5 within 5 %", "all 625 of the steps", "θ up to 10° in steps of 0.5°"):
        assert part in text
    assert screen.status.text() == READY
    assert screen.curves.summary == NOTHING
    screen.choice.setCurrentIndex(1)
    assert len(cells(screen, 0)) == 30
    assert "flux into the central 5 × 5 mm within 5 % or 10 %" in screen.study_text.toPlainText()
    assert "20,000 random corners" in screen.study_text.toPlainText()


def test_a_file_that_is_no_study_is_refused_with_the_reason(screen: TolerancesScreen, tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(SMALL.replace('"sample", ', '"mirror_9", '), encoding="utf-8")
    screen.open_study(wrong)
    assert screen.status.text().startswith("✗ ")
    assert "mirror_9" in screen.status.text()
    assert not screen.compute_button.isEnabled()
    wrong.write_text(SMALL, encoding="utf-8")
    screen.open_study(wrong)
    assert screen.status.text() == READY
    assert screen.compute_button.isEnabled()
    wrong.unlink()
    screen.compute()
    assert "wrong.toml" in screen.status.text()
    assert NoStudies.asked == []


def test_progress_and_result_are_shown_and_the_result_is_kept_for_its_study(screen: TolerancesScreen) -> None:
    click(screen.compute_button)
    assert NoStudies.asked == ["quick.toml"]
    assert not screen.choice.isEnabled()
    answer(screen, StudyProgress(0.25, "the study: 8192 of 531441 combinations"))
    assert screen.progress.value() == 250
    assert screen.status.text() == "The study: 8192 of 531441 combinations …"
    answer(screen, WorkFailed("of an earlier study"), number=0)
    outcome = made_outcome()
    answer(screen, outcome)
    assert NoStudies.asked[-1] == "end"
    assert screen.summary.text() == outcome.summary
    assert screen.report.toPlainText() == outcome.text
    alone = cells(screen, 2)
    assert (alone[10], alone[20], alone[7]) == ("3.10", "✗ 6.20", "✗ no value")
    assert (cells(screen, 3)[0], cells(screen, 3)[3]) == ("> 2", "0.060")
    assert cells(screen, 6)[2] == "−0.040"  # a sensitivity of -0.8 times the limit of 0.05
    screen.choice.setCurrentIndex(1)
    assert screen.report.toPlainText() == ""
    screen.choice.setCurrentIndex(0)
    assert screen.outcome is outcome
    assert screen.status.text() == "Computed: made."
    click(screen.compute_button)
    assert screen.report.toPlainText() == ""


def test_the_curve_of_the_chosen_set_has_its_content_as_text(qtbot: QtBot, screen: TolerancesScreen) -> None:
    click(screen.compute_button)
    answer(screen, made_outcome())
    text = screen.curves.summary
    assert text.startswith("SIMULATED, 30 deviations, relative RMS (formula 5): 25.0 % within 5 %")
    assert "50 % within 10.00 %" in text
    assert "the worst 20.00 %" in text
    qtbot.keyClick(screen.distributions, Qt.Key.Key_Down)
    qtbot.keyClick(screen.distributions, Qt.Key.Key_Down)
    assert "yield, uniform" in screen.curves.summary
    assert "40.0(0.4) % within 5 %" in screen.curves.summary


def test_a_study_without_a_lobe_has_no_sensitivities(screen: TolerancesScreen) -> None:
    click(screen.compute_button)
    answer(screen, made_outcome(slopes=False))
    assert screen.deviations.columnCount() == 6


def test_a_computation_is_cancelled_and_one_that_fails_gives_the_reason(screen: TolerancesScreen) -> None:
    click(screen.compute_button)
    click(screen.cancel_button)
    assert screen.status.text() == CANCELLED
    assert NoStudies.asked == ["quick.toml", "end"]
    answer(screen, made_outcome())  # it was on its way
    assert screen.outcome is None
    click(screen.compute_button)
    answer(screen, WorkFailed("the instrument gives no value"), number=2)
    assert screen.status.text() == "✗ the instrument gives no value"
    assert screen.compute_button.isEnabled()


def test_nothing_is_computed_while_a_run_is_in_progress(screen: TolerancesScreen) -> None:
    screen.show_message(Attached("window 1", Snapshot(), True, ""))
    click(screen.compute_button)
    screen.show_message(StateChanged(State.RUNNING, ""))
    assert NoStudies.asked == ["quick.toml", True]
    answer(screen, StudyProgress(0.5, "yield, uniform", True))
    assert screen.status.text() == f"{WAITING}: yield, uniform"
    click(screen.cancel_button)
    assert not screen.compute_button.isEnabled()
    assert IN_RUN in screen.compute_button.toolTip()
    screen.show_message(StateChanged(State.DONE, ""))
    assert NoStudies.asked == ["quick.toml", True, "end", False]
    assert screen.compute_button.isEnabled()
    assert screen.status.text() == READY
    screen.show_message(StateChanged(State.RUNNING, ""))
    screen.show_message(NotAttached("there is no station"))
    assert screen.compute_button.isEnabled()


def test_the_files_are_saved_and_those_of_an_earlier_study_replaced_after_a_question(
    qtbot: QtBot, screen: TolerancesScreen, tmp_path: Path
) -> None:
    click(screen.compute_button)
    outcome = made_outcome()
    answer(screen, outcome)
    folder = tmp_path / "study"
    screen.save_in(folder)
    assert {each.name: each.read_bytes() for each in folder.iterdir()} == outcome.files
    assert "Written into study: made.txt, made.png" in screen.status.text()
    (folder / "made.txt").write_text("older", encoding="utf-8")
    screen.save_in(folder)
    assert (folder / "made.txt").read_text(encoding="utf-8") == "older"
    assert screen.question is not None
    qtbot.addWidget(screen.question)
    screen.question.chosen.emit(REPLACE)
    assert (folder / "made.txt").read_bytes() == outcome.files["made.txt"]
    shutil.rmtree(folder)
    folder.write_text("a file", encoding="utf-8")
    screen.save_in(folder / "deeper")
    assert screen.status.text().startswith("✗ ")


def test_a_study_is_computed_by_keys_and_the_focus_goes_where_the_next_key_is(qtbot: QtBot, screen: TolerancesScreen) -> None:
    screen.show()
    screen.activateWindow()
    qtbot.waitUntil(screen.isActiveWindow)
    qtbot.keyClick(screen, Qt.Key.Key_Y, Qt.KeyboardModifier.AltModifier)
    assert screen.choice.hasFocus()
    qtbot.keyClick(screen, Qt.Key.Key_C, Qt.KeyboardModifier.AltModifier)
    qtbot.waitUntil(lambda: screen.cancel_button.hasFocus())  # Qt clicks a button 0.1 s after its letter
    answer(screen, made_outcome())
    assert screen.save_button.hasFocus()
    qtbot.keyClick(screen, Qt.Key.Key_C, Qt.KeyboardModifier.AltModifier)
    qtbot.waitUntil(lambda: screen.cancel_button.hasFocus())
    qtbot.keyClick(screen.cancel_button, Qt.Key.Key_Space)
    assert screen.status.text() == CANCELLED
    assert screen.compute_button.hasFocus()


@given(greatest=st.floats(0.01, 5000.0), pixels=st.floats(60.0, 2000.0))
def test_the_values_of_the_axis_have_room_and_begin_at_zero(greatest: float, pixels: float) -> None:
    values = linear_ticks(0.0, greatest, pixels, ROOM_OF_VALUE)
    assert values[0] == 0.0
    assert values[-1] <= greatest * (1.0 + 1e-9)
    if len(values) > 1:
        assert (values[1] - values[0]) * pixels / greatest >= ROOM_OF_VALUE * (1.0 - 1e-6)


def test_a_worker_computes_what_the_command_does_and_waits_when_it_has_to(tmp_path: Path) -> None:
    """Its numbers are those of the command's JSON."""
    path = tmp_path / "small.toml"
    path.write_text(SMALL, encoding="utf-8")
    answers: Answers = queue.Queue()
    studies = Studies(answers.put, process=False)
    studies.compute(path)
    studies.wait(True)
    assert isinstance(last_of(answers, until_it_waits=True), StudyProgress)
    studies.end()
    studies.compute(path)
    studies.wait(True)
    assert isinstance(last_of(answers, until_it_waits=True), StudyProgress)
    studies.wait(False)
    outcome = last_of(answers)
    studies.end()
    assert isinstance(outcome, StudyOutcome)
    tables = tuple(f"-{name}.csv" for name in ("deviations", "combinations", "limitations"))
    assert set(outcome.files) == {f"small{end}" for end in (".png", "-elements.png", *tables, ".txt", ".json")}
    found = json.loads(outcome.files["small.json"])
    assert found["simulated"] is True
    (case,) = found["cases"]
    study, drawn = outcome.distributions
    assert (study.number, study.median_percent) == (9, case["combinations"]["median_percent"])
    assert (study.worst_percent, study.factor) == (case["worst_percent"], case["common_factor"])
    assert study.cumulative[-1] == 1.0
    limit, share, error = study.shares[0]
    assert (limit, error) == (5.0, 0.0)
    step = study.largest_percent / len(study.cumulative)
    assert study.cumulative[math.floor(limit / step) - 1] <= share <= study.cumulative[math.ceil(limit / step)]
    assert (drawn.name, drawn.number, drawn.complete, drawn.factor) == ("yield, uniform", 100, False, None)
    sample, arc = outcome.deviations
    assert sample.peak_deg == pytest.approx(2.0, abs=2e-3)  # a mirror's law: the peak turns twice as far
    assert arc.peak_deg == pytest.approx(-1.0, abs=2e-3)
    assert f"{100.0 * share:.1f}" in outcome.summary
    assert outcome.text.startswith("SIMULATED: small")


def test_a_worker_that_is_ended_by_another_program_is_a_study_without_a_result(monkeypatch: pytest.MonkeyPatch) -> None:
    answers: Answers = queue.Queue()
    monkeypatch.setattr(tolerances, "serve_study", lambda connection: connection.recv())
    studies = Studies(answers.put, process=False)
    studies.compute(FOLDER / "quick.toml")
    assert answers.get(timeout=LONGEST_S) == (1, WorkFailed(ENDED))
    studies.end()
    assert answers.empty()


@pytest.mark.long
def test_a_study_in_a_process_is_ended_at_once() -> None:
    answers: Answers = queue.Queue()
    studies = Studies(answers.put)
    studies.compute(FOLDER / "table2.toml")
    assert isinstance(answers.get(timeout=LONGEST_S)[1], StudyProgress)
    (process,) = [each for each in multiprocessing.active_children() if each.name == "tolerances"]
    studies.end()
    with pytest.raises(ValueError, match="closed"):
        process.is_alive()
    studies.compute(FOLDER / "quick.toml")
    found = last_of(answers)
    studies.end()
    assert isinstance(found, StudyOutcome)
    assert [each[:2] for each in read_content(FOLDER / "quick.toml").deviations] == [
        (each.title, f"±{each.limit:g} {each.unit}") for each in found.deviations
    ]
