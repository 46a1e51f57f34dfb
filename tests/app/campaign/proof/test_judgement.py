"""The fit of shared inputs to values that are for the most part noise."""

import numpy as np
import pytest

from goniotwin.app.campaign.measurement_model.effects import Dense, Effects, Group
from goniotwin.app.campaign.measurement_model.fit import ValuesCovariance
from goniotwin.app.campaign.measurement_model.inputs import InputQuantity
from goniotwin.app.campaign.proof.judgement import scaled_to_truth


def test_noise_is_not_taken_for_an_input() -> None:
    """Values that are a third of their noise, nothing of them shared: each input is 0 within its uncertainty.

    Of the value, a sensitivity follows the noise: the products of both have the sum n, whatever the input is.
    """
    rng = np.random.default_rng(3)
    truth = np.full(3000, 1.0)
    noise = 3.0
    value = truth + noise * rng.normal(size=truth.size)
    inputs = [InputQuantity(name, "1", 0.05, "normal", "all values", "", "") for name in ("linearity", "crosstalk", "lamp")]
    # A share of the value, and what is added to it: 1 in the value's unit.
    sensitivity = np.stack([-3.0 * np.ones(value.size), 1.0 / value], axis=1)
    group = Group("lamp", {0: inputs[2]}, np.zeros((value.size, 1), dtype=np.int64), np.ones((value.size, 1)))
    effects = Effects(value, {"noise": (noise / value) ** 2}, [group], [Dense(inputs[:2], sensitivity)])
    residual = (value - truth) / value
    fit = ValuesCovariance(scaled_to_truth(effects, truth / value)).fit(residual)
    for estimate, expected in zip(fit.estimate, fit.expected_variance, strict=True):
        assert abs(estimate) < 3.5 * np.sqrt(expected)
    assert abs(ValuesCovariance(effects).fit(residual).of("linearity")) > 0.05  # a whole u: the fault that this prevents
    added = scaled_to_truth(effects, truth / value).dense[0].sensitivity[:, 1]
    assert added == pytest.approx(1.0 / value)
