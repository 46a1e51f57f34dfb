"""The stages of a tolerance study on responses whose limits, worst corners and yields have closed forms."""

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest

from goniotwin.app.simulation.corner_search import rms_percent, search_worst
from goniotwin.app.simulation.tolerances.drawing import draw_deviations
from goniotwin.app.simulation.tolerances.stages import (
    all_combinations,
    counted_share,
    evaluate_draws,
    levels_of,
    limits_alone,
    random_corners,
    reduce_limits,
    worst_combination,
)
from goniotwin.arrays import Floats

RANDOM = np.random.Generator(np.random.Philox(3))


class Closed:
    """A response with a closed form, which counts its evaluations."""

    def __init__(self, function: Callable[[Floats], Floats]) -> None:
        self.function, self.evaluated = function, 0

    def residuals(self, values: Floats) -> Floats:
        self.evaluated += len(values)
        return self.function(values)


def linear(slopes: Floats, constant: float = 0.0) -> Closed:
    """One residual, the sum of the deviations times their slopes (k,)."""
    return Closed(lambda values: constant + values @ slopes[:, None])


def test_limits_alone_of_a_linear_response_are_the_limit_over_the_slope() -> None:
    slopes = np.array([0.5, -2.0, 0.0, 1e-3])
    limits = np.array([0.05, 0.01, 0.1, 0.1])
    found = limits_alone(linear(slopes), limits, np.full(4, 1.0), (5.0, 10.0))
    np.testing.assert_allclose(found.percent, 100.0 * np.abs(slopes * limits)[:, None] * np.ones(2), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(found.permitted[:2], [[0.1, 0.2], [0.025, 0.05]], rtol=1e-9)
    assert np.all(np.isinf(found.permitted[2:]))


def test_the_worse_sign_and_the_first_of_several_failures_decide_a_limit_alone() -> None:
    # Plus fails at 0.2, minus at 0.1; beyond 0.3 both pass again.
    one_sided = Closed(lambda values: np.where((values > 0.2) & (values < 0.3) | (values < -0.1) & (values > -0.3), 1.0, 0.0))
    found = limits_alone(one_sided, np.array([0.15]), np.array([1.0]), (5.0,))
    np.testing.assert_allclose(found.percent, [[100.0, 0.0]])
    assert found.permitted[0, 0] == pytest.approx(0.1, rel=1e-6)


def test_a_response_without_a_value_fails() -> None:
    assert rms_percent(np.array([[0.0, np.nan]]))[0] == math.inf
    clipped = Closed(lambda values: np.where(np.abs(values) < 0.25, 0.0, np.nan))
    assert limits_alone(clipped, np.array([0.1]), np.array([1.0]), (5.0,)).permitted[0, 0] == pytest.approx(0.25, rel=1e-6)


def test_all_combinations_of_a_linear_response_are_counted_and_the_worst_is_the_sum() -> None:
    slopes, limits = np.array([0.3, -0.5, 0.2]), np.array([0.1, 0.1, 0.1])
    found = all_combinations(linear(slopes), [levels_of(0.1, 0.1)] * 3, (5.0, 10.0))
    every = np.array([abs(np.dot(each, slopes)) for each in itertools.product((-0.1, 0.0, 0.1), repeat=3)])
    np.testing.assert_allclose(found.percent, 100.0 * every, rtol=1e-12, atol=1e-12)
    assert found.worst_percent == pytest.approx(10.0)
    assert found.shares == ((float(np.mean(every <= 0.05)), 0.0), (1.0, 0.0))
    np.testing.assert_allclose(np.abs(found.worst), limits)
    # The paper's reading: each deviation still has its whole range among the combinations that pass.
    np.testing.assert_allclose(found.surviving, [[-0.1, 0.1]] * 3)


def test_levels_have_zero_and_both_limits() -> None:
    np.testing.assert_allclose(levels_of(0.05, 0.05), [-0.05, 0.0, 0.05])
    np.testing.assert_allclose(levels_of(0.1, 0.05), [-0.1, -0.05, 0.0, 0.05, 0.1])
    np.testing.assert_allclose(levels_of(0.05, 0.02), [-0.05, -0.04, -0.02, 0.0, 0.02, 0.04, 0.05])


def test_the_reduced_limits_of_a_linear_response_are_the_limit_over_the_sum_of_slopes() -> None:
    slopes, limits = np.array([0.4, -1.0, 0.6]), np.array([0.05, 0.05, 0.1])
    found = reduce_limits(linear(slopes, 0.01), limits, 5.0)
    assert found.factor == pytest.approx((0.05 - 0.01) / np.abs(slopes * limits).sum(), rel=1e-8)
    assert found.worst.percent == pytest.approx(5.0)
    passing = reduce_limits(linear(slopes), 0.1 * limits, 5.0)
    assert passing.factor == 1.0
    impossible = reduce_limits(linear(slopes, 0.1), limits, 5.0)
    assert impossible.factor == 0.0
    assert impossible.worst.percent == pytest.approx(10.0)


@pytest.mark.parametrize("count", [1, 2, 5, 8])
def test_the_search_finds_the_worst_corner_of_random_quadratic_responses(count: int) -> None:
    """The residuals of a lobe: linear in the deviations, with squares and products a tenth as large."""
    for _ in range(3):
        constant, slopes = 0.02 * RANDOM.standard_normal(9), 0.05 * RANDOM.standard_normal((count, 9))
        bends = 0.005 * RANDOM.standard_normal((count, count, 9))
        response = Closed(
            lambda x, c=constant, s=slopes, b=bends: c + x @ s + np.einsum("ni,nj,ijm->nm", x, x, b)  # type: ignore[misc]
        )
        every = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=count)))
        assert search_worst(response.residuals, count).percent == rms_percent(response.residuals(every)).max()


