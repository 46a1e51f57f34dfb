"""One state of each device, from its last answer: connected, silent, disconnected, and connected again by itself."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from goniotwin.app.campaign.running.events import EventLogged, State
from goniotwin.app.campaign.running.question import Answer
from goniotwin.app.rig import AXES
from goniotwin.app.station.contacts import ASK_S, CONNECT_S, REPEAT_S
from goniotwin.app.station.messages import Contact, DeviceChanged, QuestionAsked, RowSaved
from goniotwin.app.station.permissions import allowed
from goniotwin.drivers import Rig
from goniotwin.drivers.errors import NoAnswer, Taken
from tests.app.campaign.campaign_bench import QUIET
from tests.app.station.station_bench import Idle
from tests.conftest import SMALL, Writer

ASK = SMALL + '\n[faults]\nwire = "ask"\n'


@pytest.fixture
def idle(write_rig: Writer) -> Iterator[Idle]:
    idle = Idle(write_rig(*QUIET))
    idle.wait(2.0 * ASK_S)
    yield idle
    idle.station.close_rig()


def silent_positions(patch: pytest.MonkeyPatch) -> None:
    """Let the axes' controller not answer."""
    patch.setattr("goniotwin.drivers.motion.tmcl.axis.TmclAxis.position_deg", no_answer)


def no_answer(*_: object) -> float:
    raise NoAnswer("gamma", "GAP", "0 of 9 bytes")


