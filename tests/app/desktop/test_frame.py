"""The frame of the window: screens, keys, menus, what fits on a screen, and what is remembered. Most of it needs no rig."""

import json
import math
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from PySide6.QtCore import Qt
from PySide6.QtGui import QAction
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractItemView,
    QApplication,
    QCheckBox,
    QDialog,
    QLabel,
    QLineEdit,
    QMenu,
    QPlainTextEdit,
    QWidget,
)
from pytestqt.qtbot import QtBot

import goniotwin
from goniotwin import examples
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.running.events import SafetyOrder
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.data.opening import open_dataset
from goniotwin.app.data.results import Results
from goniotwin.app.desktop import MainWindow, Theme, view
from goniotwin.app.desktop.bench.screen import BenchScreen
from goniotwin.app.desktop.campaigns.screen import CampaignsScreen
from goniotwin.app.desktop.dialogs import FileDialog
from goniotwin.app.desktop.events.panels import NOTICES, LogEntry
from goniotwin.app.desktop.events.question import Choice, QuestionBox
from goniotwin.app.desktop.events.screen import EventsScreen
from goniotwin.app.desktop.file_chooser import FileChooser
from goniotwin.app.desktop.menu import about_text
from goniotwin.app.desktop.model.axes import GREEK
from goniotwin.app.desktop.model.campaigns import list_campaigns
from goniotwin.app.desktop.model.results import Answered, Opened
from goniotwin.app.desktop.remembered import MOST_RECENT, Remembered
from goniotwin.app.desktop.results.screen import ResultsScreen
from goniotwin.app.desktop.rig.panels import DEVICES, contact_text
from goniotwin.app.desktop.rig.strip import lamp_text
from goniotwin.app.desktop.run.axes import PIXELS_OF_VALUE, ValueAxis
from goniotwin.app.desktop.run.panel import PAUSE, RESUME
from goniotwin.app.desktop.screen import Screen
from goniotwin.app.desktop.setup.screen import SetupScreen
from goniotwin.app.desktop.theme import Colours
from goniotwin.app.desktop.tolerances.screen import FOLDER, TolerancesScreen
from goniotwin.app.figures.scale import log_ticks
from goniotwin.app.rig import AXES, read_rig
from goniotwin.app.rig.kinds import ROLES
from goniotwin.app.station.messages import BenchChanged, Contact, DeviceStatus, LampRead
from goniotwin.protocols.clock import calendar_stamp
from tests.app.desktop.conftest import READY_MS, WindowOpener, end_window, named_label, ready
from tests.app.desktop.made_study import made_outcome
from tests.app.desktop.screen_faults import SCREEN, controls, faults
from tests.conftest import REPOSITORY, RIG, SCHEDULE, Writer
from tests.sizes import some

FrameMaker = Callable[..., MainWindow]
NAMED = (QAbstractButton, QAbstractItemView, QPlainTextEdit)


@pytest.fixture
def make_frame(qapp: QApplication, tmp_path: Path) -> Iterator[FrameMaker]:
    """Windows with all screens and plots, but without a rig."""
    windows: list[MainWindow] = []

    def make(remembered: Remembered | None = None) -> MainWindow:
        window = MainWindow(Theme(qapp), RIG, None, tmp_path / "journals", 20.0, remembered)
        window.view.complete()
        windows.append(window)
        return window

    yield make
    for window in windows:
        end_window(qapp, window)


@pytest.fixture
def frame(make_frame: FrameMaker, monkeypatch: pytest.MonkeyPatch) -> MainWindow:
    monkeypatch.setattr(MainWindow, "complete", lambda _window: None)
    return make_frame()


def status_of(device: str) -> DeviceStatus:
    """The state of a device of a rig whose monitor is unplugged."""
    if device == "monitor":
        return DeviceStatus(Contact.DISCONNECTED, error="no reply to *IDN?")
    return DeviceStatus(Contact.CONNECTED, "identity")


