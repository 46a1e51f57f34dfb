"""What observations show of inputs: against a Kalman filter by hand, augmented least squares, and drawn inputs."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.campaign.measurement_model.alignment import Alignment, chance_of
from goniotwin.app.campaign.measurement_model.posterior import Posterior
from tests.app.campaign.measurement_model.made_effects import made_input


def made_posterior(seed: int, observations: int, inputs: int, *, correlated: bool = False) -> Posterior:
    rng = np.random.default_rng(seed)
    before = Alignment.stated([made_input(f"input {k}", float(u)) for k, u in enumerate(rng.uniform(0.1, 2.0, inputs))])
    if correlated:
        turned = rng.normal(size=(inputs, inputs))
        before = replace(before, value=rng.normal(size=inputs), covariance=turned @ turned.T + np.eye(inputs))
    own = rng.normal(size=(observations, observations))
    own = own @ own.T + 0.1 * np.eye(observations)
    return Posterior(before, rng.normal(size=observations), rng.normal(size=(observations, inputs)), own)


def test_one_observation_is_a_kalman_filter_by_hand() -> None:
    """An input of u 2, observed as 3 with u 1: 3 * 4 / 5, variance 4 / 5, and 3 is 3 / sqrt(5) u from what was expected."""
    found = Posterior(Alignment.stated([made_input("x", 2.0)]), np.array([3.0]), np.ones((1, 1)), np.ones((1, 1)))
    assert found.alignment.value == pytest.approx([2.4])
    assert found.alignment.covariance == pytest.approx(np.array([[0.8]]))
    assert found.rank == pytest.approx(0.8)
    assert found.determined == 1
    assert found.chi_square == pytest.approx(1.8)
    (single,) = found.single_errors
    assert single.size == pytest.approx(3.0)
    assert single.u == pytest.approx(math.sqrt(5.0))
    assert found.chance == pytest.approx(math.erfc(math.sqrt(0.9)), rel=0.05)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 8), st.integers(1, 9))
def test_a_posterior_is_augmented_least_squares(seed: int, observations: int, inputs: int) -> None:
    """Observations and prior as rows of one least squares; eigenvalues of the information for the rank."""
    found = made_posterior(seed, observations, inputs, correlated=True)
    of_own, of_prior = (np.linalg.inv(np.linalg.cholesky(each)) for each in (found.own, found.before.covariance))
    rows = np.concatenate([of_own @ found.sensitivity, of_prior])
    seen = np.concatenate([of_own @ found.residual, np.zeros(inputs)])
    solved, _, _, _ = np.linalg.lstsq(rows, seen, rcond=None)
    assert found.alignment.value == pytest.approx(found.before.value + solved, rel=1e-6, abs=1e-8)
    assert found.alignment.covariance == pytest.approx(np.linalg.inv(rows.T @ rows), rel=1e-6, abs=1e-8)
    assert found.chi_square == pytest.approx(float(np.sum((rows @ solved - seen) ** 2)), rel=1e-6)
    whitened = of_own @ found.sensitivity @ np.linalg.inv(of_prior)
    information = np.linalg.eigvalsh(whitened.T @ whitened)
    assert found.rank == pytest.approx(float(np.sum(information / (1.0 + information))), rel=1e-6)
    assert found.determined == int(np.sum(information > 1.0))


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6))
def test_two_observations_one_after_the_other_are_both_together(seed: int) -> None:
    both = made_posterior(seed, 2, 4)
    both = replace(both, own=np.diag(np.diag(both.own)))
    one = replace(both, residual=both.residual[:1], sensitivity=both.sensitivity[:1], own=both.own[:1, :1])
    between = one.alignment
    expected = both.sensitivity[1:] @ (between.value - both.before.value)
    other = Posterior(between, both.residual[1:] - expected, both.sensitivity[1:], both.own[1:, 1:])
    assert other.alignment.value == pytest.approx(both.alignment.value, rel=1e-6, abs=1e-9)
    assert other.alignment.covariance == pytest.approx(both.alignment.covariance, rel=1e-6, abs=1e-9)
    assert one.chi_square + other.chi_square == pytest.approx(both.chi_square, rel=1e-6)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), st.booleans(), st.sampled_from([1.0, 1e-9]))
def test_the_inputs_after_observations_keep_their_names(seed: int, correlated: bool, least: float) -> None:
    """The uncorrelated inputs before and the observations' own errors have the covariance of an augmented least squares.

    Also where the observations are all but exact, and a covariance less another one would have negative variances.
    """
    found = made_posterior(seed, 3, 5, correlated=correlated)
    own = least * np.diag(found.own)
    found = replace(found, own=np.diag(own))
    errors = [made_input(f"error {k}", math.sqrt(each)) for k, each in enumerate(own.tolist())]
    after = found.named_alignment(errors, "a scan")
    inputs, change = after.modes
    names = [each.name for each in (found.before.modes[0] if correlated else found.before.inputs)]
    assert [each.name for each in inputs] == [*names, *(each.name for each in errors)]
    scaled = change * [each.u for each in inputs]
    of_prior = np.linalg.inv(np.linalg.cholesky(found.before.covariance))
    rows = np.concatenate([found.sensitivity / np.sqrt(own)[:, None], of_prior])
    seen = np.concatenate([found.residual / np.sqrt(own), np.zeros(5)])
    assert after.value == pytest.approx(found.before.value + np.linalg.lstsq(rows, seen, rcond=None)[0], rel=1e-5, abs=1e-6)
    left = np.linalg.pinv(rows)
    scale = float(np.abs(found.before.covariance).max())
    for covariance in (scaled @ scaled.T, after.covariance):
        assert covariance == pytest.approx(left @ left.T, rel=1e-5, abs=1e-6 * scale)
    assert np.all(np.diag(after.covariance) >= 0.0)


def test_what_is_left_of_the_inputs_and_the_observations_make_the_posterior_covariance() -> None:
    found = made_posterior(5, 3, 6)
    wanted = np.random.default_rng(1).normal(size=(2, 6))
    left, prior = found.left(wanted), found.before.covariance
    of_own = wanted @ found.alignment.covariance @ found.sensitivity.T @ np.linalg.inv(found.own)  # the gain, another way
    assert left @ prior @ left.T + of_own @ found.own @ of_own.T == pytest.approx(
        wanted @ found.alignment.covariance @ wanted.T, rel=1e-6
    )


def test_one_input_that_is_off_is_named_with_its_size() -> None:
    """What it does to the observations is explained by no other as well: Cauchy and Schwarz."""
    found = made_posterior(7, 4, 5)
    off = replace(found, residual=9.0 * found.sensitivity[:, 3])
    assert off.single_errors[0].input.name == "input 3"
    assert off.single_errors[0].size == pytest.approx(9.0, rel=1e-9)
    assert off.single_errors[0].z ** 2 == pytest.approx(off.chi_square, rel=1e-9)


def test_a_rectangular_input_has_no_tails() -> None:
    """Half of the rigs are beyond half of its width, and none beyond the whole: a normal law would have 8 % there."""
    one = replace(made_input("angle", 1.0 / math.sqrt(3.0)), distribution="rectangular")
    for size, share in ((0.5, 0.5), (0.9, 0.1), (1.01, 0.0)):
        found = Posterior(Alignment.stated([one]), np.array([size]), np.ones((1, 1)), np.full((1, 1), 1e-8))
        assert found.chance == pytest.approx(share, abs=0.01)


@pytest.mark.long
@pytest.mark.parametrize("correlated", [False, True])
def test_chances_of_errors_of_the_stated_law_are_uniform(correlated: bool) -> None:
    """Of drawn errors 5 % have a chance below 0.05, 50 % below 0.5; chi-square has its mean."""
    law, rng = made_posterior(11, 3, 4, correlated=correlated), np.random.default_rng(2)
    total = law.sensitivity @ law.before.covariance @ law.sensitivity.T + law.own
    drawn = [replace(law, residual=each) for each in rng.multivariate_normal(np.zeros(3), total, 200)]
    chances = np.array([each.chance for each in drawn])
    for level in (0.05, 0.5, 0.9):
        assert np.mean(chances < level) == pytest.approx(level, abs=3.5 * math.sqrt(level * (1.0 - level) / 200))
    assert np.mean([each.chi_square for each in drawn]) == pytest.approx(3.0, abs=3.5 * math.sqrt(6.0 / 200))


def test_the_chance_of_a_chi_square_is_that_of_its_table() -> None:
    """5 % and 0.1 % of the distributions of 2 and 10 degrees of freedom, by their tables; the formula is near."""
    for degrees, at, share in ((2, 5.991, 0.05), (2, 13.816, 0.001), (10, 18.307, 0.05), (10, 29.588, 0.001)):
        assert chance_of(at, degrees) == pytest.approx(share, rel=0.2)


def test_the_departure_of_an_alignment_is_a_chi_square_of_what_it_has_determined() -> None:
    """Inputs drawn as stated, observed with little noise: as many degrees of freedom as combinations."""
    law, rng = made_posterior(3, 2, 5), np.random.default_rng(4)
    law = replace(law, own=1e-4 * np.eye(2))
    u = np.array([each.u for each in law.before.inputs])
    found = []
    for _ in range(200):
        seen = law.sensitivity @ (u * rng.standard_normal(5)) + 1e-2 * rng.standard_normal(2)
        departure, count = replace(law, residual=seen).alignment.departure
        assert count == 2
        found.append(departure)
    assert np.mean(found) == pytest.approx(2.0, abs=3.5 * math.sqrt(4.0 / 200))
    off = replace(law, residual=9.0 * law.sensitivity[:, 0] * u[0])
    assert off.alignment.departure[0] == pytest.approx(off.chi_square, rel=0.01)  # by the observations themselves
    assert law.alignment.rank == pytest.approx(law.rank, rel=1e-6)
