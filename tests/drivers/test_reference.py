"""Reference of an axis across processes: what one process stores, and how the next one uses it."""

import contextlib

import pytest

from goniotwin.drivers import DeviceError, Homing, wait
from goniotwin.drivers.errors import Forgotten, Unreferenced
from goniotwin.protocols.tmcl_parameters import SearchMode
from tests.drivers.axis_bench import AxisBench

PARKED, ANYWHERE = {"power_up_at_reference": True}, {"power_up_at_reference": False}
HOMING = Homing(mode=SearchMode.HOME_NEGATIVE_NO_STOPS, speed_deg_s=10.0, switch_speed_deg_s=0.5, angle_deg=-4.0)
HOME = {"home_deg": -5.0}


def test_after_a_power_up_an_axis_is_unreferenced_until_its_position_is_set() -> None:
    bench = AxisBench(ANYWHERE).connect()
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
def test_a_reset_detected_by_one_process_is_known_to_the_next(settings: dict[str, bool]) -> None:
    """Its counter is 0 at 10 deg, with `power_up_at_reference` or without it."""
    bench = AxisBench(settings, axes=2).connect()
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


def test_a_reset_between_two_processes_is_detected() -> None:
    bench = AxisBench(ANYWHERE).connect()
    bench.axis.set_position(0.0)
    bench.move(10.0)
    bench.module.close()
    bench.line.reset(bench.clock.now())
    for _ in range(2):  # a process that connects and ends does not reference the axis
        bench.next_process()
        with pytest.raises(Unreferenced):
            bench.axis.start(20.0)


def test_the_encoder_of_an_axis_is_lost_in_a_reset_until_the_axis_is_referenced() -> None:
    """Its counter is 0 at 30 deg, and after a jam without a reset it is right, in this process and the next."""
    bench = AxisBench({"homing": HOMING}, HOME).connect()
    bench.move(30.0)
    bench.line.reset(bench.clock.now())
    bench.connect()
    assert (bench.axis.position_deg(), bench.axis.encoder_deg()) == (0.0, None)
    bench.axis.start_homing()  # its end is not waited for
    for _ in range(2):
        bench.clock.sleep_until(bench.clock.now() + 10.0)
        bench.next_process()
        assert not bench.axis.referenced
        assert bench.axis.encoder_deg() is None
    bench.axis.set_position(30.0)
    assert bench.axis.encoder_deg() == pytest.approx(30.0, abs=0.01)
    bench.plant.shafts["sigma"].jam(bench.clock.now())
    with contextlib.suppress(DeviceError):
        bench.move(40.0)
    for _ in range(2):
        bench.next_process()
        assert not bench.axis.referenced
        assert bench.axis.encoder_deg() == pytest.approx(30.0, abs=0.01)


def test_a_process_that_ends_between_canary_and_settings_does_not_reference_the_axis() -> None:
    bench = AxisBench(ANYWHERE)
    bench.module.connect()  # the process ends before its axes are connected
    bench.next_process()
    assert "powered up" in bench.axis.unreferenced_reason


def test_the_next_process_keeps_the_reference_of_a_homed_axis() -> None:
    required = {"homing": HOMING, "homing_required": True, "power_up_at_reference": False}
    bench = AxisBench(required, HOME).connect()
    assert "homed" in bench.axis.unreferenced_reason
    wait(bench.clock, [bench.axis.start_homing()])
    bench.next_process()
    bench.move(10.0)
    assert bench.angle() == pytest.approx(10.0, abs=1e-2)


def test_a_search_that_did_not_end_leaves_the_axis_unreferenced_for_the_next_process() -> None:
    bench = AxisBench({"homing": HOMING}, HOME).connect()
    search = bench.axis.start_homing()
    bench.poll_for(search, 0.2)
    bench.clock.sleep_until(bench.clock.now() + 10.0)  # the heartbeat stops it
    bench.next_process()
    assert bench.axis.unreferenced_reason == "an earlier run has left it unreferenced"


def test_a_stall_that_was_not_read_is_detected_by_the_next_process() -> None:
    bench = AxisBench({"stall_speed_deg_s": 1.0, "encoder": False}).connect()
    move = bench.axis.start(30.0)
    bench.poll_for(move, 1.5)
    bench.plant.shafts["sigma"].jam(bench.clock.now())
    bench.clock.sleep_until(bench.clock.now() + 10.0)
    bench.next_process()
    assert bench.axis.unreferenced_reason == "stall has stopped it before it was connected"


def slipped(**settings: object) -> AxisBench:
    bench = AxisBench(dict(settings)).connect()
    bench.plant.shafts["sigma"].jam(bench.clock.now())
    with contextlib.suppress(DeviceError):
        bench.move(10.0)
    return bench


def test_a_disagreement_of_the_encoder_names_both_angles_and_persists() -> None:
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


def test_a_disagreement_of_the_encoder_is_detected_at_connection() -> None:
    bench = slipped()
    bench.next_process()
    assert "its encoder at 0.000 deg" in bench.axis.unreferenced_reason


@pytest.mark.parametrize("settings", [{"encoder_tolerance_deg": 0.0}, {"encoder_tolerance_deg": 10.5}, {"encoder": False}])
def test_the_encoder_tolerance_is_a_setting(settings: dict[str, float]) -> None:
    bench = slipped(**settings)
    assert bench.axis.read_back()[0] == pytest.approx(10.0)
    bench.next_process()
    assert bench.axis.referenced


def test_the_stated_backlash_is_within_the_tolerance() -> None:
    bench = AxisBench({"backlash_deg": 0.3}, {"backlash_deg": 0.3}).connect()
    for angle in (10.0, 5.0, 5.1, 20.0):
        bench.move(angle)
        bench.axis.read_back()
    bench.next_process()
    assert bench.axis.referenced


def test_a_single_wrong_encoder_reading_is_tolerated(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = AxisBench().connect()
    readings = iter([3.0, 0.0])
    monkeypatch.setattr(bench.axis, "encoder_deg", lambda: next(readings))
    assert bench.axis.read_back() == (0.0, 0.0)
    assert bench.axis.referenced


def test_counter_and_encoder_of_a_moving_axis_are_not_compared() -> None:
    bench = AxisBench().connect()
    bench.axis.start(100.0)
    bench.clock.sleep_until(bench.clock.now() + 1.0)
    bench.next_process()
    assert bench.axis.referenced
