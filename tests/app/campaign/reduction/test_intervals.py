"""Intervals of 95 %: of the logarithm or not, and as many u away as their coverage."""

import math
from dataclasses import replace

import numpy as np
import pytest

from goniotwin.app.campaign.reduction.components import COVERAGE, interval, mostly_added
from goniotwin.app.campaign.studies.theory import deviations_in_u
from tests.app.campaign.reduction.made_points import made_points


def test_an_interval_is_one_of_the_logarithm_where_u_is_above_15_percent_and_not_noise() -> None:
    value, u = np.array([1.0, 1.0, 2.0, -1.0, 1.0]), np.array([0.1, 0.2, 0.6, 0.5, 0.3])
    parts = {"pose": u**2 * [1.0, 1.0, 0.51, 1.0, 0.49], "dark": u**2 * [0.0, 0.0, 0.49, 0.0, 0.3], "noise": u**2 * 0.21}
    parts["noise"][:4] = 0.0
    assert mostly_added(parts).tolist() == [False, False, False, False, True]
    low, high = interval(value, u, mostly_added(parts))
    assert low == pytest.approx([1.0 - 0.196, math.exp(-0.392), 2.0 * math.exp(-0.588), -1.0 - 0.98, 1.0 - 0.588])
    assert high == pytest.approx([1.0 + 0.196, math.exp(0.392), 2.0 * math.exp(0.588), -1.0 + 0.98, 1.0 + 0.588])


def test_an_end_of_an_interval_is_as_many_u_away_as_its_coverage() -> None:
    """The rule of intervals is that of deviations from a truth."""
    made = made_points(30.0, np.full(4, 40.0), np.full(4, 180.0), np.array([1.0, 1.0, 1.0, -1.0]), 0.0)
    u = np.array([0.1, 0.3, 0.3, 0.3])
    added = u**2 * [0.0, 0.0, 1.0, 0.0]
    points = replace(made, own={"noise": added, "pose": u**2 - added})
    for end, sign in zip(interval(points.bsdf, points.u_bsdf, mostly_added(points.components)), (1.0, -1.0), strict=True):
        assert deviations_in_u(points, end) == pytest.approx(np.full(4, sign * COVERAGE), rel=1e-12)
