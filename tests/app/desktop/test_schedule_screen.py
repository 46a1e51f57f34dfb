"""The schedule screen: form and text are one, an error has its line, and nothing that was typed is lost or started unsaved."""

import shutil
from pathlib import Path

import pytest
from PySide6.QtCore import QEvent, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QApplication, QComboBox, QFileDialog, QLineEdit
from pytestqt.qtbot import QtBot

from goniotwin import examples
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.desktop.events.question import CANCEL, REPLACE, QuestionBox
from goniotwin.app.desktop.model.draft import Drafted, line_of
from goniotwin.app.desktop.setup.form import NewSchedule
from goniotwin.app.desktop.setup.screen import UNSAVED, SetupScreen
from goniotwin.app.desktop.window import MainWindow
from tests.app.desktop.conftest import READY_MS, WindowOpener, click, ready
from tests.app.desktop.keyboard import press


@pytest.fixture
def window(qtbot: QtBot, open_window: WindowOpener, tmp_path: Path) -> MainWindow:
    """The window with a copy of the example, on the rig of the example."""
    schedule = tmp_path / "first.toml"
    shutil.copy(examples.FIRST_SCHEDULE, schedule)
    window = ready(qtbot, open_window(rig=examples.FIRST_RIG, schedule=schedule))
    press("Ctrl+3")
    qtbot.waitUntil(lambda: planned(qtbot, screen_of(window)).maps != (), timeout=READY_MS)  # the rig is there
    return window


def screen_of(window: MainWindow) -> SetupScreen:
    return window.view.screen_of(SetupScreen)


def planned(qtbot: QtBot, screen: SetupScreen) -> Drafted:
    """Wait for what comes of the text."""
    qtbot.waitUntil(lambda: screen.drafted is not None and screen.drafted.text == screen.text, timeout=READY_MS)
    assert screen.drafted is not None
    return screen.drafted


def enter(screen: SetupScreen, key: str, text: str) -> None:
    """Type into a field of the form."""
    field = screen.form.fields[key]
    if isinstance(field, QComboBox):
        field.setCurrentText(text)
        field.activated.emit(field.currentIndex())
    else:
        field.setText(text)
        field.editingFinished.emit()


def question() -> QuestionBox:
    """The question that is open."""
    found = [each for each in QApplication.topLevelWidgets() if isinstance(each, QuestionBox) and each.isVisible()]
    assert len(found) == 1
    return found[0]


def test_a_value_of_the_form_is_in_the_text_and_the_file_after_saving(qtbot: QtBot, window: MainWindow) -> None:
    screen = screen_of(window)
    assert window.presenter.plan is not None
    path, before = Path(window.presenter.plan.schedule.name), screen.text
    first = planned(qtbot, screen)
    assert first.facts[0].startswith("402 rows")
    assert len(first.maps) == 2
    assert window.view.run.start_button.isEnabled()
    enter(screen, "sigma_deg", "30, 45, 60")
    assert screen.text == before.replace("sigma_deg = [30, 60]", "sigma_deg = [30, 45, 60]")
    assert screen.unsaved
    assert not window.view.run.start_button.isEnabled()
    assert UNSAVED in window.view.run.start_button.toolTip()
    assert len(planned(qtbot, screen).maps) == 3
    assert path.read_text(encoding="utf-8") == before
    press("Ctrl+S")
    assert path.read_text(encoding="utf-8") == screen.text
    assert not window.view.run.start_button.isEnabled()  # not with the plan of the former text
    ready(qtbot, window)
    assert window.presenter.plan is not None
    assert len(window.presenter.plan.rows) > 402


def test_what_is_typed_into_the_text_is_in_the_form_and_an_error_has_its_line(qtbot: QtBot, window: MainWindow) -> None:
    screen = screen_of(window)
    text = screen.text
    screen._text.setPlainText(text.replace("readings = 2", "readings = 3"))
    readings = screen.form.fields["readings"]
    assert isinstance(readings, QLineEdit)
    assert readings.text() == "3"
    screen._text.setPlainText(text.replace("[30, 60]", "[30, 95]"))
    assert planned(qtbot, screen).line == 1 + text.splitlines().index("sigma_deg = [30, 60]")
    assert "95 deg is not from 0 to 87" in screen.error
    screen._text.setPlainText(text.replace("[30, 60]", "[30, 60"))
    assert planned(qtbot, screen).line is not None
    assert "is not TOML" in screen.error
    assert screen.drafted is not None
    assert screen.drafted.maps  # those of the last plan
    enter(screen, "sigma_deg", "30")
    assert "is not TOML" in screen.error  # the form does not change a text that it cannot read
    screen._text.setPlainText(text)
    planned(qtbot, screen)
    assert screen.error == ""


def test_what_is_no_value_stays_marked_and_is_neither_saved_nor_started(qtbot: QtBot, window: MainWindow) -> None:
    screen, start = screen_of(window), window.view.run.start_button
    text = screen.text
    no_number, two = "is neither numbers nor a range", "may be one number or two; write 22.5 or 22, 5"
    for typed, reason in (("thirty", no_number), ("22,5", two)):
        enter(screen, "sigma_deg", typed)
        screen._plan()
        planned(qtbot, screen)
        assert f"{typed!r} {reason}" in screen.error
        assert reason in start.toolTip()
        assert not start.isEnabled()
        enter(screen, "readings", "3")  # another field is taken, and this one stays as it was typed
        assert f"{typed!r} {reason}" in screen.error
        field = screen.form.fields["sigma_deg"]
        assert isinstance(field, QLineEdit)
        assert field.text() == typed
        screen.save()
        assert f"Not saved: Sigma (incidence), deg: {typed!r}" in window.view.status
        assert screen.unsaved
        enter(screen, "readings", "2")
    assert screen.text == text
    enter(screen, "sigma_deg", "30, 60")
    planned(qtbot, screen)
    assert screen.error == ""
    qtbot.waitUntil(start.isEnabled, timeout=READY_MS)


