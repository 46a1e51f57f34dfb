"""Homing, references and moves of an axis."""

import pytest

from goniotwin.drivers import DeviceError, Homing, wait
from goniotwin.drivers.errors import Forgotten, Interrupted, LimitError, Unreferenced
from goniotwin.protocols.tmcl import Command, CommandFrame
from goniotwin.protocols.tmcl_parameters import AxisParameter, ErrorFlag, SearchMode
from tests.drivers.axis_bench import AxisBench

PER_DEG = 5120
HOMING = Homing(mode=SearchMode.HOME_NEGATIVE_NO_STOPS, speed_deg_s=10.0, switch_speed_deg_s=0.5)
HOME = {"home_deg": -5.0}  # its upper edge, reached from above, is at -4 deg


def homed(angle_deg: float | None = -4.0) -> AxisBench:
    homing = Homing(HOMING.mode, HOMING.speed_deg_s, HOMING.switch_speed_deg_s, angle_deg)
    return AxisBench({"homing": homing, "homing_required": True, "power_up_at_reference": False}, HOME).connect()


def test_an_axis_with_homing_required_moves_to_no_angle_before_homing() -> None:
    bench = homed()
    assert not bench.axis.referenced
    with pytest.raises(Unreferenced, match="not been homed"):
        bench.axis.start(3.0)
    wait(bench.clock, [bench.axis.start_homing()])
    bench.move(3.0)
    assert bench.angle() == pytest.approx(3.0, abs=2.0 / PER_DEG)
    assert bench.axis.encoder_deg() == pytest.approx(3.0, abs=3.0 / PER_DEG)


def test_homing_does_not_block_other_devices() -> None:
    bench = homed()
    search = bench.axis.start_homing()
    while True:
        bench.clock.sleep_until(search.due)
        before = bench.clock.now()
        done = search.poll()
        assert bench.clock.now() - before < 0.05
        if done:
            break


def test_the_reference_is_at_the_angle_of_the_settings() -> None:
    bench = homed(angle_deg=100.0)
    wait(bench.clock, [bench.axis.start_homing()])
    assert bench.axis.position_deg() == pytest.approx(100.0)
    bench.move(107.0)
    assert bench.angle() == pytest.approx(3.0, abs=2.0 / PER_DEG)


def test_homing_gives_the_error_of_the_old_reference() -> None:
    bench = homed()
    wait(bench.clock, [bench.axis.start_homing()])
    now = bench.clock.now()
    bench.plant.shafts["sigma"].jam(now)
    bench.move(1.0)
    bench.plant.shafts["sigma"].jam(bench.clock.now(), jammed=False)
    wait(bench.clock, [bench.axis.start_homing()])
    # By the old counter the reference is 5 deg further on, to the nearest four full steps of 1024 microsteps.
    assert bench.axis.last_reference_deg == pytest.approx(1.0, abs=512.5 / PER_DEG)


def test_a_stop_ends_the_search_and_leaves_the_axis_unreferenced() -> None:
    bench = homed()
    search = bench.axis.start_homing()
    bench.poll_for(search, 1.0)
    bench.axis.stop()
    with pytest.raises(DeviceError, match="ended before it found"):
        wait(bench.clock, [search])
    assert not bench.axis.referenced
    bench.clock.sleep_until(bench.clock.now() + 0.5)  # its ramp
    rest = bench.angle()
    bench.clock.sleep_until(bench.clock.now() + 100.0)
    assert bench.angle() == rest


def test_a_search_without_result_is_ended_after_its_time_limit() -> None:
    bench = AxisBench({"homing": Homing(8, 10.0, 0.5, longest_s=20.0)}).connect()
    with pytest.raises(DeviceError, match="no reference within 20 s"):
        wait(bench.clock, [bench.axis.start_homing()])
    bench.clock.sleep_until(bench.clock.now() + 2.0)
    assert bench.axis.position_deg() == bench.axis.position_deg()
    assert bench.axis.unreferenced_reason


def test_a_search_with_a_blocked_motor_gives_no_reference() -> None:
    bench = AxisBench({"homing": HOMING, "max_deviation_deg": 0.2}, HOME).connect()
    search = bench.axis.start_homing()
    bench.poll_for(search, 0.2)
    bench.plant.shafts["sigma"].jam(bench.clock.now())
    with pytest.raises(DeviceError):
        wait(bench.clock, [search])
    assert not bench.axis.referenced


