"""The bench screen and the rig screen on a station of the virtual rig, on the virtual clock: no thread, no wire, no wait."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import cast

import pytest
from PySide6.QtCore import QPoint, QRect, QSize, Qt
from PySide6.QtWidgets import QApplication, QLineEdit, QPushButton, QWidget
from pytestqt.qtbot import QtBot

from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.row import RowData
from goniotwin.app.campaign.running.events import EventLogged, Positions, State, StateChanged
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.desktop import MainWindow
from goniotwin.app.desktop.bench.position_entry import PositionEntry
from goniotwin.app.desktop.bench.screen import CANCEL, SET_POSITION, BenchScreen
from goniotwin.app.desktop.model.messages import Attached, PastRead
from goniotwin.app.desktop.model.rig_facts import DarkAges
from goniotwin.app.desktop.rig.panels import answered_text
from goniotwin.app.desktop.rig.screen import RigScreen
from goniotwin.app.desktop.theme import DARK, LIGHT
from goniotwin.app.rig import RigFile, read_rig
from goniotwin.app.station.messages import (
    ActivityChanged,
    Message,
    Snapshot,
    SpeedChanged,
    advance,
)
from goniotwin.app.station.permissions import CommandRefused, allowed
from goniotwin.app.station.poller import ENCODERS_S, POLL_S
from goniotwin.app.station.station import Station
from goniotwin.drivers import Monitor, NoAnswer
from goniotwin.protocols.clock import VirtualClock
from tests.app.campaign.campaign_bench import QUIET
from tests.app.desktop.conftest import READY_MS
from tests.conftest import Writer

AXES = ("sigma", "beta", "shift", "gamma")


class Desk:
    """Both screens as clients of one station. Each command is carried out at once."""

    def __init__(self, qtbot: QtBot, rig: Path) -> None:
        self.qtbot = qtbot
        self.bench, self.rig = BenchScreen(LIGHT), RigScreen(LIGHT)
        self.events: list[Message] = []
        self.commands: list[tuple[str, dict[str, object]]] = []
        self.state = Snapshot()
        self.clock, self.wall = VirtualClock(), VirtualClock()
        self.station = Station(clock=self.clock, wall=self.wall)
        description = read_rig(rig)
        for screen in (self.bench, self.rig):
            qtbot.addWidget(screen)
            screen.complete()
            screen.set_rig(description.file)
            screen.command.connect(self._command)
        self.station.board.subscribe(self._note)
        self.station.open(description)
        self.station.connect_all()
        self.settle()

    def _note(self, _number: int, message: Message) -> None:
        self.events.append(message)
        self.show(message)

    def show(self, message: Message) -> None:
        """Show an event in both screens, and what is refused from then on."""
        self.state = advance(self.state, message)
        for screen in (self.bench, self.rig):
            screen.show_message(message)
            screen.set_refusals(allowed(self.state))

    def _command(self, command: str, arguments: object) -> None:
        given = cast(dict[str, object], arguments)
        self.commands.append((command, given))
        try:
            getattr(self.station, command)(**given)
        except CommandRefused as refusal:
            self.bench.show_refusal(str(refusal))
        self.settle()

    def settle(self) -> None:
        """Do what is asked for, and report the positions."""
        self.station.work()
        self.wall.sleep_until(self.wall.now() + POLL_S)
        self.station.tick()

    def rest(self) -> None:
        """Let a second of the rig's time pass, after which counters and encoders at rest are compared."""
        self.settle()
        self.clock.sleep_until(self.clock.now() + 1.0)
        self.wall.sleep_until(self.wall.now() + ENCODERS_S)
        self.settle()

    def close(self) -> None:
        self.station.close_rig()
        self.bench.shut_down()

    def go(self, axis: str, angle: str) -> None:
        """Type an angle, and press Enter."""
        field = self.bench.axes[axis].target
        field.selectAll()
        self.qtbot.keyClicks(field, angle)
        self.qtbot.keyClick(field, Qt.Key.Key_Return)

    def press(self, button: QPushButton) -> None:
        assert button.isEnabled(), button.toolTip()
        self.qtbot.keyClick(button, Qt.Key.Key_Space)


