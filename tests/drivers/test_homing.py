"""References: found, kept, lost, and found again."""

import pytest

from goniotwin.drivers import DeviceError, Homing, wait
from goniotwin.drivers.errors import Forgotten, Interrupted, LimitError, Unreferenced
from goniotwin.protocols.tmcl import Axis, Command, Request
from goniotwin.protocols.tmcl_parameters import ErrorFlag, SearchMode
from tests.drivers.axis_bench import DriverBench

PER_DEG = 5120
HOMING = Homing(mode=SearchMode.HOME_NEGATIVE_NO_STOPS, speed=10.0, switch_speed=0.5)
HOME = {"home_deg": -5.0}  # its upper edge, which is met downwards, is at -4 deg


def homed(angle_deg: float | None = -4.0) -> DriverBench:
    homing = Homing(HOMING.mode, HOMING.speed, HOMING.switch_speed, angle_deg)
    return DriverBench({"homing": homing, "homing_required": True}, HOME).connect()


def test_an_axis_that_has_to_be_homed_moves_to_no_angle_before() -> None:
    bench = homed()
    assert not bench.axis.referenced
    with pytest.raises(Unreferenced, match="not been homed"):
        bench.axis.start(3.0)
    wait(bench.clock, [bench.axis.start_homing()])
    bench.move(3.0)
    assert bench.angle() == pytest.approx(3.0, abs=2.0 / PER_DEG)
    assert bench.axis.encoder_deg() == pytest.approx(3.0, abs=3.0 / PER_DEG)


def test_homing_blocks_nobody() -> None:
    bench = homed()
    search = bench.axis.start_homing()
    while True:
        bench.clock.sleep_until(search.due)
        before = bench.clock.now()
        done = search.poll()
        assert bench.clock.now() - before < 0.05
        if done:
            break


def test_the_reference_is_at_the_angle_that_the_operator_says() -> None:
    bench = homed(angle_deg=100.0)
    wait(bench.clock, [bench.axis.start_homing()])
    assert bench.axis.position_deg() == pytest.approx(100.0)
    bench.move(107.0)
    assert bench.angle() == pytest.approx(3.0, abs=2.0 / PER_DEG)


def test_the_old_counter_tells_how_far_it_had_gone_astray() -> None:
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
    bench.keep(search, 1.0)
    bench.axis.stop()
    with pytest.raises(DeviceError, match="ended before it found"):
        wait(bench.clock, [search])
    assert not bench.axis.referenced
    bench.clock.sleep_until(bench.clock.now() + 0.5)  # its ramp
    rest = bench.angle()
    bench.clock.sleep_until(bench.clock.now() + 100.0)
    assert bench.angle() == rest


def test_a_search_that_finds_nothing_is_ended() -> None:
    bench = DriverBench({"homing": Homing(8, 10.0, 0.5, longest_s=20.0)}).connect()
    with pytest.raises(DeviceError, match="no reference within 20 s"):
        wait(bench.clock, [bench.axis.start_homing()])
    bench.clock.sleep_until(bench.clock.now() + 2.0)
    assert bench.axis.position_deg() == bench.axis.position_deg()
    assert bench.axis.unreferenced_reason


def test_a_search_that_jams_is_no_reference() -> None:
    bench = DriverBench({"homing": HOMING, "max_deviation_deg": 0.2}, HOME).connect()
    search = bench.axis.start_homing()
    bench.keep(search, 0.2)
    bench.plant.shafts["sigma"].jam(bench.clock.now())
    with pytest.raises(DeviceError):
        wait(bench.clock, [search])
    assert not bench.axis.referenced


def test_without_a_homing_in_the_file_there_is_none() -> None:
    with pytest.raises(DeviceError, match="homing"):
        DriverBench().connect().axis.start_homing()


def test_an_operator_may_say_where_it_is() -> None:
    bench = homed()
    bench.axis.set_position(30.0)
    assert bench.axis.position_deg() == pytest.approx(30.0)
    assert bench.axis.encoder_deg() == pytest.approx(30.0, abs=2.0 / PER_DEG)
    bench.move(31.0)
    assert bench.angle() == pytest.approx(1.0, abs=1.0 / PER_DEG)