def test_a_question_to_an_idle_device_is_repeated_twice_before_it_counts_as_lost(
    idle: Idle, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        silent_positions(patch)
        idle.wait(0.3)
        assert idle.status("axes").contact is Contact.SILENT
        assert idle.status("axes").identity == "TMCM-6214"
        assert "GAP" in idle.status("axes").detail
        idle.wait(1.5 * REPEAT_S)
        assert idle.status("axes").contact is Contact.SILENT
    idle.wait(REPEAT_S)
    assert idle.status("axes").connected
    assert "GAP" in idle.status("axes").detail  # its last fault stays
    silent_positions(monkeypatch)
    idle.wait(2.5 * REPEAT_S)
    assert idle.status("axes").contact is Contact.DISCONNECTED
    assert all(idle.status(each).connected for each in ("monochromator", "photodiodes", "monitor"))


def test_nothing_is_known_of_the_axes_of_a_silent_controller(idle: Idle, monkeypatch: pytest.MonkeyPatch) -> None:
    assert idle.station.snapshot.encoders.keys() == {"gamma", "sigma", "beta"}  # the shift has none
    silent_positions(monkeypatch)
    idle.wait(0.3)
    now = idle.station.snapshot
    assert now.rig is not None
    assert now.rig.silent_axes == ["gamma", "sigma", "beta", "shift"]
    assert (now.positions, now.encoders) == ({}, {})
    assert allowed(now)["start"] == "not responding: axes"


def test_a_lost_idle_device_is_connected_again_when_it_is_plugged_in(idle: Idle) -> None:
    """The walk: the monitor is unplugged, and everything else goes on."""
    monitor = idle.virtual.usb["monitor"]
    monitor.unplug()
    idle.wait(ASK_S + 3.0 * REPEAT_S)
    assert idle.status("monitor").contact is Contact.DISCONNECTED
    assert allowed(idle.station.snapshot)["start"] == "not responding: monitor"
    answered = idle.status("monitor").answered
    assert answered
    idle.wait(3.0 * CONNECT_S)
    assert idle.status("monitor").contact is Contact.DISCONNECTED
    monitor.replug()
    idle.wait(2.0 * CONNECT_S)
    assert idle.status("monitor").connected
    assert idle.status("monitor").answered >= answered
    assert idle.station.snapshot.rig is not None
    assert idle.station.snapshot.rig.not_responding == []


def test_axes_that_come_back_after_a_reset_are_unreferenced(idle: Idle) -> None:
    assert idle.station.snapshot.unreferenced == {}
    idle.virtual.serial["axes"].reset(idle.clock.now())
    moves = [idle.virtual.plant.shafts[axis].newest.moves for axis in AXES]
    idle.wait(0.3)
    assert idle.status("axes").contact is Contact.DISCONNECTED
    idle.wait(2.0 * CONNECT_S)
    assert idle.status("axes").connected
    assert idle.station.snapshot.unreferenced.keys() == set(AXES)
    assert [idle.virtual.plant.shafts[axis].newest.moves for axis in AXES] == moves


def test_a_device_that_another_program_has_taken_is_left_to_it(idle: Idle, monkeypatch: pytest.MonkeyPatch) -> None:
    attempts: list[str] = []

    def taken(*_: object) -> float:
        raise Taken("axes", "check the canary", "another program has taken the controller")

    monkeypatch.setattr(Rig, "connect_device", lambda _rig, name: attempts.append(name))
    monkeypatch.setattr("goniotwin.drivers.motion.tmcl.axis.TmclAxis.position_deg", taken)
    idle.wait(4.0 * CONNECT_S)
    assert idle.status("axes").contact is Contact.DISCONNECTED
    assert "another program" in idle.status("axes").error
    assert attempts == []


def test_a_device_that_was_never_there_is_connected_by_hand_alone(
    write_rig: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its port may be another device's."""
    idle = Idle(write_rig(*QUIET, ('port = "twin://virtual/axes"', f'port = "{(tmp_path / "none").as_posix()}"')))
    attempts: list[str] = []
    monkeypatch.setattr(idle.opened.rig, "connect_device", attempts.append)
    idle.wait(4.0 * CONNECT_S)
    assert idle.status("axes").contact is Contact.DISCONNECTED
    assert attempts == []
    idle.station.close_rig()


def test_a_device_that_fails_in_a_run_is_silent_until_a_row_has_its_answer(
    idle: Idle, write_schedule: Writer, tmp_path: Path
) -> None:
    module = idle.virtual.modbus["adc-2"]
    seen: list[Contact] = []

    def react(message: object) -> None:
        match message:
            case QuestionAsked(number, question) if Answer.MOUNTED in question.answers:
                idle.station.answer(number, Answer.MOUNTED)
            case QuestionAsked(number, question):
                assert question.device == "photodiodes"
                seen.append(idle.status("photodiodes").contact)
                module.units = (1,)
                idle.station.answer(number, Answer.RETRY)
            case RowSaved(row) if row.kind == "dark" and not seen:
                module.units = (9,)
            case RowSaved(row) if row.kind == "measure":
                seen.append(idle.status("photodiodes").contact)

    idle.reactions.append(react)
    idle.station.start(write_schedule(text=ASK), tmp_path, person=True)
    assert idle.work().state is State.DONE
    assert seen[0] is Contact.SILENT
    assert set(seen[1:]) == {Contact.CONNECTED}


def contacts_during_a_question(idle: Idle, device: str, lose: Callable[[], None], restore: Callable[[], None]) -> list[Contact]:
    """Contacts of a device that is lost at the first question, and restored once that is noted; then the answer."""
    seen: list[Contact] = []

    def react(message: object) -> None:
        question = idle.station.snapshot.question
        match message:
            case QuestionAsked() if not seen:
                lose()
            case QuestionAsked(number, _):
                idle.station.answer(number, Answer.MOUNTED)
            case DeviceChanged(name, status) if name == device:
                seen.append(status.contact)
                restore()
                idle.wall.sleep_until(idle.wall.now() + REPEAT_S)
                if status.connected and question is not None:
                    idle.station.answer(question.number, Answer.MOUNTED)

    idle.reactions.append(react)
    return seen


def test_axes_that_do_not_respond_while_a_question_waits_are_silent(idle: Idle, write_schedule: Writer, tmp_path: Path) -> None:
    """A mounting may last an hour. When they respond again they are connected, and the run goes on."""
    silent = pytest.MonkeyPatch()
    seen = contacts_during_a_question(idle, "axes", lambda: silent_positions(silent), silent.undo)
    idle.station.start(write_schedule(text=SMALL), tmp_path, person=True)
    assert idle.work().state is State.DONE
    assert seen == [Contact.SILENT, Contact.CONNECTED]


def test_a_device_that_fails_while_a_question_waits_is_silent_until_it_responds(
    idle: Idle, write_schedule: Writer, tmp_path: Path
) -> None:
    """A mounting in whose middle the monitor's cable is pulled and plugged in again."""
    monitor = idle.virtual.usb["monitor"]

    def unplug() -> None:
        monitor.unplug()
        idle.wall.sleep_until(idle.wall.now() + ASK_S)

    seen = contacts_during_a_question(idle, "monitor", unplug, monitor.replug)
    idle.station.start(write_schedule(text=SMALL), tmp_path, person=True)
    assert idle.work().state is State.DONE
    assert seen == [Contact.SILENT, Contact.CONNECTED]


@pytest.mark.parametrize(("device", "question"), [("monochromator", "ask"), ("monitor", "ask"), ("photodiodes", "check")])
def test_the_run_learns_of_a_reset_while_a_question_waits(
    idle: Idle, write_schedule: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, device: str, question: str
) -> None:
    """The question that finds a device reset restores nothing: wavelength, gain and averaging are the run's."""
    resets: dict[str, Callable[[float], None]] = {
        "monochromator": idle.virtual.serial["mono"].reset,
        "photodiodes": idle.virtual.modbus["adc-2"].reset,
        "monitor": idle.virtual.usb["monitor"].instrument.power_cycle,
    }
    driver = idle.opened.rig.device(device)
    ask = getattr(driver, question)
    asked: list[int] = []
    faults: list[str] = []
    flags: list[tuple[str, ...]] = []

    def ask_and_answer() -> None:
        try:
            ask()
        finally:
            if len(asked) > 1:
                idle.station.answer(asked[-1], Answer.MOUNTED)

    def react(message: object) -> None:
        match message:
            case QuestionAsked(number, _):
                asked.append(number)
                if len(asked) == 1:
                    idle.station.answer(number, Answer.MOUNTED)
                else:
                    resets[device](idle.clock.now())
                    idle.wall.sleep_until(idle.wall.now() + ASK_S)
            case EventLogged("fault", what):
                faults.append(what)
            case RowSaved(_, row_flags):
                flags.append(row_flags)

    monkeypatch.setattr(driver, question, ask_and_answer)
    idle.reactions.append(react)
    idle.station.start(write_schedule(text=SMALL), tmp_path, person=True)
    assert idle.work().state is State.DONE, (idle.station.snapshot.reason, faults)
    assert len(asked) > 1
    assert any("has lost its settings" in each or "have lost their settings" in each for each in faults), faults
    assert set(flags) == {()}


def test_a_move_of_a_jammed_axis_ends_with_the_contradiction_and_both_values_are_known(idle: Idle) -> None:
    idle.virtual.plant.shafts["beta"].jam(idle.clock.now())
    idle.station.move("beta", 20.0)
    idle.work()
    assert "more than 0.05 deg apart" in idle.error
    idle.wait(2.0)
    now = idle.station.snapshot
    assert now.unreferenced.keys() == {"beta"}
    assert now.positions["beta"] == pytest.approx(20.0, abs=0.001)
    assert now.encoders["beta"] == pytest.approx(0.0, abs=0.001)
