"""The fit of shared inputs has the law that it states: against the definition with full matrices, and on drawn errors."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.campaign.measurement_model.effects import Effects
from goniotwin.app.campaign.measurement_model.fit import ValuesCovariance
from tests.app.campaign.measurement_model.made_effects import dense_sensitivities, drawn_errors, made_effects


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 40), st.integers(0, 4), st.integers(1, 9))
def test_fit_is_generalised_least_squares(seed: int, values: int, dense: int, members: int) -> None:
    effects = made_effects(seed, values, dense, members)
    residual = drawn_errors(effects, seed + 1)
    fit = ValuesCovariance(effects).fit(residual)
    own = np.sum(list(effects.independent.values()), axis=0)
    shared = dense_sensitivities(effects)
    alone = (shared != 0.0).sum(axis=0) < 2
    alone[:dense] = False
    v = own + np.sum(shared[:, alone] ** 2, axis=1)
    inverse = np.linalg.inv(np.diag(own) + shared @ shared.T)
    assert fit.chi_square == pytest.approx(v * (inverse @ residual) ** 2, rel=1e-6, abs=1e-12)
    assert fit.expected == pytest.approx(v * np.diag(inverse), rel=1e-6)
    for k, each in enumerate(effects.dense[0].inputs):
        at = [one.name for one in fit.inputs].index(each.name)
        assert fit.estimate[at] == pytest.approx(each.u * shared[:, k] @ inverse @ residual, rel=1e-6, abs=1e-12)
        assert fit.expected_variance[at] == pytest.approx(
            each.u**2 * shared[:, k] @ inverse @ shared[:, k], rel=1e-6, abs=1e-15
        )


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6))
def test_paired_covariance_is_the_diagonal_of_the_covariance(seed: int) -> None:
    effects = made_effects(seed, 12)
    rng = np.random.default_rng(seed)
    one, other = rng.integers(0, 12, 30), rng.integers(0, 12, 30)
    assert effects.paired_covariance(one, other) == pytest.approx(np.diag(effects.covariance(one, other)), rel=1e-9, abs=1e-18)


def _ratios(effects: Effects, law: Effects, rigs: int) -> tuple[float, float]:
    """chi2/n of what is left, and variance of the fitted dense inputs over the expected one, over drawn rigs."""
    left, expected, variance, known = 0.0, 0.0, 0.0, 0.0
    for seed in range(rigs):
        fit = ValuesCovariance(effects).fit(drawn_errors(law, seed))
        left, expected = left + fit.chi_square.sum(), expected + fit.expected.sum()
        u = np.array([each.u for each in fit.inputs])
        dense = np.array([each.name.startswith("dense") for each in fit.inputs])
        variance += float(np.sum((fit.estimate / u)[dense] ** 2))
        known += float(np.sum((fit.expected_variance / u**2)[dense]))
    return left / expected, variance / known


def test_errors_of_the_stated_law_give_one() -> None:
    effects = made_effects(3)
    left, variance = _ratios(effects, effects, 200)
    assert left == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / (200 * 30)))
    assert variance == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / (200 * 4)))


def test_wrong_uncertainties_are_found_where_they_are_wrong() -> None:
    effects = made_effects(3)
    noisier = replace(effects, independent={name: 4.0 * each for name, each in effects.independent.items()})
    left, variance = _ratios(effects, noisier, 50)
    assert left > 2.0
    assert variance < 1.5
    shared = replace(effects, dense=[replace(part, sensitivity=2.0 * part.sensitivity) for part in effects.dense])
    left, variance = _ratios(effects, shared, 50)
    assert left < 1.2
    assert variance > 3.0
