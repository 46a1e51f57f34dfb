"""Axes of the virtual motion module: switches, reference searches, stalls, encoders, heartbeats."""

import pytest

from goniotwin.protocols.tmcl import Command
from goniotwin.protocols.tmcl_parameters import AxisParameter, ErrorFlag, SearchCommand, SearchMode
from tests.twin.devices.tmcl_bench import PER_DEG, Bench

TURN = 51_200


def enabled(bench: Bench, *, soft: bool = False) -> Bench:
    bench.set(AxisParameter.RIGHT_SWITCH_DISABLED, 0, 0.0)
    bench.set(AxisParameter.LEFT_SWITCH_DISABLED, 0, 0.0)
    bench.set(AxisParameter.SOFT_STOP, int(soft), 0.0)
    return bench


def test_a_limit_switch_on_the_way_stops_the_axis_there() -> None:
    bench = enabled(Bench(upper_switch_deg=2.0))
    bench.go(100_000, 1.0)
    # 2 deg are 10240 microsteps: 5000 in the first second, 5240 at 10000 pps.
    assert bench.get(AxisParameter.RIGHT_SWITCH, 2.5) == 0
    assert bench.get(AxisParameter.ACTUAL_POSITION, 2.6) == 10_240
    assert bench.get(AxisParameter.ACTUAL_VELOCITY, 2.6) == 0
    assert bench.get(AxisParameter.RIGHT_SWITCH, 2.6) == 1
    assert bench.get(AxisParameter.LEFT_SWITCH, 2.6) == 0
    assert bench.get(AxisParameter.POSITION_REACHED, 10.0) == 0
    assert bench.get(AxisParameter.TARGET_POSITION, 10.0) == 100_000
    assert bench.angle(100.0) == pytest.approx(2.0)


def test_a_soft_stop_brakes_behind_the_switch() -> None:
    bench = enabled(Bench(upper_switch_deg=2.0), soft=True)
    bench.go(100_000, 1.0)
    assert bench.get(AxisParameter.ACTUAL_POSITION, 10.0) == 10_240 + 5_000  # 10000 pps at 10000 pps/s brake within 5000


def test_at_a_switch_only_the_way_back_is_free() -> None:
    bench = enabled(Bench(upper_switch_deg=2.0))
    bench.go(100_000, 1.0)
    bench.go(100_000, 5.0)
    assert bench.get(AxisParameter.ACTUAL_POSITION, 9.0) == 10_240
    bench.go(0, 10.0)
    assert bench.get(AxisParameter.POSITION_REACHED, 20.0) == 1


def test_a_disabled_switch_is_seen_and_ignored() -> None:
    bench = Bench(upper_switch_deg=2.0)
    bench.go(20_480, 1.0)
    assert bench.get(AxisParameter.POSITION_REACHED, 20.0) == 1
    assert bench.get(AxisParameter.RIGHT_SWITCH, 20.0) == 1


def test_polarity_and_exchange_of_the_switches() -> None:
    bench = Bench(upper_switch_deg=2.0)
    bench.set(AxisParameter.RIGHT_SWITCH_POLARITY, 1, 0.5)
    assert bench.get(AxisParameter.RIGHT_SWITCH, 1.0) == 1
    bench.set(AxisParameter.RIGHT_SWITCH_POLARITY, 0, 1.5)
    bench.set(AxisParameter.SWAP_SWITCHES, 1, 1.5)
    bench.go(20_480, 2.0)
    assert (bench.get(AxisParameter.RIGHT_SWITCH, 20.0), bench.get(AxisParameter.LEFT_SWITCH, 20.0)) == (0, 1)


def test_an_axis_that_turns_the_other_way_meets_its_upper_switch_at_the_left() -> None:
    bench = enabled(Bench(upper_switch_deg=2.0, sense=-1))
    bench.go(-100_000, 1.0)
    assert bench.get(AxisParameter.ACTUAL_POSITION, 10.0) == -10_240
    assert bench.get(AxisParameter.LEFT_SWITCH, 10.0) == 1


def searching(mode: int, **mechanics: object) -> Bench:
    bench = Bench(**mechanics)  # type: ignore[arg-type]
    bench.set(AxisParameter.REFERENCE_SEARCH_MODE, mode, 0.0)
    bench.set(AxisParameter.REFERENCE_SEARCH_SPEED, 10_000, 0.0)
    bench.set(AxisParameter.REFERENCE_SWITCH_SPEED, 1_000, 0.0)
    return bench