@pytest.mark.parametrize("angle", [float("nan"), float("inf"), 1e9])
def test_but_not_nonsense(angle: float) -> None:
    with pytest.raises(LimitError):
        homed().axis.set_position(angle)


def test_nor_while_it_turns() -> None:
    bench = DriverBench().connect()
    move = bench.axis.start(30.0)
    bench.keep(move, 1.0)
    with pytest.raises(DeviceError, match="moving"):
        bench.axis.set_position(1.0)


def test_a_reset_is_noticed_and_leaves_the_axis_unreferenced_until_somebody_says_where_it_is() -> None:
    bench = DriverBench().connect()
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


def test_a_reset_before_anybody_asks_is_noticed_when_the_move_is_to_begin() -> None:
    bench = DriverBench().connect()
    bench.move(10.0)
    bench.line.reset(bench.clock.now())
    with pytest.raises(Forgotten):
        bench.axis.start(20.0)
    assert bench.angle() == pytest.approx(10.0, abs=1.0 / PER_DEG)


def test_a_reset_in_the_middle_of_a_move_is_no_arrival() -> None:
    bench = DriverBench().connect()
    move = bench.axis.start(10.0)
    bench.keep(move, 0.6)
    bench.line.reset(bench.clock.now())  # counter and target are 0 now, so the module says that it has arrived
    with pytest.raises(Forgotten):
        wait(bench.clock, [move])


def test_a_reset_while_the_port_was_closed_is_noticed_at_the_next_connection() -> None:
    bench = DriverBench().connect()
    bench.module.close()
    bench.line.reset(bench.clock.now())
    bench.connect()
    assert bench.axis.unreferenced_reason == "its module has reset, and its counter with it"


def test_connecting_again_to_a_module_that_has_not_reset_leaves_all_as_it_was() -> None:
    bench = DriverBench().connect()
    bench.move(10.0)
    bench.connect()
    assert bench.axis.referenced
    assert bench.axis.position_deg() == pytest.approx(10.0)


def stalls(**settings: object) -> DriverBench:
    bench = DriverBench(dict(settings)).connect()
    move = bench.axis.start(30.0)
    bench.keep(move, 1.5)
    bench.plant.shafts["sigma"].jam(bench.clock.now())
    with pytest.raises(DeviceError, match=r"stopped at .* deg: ") as caught:
        wait(bench.clock, [move])
    assert not bench.axis.referenced
    bench.reason = str(caught.value)  # type: ignore[attr-defined]
    return bench


def test_a_stall_is_told_and_latched() -> None:
    bench = stalls(stall_speed=1.0)
    assert "stalled" in bench.reason  # type: ignore[attr-defined]
    assert bench.axis.errors == ErrorFlag.STALL
    assert bench.axis.read_errors() == ErrorFlag.STALL  # the module has forgotten it, the driver has not


def test_a_deviation_of_the_encoder_is_told() -> None:
    bench = stalls(max_deviation_deg=0.5)
    assert "encoder" in bench.reason  # type: ignore[attr-defined]
    deviation = bench.axis.deviation_deg()
    assert deviation == pytest.approx(-0.5, abs=0.01)


def test_a_limit_switch_is_told() -> None:
    bench = DriverBench({"switches": True}, {"upper_switch_deg": 20.0}).connect()
    with pytest.raises(DeviceError, match=r"20\.000 deg: the right limit switch"):
        bench.move(30.0)
    assert not bench.axis.referenced
    assert bench.axis.switches().right


def test_a_stop_leaves_the_axis_referenced() -> None:
    bench = DriverBench().connect()
    move = bench.axis.start(30.0)
    bench.keep(move, 1.0)
    bench.axis.stop()
    with pytest.raises(DeviceError, match="a stop from elsewhere"):
        wait(bench.clock, [move])
    assert bench.axis.referenced
    bench.move(30.0)
    assert bench.angle() == pytest.approx(30.0, abs=1.0 / PER_DEG)


