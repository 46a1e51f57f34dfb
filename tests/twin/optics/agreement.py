"""Agreement of two estimates of the same values within their errors."""

import math
from typing import Any

import numpy as np


def agree(first: Any, first_error: Any, second: Any, second_error: Any) -> None:
    """Check chi-square of difference over error within its quantiles of 0.0005 and 0.9995, and the largest below 5.5."""
    error = np.hypot(first_error, second_error)
    known = error > 0.0
    assert np.array_equal(np.asarray(first)[~known], np.asarray(second)[~known])
    deviation = (first - second)[known] / error[known]
    freedom = deviation.size
    # The normal approximation of Wilson and Hilferty.
    chi = (np.sum(deviation**2) / freedom) ** (1 / 3)
    assert abs(chi - 1.0 + 2.0 / (9 * freedom)) < 3.29 * math.sqrt(2.0 / (9 * freedom))
    assert np.max(np.abs(deviation)) < 5.5
