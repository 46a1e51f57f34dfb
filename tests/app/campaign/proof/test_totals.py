"""Totals of a proof on results of a known law: exact coverage, its standard error over rigs, and what is wrong is seen."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.campaign.proof.judgement import Cell, RigResult
from goniotwin.app.campaign.proof.totals import Totals, chi_square_quantile, mean_square_limits
from goniotwin.app.json_document import json_value


def made_results(seed: int, rigs: int, values: int, common: float, wrong: float = 1.0) -> list[RigResult]:
    """Rigs with values of a normal law, of whose variance a rig has the share `common` in all of its values."""
    rng = np.random.default_rng(seed)
    results = []
    for rig in range(rigs):
        z = wrong * (math.sqrt(common) * rng.normal() + math.sqrt(1.0 - common) * rng.normal(size=values))
        left = z - z.mean()
        cell = Cell(
            values,
            int(np.sum(np.abs(z) <= 1.96)),
            float(z.sum()),
            int(np.sum(np.abs(z) > 5.0)),
            float(np.sum(left**2)),
            (1.0 - common) * (values - 1.0),
        )
        u = 0.01
        results.append(
            RigResult(
                rig,
                {"all": {"all": cell}, "decade": {"1e+0 to 1e-1": cell}},
                {"pose": (float(wrong * rng.normal()) ** 2, 1.0)},
                {"paint": (float(d := rng.normal()), float(d + 0.01 * rng.normal()))},
                {"paint, 550 nm": (u * (of_sum := float(wrong * rng.normal())), u, of_sum, 0.0)},
            )
        )
    return results


def standard_error(rigs: int, values: int, common: float) -> float:
    """That of a coverage of 95 %: values of one rig that share their error are worth few values."""
    shared, weight = np.polynomial.hermite_e.hermegauss(120)
    ends = [(each - math.sqrt(common) * shared) / math.sqrt(1.0 - common) for each in (-1.96, 1.96)]
    low, high = (np.array([0.5 * math.erfc(-each / math.sqrt(2.0)) for each in end.tolist()]) for end in ends)
    within = high - low
    mean = float(weight @ within / weight.sum())
    of_rig = float(weight @ ((within - mean) ** 2 + within * (1.0 - within) / values) / weight.sum())
    return math.sqrt(of_rig / rigs)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), st.floats(0.0, 0.9))
def test_the_law_that_is_stated_is_found_within_the_standard_errors(seed: int, common: float) -> None:
    totals = Totals(made_results(seed, 300, 30, common))
    whole = totals.whole
    assert whole is not None
    expected = standard_error(300, 30, common)
    assert abs(whole.coverage - 0.95) < 5.0 * expected
    assert 0.4 * expected < whole.u_coverage < 1.8 * expected
    assert abs(whole.mean) < 5.0 * whole.u_mean
    assert whole.chi_square == pytest.approx(1.0, abs=5.0 * math.sqrt(2.0 / (300 * 29)))
    assert totals.variance_shared == pytest.approx(1.0, abs=5.0 * math.sqrt(2.0 / 300))
    (reflectance,) = totals.reflectances
    assert reflectance.u_over_scatter == pytest.approx(1.0, abs=0.25)


def test_what_the_directions_do_not_resolve_is_drawn_once_for_all_rigs() -> None:
    for share, size, outside in (
        (0.95, 0.3, False),
        (0.1, 0.3, True),
        (0.95, 2.0, False),
        (0.95, 3.0, True),
        (0.1, 1.0, False),
    ):
        errors = [size * (-1) ** seed for seed in range(30)]
        found = [RigResult(k, reflectances={"paint, 550 nm": (z, 1.0, z, share)}) for k, z in enumerate(errors)]
        (reflectance,) = Totals(found).reflectances
        assert reflectance.outside == outside


def test_what_is_wrong_is_seen() -> None:
    totals = Totals(made_results(1, 100, 30, 0.5, wrong=2.0))
    whole, (reflectance,) = totals.whole, totals.reflectances
    assert whole is not None
    assert whole.coverage < 0.95 - 5.0 * whole.u_coverage
    assert whole.chi_square > 3.0
    assert totals.variance_shared > 2.0
    assert reflectance.chi_square > reflectance.limits[1]
    assert reflectance.u_over_scatter < 0.7
    assert totals.worst is not None
    assert totals.worst[1].label == "1e+0 to 1e-1"
    correlation, difference = totals.angles["paint"]
    assert correlation > 0.999
    assert difference == pytest.approx(0.01, rel=0.3)


def test_no_rig_and_one_rig_have_no_standard_error() -> None:
    assert json_value(Totals([]))["coverage_percent"] is None
    one = json_value(Totals(made_results(1, 1, 30, 0.5)))
    assert one["standard_error_percent"] is None
    failed = Totals([RigResult(7, failed="the lamp")])
    assert (failed.rigs, failed.failed) == (0, {7: "the lamp"})


@pytest.mark.parametrize(("freedom", "low", "high"), [(20, 7.434, 39.997), (200, 152.241, 255.264)])
def test_limits_of_chi_square(freedom: int, low: float, high: float) -> None:
    """Quantiles of 0.5 and 99.5 % from the tables of chi-square."""
    assert chi_square_quantile(freedom, -2.5758) == pytest.approx(low, rel=1e-2)
    assert chi_square_quantile(freedom, 2.5758) == pytest.approx(high, rel=1e-2)


def test_limits_of_a_mean_square_of_deviates_that_have_a_part_in_common() -> None:
    """With nothing in common those of chi-square of 20 over 20, with all those of 1, by its tables; between by draws."""
    assert mean_square_limits(20, 0.0) == pytest.approx((7.434 / 20.0, 39.997 / 20.0), rel=2e-2)
    assert mean_square_limits(20, 1.0) == pytest.approx((3.93e-5, 7.879), rel=2e-2)
    draws = np.random.default_rng(1)
    z = math.sqrt(0.6) * draws.normal(size=(100_000, 1)) + math.sqrt(0.4) * draws.normal(size=(100_000, 8))
    drawn = np.quantile(np.mean(z**2, axis=1), [0.005, 0.995])
    assert mean_square_limits(8, 0.6) == pytest.approx(drawn, rel=5e-2)