def test_homing_without_its_settings_is_an_error() -> None:
    with pytest.raises(DeviceError, match="homing"):
        AxisBench().connect().axis.start_homing()


def test_the_operator_can_set_the_position() -> None:
    bench = homed()
    bench.axis.set_position(30.0)
    assert bench.axis.position_deg() == pytest.approx(30.0)
    assert bench.axis.encoder_deg() == pytest.approx(30.0, abs=2.0 / PER_DEG)
    bench.move(31.0)
    assert bench.angle() == pytest.approx(1.0, abs=1.0 / PER_DEG)


@pytest.mark.parametrize("angle", [float("nan"), float("inf"), 1e9])
def test_a_position_beyond_the_counter_is_refused(angle: float) -> None:
    with pytest.raises(LimitError):
        homed().axis.set_position(angle)


def test_the_position_cannot_be_set_during_a_move() -> None:
    bench = AxisBench().connect()
    move = bench.axis.start(30.0)
    bench.poll_for(move, 1.0)
    with pytest.raises(DeviceError, match="moving"):
        bench.axis.set_position(1.0)


def test_a_reset_leaves_the_axis_unreferenced_until_its_position_is_set() -> None:
    bench = AxisBench().connect()
    bench.move(10.0)
    bench.line.reset(bench.clock.now())
    with pytest.raises(Forgotten, match="module has reset"):
        bench.axis.position_deg()
    with pytest.raises(Forgotten):
        bench.axis.check_canary()
    with pytest.raises(Unreferenced, match="reset"):
        bench.axis.start(20.0)
    bench.connect()
    assert bench.axis.position_deg() == 0.0
    with pytest.raises(Unreferenced, match="reset"):
        bench.axis.start(20.0)
    bench.axis.set_position(10.0)
    bench.move(20.0)
    assert bench.angle() == pytest.approx(20.0, abs=1.0 / PER_DEG)


def test_a_reset_before_a_move_is_detected_when_the_move_starts() -> None:
    bench = AxisBench().connect()
    bench.move(10.0)
    bench.line.reset(bench.clock.now())
    with pytest.raises(Forgotten):
        bench.axis.start(20.0)
    assert bench.angle() == pytest.approx(10.0, abs=1.0 / PER_DEG)


def test_a_reset_during_a_move_is_not_taken_for_an_arrival() -> None:
    bench = AxisBench().connect()
    move = bench.axis.start(10.0)
    bench.poll_for(move, 0.6)
    bench.line.reset(bench.clock.now())  # counter and target are 0 now, so that the module reports the target as reached
    with pytest.raises(Forgotten):
        wait(bench.clock, [move])


def test_a_reset_while_the_port_is_closed_is_detected_at_the_next_connection() -> None:
    bench = AxisBench().connect()
    bench.module.close()
    bench.line.reset(bench.clock.now())
    bench.connect()
    assert bench.axis.unreferenced_reason == "its module has reset, and its counter with it"


def test_connecting_again_without_a_reset_keeps_the_reference() -> None:
    bench = AxisBench().connect()
    bench.move(10.0)
    bench.connect()
    assert bench.axis.referenced
    assert bench.axis.position_deg() == pytest.approx(10.0)


def blocked(**settings: object) -> AxisBench:
    bench = AxisBench(dict(settings)).connect()
    move = bench.axis.start(30.0)
    bench.poll_for(move, 1.5)
    bench.plant.shafts["sigma"].jam(bench.clock.now())
    with pytest.raises(DeviceError, match=r"stopped at .* deg: ") as caught:
        wait(bench.clock, [move])
    assert not bench.axis.referenced
    bench.reason = str(caught.value)  # type: ignore[attr-defined]
    return bench


def test_a_stall_is_reported_and_latched() -> None:
    bench = blocked(stall_speed_deg_s=1.0)
    assert "stalled" in bench.reason  # type: ignore[attr-defined]
    assert bench.axis.errors == ErrorFlag.STALL
    assert bench.axis.read_errors() == ErrorFlag.STALL  # cleared in the module, latched in the driver


def test_a_deviation_of_the_encoder_is_reported() -> None:
    bench = blocked(max_deviation_deg=0.5)
    assert "encoder" in bench.reason  # type: ignore[attr-defined]
    deviation = bench.axis.deviation_deg()
    assert deviation == pytest.approx(-0.5, abs=0.01)