def shown(qtbot: QtBot, window: MainWindow) -> MainWindow:
    window.show()
    qtbot.waitUntil(window.isVisible)
    return window


def each_screen(window: MainWindow) -> Iterator[Screen]:
    for number, screen in enumerate(window.view.screens):
        window.view.show_screen(number)
        for _ in range(3):  # a screen follows its room, and the room the screen's scroll bars
            QApplication.processEvents()
        yield screen


def test_every_control_and_every_value_has_an_accessible_name(qtbot: QtBot, frame: MainWindow) -> None:
    """By a walk through all widgets; of labels those that are no plain words beside a value."""
    shown(qtbot, frame)
    frame.view.orders.add(SafetyOrder("Cut the motors' power", "the stop is not confirmed"))
    frame.view.question.set_question("Mount gaussian-5")
    seen = set()
    for screen in each_screen(frame):
        assert screen.accessibleName()
        for control in controls(frame):
            seen.add(control)
            assert control.accessibleName(), (screen.title, control)
        for label in screen.findChildren(QLabel):
            if label.isVisible() and label.wordWrap() and label.text() and label.accessibleName() == "":
                assert re.fullmatch(r"[^0-9/]*", label.text()), label.text()
    assert len(seen) >= 17


def test_a_control_shows_its_mnemonic_and_no_other_of_its_screen_has_it(qtbot: QtBot, frame: MainWindow) -> None:
    """Those of the menus, and of the controls that are on every screen, are among them."""
    shown(qtbot, frame)
    frame.view.question.set_question("Mount gaussian-5")
    frame.view.rig.person.show()
    for screen in each_screen(frame):
        texts = [action.text() for action in frame.menuBar().actions()]
        texts += [each.text() for each in controls(frame) if isinstance(each, QAbstractButton)]
        texts += [each.text() for each in frame.findChildren(QLabel) if each.isVisible() and each.buddy() is not None]
        # A notice that the station is gone offers to resume; no run is paused then.
        for more in ([RESUME], *([PAUSE, notice] for notice in NOTICES.values())):
            letters = [found[1].lower() for each in [*texts, *more] if (found := re.search("&(.)", each))]
            letters.remove("p")
            assert len(letters) == len(set(letters)), (screen.title, letters)
            assert {"f", "r", "v", "h", "s", "a"} <= set(letters)


def test_a_menu_has_each_mnemonic_and_each_key_once(frame: MainWindow) -> None:
    keys = []
    for menu in frame.menuBar().findChildren(QMenu):
        actions = [action for action in menu.actions() if not action.isSeparator()]
        letters = [found[1].lower() for action in actions if (found := re.search("&(.)", action.text()))]
        assert len(letters) == len(set(letters)), letters
        keys += [action.shortcut().toString() for action in actions if not action.shortcut().isEmpty()]
    assert len(keys) == len(set(keys)) >= 10


def tab_stops(window: MainWindow) -> list[QWidget]:
    """The widgets that Tab reaches, from the first."""
    found, each = [], window.nextInFocusChain()
    while each is not None and each is not window:
        if each.focusPolicy() & Qt.FocusPolicy.TabFocus and each.isVisibleTo(window):
            found.append(each)
        each = each.nextInFocusChain()
    return found


@pytest.mark.parametrize("size", [(1280, 800), (640, 400)])
def test_every_tab_stop_has_an_accessible_name(qtbot: QtBot, frame: MainWindow, size: tuple[int, int]) -> None:
    frame.resize(*size)
    shown(qtbot, frame)
    for screen in each_screen(frame):
        stops = tab_stops(frame)
        assert [each for each in stops if not each.accessibleName()] == [], screen.title
        assert any(screen.isAncestorOf(each) for each in stops)


