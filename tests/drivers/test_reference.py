"""Whether it is known where an axis is: what one process knows of it, and what the next one makes of that."""

import contextlib

import pytest

from goniotwin.drivers import DeviceError, Homing, wait
from goniotwin.drivers.errors import Forgotten, Unreferenced
from goniotwin.protocols.tmcl_parameters import SearchMode
from tests.drivers.axis_bench import DriverBench

PARKED, ANYWHERE = {"power_up_at_reference": True}, {"power_up_at_reference": False}
HOMING = Homing(mode=SearchMode.HOME_NEGATIVE_NO_STOPS, speed=10.0, switch_speed=0.5, angle_deg=-4.0)
HOME = {"home_deg": -5.0}


def test_an_axis_that_may_be_anywhere_goes_nowhere_after_a_power_up_until_somebody_says_where_it_is() -> None:
    bench = DriverBench(ANYWHERE).connect()
    with pytest.raises(Unreferenced, match=r"powered up or has reset.*goniotwin home, goniotwin here"):
        bench.axis.start(10.0)
    bench.next_process()
    assert "powered up" in bench.axis.unreferenced_reason or "left it unreferenced" in bench.axis.unreferenced_reason
    bench.axis.set_position(0.0)
    bench.move(10.0)
    bench.next_process()
    assert bench.axis.referenced
    assert bench.axis.position_deg() == pytest.approx(10.0, abs=1e-3)


@pytest.mark.parametrize("settings", [PARKED, ANYWHERE])
def test_a_reset_that_a_run_has_met_is_known_to_the_next_process(settings: dict[str, bool]) -> None:
    """Its counter says 0 at 10 deg, wherever the file says that it is parked."""
    bench = DriverBench(settings, axes=2).connect()
    for axis in bench.axes.values():
        axis.set_position()
    bench.move(10.0)
    bench.line.reset(bench.clock.now())
    with pytest.raises(Forgotten):
        bench.axis.position_deg()
    for _ in range(3):
        bench.next_process()
        for axis in bench.axes.values():
            with pytest.raises(Unreferenced):
                axis.start(20.0)
    bench.axis.set_position(10.0)
    bench.next_process()
    bench.move(20.0)
    assert bench.angle() == pytest.approx(20.0, abs=1e-3)
    assert not bench.axes["beta"].referenced


def test_a_reset_between_two_processes_is_noticed() -> None:
    bench = DriverBench(ANYWHERE).connect()
    bench.axis.set_position(0.0)
    bench.move(10.0)
    bench.module.close()
    bench.line.reset(bench.clock.now())
    for _ in range(2):  # one that connects and ends does not make it good
        bench.next_process()
        with pytest.raises(Unreferenced):
            bench.axis.start(20.0)


def test_a_process_that_ends_between_canary_and_settings_does_not_make_it_good() -> None:
    bench = DriverBench(ANYWHERE)
    bench.module.connect()  # the axes are not connected any more
    bench.next_process()
    assert "powered up" in bench.axis.unreferenced_reason


def test_what_was_homed_is_believed_by_the_next_process_though_homing_is_required() -> None:
    required = {"homing": HOMING, "homing_required": True, "power_up_at_reference": False}
    bench = DriverBench(required, HOME).connect()
    assert "homed" in bench.axis.unreferenced_reason
    wait(bench.clock, [bench.axis.start_homing()])
    bench.next_process()
    bench.move(10.0)
    assert bench.angle() == pytest.approx(10.0, abs=1e-2)


def test_a_search_that_never_ended_leaves_it_in_doubt_for_the_next_process() -> None:
    bench = DriverBench({"homing": HOMING}, HOME).connect()
    search = bench.axis.start_homing()
    bench.keep(search, 0.2)
    bench.clock.sleep_until(bench.clock.now() + 10.0)  # nobody speaks to it: its heartbeat stops it
    bench.next_process()
    assert bench.axis.unreferenced_reason == "an earlier run has left it unreferenced"


def test_a_stall_that_nobody_asked_for_any_more_is_met_by_the_next_process() -> None:
    bench = DriverBench({"stall_speed": 1.0, "encoder": False}).connect()
    move = bench.axis.start(30.0)
    bench.keep(move, 1.5)
    bench.plant.shafts["sigma"].jam(bench.clock.now())
    bench.clock.sleep_until(bench.clock.now() + 10.0)
    bench.next_process()
    assert bench.axis.unreferenced_reason == "stall has stopped it before it was connected"


def slipped(**settings: object) -> DriverBench:
    bench = DriverBench(dict(settings)).connect()
    bench.plant.shafts["sigma"].jam(bench.clock.now())
    with contextlib.suppress(DeviceError):
        bench.move(10.0)
    return bench


def test_an_encoder_that_disagrees_is_told_with_both_angles_and_stays_told() -> None:
    bench = slipped()
    with pytest.raises(Unreferenced, match=r"sigma: .*10\.000 deg.*0\.000 deg.*0\.05 deg apart; home it"):
        bench.axis.read_back()
    bench.plant.shafts["sigma"].jam(bench.clock.now(), jammed=False)
    for _ in range(2):
        with pytest.raises(Unreferenced):
            bench.axis.start(20.0)
        bench.next_process()
    bench.axis.set_position(0.0)
    bench.move(10.0)
    assert bench.axis.read_back()[0] == pytest.approx(10.0)


def test_an_encoder_that_disagrees_is_noticed_when_connecting() -> None:
    bench = slipped()
    bench.next_process()
    assert "its encoder at 0.000 deg" in bench.axis.unreferenced_reason


@pytest.mark.parametrize("settings", [{"encoder_tolerance_deg": 0.0}, {"encoder_tolerance_deg": 10.5}, {"encoder": False}])
def test_the_tolerance_is_the_operators(settings: dict[str, float]) -> None:
    bench = slipped(**settings)
    assert bench.axis.read_back()[0] == pytest.approx(10.0)
    bench.next_process()
    assert bench.axis.referenced


def test_the_believed_backlash_is_no_disagreement() -> None:
    bench = DriverBench({"backlash_deg": 0.3}, {"backlash_deg": 0.3}).connect()
    for angle in (10.0, 5.0, 5.1, 20.0):
        bench.move(angle)
        bench.axis.read_back()
    bench.next_process()
    assert bench.axis.referenced


def test_one_wrong_answer_is_no_disagreement(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = DriverBench().connect()
    answers = iter([3.0, 0.0])
    monkeypatch.setattr(bench.axis, "encoder_deg", lambda: next(answers))
    assert bench.axis.read_back() == (0.0, 0.0)
    assert bench.axis.referenced


def test_the_counter_of_an_axis_that_turns_is_not_held_against_its_encoder() -> None:
    bench = DriverBench().connect()
    bench.axis.start(100.0)
    bench.clock.sleep_until(bench.clock.now() + 1.0)
    bench.next_process()
    assert bench.axis.referenced
