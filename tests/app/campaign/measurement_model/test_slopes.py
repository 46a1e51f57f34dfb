"""What a parabola through neighbours does not resolve: third and fourth derivatives, which show on both sides."""

import numpy as np
import pytest

from goniotwin.app.campaign.measurement_model.slopes import MAX_DISTANCE_RAD, local_parabola
from goniotwin.arrays import Floats


@pytest.mark.parametrize("step", [0.02, 0.002], ids=["three values", "many values"])
def test_third_and_fourth_derivatives_are_found_by_the_two_sides(step: float) -> None:
    window = 0.02
    x: Floats = np.asarray(np.arange(-40, 41) * step, dtype=np.float64)
    line = np.zeros(x.size, dtype=np.int64)
    middle = x.size // 2
    for power, error_of, size_of in ((3, "first", "departure"), (4, "second", "half_difference")):
        fit = local_parabola(line, x, x**power, np.zeros(x.size), window, MAX_DISTANCE_RAD)
        error = abs(getattr(fit, error_of)[middle])  # the true derivative in the middle is 0
        share = fit.third if power == 3 else fit.fourth
        assert error > 0.0
        assert abs(share[middle] * getattr(fit, size_of)[middle]) == pytest.approx(error, rel=1e-9)


def test_a_parabola_is_resolved() -> None:
    x: Floats = np.asarray(np.arange(-10, 11) * 0.01, dtype=np.float64)
    fit = local_parabola(np.zeros(x.size, dtype=np.int64), x, 3.0 * x**2 - x, np.zeros(x.size), 0.02, MAX_DISTANCE_RAD)
    assert np.allclose(fit.half_difference, 0.0, atol=1e-9)
    assert np.allclose(fit.departure, 0.0, atol=1e-9)