def test_the_keys_of_stop_hold_in_the_windows_beside_the_main_one(qtbot: QtBot, frame: MainWindow, tmp_path: Path) -> None:
    """A choice of a file, a text, a question of the bench: none is modal, and each is closed by Esc once it is up."""
    shown(qtbot, frame)
    run = frame.view.run
    stopped: list[bool] = []
    run.stop_button.setEnabled(True)
    run.stop.connect(lambda: stopped.append(True))
    chosen: list[Path] = []
    (tmp_path / "a.csv").touch()
    frame.menus.help_wanted.emit()
    frame.view.screen_of(BenchScreen)._ask_about_position("sigma")
    FileDialog(frame, "Open", tmp_path, "Table (*.csv)", chosen.append)
    save = FileDialog(frame.view.screens[0], "Save", tmp_path / "a.csv", "Table (*.csv)", chosen.append, save=True)
    boxes = [each for each in QApplication.topLevelWidgets() if isinstance(each, QDialog) and each.isVisible()]
    assert len(boxes) == 4
    for number, box in enumerate(boxes, start=1):
        box.activateWindow()
        qtbot.waitUntil(box.isActiveWindow)
        focus = QApplication.focusWidget()
        qtbot.keyClick(focus, Qt.Key.Key_Period, Qt.KeyboardModifier.ControlModifier)
        assert len(stopped) == number
        qtbot.keyPress(focus, Qt.Key.Key_Escape)
        assert run.stop_button.isDown()
        assert box.isVisible()
        if box is save:
            save.accept()
        qtbot.keyRelease(focus, Qt.Key.Key_Escape)
        qtbot.waitUntil(lambda: not run.stop_button.isDown())
        assert box not in QApplication.topLevelWidgets() or not box.isVisible()
    assert chosen == [tmp_path / "a.csv"]


def test_a_name_that_is_not_there_blocks_nothing(frame: MainWindow, tmp_path: Path) -> None:
    chosen: list[Path] = []
    dialog = FileDialog(frame, "Open", tmp_path, "Table (*.csv)", chosen.append)
    (name,) = dialog.findChildren(QLineEdit, "fileNameEdit")
    name.setText("nothing.csv")
    dialog.accept()
    assert QApplication.activeModalWidget() is None
    assert dialog.isVisible()
    assert dialog.windowTitle() == "Open: there is no nothing.csv"
    name.setText("n" * 300)  # longer than a name can be
    dialog.accept()
    assert dialog.isVisible()
    (tmp_path / "there.csv").touch()
    name.setText("there.csv")
    dialog.accept()
    assert chosen == [tmp_path / "there.csv"]


def test_a_question_leaves_the_keys_to_a_dialog_in_which_a_person_is(qtbot: QtBot, frame: MainWindow) -> None:
    choices = (Choice("Yes", ""), Choice("No", "", default=True))
    first = QuestionBox(frame, "First", "", choices)
    qtbot.waitUntil(lambda: QApplication.activeWindow() is first)
    second = QuestionBox(frame, "Second", "", choices)
    qtbot.wait(50)
    qtbot.waitUntil(lambda: QApplication.activeWindow() is first)
    assert second.isVisible()
    first.dismiss()
    second.appear()
    qtbot.waitUntil(lambda: QApplication.activeWindow() is second)
    second.dismiss()


def test_the_words_of_the_wire_are_in_the_tool_tip_of_an_event_and_of_a_device(frame: MainWindow) -> None:
    headline, detail = "Monitor (PM100D) is not responding: check cable and power", "READ?: not responding within 2 s"
    events = frame.view.screen_of(EventsScreen)
    events.add(LogEntry(headline, "monitor", "no run can start", serious=True, detail=detail))
    what = events.model.index(0, 1)
    assert what.data() == f"✗ {headline}"
    assert what.data(Qt.ItemDataRole.ToolTipRole) == f"{headline}\n{detail}"
    frame.view.devices.set_devices({"monitor": DeviceStatus(Contact.DISCONNECTED, error=headline, detail=detail)})
    (shown,) = [each for each in frame.view.devices.findChildren(QLabel) if each.text() == headline]
    assert shown.toolTip() == detail