ENDS = {"lower_switch_deg": -3.0, "upper_switch_deg": 2.0}
HOME = {"home_deg": 1.0, "home_width_deg": 0.5}


@pytest.mark.parametrize(
    ("mode", "place_deg", "mechanics"),
    [
        (SearchMode.LEFT, -3.0, ENDS),
        (SearchMode.LEFT + 64, 2.0, ENDS),
        (SearchMode.RIGHT_THEN_LEFT, -3.0, ENDS),
        (SearchMode.RIGHT_THEN_LEFT_BOTH_SIDES, -3.0, ENDS),
        (SearchMode.LEFT_BOTH_SIDES, -3.0, ENDS),
        (SearchMode.LEFT_BOTH_SIDES + 64, 2.0, ENDS),
        (SearchMode.HOME_NEGATIVE, 1.5, ENDS | HOME),
        (SearchMode.HOME_POSITIVE, 1.0, ENDS | HOME),
        (SearchMode.HOME_POSITIVE_NO_STOPS, 1.0, HOME),
        (SearchMode.HOME_NEGATIVE_NO_STOPS, 1.5, HOME),
    ],
)
@pytest.mark.parametrize("start_deg", [0.0, 1.2, -2.0])
def test_every_search_ends_at_its_place_and_counts_from_there(
    mode: int, place_deg: float, mechanics: dict[str, float], start_deg: float
) -> None:
    bench = searching(mode, **mechanics)
    bench.go(round(start_deg * PER_DEG), 1.0)
    assert bench.search(SearchCommand.START, 20.0) == 0
    assert bench.search(SearchCommand.STATUS, 20.1) != 0
    assert bench.get(AxisParameter.POSITION_REACHED, 20.1) == 0
    assert bench.search(SearchCommand.STATUS, 2000.0) == 0
    assert bench.get(AxisParameter.ACTUAL_POSITION, 2000.0) == 0
    assert bench.get(AxisParameter.TARGET_POSITION, 2000.0) == 0
    assert bench.get(AxisParameter.POSITION_REACHED, 2000.0) == 1
    # All modes arrive within a microstep or two of the edge; downwards without end stops it may be that of a turn before.
    turns = round((bench.angle(2000.0) - place_deg) / 360.0)
    place_deg += 360.0 * turns
    assert turns == (-1 if mode == SearchMode.HOME_NEGATIVE_NO_STOPS and start_deg < 1.0 else 0)
    assert bench.angle(2000.0) == pytest.approx(place_deg, abs=2.0 / PER_DEG)
    assert bench.get(AxisParameter.LAST_REFERENCE_POSITION, 2000.0) == pytest.approx(place_deg * PER_DEG, abs=2)
    if mode in (SearchMode.RIGHT_THEN_LEFT, SearchMode.RIGHT_THEN_LEFT_BOTH_SIDES):
        assert bench.get(AxisParameter.SWITCH_DISTANCE, 2000.0) == pytest.approx(5.0 * PER_DEG, abs=4)
    bench.go(PER_DEG, 2001.0)
    assert bench.angle(2100.0) == pytest.approx(place_deg + 1.0, abs=2.0 / PER_DEG)


def test_an_inverted_home_switch_is_found_by_its_mode() -> None:
    bench = searching(SearchMode.HOME_POSITIVE_NO_STOPS + 128, home_deg=1.5, home_width_deg=359.5)  # open from 1 to 1.5 deg
    bench.search(SearchCommand.START, 1.0)
    assert bench.search(SearchCommand.STATUS, 1000.0) == 0
    assert bench.angle(1000.0) == pytest.approx(1.0, abs=2.0 / PER_DEG)


def test_a_search_moves_the_plant_without_queries() -> None:
    """The axis passes through the phases of the search without any request: other devices share the plant."""
    bench = searching(SearchMode.LEFT, **ENDS)
    bench.search(SearchCommand.START, 1.0)
    assert bench.angle(1.5) < 0.0
    assert bench.angle(500.0) == pytest.approx(-3.0, abs=2.0 / PER_DEG)