@pytest.fixture
def desk(qtbot: QtBot, write_rig: Writer) -> Iterator[Desk]:
    desk = Desk(qtbot, write_rig(*QUIET))
    yield desk
    desk.close()


def test_nothing_moves_on_connect(desk: Desk) -> None:
    assert desk.commands == []
    assert [desk.bench.axes[axis].position.text() for axis in AXES] == ["0.00°"] * 4
    assert {tuple(each.degrees.values()) for each in desk.events if isinstance(each, Positions)} == {(0.0,) * 4}
    assert desk.bench.status.text() == "Ready. Nothing moves before a command."
    assert desk.bench.light.shutter.text() == "Open"


def test_an_axis_goes_where_it_is_sent_by_the_keyboard(desk: Desk) -> None:
    desk.go("sigma", "30")
    assert desk.bench.axes["sigma"].position.text() == "30.00°"
    assert "σ 30.00°" in desk.bench.instrument.summary
    assert desk.commands == [("move", {"axis": "sigma", "target_deg": 30.0})]


def test_steps_of_a_jog_add_up(desk: Desk) -> None:
    sigma = desk.bench.axes["sigma"]
    desk.bench.step.setCurrentIndex(desk.bench.step.findData(0.1))
    for _ in range(3):
        desk.press(sigma.up)
    desk.press(sigma.down)
    assert desk.commands[-1] == ("move", {"axis": "sigma", "target_deg": 0.2})
    assert sigma.position.text() == "0.20°"


@pytest.mark.parametrize(
    ("typed", "moved"), [("30,5", 30.5), ("1e309", None), ("1.234,5", None), ("1,000", 1.0), ("30.005", None), ("", None)]
)
def test_a_number_is_what_was_typed_or_refused(desk: Desk, typed: str, moved: float | None) -> None:
    """A comma drove an axis to ten times the angle."""
    sigma = desk.bench.axes["sigma"]
    sigma.target.setFocus()
    desk.go("sigma", typed) if typed else desk.go("sigma", "\b")
    assert [each["target_deg"] for _, each in desk.commands] == ([] if moved is None else [moved])
    assert ("give a number" in desk.bench.status.text()) == (moved is None)
    assert sigma.target.value() == (moved or 0.0)
    desk.bench.light.readings.selectAll()
    desk.qtbot.keyClicks(desk.bench.light.readings, "1,5")
    desk.press(desk.bench.light.read)
    assert [name for name, _ in desk.commands if name == "read"] == []
    assert "whole" in desk.bench.status.text()


def test_fields_have_what_is_there_unless_it_is_being_edited(desk: Desk) -> None:
    """Enter in a field with an old angle drove there."""
    sigma, light = desk.bench.axes["sigma"], desk.bench.light
    desk.station.move("sigma", 20.0)  # as a run does, or another window
    desk.settle()
    assert sigma.target.value() == 20.0
    desk.qtbot.keyClicks(sigma.target, "7")
    desk.station.move("sigma", 25.0)
    desk.settle()
    assert sigma.target.value() == 20.0
    assert "7" in sigma.target.text()
    desk.station.wavelength(600.0)
    desk.settle()
    light.wavelength.selectAll()
    desk.qtbot.keyClicks(light.wavelength, "9000")
    desk.qtbot.keyClick(light.wavelength, Qt.Key.Key_Return)
    assert "9000 nm" in desk.bench.status.text()
    assert "schedule" not in desk.bench.status.text()
    assert light.wavelength.value() == 600.0