def test_a_large_window_becomes_a_small_one_in_one_step(qtbot: QtBot, frame: MainWindow) -> None:
    frame.resize(1280, 800)
    frame.view.set_simulated(True, 1)
    shown(qtbot, frame)
    for screen in each_screen(frame):
        frame.resize(1280, 800)
        QApplication.processEvents()
        frame.resize(640, 400)
        assert (frame.width(), frame.height()) == (640, 400), screen.title


def test_tab_goes_from_the_navigation_through_the_screen_to_the_run_and_not_to_stop(qtbot: QtBot, frame: MainWindow) -> None:
    shown(qtbot, frame)
    for screen in each_screen(frame):
        stops = tab_stops(frame)
        own = [stops.index(each) for each in controls(frame) if screen.isAncestorOf(each)]
        run = [stops.index(each) for each in (frame.view.run.start_button, frame.view.run.pause_button, frame.view.run.speeds)]
        first = next(at for at, each in enumerate(stops) if frame.view.navigation.isAncestorOf(each))
        assert first < min(own) <= max(own) < run[0] < run[1] < run[2]
        assert frame.view.run.stop_button not in stops
    assert set(controls(frame)) - set(stops) <= {
        frame.view.run.stop_button,
        frame.view.run.progress,
        frame.menuBar(),
        *frame.view.navigation.buttons,
    }


def test_the_first_focus_is_on_the_screen_that_is_shown(qtbot: QtBot, frame: MainWindow) -> None:
    shown(qtbot, frame)
    frame.activateWindow()
    qtbot.waitUntil(frame.isActiveWindow)
    assert QApplication.focusWidget() is frame.view.navigation.buttons[frame.view.shown_screen]
    qtbot.keyClick(frame, Qt.Key.Key_1, Qt.KeyboardModifier.ControlModifier)
    assert frame.view.shown_screen == 0
    assert QApplication.focusWidget() is frame.view.navigation.buttons[0]
    qtbot.keyClick(frame.view.navigation.buttons[0], Qt.Key.Key_Down)
    assert frame.view.shown_screen == 1