def test_an_axis_that_is_polled_is_not_stopped_by_the_heartbeat_and_one_whose_host_is_gone_is() -> None:
    bench = DriverBench().connect()
    bench.move(100.0)  # ten seconds at 10 deg/s
    assert bench.angle() == pytest.approx(100.0, abs=1.0 / PER_DEG)
    bench.axis.start(0.0)
    bench.clock.sleep_until(bench.clock.now() + 60.0)
    # 2 s of heartbeat after the move was sent, then the ramp of 0.5 s: 0.5 s to get up to 10 deg/s, and 1.5 s at it.
    assert bench.angle() == pytest.approx(100.0 - 2.5 - 15.0 - 2.5, abs=0.1)
    assert bench.axis.referenced


def test_an_exposure_may_last_for_ever() -> None:
    bench = DriverBench().connect()
    bench.move(10.0)
    bench.clock.sleep_until(bench.clock.now() + 3600.0)
    assert bench.axis.position_deg() == pytest.approx(10.0)
    bench.move(11.0)


@pytest.mark.parametrize(("approach", "angles"), [("below", (30.0, 10.0, 10.5)), ("above", (10.0, 30.0, 29.5))])
def test_against_backlash_every_move_arrives_from_one_side(approach: str, angles: tuple[float, ...]) -> None:
    play = {"backlash_deg": 0.4} if approach == "below" else {"backlash_deg": 0.4, "zero_deg": -0.4}
    bench = DriverBench({"backlash_deg": 0.5, "approach_from": approach, "homing_required": False}, play).connect()
    for angle in angles:
        bench.move(angle)
        assert bench.angle() == pytest.approx(angle, abs=1.0 / PER_DEG)


def test_without_it_they_arrive_where_they_come_from() -> None:
    bench = DriverBench(mechanics={"backlash_deg": 0.4}).connect()
    bench.move(30.0)
    bench.move(10.0)
    assert bench.angle() == pytest.approx(10.4)


def test_a_target_that_leaves_no_room_for_the_approach_is_refused() -> None:
    bench = DriverBench({"backlash_deg": 0.5, "lower_deg": 0.0}).connect()
    with pytest.raises(LimitError, match="approaches from below"):
        bench.axis.start(0.5)


def test_a_stop_between_the_two_legs_ends_the_move() -> None:
    bench = DriverBench({"backlash_deg": 0.5}, {"backlash_deg": 0.4}).connect()
    bench.move(30.0)
    move = bench.axis.start(10.0)
    while bench.axis.read_parameter(Axis.POSITION_REACHED) == 0:
        bench.clock.sleep_until(bench.clock.now() + 0.01)
    bench.axis.stop()
    with pytest.raises(Interrupted):
        wait(bench.clock, [move])
    assert bench.axis.position_deg() == pytest.approx(9.0)


def test_the_foretold_time_of_two_legs_is_theirs() -> None:
    bench = DriverBench({"backlash_deg": 0.5}, {"backlash_deg": 0.4}).connect()
    bench.move(30.0)
    settings, start = bench.axis.settings, bench.clock.now()
    move = bench.axis.start(10.0)
    wait(bench.clock, [move])
    assert bench.clock.now() - start == pytest.approx(settings.seconds_between(30.0, 10.0), abs=0.05)
    assert move.arrival == pytest.approx(bench.clock.now(), abs=0.02)


def test_a_turn_by_an_angle_needs_no_reference() -> None:
    bench = homed()
    wait(bench.clock, [bench.axis.start_relative(3.0)])
    assert bench.angle() == pytest.approx(3.0, abs=1.0 / PER_DEG)
    assert not bench.axis.referenced


def test_currents_and_drivers_flags() -> None:
    bench = DriverBench().connect()
    bench.axis.set_currents(50, 5)
    assert bench.module.exchange(Request(1, Command.GAP, 6, 4)) == 50
    assert bench.axis.driver_flags().name == "STANDSTILL"
