"""Relative uncertainties above 1 % of the peak and by decade, against values of a power law with a constant u."""

import numpy as np
import pytest

from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.schedule.file import TargetTable
from goniotwin.app.campaign.studies.decades import TargetInDecade, UncertaintyByDecade, target_texts, uncertainty_texts
from goniotwin.arrays import Floats
from tests.app.campaign.reduction.made_points import made_points

U = 1e-3


def test_u_is_stated_above_a_hundredth_of_the_peak_of_each_light_and_by_decade() -> None:
    """Twenty values a decade down from two peaks, 1 and 1000, at two sigmas: u over the value is U / value in closed form."""
    below: Floats = 10.0 ** (-(np.arange(140, dtype=np.float64) + 0.5) / 20.0)
    below[0] = 1.0
    azimuth, zenith = np.full(below.size, 180.0), np.linspace(0.0, 89.0, below.size)
    blocks = [made_points(sigma, zenith, azimuth, peak * below, U) for sigma, peak in ((10.0, 1.0), (40.0, 1e3))]
    no_value = np.full(below.size, -1.0)
    blocked = {"shadowed": np.ones(below.size, dtype=bool)}
    blocks += [made_points(60.0, zenith, azimuth, no_value, U), made_points(60.0, zenith, azimuth, 1e9 * below, U, blocked)]
    found = UncertaintyByDecade()
    for block in (blocks[0], BsdfPoints.join(blocks[1:])):
        found.add(block)
    result = found.summary()
    relative = np.concatenate([U / below[:40], 1e-3 * U / below[:40]])  # sorted by hand: two decades of each light
    assert result.values == 80
    assert [result.p05, result.p50, result.p95] == pytest.approx(np.percentile(relative, [5, 50, 95]).tolist())
    assert [each.values for each in result.decades] == [40, 40, 40, 40, 40, 80]
    for k, each in enumerate(result.decades[:-1]):
        of_decade = np.concatenate([share * U / below[20 * k : 20 * k + 20] for share in (1.0, 1e-3)])
        assert each.p50 == pytest.approx(np.median(of_decade))
    assert result.above_zero == 280
    assert result.to_a_tenth == 40 + 100  # U is a tenth of 1e-2: two decades below the one peak, five below the other
    upper, by_decade = uncertainty_texts(result)
    assert upper.endswith("(80 values)")
    assert "to 1e-1: " in by_decade
    assert "below 1e-5: " in by_decade


def test_without_a_value_above_zero_there_is_nothing_to_state() -> None:
    points = made_points(10.0, np.array([20.0]), np.array([180.0]), np.array([-0.1]), U)
    found = UncertaintyByDecade()
    found.add(points)
    assert np.isnan(found.summary().p50)
    assert uncertainty_texts(found.summary()) == []


def test_a_target_counts_the_values_above_its_share_of_the_peak_in_each_decade() -> None:
    """Twenty values a decade with u = 1e-3 of the peak: u over the value is at most 1 % down to a tenth of the peak."""
    below: Floats = 10.0 ** (-(np.arange(140, dtype=np.float64) + 0.5) / 20.0)
    below[0] = 1.0
    found = UncertaintyByDecade()
    found.add(made_points(10.0, np.linspace(0.0, 89.0, below.size), np.full(below.size, 180.0), below, U))
    # Ten values from 1e-1 on to 10**-1.5, of which none reaches 1 %, and a u of 2 % is reached down to 0.05 of the peak.
    asked = TargetTable(relative_u=0.01, above_peak_share=10.0**-1.5)
    assert found.against(asked) == [
        TargetInDecade("1e+0 to 1e-1", 20, 20, True),
        TargetInDecade("1e-1 to 1e-2", 10, 0, False),
    ]
    assert [each.within for each in found.against(TargetTable(relative_u=0.02))] == [20, int(np.sum(below[20:] >= 0.05))]
    assert target_texts(found.against(asked)) == [
        "to 1e-1 of the peak: 20 of 20 values, met",
        "to 1e-2 of the peak: 0 of 10 values, missed",
    ]
    assert found.against(None) == found.against(TargetTable(longest_h=1.0)) == []