def test_a_search_without_a_switch_goes_on_until_it_is_stopped() -> None:
    bench = searching(SearchMode.HOME_NEGATIVE_NO_STOPS)
    bench.search(SearchCommand.START, 1.0)
    assert bench.search(SearchCommand.STATUS, 1000.0) != 0
    assert bench.get(AxisParameter.ACTUAL_VELOCITY, 1000.0) == -10_000
    bench.search(SearchCommand.STOP, 1000.0)
    assert bench.search(SearchCommand.STATUS, 1000.01) == 15  # real modules return this for a moment
    assert bench.search(SearchCommand.STATUS, 1002.0) == 0
    assert bench.get(AxisParameter.ACTUAL_VELOCITY, 1002.0) == 0


def test_a_stop_ends_a_search_too() -> None:
    bench = searching(SearchMode.LEFT, **ENDS)
    bench.search(SearchCommand.START, 1.0)
    bench.ask(Command.MST, 0, t=1.5)
    assert bench.search(SearchCommand.STATUS, 10.0) == 0
    assert bench.get(AxisParameter.ACTUAL_POSITION, 1000.0) == bench.get(AxisParameter.ACTUAL_POSITION, 10.0) != 0


def test_a_jammed_shaft_stands_while_the_counter_runs() -> None:
    bench = Bench()
    bench.go(TURN, 1.0)
    bench.shaft.jam(3.0)
    stuck = bench.angle(3.0)
    assert bench.get(AxisParameter.POSITION_REACHED, 50.0) == 1
    assert bench.angle(50.0) == stuck == pytest.approx(15_000 / PER_DEG)
    assert bench.get(AxisParameter.ENCODER_POSITION, 50.0) == pytest.approx(15_000, abs=1)
    assert bench.get(AxisParameter.ERROR_FLAGS, 50.0) == 0


def test_a_released_shaft_is_whole_electric_cycles_behind() -> None:
    bench = Bench()
    bench.go(TURN, 1.0)
    bench.shaft.jam(3.0)
    bench.shaft.jam(50.0, jammed=False)
    behind = (10.0 - bench.angle(51.0)) * PER_DEG
    assert behind == pytest.approx(round(behind / 1024) * 1024)  # four full steps of 256 microsteps
    assert 30_000 < behind < 42_000
    bench.go(0, 60.0)
    assert bench.angle(100.0) == pytest.approx(-behind / PER_DEG)


def test_a_stall_stops_the_motor_where_it_is_to() -> None:
    bench = Bench()
    bench.set(AxisParameter.STALL_VELOCITY, 1_000, 0.0)
    bench.go(TURN, 1.0)
    bench.shaft.jam(3.0)
    assert bench.get(AxisParameter.ACTUAL_VELOCITY, 3.001) == 0
    assert bench.get(AxisParameter.ACTUAL_POSITION, 10.0) == 15_000
    assert bench.get(AxisParameter.ERROR_FLAGS, 10.0) == ErrorFlag.STALL
    assert bench.get(AxisParameter.ERROR_FLAGS, 10.0) == 0  # reading clears it


def test_a_deviation_of_the_encoder_stops_the_motor() -> None:
    bench = Bench()
    bench.set(AxisParameter.MAX_ENCODER_DEVIATION, 500, 0.0)
    bench.go(TURN, 1.0)
    assert bench.get(AxisParameter.ERROR_FLAGS, 3.0) == 0
    bench.shaft.jam(3.0)
    assert bench.get(AxisParameter.ERROR_FLAGS, 3.04) == 0  # 400 microsteps
    assert bench.get(AxisParameter.ERROR_FLAGS, 3.06) == ErrorFlag.DEVIATION
    assert bench.get(AxisParameter.ACTUAL_POSITION, 10.0) == 15_500
    assert bench.get(AxisParameter.POSITION_REACHED, 10.0) == 0


def test_an_eccentric_encoder_shows_its_error() -> None:
    bench = Bench(encoder_error_deg=0.1)
    bench.go(90 * PER_DEG, 1.0)
    assert bench.get(AxisParameter.ENCODER_POSITION, 1000.0) == pytest.approx(90.1 * PER_DEG, abs=1)


def test_a_coarse_encoder_counts_in_whole_counts() -> None:
    bench = Bench(encoder_counts=4_000)  # 12.8 microsteps each
    bench.set(AxisParameter.ENCODER_RESOLUTION, 4_000, 0.0)
    bench.go(100, 1.0)
    assert bench.get(AxisParameter.ENCODER_POSITION, 100.0) == round(12.8 * 8)
    bench.set(AxisParameter.ENCODER_RESOLUTION, 8_000, 101.0)  # twice the true resolution halves the reading
    assert bench.get(AxisParameter.ENCODER_POSITION, 102.0) == round(12.8 * 8 / 2)