def test_a_letter_with_alt_is_no_part_of_the_text(window: MainWindow) -> None:
    screen = screen_of(window)
    text = screen.text
    screen._text.setFocus()
    for modifier in (Qt.KeyboardModifier.AltModifier, Qt.KeyboardModifier.NoModifier):
        QApplication.sendEvent(screen._text, QKeyEvent(QEvent.Type.KeyPress, Qt.Key.Key_S, modifier, "s"))
    bracket = QKeyEvent(QEvent.Type.KeyPress, Qt.Key.Key_BracketLeft, Qt.KeyboardModifier.AltModifier, "[")
    QApplication.sendEvent(screen._text, bracket)  # some keyboards of macOS have it there
    assert screen.text == "s[" + text


def test_a_new_schedule_is_written_by_keys_saved_and_ready_to_start(qtbot: QtBot, window: MainWindow, tmp_path: Path) -> None:
    screen = screen_of(window)
    click(screen.schedule.new_button)
    (box,) = [each for each in QApplication.topLevelWidgets() if isinstance(each, NewSchedule) and each.isVisible()]
    qtbot.waitUntil(lambda: QApplication.activeWindow() is box)
    assert box.sample.currentText() == "satin"
    box.template.setCurrentIndex(2)
    box.longest_h.setText("long")
    box._accept()
    assert "'long' is no number" in box._error.text()
    box.longest_h.setText("-1")
    box._accept()
    qtbot.waitUntil(lambda: "✗" in box._error.text(), timeout=READY_MS)
    assert box.isVisible()
    box.longest_h.setText("0.1")
    box._accept()
    qtbot.waitUntil(lambda: "[target]" in screen.text, timeout=READY_MS)
    assert "longest_h = 0.1" in screen.text
    assert screen.unsaved
    planned(qtbot, screen)
    screen.save(tmp_path / "plane.toml")
    ready(qtbot, window)
    assert read_schedule(tmp_path / "plane.toml").file.samples == ["satin"]
    assert window.presenter.plan is not None
    assert window.presenter.plan.schedule.text == screen.text


def test_unsaved_changes_are_asked_about_before_they_go(qtbot: QtBot, window: MainWindow, tmp_path: Path) -> None:
    screen = screen_of(window)
    before = screen.text
    other = tmp_path / "other.toml"
    other.write_text(before.replace('name = "first"', 'name = "other"'), encoding="utf-8")
    enter(screen, "readings", "4")
    edited = screen.text
    window._open_schedule(other)
    question().chosen.emit(CANCEL)
    assert screen.text == edited
    assert not window.close()
    assert window.isVisible()
    question().chosen.emit(CANCEL)
    assert window.isVisible()
    window._open_schedule(other)
    question().chosen.emit("Discard")
    qtbot.waitUntil(lambda: 'name = "other"' in screen.text, timeout=READY_MS)
    assert not screen.unsaved


def test_a_copy_asks_before_it_replaces_and_an_example_is_not_written_to(
    qtbot: QtBot, window: MainWindow, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    screen = screen_of(window)
    there = tmp_path / "there.toml"
    there.write_text("older", encoding="utf-8")
    click(screen.schedule.copy_button)
    dialog = _file_dialog()
    dialog.fileSelected.emit(str(there))
    assert there.read_text(encoding="utf-8") == "older"
    question().chosen.emit(REPLACE)
    assert there.read_text(encoding="utf-8") == screen.text
    dialog.close()
    window._open_schedule(examples.FIRST_SCHEDULE)
    qtbot.waitUntil(lambda: screen._path == examples.FIRST_SCHEDULE, timeout=READY_MS)
    content = examples.FIRST_SCHEDULE.read_bytes()
    enter(screen, "readings", "5")
    press("Ctrl+S")
    assert examples.FIRST_SCHEDULE.read_bytes() == content
    _file_dialog().close()
    screen.leave(lambda: None)
    question().chosen.emit("Discard")


def test_line_ends_and_blanks_of_a_file_stay(qtbot: QtBot, window: MainWindow, tmp_path: Path) -> None:
    screen = screen_of(window)
    path = tmp_path / "windows.toml"
    text = "# two\N{NO-BREAK SPACE}words\r\n" + screen.text.replace("\n", "\r\n")
    path.write_bytes(text.encode())
    window._open_schedule(path)
    qtbot.waitUntil(lambda: screen._path == path, timeout=READY_MS)
    assert not screen.unsaved
    ready(qtbot, window)
    enter(screen, "readings", "3")
    screen.save()
    assert path.read_bytes() == text.replace("readings = 2", "readings = 3").encode()
    ready(qtbot, window)


def test_the_line_of_an_error() -> None:
    text = 'name = "a"\n\n[drift]\nevery_s = -1\n'
    assert line_of("a.toml: drift.every_s: should be above 0", text, "a.toml") == 4
    assert line_of("a.toml: drift.limit.0: is wrong", text, "a.toml") == 3
    assert line_of("a.toml: is not TOML: Invalid value (at line 2, column 3)", text, "a.toml") == 2
    assert line_of("a.toml: looks like a rig file", text, "a.toml") is None


def _file_dialog() -> QFileDialog:
    (found,) = [each for each in QApplication.topLevelWidgets() if isinstance(each, QFileDialog) and each.isVisible()]
    return found