def test_enter_during_a_move_is_refused_in_words(desk: Desk) -> None:
    desk.show(ActivityChanged("moving sigma to 30 deg"))
    desk.go("beta", "10")
    assert desk.commands == []
    assert desk.bench.status.text() == "✗ beta is not moved: moving sigma to 30 deg"


def test_a_refused_move_gives_its_reason_and_moves_nothing(desk: Desk) -> None:
    desk.go("sigma", "200")
    assert "✗ sigma: move to 200 deg: outside its soft limits 0 to 180 deg" in desk.bench.status.text()
    assert desk.bench.axes["sigma"].position.text() == "0.00°"
    desk.go("shift", "5")
    assert desk.bench.status.text().startswith("Ready")
    assert "must not cross the incoming beam" in desk.bench.instrument.summary
    desk.go("beta", "300")
    assert "the arc would collide with the incoming beam" in desk.bench.status.text()
    assert desk.bench.axes["beta"].position.text() == "0.00°"


def test_a_position_is_set_only_after_a_question(desk: Desk) -> None:
    """Its field is empty whatever the bench shows, and an answer without an angle is none."""
    sigma = desk.bench.axes["sigma"]
    for choice, commands in ((CANCEL, 0), (SET_POSITION, 1)):
        sigma.target.setValue(12.5)
        desk.press(sigma.set_button)
        question = desk.bench.question
        assert question is not None
        field = question.findChild(QLineEdit)
        assert field is not None
        assert field.text() == ""
        if choice == SET_POSITION:
            question.buttons[SET_POSITION].click()
            assert "read the angle from the scale" in question.problem
            desk.qtbot.keyClicks(field, "12,5")
            desk.qtbot.keyClick(field, Qt.Key.Key_Return)  # neither that answer nor the default
            assert question.isVisible()
        assert len(desk.commands) == 0
        question.buttons[choice].click()
        assert len(desk.commands) == commands
    assert sigma.position.text() == "12.50°"


def test_an_axis_whose_encoder_contradicts_is_marked_with_both_values(desk: Desk) -> None:
    """A jammed axis: its counter has gone on. The encoder's value is taken by a button."""
    opened = desk.station.opened
    assert opened is not None
    assert opened.virtual is not None
    shaft = opened.virtual.plant.shafts["sigma"]
    desk.go("sigma", "30")
    shaft.jam(opened.rig.clock.now())
    desk.go("sigma", "60")
    sigma = desk.bench.axes["sigma"]
    assert "more than 0.05 deg apart" in desk.bench.status.text()
    desk.rest()
    assert sigma.position.text() == "✗ 60.00° | 30.00°"
    assert "σ ✗ 60.00° | 30.00°" in desk.bench.instrument.summary
    desk.press(sigma.set_button)
    question = desk.bench.question
    assert question is not None
    entry = question.findChild(PositionEntry)
    assert entry is not None
    assert entry.place == "60.000°, 30.000°, −30.000°"
    assert entry.field.text() == ""
    shaft.jam(opened.rig.clock.now(), False)
    desk.rest()
    entry.take.click()
    question.buttons[SET_POSITION].click()
    desk.rest()
    assert sigma.position.text() == "30.00°"
    assert opened.virtual.plant.angle_deg("sigma", opened.rig.clock.now()) == pytest.approx(30.0, abs=0.01)


def test_the_encoder_that_a_reset_has_zeroed_is_not_offered(desk: Desk) -> None:
    opened = desk.station.opened
    assert opened is not None
    assert opened.virtual is not None
    desk.go("sigma", "30")
    desk.rest()
    opened.virtual.serial["axes"].reset(opened.rig.clock.now())
    for _ in range(9):  # found, given up, and connected again
        desk.rest()
    sigma = desk.bench.axes["sigma"]
    assert sigma.position.text() == "✗ 0.00°"
    desk.press(sigma.set_button)
    question = desk.bench.question
    assert question is not None
    entry = question.findChild(PositionEntry)
    assert entry is not None
    assert entry.place == "0.000°, lost in the reset, –"
    assert not entry.take.isEnabled()
    assert "lost in the reset" in entry.take.toolTip()
    entry.field.setText("30")
    question.buttons[SET_POSITION].click()
    desk.rest()
    assert sigma.position.text() == "30.00°"
    assert desk.station.snapshot.encoders["sigma"] == pytest.approx(30.0, abs=0.01)