def test_a_limit_switch_is_reported() -> None:
    bench = AxisBench({"switches": True}, {"upper_switch_deg": 20.0}).connect()
    with pytest.raises(DeviceError, match=r"20\.000 deg: the right limit switch"):
        bench.move(30.0)
    assert not bench.axis.referenced
    assert bench.axis.switches().right


def test_a_stop_leaves_the_axis_referenced() -> None:
    bench = AxisBench().connect()
    move = bench.axis.start(30.0)
    bench.poll_for(move, 1.0)
    bench.axis.stop()
    with pytest.raises(DeviceError, match="a stop from elsewhere"):
        wait(bench.clock, [move])
    assert bench.axis.referenced
    bench.move(30.0)
    assert bench.angle() == pytest.approx(30.0, abs=1.0 / PER_DEG)


def test_the_heartbeat_stops_an_axis_only_without_polls() -> None:
    bench = AxisBench().connect()
    bench.move(100.0)  # ten seconds at 10 deg/s
    assert bench.angle() == pytest.approx(100.0, abs=1.0 / PER_DEG)
    bench.axis.start(0.0)
    bench.clock.sleep_until(bench.clock.now() + 60.0)
    # 2 s of heartbeat after the move was sent: 0.5 s ramp up to 10 deg/s and 1.5 s at this speed; then 0.5 s ramp down.
    assert bench.angle() == pytest.approx(100.0 - 2.5 - 15.0 - 2.5, abs=0.1)
    assert bench.axis.referenced


def test_an_hour_without_requests_does_not_disturb_an_axis_at_rest() -> None:
    bench = AxisBench().connect()
    bench.move(10.0)
    bench.clock.sleep_until(bench.clock.now() + 3600.0)
    assert bench.axis.position_deg() == pytest.approx(10.0)
    bench.move(11.0)


@pytest.mark.parametrize(("approach", "angles"), [("below", (30.0, 10.0, 10.5)), ("above", (10.0, 30.0, 29.5))])
def test_with_backlash_every_move_arrives_from_one_side(approach: str, angles: tuple[float, ...]) -> None:
    backlash = {"backlash_deg": 0.4} if approach == "below" else {"backlash_deg": 0.4, "zero_deg": -0.4}
    bench = AxisBench({"backlash_deg": 0.5, "approach_from": approach, "homing_required": False}, backlash).connect()
    for angle in angles:
        bench.move(angle)
        assert bench.angle() == pytest.approx(angle, abs=1.0 / PER_DEG)


def test_without_the_setting_the_backlash_shifts_the_axis() -> None:
    bench = AxisBench(mechanics={"backlash_deg": 0.4}).connect()
    bench.move(30.0)
    bench.move(10.0)
    assert bench.angle() == pytest.approx(10.4)


def test_a_target_with_its_approach_outside_the_limits_is_refused() -> None:
    bench = AxisBench({"backlash_deg": 0.5, "lower_deg": 0.0}).connect()
    with pytest.raises(LimitError, match="approaches from below"):
        bench.axis.start(0.5)


def test_a_stop_between_the_two_legs_ends_the_move() -> None:
    bench = AxisBench({"backlash_deg": 0.5}, {"backlash_deg": 0.4}).connect()
    bench.move(30.0)
    move = bench.axis.start(10.0)
    while bench.axis.read_parameter(AxisParameter.POSITION_REACHED) == 0:
        bench.clock.sleep_until(bench.clock.now() + 0.01)
    bench.axis.stop()
    with pytest.raises(Interrupted):
        wait(bench.clock, [move])
    assert bench.axis.position_deg() == pytest.approx(9.0)


def test_the_estimated_duration_of_two_legs_is_right() -> None:
    bench = AxisBench({"backlash_deg": 0.5}, {"backlash_deg": 0.4}).connect()
    bench.move(30.0)
    move = bench.axis.start(10.0)
    wait(bench.clock, [move])
    assert move.arrival == pytest.approx(bench.clock.now(), abs=0.02)


def test_a_relative_move_needs_no_reference() -> None:
    bench = homed()
    wait(bench.clock, [bench.axis.start_relative(3.0)])
    assert bench.angle() == pytest.approx(3.0, abs=1.0 / PER_DEG)
    assert not bench.axis.referenced


def test_motor_currents_and_driver_flags() -> None:
    bench = AxisBench().connect()
    bench.axis.set_currents(50, 5)
    assert bench.module.exchange(CommandFrame(1, Command.GAP, 6, 4)) == 50
    assert bench.axis.driver_flags().name == "STANDSTILL"