def test_backlash_holds_the_axis_back_after_a_change_of_direction() -> None:
    bench = Bench(backlash_deg=0.5)
    bench.go(10 * PER_DEG, 1.0)
    assert bench.angle(100.0) == pytest.approx(10.0)
    bench.go(round(9.8 * PER_DEG), 100.0)
    assert bench.angle(200.0) == pytest.approx(10.0, abs=1e-3)
    bench.go(9 * PER_DEG, 200.0)
    assert bench.angle(300.0) == pytest.approx(9.5)
    bench.go(round(9.3 * PER_DEG), 300.0)
    assert bench.angle(400.0) == pytest.approx(9.5)
    bench.go(10 * PER_DEG, 400.0)
    assert bench.angle(500.0) == pytest.approx(10.0)


def test_silence_longer_than_the_heartbeat_stops_the_motors() -> None:
    bench = Bench()
    bench.heartbeat(500, 1.0)
    bench.go(10 * TURN, 1.0)
    assert bench.get(AxisParameter.ACTUAL_VELOCITY, 1.5) == 5_000
    rest = bench.angle(100.0)  # without any query the axis still comes to rest in the plant
    # Until 2.0 s 5000 microsteps at 10000 pps/s, and as many to brake.
    assert rest == pytest.approx(10_000 / PER_DEG)
    assert bench.get(AxisParameter.ACTUAL_POSITION, 100.0) == 10_000
    assert bench.get(AxisParameter.POSITION_REACHED, 100.0) == 0
    assert bench.angle(200.0) == rest


def test_traffic_keeps_the_motors_turning() -> None:
    bench = Bench()
    bench.heartbeat(500, 1.0)
    bench.go(TURN, 1.0)
    for k in range(20):
        bench.get(AxisParameter.ACTUAL_POSITION, 1.4 + 0.4 * k)
    assert bench.get(AxisParameter.POSITION_REACHED, 9.2) == 1
    assert bench.angle(9.2) == pytest.approx(10.0)


def test_a_counter_set_in_the_middle_of_a_ramp_shifts_the_target() -> None:
    """As a TMCM-3214 does: stop first."""
    bench = Bench()
    bench.go(20_000, 1.0)
    bench.set(AxisParameter.ACTUAL_POSITION, 0, 2.0)  # at 5000
    assert bench.get(AxisParameter.ACTUAL_POSITION, 100.0) == 20_000
    assert bench.angle(100.0) == pytest.approx(25_000 / PER_DEG)


def test_a_new_speed_holds_for_the_move_under_way() -> None:
    bench = Bench()
    bench.go(TURN, 1.0)
    bench.set(AxisParameter.MAX_VELOCITY, 2_000, 3.0)
    assert bench.get(AxisParameter.ACTUAL_VELOCITY, 5.0) == 2_000
    assert bench.get(AxisParameter.ACTUAL_POSITION, 100.0) == TURN


def test_turning_and_the_reversed_shaft() -> None:
    bench = Bench()
    assert bench.ask(Command.ROL, 0, 1_000, 1.0) == 1_000
    assert bench.get(AxisParameter.TARGET_VELOCITY, 2.0) == -1_000
    assert bench.get(AxisParameter.ACTUAL_VELOCITY, 2.0) == -1_000
    bench.ask(Command.MST, 0, t=2.0)
    here = bench.angle(3.0)
    assert here < 0.0
    bench.set(AxisParameter.REVERSE_SHAFT, 1, 3.0)
    assert bench.angle(4.0) == pytest.approx(here)
    bench.ask(Command.ROL, 0, 1_000, 4.0)
    assert bench.angle(6.0) > here


@pytest.mark.parametrize(("reference", "target"), [(0, 21_000), (1, 6_000)])
def test_a_relative_move_is_from_the_target_or_from_where_it_is(reference: int, target: int) -> None:
    bench = Bench()
    bench.set(AxisParameter.RELATIVE_REFERENCE, reference, 0.0)
    bench.go(20_000, 1.0)
    bench.ask(Command.MST, 0, t=1.0 + 0.5**0.5)  # 2500 up, 2500 down
    assert bench.ask(Command.MVP, 1, 1_000, 10.0) == pytest.approx(target, abs=1)
