"""Random numbers and elementary functions of the forward estimator's loops."""

import math
from typing import Any

import numpy as np
import pytest

from goniotwin.twin.optics.forward.elementary import arcsine, cosine, cosine_and_sine, exp_minus, minus_log, sine_ratio
from goniotwin.twin.optics.kernel import kernel
from goniotwin.twin.optics.montecarlo import circle_point, high_16, low_16, scramble, uniform, upper_24, word, word_key
from tests.sizes import parted

COUNT = 1 << 20


@kernel()
def numbers(block: int, count: int) -> Any:
    """Numbers made of the three words of a block's paths."""
    key = scramble(np.uint64(block))
    keys = word_key(key, 0), word_key(key, 1)
    result = np.empty((count, 4))
    for i in range(count):
        first, second = word(keys[0], i), word(keys[1], i)
        result[i, 0], result[i, 1] = low_16(first), high_16(first)
        result[i, 2] = upper_24(second)
        result[i, 3] = uniform(key, i)
    return result


def chi_square(counts: Any) -> float:
    """Chi-square of equal counts, as a standard normal number (Wilson, Hilferty)."""
    expected, freedom = counts.mean(), counts.size - 1
    chi = float(np.sum((counts - expected) ** 2) / expected / freedom)
    return float((chi ** (1 / 3) - 1.0 + 2.0 / (9 * freedom)) / math.sqrt(2.0 / (9 * freedom)))


@parted(4)
@pytest.mark.parametrize("block", [0, 1, 12345])
def test_the_numbers_of_a_path_are_uniform_and_independent(block: int, part: int) -> None:
    drawn = numbers(block, COUNT // part)
    assert np.all((drawn >= 0.0) & (drawn < 1.0))
    for a in range(4):
        assert abs(chi_square(np.histogram(drawn[:, a], 4096, (0.0, 1.0))[0])) < 4.5
        for b in range(a):
            assert abs(chi_square(np.histogram2d(drawn[:, a], drawn[:, b], 64, [[0, 1], [0, 1]])[0])) < 4.5
        # Neighbouring paths are independent too.
        assert abs(chi_square(np.histogram2d(drawn[1:, a], drawn[:-1, a], 64, [[0, 1], [0, 1]])[0])) < 4.5


def test_blocks_are_independent() -> None:
    drawn = np.array([numbers(block, 2) for block in range(20_000)])
    for a in range(4):
        assert abs(chi_square(np.histogram2d(drawn[:, 0, a], drawn[:, 1, a], 32, [[0, 1], [0, 1]])[0])) < 4.5
        assert abs(chi_square(np.histogram2d(drawn[1:, 0, a], drawn[:-1, 0, a], 32, [[0, 1], [0, 1]])[0])) < 4.5


@kernel()
def applied(which: int, values: Any) -> Any:
    result = np.empty(values.size)
    for i in range(values.size):
        x = values[i]
        if which == 0:
            result[i] = sine_ratio(x)
        elif which == 1:
            result[i] = cosine(x)
        elif which == 2:
            result[i] = minus_log(x)
        elif which == 3:
            result[i] = exp_minus(x)
        elif which == 4:
            result[i] = arcsine(x)
        else:
            result[i] = math.atan2(cosine_and_sine(x)[1], cosine_and_sine(x)[0]) / (2.0 * math.pi) + 0.5
    return result


@pytest.mark.parametrize(
    ("which", "function", "low", "high", "relative"),
    [
        (0, lambda x: np.sinc(np.sqrt(x) / np.pi), 0.0, (0.5 * math.pi) ** 2, 3e-7),
        (1, lambda x: np.cos(np.sqrt(x)), 0.0, 2.0, 1e-6),
        (2, lambda x: -np.log(x), 2.0**-24, 0.9999, 5e-7),
        (3, lambda x: np.exp(-x), 0.0, 50.0, 6e-6),
        (4, np.arcsin, 1e-6, 1.0, 5e-7),
        (5, lambda x: x, 0.05, 0.95, 2e-6),
    ],
    ids=["sine", "cosine", "log", "exp", "arcsine", "turn"],
)
def test_functions_are_accurate_to_single_precision(
    which: int, function: Any, low: float, high: float, relative: float
) -> None:
    values = np.concatenate([np.linspace(low, high, 20_001), np.geomspace(max(low, 1e-6), high, 20_001)]).astype(np.float32)
    values = np.clip(values, np.float32(low), np.float32(high))
    exact = function(values.astype(np.float64))
    assert np.max(np.abs(applied(which, values) - exact) / np.abs(exact)) < relative


def test_values_far_below_a_peak_are_zero_instead_of_denormal() -> None:
    drawn = applied(3, np.array([55.0, 56.0, 200.0, 1e9, np.inf], dtype=np.float32))
    assert drawn[0] == pytest.approx(math.exp(-55.0), rel=1e-5)
    assert not np.any(drawn[1:])


def test_a_point_of_the_circle_is_exact_to_the_last_digits() -> None:
    for share in np.linspace(0.0, 1.0, 1001):
        turn = 2.0 * math.pi * share
        assert circle_point(share) == pytest.approx((math.cos(turn), math.sin(turn)), abs=2e-15)
