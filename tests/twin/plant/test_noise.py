"""Counter-based random numbers."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.arrays import Floats
from goniotwin.twin.plant.noise import normal, wandering
from goniotwin.twin.plant.process_key import process_key

COUNT = 20_000


def _numbers(seed: int, process: str) -> Floats:
    key = process_key(seed, process)
    return np.array([normal(key, np.int64(k)) for k in range(COUNT)])


def test_numbers_are_standard_normal() -> None:
    numbers = _numbers(1, "lamp")
    assert abs(numbers.mean()) < 4.0 / np.sqrt(COUNT)
    assert abs(numbers.var() - 1.0) < 4.0 * np.sqrt(2.0 / COUNT)
    inside = np.array([np.mean(np.abs(numbers) < limit) for limit in (1.0, 2.0, 3.0)])
    expected = np.array([0.682689, 0.954500, 0.997300])  # of the normal distribution
    assert np.all(np.abs(inside - expected) < 4.0 * np.sqrt(expected * (1 - expected) / COUNT))
    assert np.abs(numbers).max() < 6.0


def test_consecutive_numbers_seeds_and_processes_are_uncorrelated() -> None:
    one, other_process, other_seed = _numbers(1, "lamp"), _numbers(1, "dark 0"), _numbers(2, "lamp")
    limit = 4.0 / np.sqrt(COUNT)
    assert abs(np.mean(one[1:] * one[:-1])) < limit
    assert abs(np.mean(one * other_process)) < limit
    assert abs(np.mean(one * other_seed)) < limit


@given(st.integers(0, 2**31), st.integers(-(2**40), 2**40))
def test_a_number_depends_on_seed_process_and_counter_alone(seed: int, count: int) -> None:
    key = process_key(seed, "monitor")
    assert normal(key, np.int64(count)) == normal(process_key(seed, "monitor"), np.int64(count))


def test_a_slow_process_has_no_jumps() -> None:
    key = process_key(3, "wander")
    times = np.linspace(0.0, 100.0, 10_001)
    values = np.array([wandering(key, float(t), 10.0) for t in times])
    assert np.abs(np.diff(values)).max() < 0.01  # steps of 0.01 s, a thousandth of the period
    assert values.std() > 0.3