def test_an_unreferenced_axis_is_marked(qtbot: QtBot, write_rig: Writer) -> None:
    desk = Desk(qtbot, write_rig(*QUIET, ("settling_s = 0.2\npower_up_at_reference = true", "settling_s = 0.2")))
    sigma = desk.bench.axes["sigma"]
    assert sigma.position.text().startswith("✗")
    assert "unreferenced" in sigma.position.accessibleName()
    desk.go("sigma", "30")
    assert desk.bench.status.text().startswith("✗ sigma: move to 30 deg: ")
    desk.bench.command.emit("set_position", {"axis": "sigma", "angle_deg": 0.0})
    assert sigma.position.text() == "0.00°"
    desk.close()


def test_a_reading_has_a_bar_for_each_photodiode(desk: Desk) -> None:
    light = desk.bench.light
    desk.bench.command.emit("mount", {"sample": "gaussian-5"})
    desk.go("sigma", "30")
    desk.go("beta", "180")
    light.gain.setCurrentIndex(light.gain.findData(1e10))
    light.gain.activated.emit(light.gain.currentIndex())
    desk.press(light.dark)
    assert desk.bench.reading_text.text() == "Dark reading: 36 photodiodes at 1e+10 V/A; ▽ 36 without light"
    desk.press(light.shutter)
    assert (light.shutter.text(), light.shutter.accessibleName()) == ("Close", "Close the shutter")
    desk.press(light.read)
    assert "Mean of 4: 36 photodiodes" in desk.bench.reading_text.text()
    assert "▲ 1 saturated" in desk.bench.bars.summary  # the specular direction at the highest gain but one
    assert "no dark reading" not in desk.bench.bars.summary
    assert "nA" in desk.bench.trend.summary
    assert desk.bench.light.sample.currentText() == "gaussian-5"


def test_live_readings_go_on_until_they_are_switched_off(desk: Desk) -> None:
    light = desk.bench.light
    light.live.click()
    assert (desk.station.snapshot.bench.live, light.live.isChecked()) == (True, True)
    assert desk.bench.status.text() == "Live readings."
    light.live.click()
    assert (desk.station.snapshot.bench.live, light.live.isChecked()) == (False, False)


def test_during_a_run_the_bench_only_shows(desk: Desk) -> None:
    desk.show(StateChanged(State.RUNNING))
    sigma, light = desk.bench.axes["sigma"], desk.bench.light
    for control in (sigma.go, sigma.up, sigma.set_button, light.read, light.shutter, light.live, light.gain):
        assert not control.isEnabled()
        assert control.toolTip() == "a run is running"
    assert desk.bench.status.text() == "A run is running: the bench only shows."
    desk.qtbot.keyClick(sigma.target, Qt.Key.Key_Return)
    assert desk.commands == []


def test_each_control_has_a_name_and_is_reached_by_tab(desk: Desk) -> None:
    controls = [*(each for axis in desk.bench.axes.values() for each in axis.controls), desk.bench.step]
    light = desk.bench.light
    controls += [light.wavelength, light.set_wavelength_button, light.shutter, light.gain, light.sample, light.read, light.dark]
    names = [each.accessibleName() for each in (*controls, light.readings, light.live)]
    assert all(names)
    assert len(set(names)) == len(names)
    assert all(each.focusPolicy() & Qt.FocusPolicy.TabFocus for each in controls)


