"""Ramps of stepper motors."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.drivers.motion.settings import move_seconds
from goniotwin.twin.plant.motion import (
    Trajectory,
    brake_to_rest,
    cut_off,
    join,
    ramp_to_target,
    ramp_to_velocity,
    rest_at,
    turning_points,
)

PLACE = st.floats(-1e6, 1e6)
SPEED = st.floats(100.0, 1e6)
SLOPE = st.floats(100.0, 1e6)


@given(PLACE, PLACE, SPEED, SLOPE, SLOPE)
def test_a_move_from_rest_reaches_its_target_at_the_time_of_the_trapezoid(
    start: float, target: float, speed: float, up: float, down: float
) -> None:
    trajectory = ramp_to_target(1.0, start, 0.0, target, speed, up, down)
    assert trajectory.position(trajectory.end) == pytest.approx(target)
    assert trajectory.velocity(trajectory.end + 1.0) == 0.0
    assert trajectory.end - 1.0 == pytest.approx(move_seconds(target - start, speed, up, down), rel=1e-6, abs=1e-6)


@given(PLACE, PLACE, SPEED, SLOPE, SLOPE, st.floats(-1.0, 1.0))
def test_a_move_that_starts_during_a_movement_reaches_its_target_without_a_jump(
    start: float, target: float, speed: float, up: float, down: float, share: float
) -> None:
    trajectory = ramp_to_target(0.0, start, share * speed, target, speed, up, down)
    assert trajectory.position(trajectory.end) == pytest.approx(target)
    _check_smooth(trajectory, max(up, down), speed)


@given(PLACE, SPEED, SLOPE, SLOPE)
def test_a_stop_ends_at_rest_after_the_braking_distance(start: float, speed: float, up: float, down: float) -> None:
    trajectory = ramp_to_velocity(0.0, start, speed, 0.0, up, down)
    assert trajectory.velocity(trajectory.end) == 0.0
    assert trajectory.position(trajectory.end) - start == pytest.approx(speed * speed / (2.0 * down), rel=1e-6, abs=1e-3)
    _check_smooth(trajectory, max(up, down), speed)


def test_a_new_target_behind_the_axis_reverses_the_movement() -> None:
    out = ramp_to_target(0.0, 0.0, 0.0, 1000.0, 100.0, 100.0, 100.0)
    back = ramp_to_target(2.0, out.position(2.0), out.velocity(2.0), 0.0, 100.0, 100.0, 100.0)
    assert back.position(2.5) > out.position(2.0)  # it brakes before it reverses
    assert back.position(back.end) == pytest.approx(0.0, abs=1e-9)


def test_an_axis_at_rest_stays_at_rest() -> None:
    assert rest_at(5.0).position(-10.0) == rest_at(5.0).position(1e9) == 5.0


@given(PLACE, PLACE, SPEED, SLOPE, st.floats(0.0, 1.0))
def test_a_cut_off_trajectory_is_unchanged_before_and_at_rest_after(
    start: float, target: float, speed: float, slope: float, share: float
) -> None:
    whole = ramp_to_target(0.0, start, 0.0, target, speed, slope, slope)
    t = share * whole.end
    short = cut_off(whole, t)
    assert short.position(0.5 * t) == whole.position(0.5 * t)
    assert short.position(t + 1e6) == whole.position(t)
    assert short.velocity(t + 1.0) == 0.0


def test_a_braked_trajectory_is_at_rest_after_its_braking_distance() -> None:
    stopped = brake_to_rest(ramp_to_velocity(0.0, 0.0, 0.0, 100.0, 100.0, 100.0), 2.0, 50.0)
    assert stopped.position(10.0) == pytest.approx(50.0 + 100.0 + 100.0)
    assert stopped.end == pytest.approx(4.0)


def test_the_direction_changes_at_turning_points_only() -> None:
    out = ramp_to_target(0.0, 0.0, 0.0, 1000.0, 100.0, 100.0, 100.0)
    back = join(out, ramp_to_target(2.0, out.position(2.0), out.velocity(2.0), 0.0, 100.0, 100.0, 100.0))
    points = turning_points(back, 0.0)
    assert points[0] == 0.0
    for begin, end in pairwise(points):
        signs = {back.velocity(begin + share * (end - begin)) > 0.0 for share in (0.1, 0.5, 0.9)}
        assert len(signs) == 1
    assert 3.0 in [pytest.approx(point) for point in points]  # it brakes from 100 pps at 100 pps/s


def _check_smooth(trajectory: Trajectory, slope: float, speed: float) -> None:
    """Check that position and velocity are continuous between pieces."""
    for first, second in zip(trajectory.pieces, trajectory.pieces[1:], strict=False):
        dt = second.t - first.t
        position = first.position + dt * (first.velocity + 0.5 * dt * first.acceleration)
        velocity = first.velocity + dt * first.acceleration
        assert position == pytest.approx(second.position, rel=1e-6, abs=1e-3 + 1e-6 * speed)
        assert velocity == pytest.approx(second.velocity, rel=1e-6, abs=1e-6 * speed)
        assert abs(first.acceleration) <= slope * (1 + 1e-9)
