"""Shafts: play, jams, heartbeats."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.twin.plant import Mechanics
from goniotwin.twin.plant.motion import ramp_to_target, ramp_to_velocity
from goniotwin.twin.plant.shaft import Heartbeat, Shaft

PER_TURN = 51_200


def shaft(**mechanics: float) -> Shaft:
    return Shaft(Mechanics(0, 36.0, **mechanics))  # type: ignore[arg-type]


@given(st.lists(st.floats(-30.0, 30.0), min_size=1, max_size=8), st.floats(0.01, 2.0))
def test_the_axis_is_never_farther_from_its_drive_than_its_play(targets: list[float], play: float) -> None:
    axis = shaft(backlash_deg=play)
    counter, t = 0.0, 0.0
    for target in targets:
        trajectory = ramp_to_target(t, counter, 0.0, target * PER_TURN / 10.0, 1e5, 1e6, 1e6)
        axis.follow(t, trajectory)
        for share in (0.2, 0.5, 0.8, 1.0):
            moment = t + share * (trajectory.end - t)
            ahead = axis.angle_deg(moment) - trajectory.position(moment) * 10.0 / PER_TURN
            assert -1e-9 <= ahead <= play + 1e-9
        counter, t = trajectory.position(trajectory.end), trajectory.end + 1.0


@given(st.floats(0.0, 2.0), st.lists(st.floats(0.0, 10.0), min_size=2, max_size=20))
def test_past_angles_do_not_depend_on_the_order_of_the_calls(play: float, times: list[float]) -> None:
    axis = shaft(backlash_deg=play)
    axis.follow(0.0, ramp_to_target(0.0, 0.0, 0.0, 2e4, 1e4, 1e4, 1e4))
    axis.follow(1.5, ramp_to_target(1.5, axis.drive(1.5).counter(1.5), 1e4, 0.0, 1e4, 1e4, 1e4))
    assert {t: axis.angle_deg(t) for t in times} == {t: axis.angle_deg(t) for t in reversed(times)}


def test_an_expired_heartbeat_brakes_the_motor() -> None:
    axis, heartbeat = shaft(), Heartbeat()
    axis.follow(0.0, ramp_to_velocity(0.0, 0.0, 0.0, 1e4, 1e4, 1e4), 1e4, heartbeat)
    heartbeat.until = 2.0
    free = axis.angle_deg(2.0)
    assert axis.angle_deg(1e6) == pytest.approx(free + 5_000 * 10.0 / PER_TURN)
    heartbeat.until = 3.0
    assert axis.angle_deg(2.5) > axis.angle_deg(2.0) == free


def test_an_axis_at_constant_velocity_moves_without_end() -> None:
    axis = shaft()
    axis.follow(0.0, ramp_to_velocity(0.0, 0.0, 0.0, 1e4, 1e4, 1e4))
    assert axis.moved_since(1e6)


def test_the_listener_is_called_once_for_each_change_of_a_jam() -> None:
    axis = shaft()
    times: list[float] = []
    axis.listener = times.append
    axis.jam(1.0)
    axis.jam(2.0)
    axis.jam(3.0, jammed=False)
    axis.jam(4.0, jammed=False)
    assert times == [1.0, 3.0]
