"""The time left learns from the pace: of a simulation that keeps up or not, of slow devices, past a long row."""

import itertools

import numpy as np
import pytest

from goniotwin.app.campaign.row import Row
from goniotwin.app.desktop.model.time_left import TimeLeft, mountings

ROWS, SECONDS = 130, 2.2
"""About as many rows as examples/schedules/quick.toml has, and their estimated durations."""


def estimated() -> list[float]:
    """Estimated durations, a move of another axis now and then."""
    return [8.0 if k % 10 == 9 else SECONDS for k in range(ROWS)]


def after(done: int, took: list[float], speed: float = 1.0) -> TimeLeft:
    """The time left after so many rows, which took so long in real time."""
    seconds = estimated()
    left = [*itertools.accumulate(reversed(seconds), initial=0.0)][::-1]
    pace, now = TimeLeft(speed), 1000.0
    pace.begin(now, ROWS, left[0])
    for k in range(done):
        now += took[k]
        pace.add_row(now, seconds[k], ROWS - k - 1, left[k + 1])
    return pace


def test_before_the_first_row_it_is_the_estimate() -> None:
    assert after(0, []).left.seconds == pytest.approx(sum(estimated()))
    assert after(0, [], 60.0).left.seconds == pytest.approx(sum(estimated()) / 60.0)


@pytest.mark.parametrize("speed", [1.0, 10.0, 60.0])
@pytest.mark.parametrize("more_s", [0.0, 0.02, 0.25])
@pytest.mark.parametrize("factor", [0.9, 1.0, 1.1])
def test_after_a_tenth_it_is_within_a_tenth_and_its_band(speed: float, more_s: float, factor: float) -> None:
    """`more_s`: what the program takes for a row; at 60 times it may be eight times the estimate."""
    rng = np.random.default_rng(1)
    took = [(factor * each / speed + more_s) * (1.0 + 0.03 * rng.standard_normal()) for each in estimated()]
    done = ROWS // 10
    wait = after(done, took, speed).left
    left = sum(took[done:])
    assert wait.seconds == pytest.approx(left, rel=0.1)
    assert abs(wait.seconds - left) < 1.5 * wait.band
    assert wait.band < 0.5 * left


def test_a_row_that_takes_very_long_counts_little() -> None:
    took = estimated()
    left = sum(took[20:])
    took[10] += 100.0
    assert after(20, took).left.seconds == pytest.approx(left, rel=0.2)


def test_a_pause_is_no_pace_and_a_new_speed_needs_no_new_learning() -> None:
    took = [each / 10.0 + 0.05 for each in estimated()]
    pace, seconds = after(20, took, 10.0), estimated()
    before = pace.left.seconds
    pace.interrupt(5000.0)
    now = 5000.0
    for k in range(20, 24):
        now += took[k]
        pace.add_row(now, seconds[k], ROWS - k - 1, sum(seconds[k + 1 :]))
    assert pace.left.seconds == pytest.approx(before - sum(took[20:24]), rel=0.05)
    pace.set_speed(now, 60.0)
    assert pace.left.seconds == pytest.approx(sum(each / 60.0 + 0.05 for each in seconds[24:]), rel=0.1)


def test_the_next_mounting_is_a_part_of_the_whole() -> None:
    rows = [
        Row(k, f"row {k}", "mount" if k in (0, 60) else "measure", "a" if k < 60 else "b", seconds)
        for k, seconds in enumerate(estimated())
    ]
    first, second = mountings(rows)
    assert (first.number, first.sample, first.rows_left) == (0, "a", ROWS)
    assert (second.number, second.sample, second.rows_left) == (60, "b", ROWS - 60)
    pace = after(20, estimated())
    assert pace.until(second).seconds == pytest.approx(sum(estimated()[20:60]), rel=0.05)
    assert pace.until(second).seconds < pace.left.seconds