def test_the_pictures_have_words_and_follow_the_scheme(desk: Desk) -> None:
    for picture in (desk.bench.instrument, desk.bench.bars, desk.bench.trend):
        assert picture.accessibleName()
        assert picture.accessibleDescription()
    desk.bench.resize(900, 600)
    light = desk.bench.grab().toImage()
    desk.bench.set_colours(DARK)
    assert light != desk.bench.grab().toImage()


def test_what_the_mirror_unit_blocks_is_computed_while_the_screen_is_shown(desk: Desk) -> None:
    desk.go("sigma", "30")
    assert desk.bench.instrument.cells is None
    with desk.qtbot.waitSignal(desk.bench.instrument.blocked_shown, timeout=30_000) as shown:
        desk.bench.show()
    assert shown.args == [frozenset({6})]
    assert desk.bench.instrument.blocked == {6}
    assert "1 photodiode blocked by the mirror unit" in desk.bench.instrument.summary


def test_the_parts_come_back_from_the_tabs_of_a_small_room(desk: Desk) -> None:
    bench, rig = desk.bench, desk.rig
    columns: list[tuple[QWidget, list[QWidget]]] = [
        (bench, [*bench.axes.values(), bench.light]),
        (bench, [bench.bars, bench.reading_text, bench.trend]),
        (rig, [rig.rig, rig.devices, rig.axes]),
    ]

    def places(room: QSize) -> list[list[QRect]]:
        for screen in (bench, rig):
            screen.resize(room)
            screen.fit(room)
            screen.show()
        QApplication.processEvents()  # the layouts are computed again
        return [[QRect(part.mapTo(screen, QPoint()), part.size()) for part in parts] for screen, parts in columns]

    before = places(QSize(900, 600))
    for column in before:
        assert all(upper.bottom() < lower.top() for upper, lower in pairwise(column))
        assert len({each.left() for each in column}) == 1
    for _ in range(2):
        assert places(QSize(548, 259)) != before
        assert places(QSize(900, 600)) == before
        assert all(part.isVisible() for _, parts in columns for part in parts)
    assert before[0][-1].bottom() < before[1][-1].bottom()  # the room is below the parts at the left


# The rig screen.