@pytest.mark.parametrize("percent", some([200, 100, 150]))
def test_every_control_is_on_the_screen(
    qtbot: QtBot, frame: MainWindow, percent: int, tmp_path: Path, write_schedule: Writer
) -> None:
    """1280 x 800 pixels at a scale factor; with the longest texts, an order and a question."""
    frame.resize(*(side * 100 // percent for side in SCREEN))
    frame.view.set_simulated(True, 1)
    frame.view.run.set_progress(1000, 2000, 12345.0)
    frame.view.show_status("Paused, with the shutter closed. Resume continues with the next row.")
    frame.view.set_saved("Saved row by row in /home/operator/goniotwin/first-001.journal")
    frame.view.devices.set_devices({each: status_of(each) for each in DEVICES})
    frame.view.axes.set_positions(dict.fromkeys(GREEK, 180.0))
    frame.view.axes.set_targets((180.0, 90.0, 0.0, 5.0))
    for number in range(123):
        frame.view.log.add(LogEntry(f"event {number}", serious=True))
    path = tmp_path / "panel-with-a-long-name-after-weathering-001.journal"
    run_without_wires(make_plan(read_schedule(write_schedule()), read_rig(RIG)), path)
    frame.view.screen_of(CampaignsScreen).show_campaigns(list_campaigns(tmp_path))
    results, found = frame.view.screen_of(ResultsScreen), Results(open_dataset(path))
    words = ("journal, 216 values", (), True, True, True, False)
    results._take(Opened(0, "panel with a long name after weathering", *words, found.lights))
    assert results.wanted is not None
    results._take(Answered(0, found.show(results.wanted)))
    tolerances = frame.view.screen_of(TolerancesScreen)
    tolerances.open_study(FOLDER / "table1.toml")
    tolerances._show_outcome(made_outcome())
    shown(qtbot, frame)
    for screen in each_screen(frame):
        assert faults(frame, percent) == [], screen.title
    for part in range(tolerances.parts.count()):
        tolerances.parts.setCurrentIndex(part)
        QApplication.processEvents()
        assert faults(frame, percent) == [], part
    frame.view.orders.add(SafetyOrder("Cut the motors' power", "the stop is not confirmed; sigma: MST: nothing"))
    frame.view.question.set_question("Mount gaussian-5")
    QApplication.processEvents()
    assert frame.height() <= SCREEN[1] * 100 // percent
    stop = frame.view.run.stop_button
    assert stop.visibleRegion().boundingRect() == stop.rect()


def test_a_control_outside_the_screen_is_found(qtbot: QtBot, frame: MainWindow) -> None:
    frame.view.rig.open_button.setMinimumHeight(2000)
    shown(qtbot, frame)
    frame.view.show_screen(0)
    QApplication.processEvents()
    assert "QPushButton 'Open a rig file' is not whole in the window" in faults(frame, 100)


class AddedScreen(Screen):
    """A screen that a test adds."""

    title = "Added"
    icon = "tune"

    def __init__(self, colours: Colours) -> None:
        super().__init__(colours)
        self.messages: list[object] = []

    def show_message(self, message: object) -> None:
        """Note a message."""
        self.messages.append(message)


def test_a_screen_is_added_by_a_line(qtbot: QtBot, open_window: WindowOpener, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view, "SCREENS", (*view.SCREENS, AddedScreen))
    window = ready(qtbot, open_window())
    number = len(view.SCREENS) - 1
    assert "Added" in window.view.navigation.buttons[number].text()
    qtbot.keyClick(window, Qt.Key(Qt.Key.Key_1.value + number), Qt.KeyboardModifier.ControlModifier)
    assert window.view.shown_screen == number
    qtbot.waitUntil(lambda: bool(window.view.screen_of(AddedScreen).messages), timeout=READY_MS)


def menu_action(window: MainWindow, text: str) -> QAction:
    """The one action of the menus whose text begins so."""
    (found,) = [
        action
        for menu in window.menuBar().findChildren(QMenu)
        for action in menu.actions()
        if action.text().startswith(text) and action.menu() is None
    ]
    return found


def test_the_letter_and_the_key_of_start_and_pause(qtbot: QtBot, open_window: WindowOpener) -> None:
    """Alt+S opened the wrong dialog, and Alt+P did nothing."""
    window = ready(qtbot, open_window(speed=4.0))
    window.activateWindow()
    qtbot.waitUntil(window.isActiveWindow)
    window.view.show_screen(0)
    qtbot.keyClick(window, Qt.Key.Key_S, Qt.KeyboardModifier.AltModifier)
    qtbot.waitUntil(window.view.run.pause_button.isEnabled, timeout=READY_MS)
    assert isinstance(window.view.screens[window.view.shown_screen], view.FIRST)
    assert menu_action(window, "Stop").isEnabled()
    qtbot.waitUntil(lambda: window.view.run.progress.value() > 0, timeout=READY_MS)
    qtbot.keyClick(window, Qt.Key.Key_P, Qt.KeyboardModifier.AltModifier)
    qtbot.waitUntil(lambda: window.view.run.pause_button.text() == "Res&ume", timeout=READY_MS)
    assert menu_action(window, "Res&ume").isEnabled()
    assert not menu_action(window, "Open &rig").isEnabled()
    qtbot.keyClick(window, Qt.Key.Key_P, Qt.KeyboardModifier.ControlModifier)
    qtbot.waitUntil(lambda: window.view.run.pause_button.text() == PAUSE, timeout=READY_MS)


def test_the_window_remembers_its_screen_its_size_and_its_scheme(
    qtbot: QtBot, make_frame: FrameMaker, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(MainWindow, "complete", lambda _window: None)
    file = tmp_path / "window.ini"
    first = shown(qtbot, make_frame(Remembered(file)))
    first.resize(700, 500)
    first.view.show_screen(3)
    first.theme.force(None)
    first.menus.scheme_chosen.emit("dark")
    assert first.close()
    del first
    remembered = Remembered(file)
    assert remembered.scheme == "dark"
    second = make_frame(remembered)
    assert second.view.shown_screen == 3
    assert (second.width(), second.height()) == (700, 500)
    second.menus.scheme_chosen.emit(None)
    assert Remembered(file).scheme is None


def test_recent_files_are_remembered_the_latest_first_and_those_that_are_gone_left_out(tmp_path: Path) -> None:
    remembered = Remembered(tmp_path / "window.ini")
    paths = [tmp_path / f"{number}.toml" for number in range(MOST_RECENT + 2)]
    for path in paths:
        path.touch()
        remembered.add_recent("schedule", path)
    remembered.add_recent("schedule", paths[5])
    latest = [paths[5], *(each for each in reversed(paths) if each != paths[5])][:MOST_RECENT]
    assert Remembered(tmp_path / "window.ini").recent("schedule") == latest
    latest[0].unlink()
    assert remembered.recent("schedule") == latest[1:]
    assert remembered.recent("rig") == []
    remembered.set_folder(tmp_path)
    assert Remembered(tmp_path / "window.ini").folder == tmp_path
    remembered.set_folder(tmp_path / "gone")
    assert Remembered(tmp_path / "window.ini").folder is None
    assert Remembered().folder is None


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"[layout]\nwindow=@ByteArray(nonsense)\nrun=5\n"])
def test_what_is_remembered_may_be_damaged(
    make_frame: FrameMaker, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, content: bytes
) -> None:
    monkeypatch.setattr(MainWindow, "complete", lambda _window: None)
    file = tmp_path / "window.ini"
    file.write_bytes(content)
    window = make_frame(Remembered(file))
    assert isinstance(window.view.screens[window.view.shown_screen], view.FIRST)


def test_a_recent_schedule_is_opened_from_the_menu(
    qtbot: QtBot, open_window: WindowOpener, write_schedule: Writer, tmp_path: Path
) -> None:
    remembered = Remembered(tmp_path / "window.ini")
    window = ready(qtbot, open_window(schedule=write_schedule(), remembered=remembered))
    remembered.add_recent("schedule", SCHEDULE)
    (menu,) = [each for each in window.menuBar().findChildren(QMenu) if each.title() == "Recent &schedules"]
    menu.aboutToShow.emit()
    action = menu.actions()[0]  # before that of this window
    assert SCHEDULE.name in action.text()
    action.trigger()
    qtbot.waitUntil(lambda: 'name = "quick"' in window.view.screen_of(SetupScreen).text, timeout=READY_MS)


def test_the_files_of_the_first_start_are_no_recent_ones(frame: MainWindow, tmp_path: Path) -> None:
    remembered = Remembered(tmp_path / "window.ini")
    files = FileChooser(frame, tmp_path, remembered)
    files.remember("rig", examples.FIRST_RIG)
    files.remember("schedule", examples.FIRST_SCHEDULE)
    files.remember("schedule", SCHEDULE)
    assert (remembered.recent("rig"), remembered.recent("schedule")) == ([], [SCHEDULE])
    files.choose_schedule(RIG)
    files.choose_rig(RIG)
    dialogs = {each.windowTitle(): Path(each.directory().absolutePath()) for each in frame.findChildren(FileDialog)}
    assert dialogs == {"Open a schedule file": SCHEDULE.parent, "Open a rig file": RIG.parent}
    for each in frame.findChildren(FileDialog):
        each.reject()


def test_a_part_that_cannot_be_loaded_is_shown(qtbot: QtBot, make_frame: FrameMaker, monkeypatch: pytest.MonkeyPatch) -> None:
    window = make_frame()
    monkeypatch.setitem(sys.modules, "goniotwin.app.desktop.presenter", None)
    shown(qtbot, window)
    qtbot.waitUntil(lambda: "goniotwin.app.desktop.presenter" in window.view.status, timeout=READY_MS)
    assert window.close()


def test_the_set_up_shows_what_a_schedule_measures(frame: MainWindow) -> None:
    plan = make_plan(read_schedule(examples.FIRST_SCHEDULE), read_rig(examples.FIRST_RIG))
    frame.view.schedule.set_plan(plan)
    setup = frame.view.screen_of(SetupScreen)
    setup.form.complete()
    shown_in = {key: field.text() for key, field in setup.form.fields.items() if isinstance(field, QLineEdit)}
    expected = {"samples": "satin", "sigma_deg": "30, 60", "wavelength_nm": "550", "gains_v_per_a": "1e10, 1e11"}
    assert expected.items() <= shown_in.items()
    assert setup.text == plan.schedule.text
    assert not setup.unsaved
    assert plan.seconds / 20.0 < 120.0  # the first campaign, at the simulation speed of the start


def test_the_events_to_look_at_are_counted_and_can_be_shown_alone(frame: MainWindow) -> None:
    screen = frame.view.screen_of(EventsScreen)
    for number in range(5):
        screen.add(LogEntry(f"event {number}", serious=number % 2 == 1))
    assert "✗ 2" in frame.view.navigation.buttons[view.SCREENS.index(EventsScreen)].text()
    table = screen.findChild(QAbstractItemView, "events")
    assert table is not None
    assert table.model().rowCount() == 5
    only = screen.findChild(QCheckBox)
    assert only is not None
    only.click()
    assert [table.model().index(row, 1).data() for row in range(table.model().rowCount())] == ["✗ event 3", "✗ event 1"]


def test_a_device_that_does_not_respond_is_marked_at_the_navigation_and_in_the_strip(frame: MainWindow) -> None:
    frame.view.devices.set_devices({each: status_of(each) for each in DEVICES})
    assert "✗ 1" in frame.view.navigation.buttons[0].text()
    (stated,) = [each.accessibleName() for each in frame.view.strip.findChildren(QLabel) if "Devices" in each.accessibleName()]
    assert "monitor disconnected" in stated


@pytest.mark.parametrize("percent", [100, 150, 200])
def test_the_strip_has_devices_light_and_axes_and_the_bench_both_values_of_an_axis(
    qtbot: QtBot, frame: MainWindow, percent: int
) -> None:
    """The shutter always, wavelength and lamp where there is room; with an axis whose encoder contradicts."""
    frame.resize(*(side * 100 // percent for side in SCREEN))
    strip = frame.view.strip
    frame.view.devices.set_devices({each: status_of(each) for each in DEVICES})
    strip.set_light(BenchChanged(1234.5, True), LampRead(4.12e-7, True, calendar_stamp()))
    frame.view.axes.set_positions(dict.fromkeys(GREEK, 180.0), {"beta": 150.0})
    on_bench = frame.view.screen_of(BenchScreen).axes["beta"]
    frame.view.show_screen(view.SCREENS.index(BenchScreen))
    shown(qtbot, frame)
    on_bench.set_position(180.0)
    on_bench.set_unreferenced("it is jammed", 150.0)
    qtbot.wait(1)
    light, beta = (named_label(strip, name) for name in ("Light: ", "beta "))
    assert ("1234.5&nbsp;nm" in light.text()) == (percent < 200)
    assert "<b>open</b>" in light.text()
    assert ("lamp&nbsp;412&nbsp;nA" in light.text()) == (percent < 200)
    assert "shutter open, 1234.5 nm, lamp 412 nA" in light.accessibleName()
    assert beta.text() == "β ✗ 180.00° | 150.00°"
    assert on_bench.position.text() == "✗ 180.00° | 150.00°"
    assert [fault for fault in faults(frame, percent) if "180.00" in fault or "nm" in fault] == []


@pytest.mark.parametrize(
    ("lamp", "text"),
    [
        (None, "unknown"),
        (LampRead(4.12e-7, True, "2026-11-23T01:00:00+00:00"), "412 nA"),
        (LampRead(9.9996e-7, True, "2026-11-23T01:00:00+00:00"), "1 µA"),
        (LampRead(2.0e-13, False, "2026-11-23T01:00:00+00:00"), "no light"),
        (LampRead(4.12e-7, True, "2026-11-23T00:57:55+00:00"), "412 nA 2 min 05 s ago"),
    ],
)
def test_the_lamp_is_the_last_reading_with_its_age(lamp: LampRead | None, text: str) -> None:
    assert lamp_text(lamp, "2026-11-23T01:00:00+00:00") == text


@pytest.mark.parametrize(
    ("status", "text"),
    [
        (None, ("–", "not connected")),
        (DeviceStatus(Contact.CONNECTED, "PM100D"), ("✓", "connected")),
        (DeviceStatus(Contact.SILENT, "PM100D", "2026-11-23T00:59:46+00:00", "no reply"), ("✗", "silent since 14 s")),
        (DeviceStatus(Contact.DISCONNECTED, error="no reply"), ("✗", "disconnected")),
    ],
)
def test_a_device_has_one_state(status: DeviceStatus | None, text: tuple[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("goniotwin.app.desktop.rig.panels.calendar_stamp", lambda: "2026-11-23T01:00:00+00:00")
    assert contact_text(status) == text


def test_the_panels_have_the_axes_and_devices_of_a_rig() -> None:
    """They have these without the rig's modules, which take long to load."""
    assert tuple(GREEK) == AXES
    assert DEVICES == ROLES


def test_about_has_the_version(frame: MainWindow) -> None:
    assert goniotwin.__version__ in about_text()
    frame.menus.about_wanted.emit()
    frame.menus.help_wanted.emit()
    titles = {each.windowTitle() for each in QApplication.topLevelWidgets() if each.parent() is frame}
    assert {"About goniotwin", "Keys and screens"} <= titles


@given(low=st.floats(-14.0, 6.0), span=st.floats(0.01, 16.0), pixels=st.floats(60.0, 2000.0))
def test_the_texts_of_the_log_axis_never_collide(low: float, span: float, pixels: float) -> None:
    high = low + span
    ticks = log_ticks(low, high, pixels, PIXELS_OF_VALUE)
    assert all(low - 1e-6 <= each <= high + 1e-6 for each in ticks)
    assert all((after - before) * pixels / span >= PIXELS_OF_VALUE * (1 - 1e-6) for before, after in pairwise(ticks))
    if pixels >= 120.0:
        assert len(ticks) >= (2 if span < 1.0 else max(1, math.floor(span) // math.ceil(PIXELS_OF_VALUE * span / pixels)))


def test_the_texts_of_the_log_axis_are_the_values(qapp: QApplication) -> None:
    del qapp
    axis = ValueAxis()
    for low, high, pixels, texts in (
        (-3.0, 0.0, 90.0, ["0.001", "0.01", "0.1", "1"]),
        (0.3, 0.33, 150.0, ["2", "2.02", "2.04", "2.06", "2.08", "2.1", "2.12"]),
        (-9.0, -6.0, 60.0, ["1e-9", "1e-8", "1e-7", "1e-6"]),
    ):
        (_, labelled), _ = axis.tickValues(low, high, pixels)
        assert axis.tickStrings(labelled, 1.0, 1.0) == texts


def test_the_first_window_is_shown_before_the_engine_is_loaded() -> None:
    environment = {**os.environ, "QT_QPA_PLATFORM": "offscreen"}
    command = [sys.executable, "-m", "benchmarks.window", "--part", "first"]
    child = subprocess.run(command, cwd=REPOSITORY, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    found = json.loads(child.stdout.splitlines()[-1])
    assert found["heavy_modules"] == []
    assert found["first_window_cpu_s"] > 0.0