def test_the_search_takes_few_evaluations() -> None:
    slopes = RANDOM.standard_normal((12, 41))
    response = Closed(lambda x: x @ slopes)
    found = search_worst(response.residuals, 12)
    assert response.evaluated == found.evaluated < 1500
    assert found.percent == pytest.approx(found.linear_percent)


def test_the_search_of_more_deviations_than_have_their_corners_listed_finds_the_corner_with_all_signs() -> None:
    slopes = RANDOM.standard_normal(18)
    found = search_worst(linear(slopes, 0.5).residuals, 18)
    assert found.percent == pytest.approx(100.0 * (0.5 + np.abs(slopes).sum()))
    assert found.levels.tolist() == np.sign(slopes).tolist()


def test_the_search_of_many_deviations_fails_a_response_without_light_at_a_limit() -> None:
    """Such as a detector that no longer sees the sample: the residuals of these combinations are not numbers."""
    slopes = 0.01 * RANDOM.standard_normal((15, 9))

    def residuals(x: Floats) -> Floats:
        found = x @ slopes
        found[np.abs(x[:, 3]) > 0.5] = np.nan
        return np.asarray(found)

    assert search_worst(residuals, 15).percent == math.inf


def test_the_search_finds_the_worst_corner_where_the_response_is_flat_about_zero() -> None:
    """As a flux is until the light's edge reaches the square: a loss beyond a margin, in two directions."""
    across, up = RANDOM.standard_normal((2, 24))

    def loss(x: Floats) -> Floats:
        edges = [np.maximum(np.abs(x @ each) - 4.0, 0.0) for each in (across, up)]
        return np.asarray((edges[0] + edges[1])[:, None])

    found = search_worst(loss, 24)
    # Either alone has a closed form; together at least the larger of both.
    assert found.percent >= 100.0 * (max(np.abs(each).sum() for each in (across, up)) - 4.0)
    best_of_many = rms_percent(loss(random_corners(np.ones(24), 200_000, 1))).max()
    assert found.percent >= best_of_many


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_search_of_many_deviations_does_not_depend_on_where_it_begins(seed: int) -> None:
    """Thirty deviations with a margin in two directions, each of which moves the light a little: many corners nearly alike."""
    slopes = np.random.Generator(np.random.Philox(9)).uniform(0.0, 1.0, (2, 30)) ** 3

    def loss(x: Floats) -> Floats:
        left = [np.clip(1.0 - 0.05 * np.maximum(np.abs(x @ each) - 3.0, 0.0), 0.0, 1.0) for each in slopes]
        return np.asarray((1.0 - left[0] * left[1] * (1.0 - 1e-3 * np.abs(x).sum(axis=1)))[:, None])

    found = search_worst(loss, 30, seed)
    # All deviations to one side: the largest sums of both directions and of the third term at once.
    assert found.percent == pytest.approx(float(rms_percent(loss(np.ones((1, 30))))[0]), rel=1e-12)


def test_the_yield_is_that_of_the_normal_distribution() -> None:
    slopes, limits = np.array([0.3, 0.4]), np.array([0.1, 0.1])
    draws = draw_deviations("normal", limits, 40_000, 1)
    found = evaluate_draws(linear(slopes), draws, (2.5,))
    # The sum has the standard deviation 0.05 * hypot(0.3, 0.4) = 0.025: one of them is 68.27 %.
    (share, error), *_ = found.shares
    assert error == pytest.approx(math.sqrt(0.6827 * 0.3173 / 40_000), rel=0.01)
    assert abs(share - 0.6827) < 4.0 * error


def test_the_yield_is_that_of_the_uniform_distribution() -> None:
    draws = draw_deviations("uniform", np.array([0.1]), 40_000, 1)
    ((share, error),) = evaluate_draws(linear(np.array([1.0])), draws, (2.5,)).shares
    assert abs(share - 0.25) < 4.0 * error
    assert np.abs(draws).max() <= 0.1


def test_a_share_of_all_or_none_still_has_a_standard_error() -> None:
    share, error = counted_share(np.ones(1000, dtype=np.bool_))
    assert share == 1.0
    assert error == pytest.approx(1e-3, rel=0.05)


def test_progress_is_reported_after_each_chunk() -> None:
    seen: list[tuple[float, str]] = []
    levels = [levels_of(1.0, 0.5)] * 6
    all_combinations(linear(np.ones(6)), levels, (5.0,), lambda share, step: seen.append((share, step)))
    assert len(seen) == 2
    assert seen[-1] == (1.0, "15625 of 15625 combinations")


def test_the_worst_combination_is_in_units_of_the_limits() -> None:
    slopes, limits = np.array([0.3, -0.5]), np.array([0.1, 0.02])
    found = worst_combination(linear(slopes), limits)
    assert found.percent == pytest.approx(100.0 * np.abs(slopes * limits).sum())
    assert abs(int(found.levels[0] - found.levels[1])) == 2