def test_the_rig_screen_knows_devices_answers_and_errors(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    text = desk.rig.devices.text("axes")
    assert "✓ connected" in text
    assert "TMCM-6214" in text
    assert "answered" in text
    lost = "Monitor (PM100D) is not responding: check the cable"

    def lose(*_: object) -> None:
        raise NoAnswer("monitor", "READ?", "no reply", "check the cable")

    with monkeypatch.context() as patch:
        patch.setattr(Monitor, "start_mean", lose)
        desk.station.read()
        desk.settle()
    text = desk.rig.devices.text("monitor")
    assert "✗ disconnected" in text
    assert "last answered" in text
    assert lost in text
    desk.rig.devices.reconnect.emit("monitor")
    assert desk.commands == [("connect", {"device": "monitor"})]
    text = desk.rig.devices.text("monitor")
    assert "✓ connected" in text
    assert "last error at" in text


@pytest.mark.parametrize(
    ("now", "text"),
    [
        ("2026-11-23T01:00:02+00:00", "answered just now"),
        ("2026-11-23T01:01:05+00:00", "answered 1 min 05 s ago"),
        ("2026-11-23T03:01:05+01:00", "answered 1 h 01 min ago"),
    ],
)
def test_the_last_answer_has_an_age(now: str, text: str) -> None:
    assert answered_text("2026-11-23T01:00:00+00:00", now) == text
    assert answered_text("", now) == ""


def test_the_preflight_list_follows_the_rig(desk: Desk, write_schedule: Writer, tmp_path: Path, write_rig: Writer) -> None:
    screen = desk.rig
    screen.set_folder(tmp_path / "new" / "folder")
    screen.set_plan(make_plan(read_schedule(write_schedule()), read_rig(write_rig(*QUIET))))
    screen.show()
    assert "Ports: good: all 4 devices respond" in screen.preflight.text
    assert "Dark reading: unknown" in screen.preflight.text
    assert f"free in {tmp_path}" in screen.preflight.text
    screen.command.emit("read", {"dark": True})
    screen.hide()
    screen.show()
    assert "Dark reading: unknown" not in screen.preflight.text
    assert "old, renewed after" in screen.preflight.text


def test_a_dark_reading_ages_with_the_simulation(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    """A second at speed 60 and a second at speed 1 are 61 s of the rig."""
    seconds = [1000.0]
    monkeypatch.setattr("goniotwin.protocols.clock.time.monotonic", lambda: seconds[0])
    facts = desk.rig.facts
    desk.rig.command.emit("read", {"dark": True})
    facts.take(SpeedChanged(60.0))
    seconds[0] += 1.0
    facts.take(SpeedChanged(1.0))
    seconds[0] += 1.0
    assert facts.facts().dark_age_s == pytest.approx(61.0)


def test_dark_readings_are_repeated_by_the_rigs_clock_or_it_is_stated(
    write_schedule: Writer, write_rig: Writer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows as planned, then ones that last longer, because the computer does not follow; of a virtual rig they are no event."""
    text = ("shift_deg = [0, 1]", "shift_deg = [0, 1, 2, 3, 4]\ndark_every_s = 10")
    plan = make_plan(read_schedule(write_schedule(text)), read_rig(write_rig(*QUIET)))
    assert sum(row.kind == "dark" for row in plan.rows) >= 4

    def events(slower: float) -> list[EventLogged]:
        now, ages, found = 0.0, DarkAges(plan), []
        for row in plan.rows:
            begun, now = now, now + slower * row.seconds
            found.append(ages.add(row, RowData(begun, now, None, ())))
        return [each for each in found if each is not None]

    assert events(1.0) == []
    assert events(3.0) == []
    monkeypatch.setattr(RigFile, "in_process", False)
    assert events(1.0) == []
    (event,) = events(3.0)
    assert "old, dark_every_s is 10" in event.what


def test_a_window_that_is_attached_later_has_the_dark_readings_age_and_the_drift(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the journal: 100 s of the rig's time before, and 60 more since."""
    seconds = [1000.0]
    monkeypatch.setattr("goniotwin.protocols.clock.time.monotonic", lambda: seconds[0])
    facts = desk.rig.facts
    snapshot = replace(facts.station, speed=60.0, reading=None)
    desk.rig.show_message(Attached("window", snapshot, found=True, t_s=5000.0))
    assert facts.facts().dark_age_s is None
    seconds[0] += 1.0
    drift = EventLogged("drift", "beyond the limit: +2 %", "x/drift")
    desk.rig.show_message(PastRead((), 4900.0, drift))
    assert facts.facts().dark_age_s == pytest.approx(160.0)
    assert (facts.facts().drift, facts.facts().drift_beyond) == (drift.what, True)


def test_the_bench_of_a_window_is_a_client_of_its_station(qtbot: QtBot, window: MainWindow) -> None:
    bench = window.view.screen_of(BenchScreen)
    sigma = bench.axes["sigma"]
    window.view.show_screen(window.view.screens.index(bench))
    qtbot.waitUntil(lambda: sigma.position.text() == "0.00°" and bench.instrument.summary.startswith("γ"), timeout=READY_MS)
    for angle, shown in (("200", "outside its soft limits 0 to 180 deg"), ("30", "")):
        sigma.target.selectAll()
        qtbot.keyClicks(sigma.target, angle)
        qtbot.keyClick(sigma.target, Qt.Key.Key_Return)
        qtbot.waitUntil(lambda shown=shown: shown in bench.status.text(), timeout=READY_MS)  # type: ignore[misc]
    qtbot.waitUntil(lambda: sigma.position.text() == "30.00°", timeout=READY_MS)
