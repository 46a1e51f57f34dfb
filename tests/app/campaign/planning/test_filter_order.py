"""Order-sorting filters in a plan: time of their changes, their order, and warnings of the second order."""

from pathlib import Path

import pytest

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.planning.check import check_plan, describe_check
from tests.app.campaign.filter_rig import RIG_FILTERS, plan_with, rig_with
from tests.conftest import Change

MANY = "{ start = 400, stop = 780, step = 20 }"


@pytest.mark.parametrize(
    "changes",
    [
        (("shift_deg = [0, 1]", "shift_deg = [0]"), ("beta_deg = [180]", "beta_deg = [0, 180]")),  # wavelength inside
        (("shift_deg = [0, 1]", "shift_deg = [0, 1, 2]"),),  # filter by filter
    ],
)
def test_the_estimated_duration_is_that_of_the_run(changes: tuple[Change, ...], tmp_path: Path) -> None:
    drift = "[drift]\nevery_s = 60\nsigma_deg = 30\nbeta_deg = 180\nwavelength_nm = 550\nlimit = 0.5\n"
    plan = plan_with(*changes, wavelengths=MANY, tables=drift)
    result = check_plan(plan)
    assert result.filter_changes > 6
    assert result.least_s <= plan.seconds
    outcome = run_campaign(plan, tmp_path / "a.journal")
    assert outcome.seconds == pytest.approx(plan.seconds, rel=0.01)


def test_check_counts_filter_changes_and_the_order_is_filter_by_filter_where_that_is_faster() -> None:
    fine = plan_with(("shift_deg = [0, 1]", "shift_deg = { start = 0, stop = 2, step = 0.2 }"), wavelengths=MANY)
    result = check_plan(fine)
    assert result.order == ["wavelength", "shift", "filter"]
    assert "; wavelength inside, filter by filter: " in f"; {result.why}"
    # Two changes with the etalon and two with the sample, 3 + 2 positions of 1 s each; or one more change over less distance.
    assert result.filter_changes in (4, 5)
    changes = result.why.partition("; filter changes: ")[2]
    assert changes in ("4, 0 min 10 s", "5, 0 min 09 s")
    assert f"filter changes: {changes}" in describe_check(fine, result)
    far = plan_with(("shift_deg = [0, 1]", "shift_deg = [0]"), ("beta_deg = [180]", "beta_deg = [0, 180]"), wavelengths=MANY)
    result = check_plan(far)
    assert result.order == ["wavelength", "beta"]
    assert "wavelength inside, filter by filter: " in result.why
    assert result.filter_changes == 8
    plain = check_plan(plan_with(wavelengths=MANY, rig=rig_with()))
    assert plain.filter_changes == 0
    assert "filter" not in plain.why


def _second_order_warnings(*changes: Change, wavelengths: str = "[500, 720, 760]") -> list[str]:
    plan = plan_with(wavelengths=wavelengths, rig=rig_with(*changes))
    return [each for each in check_plan(plan).warnings if "half the wavelength" in each]


def test_check_warns_of_the_second_order_where_no_filter_blocks_it() -> None:
    (alone,) = _second_order_warnings()
    assert alone.startswith(
        "above 710 nm (2 wavelengths) light of half the wavelength passes as well. Put order-sorting filters"
    )
    assert "[[monochromator.filters]]" in alone
    assert "cut_on_nm" in alone
    assert _second_order_warnings(RIG_FILTERS) == []
    (without,) = _second_order_warnings(RIG_FILTERS, ("cut_on_nm = 610\n", ""))
    assert "(2 wavelengths)" in without
    assert "no sufficient cut_on_nm for 'RG610'. In [[monochromator.filters]] give a cut_on_nm above 380," in without
    (low,) = _second_order_warnings(RIG_FILTERS, ("cut_on_nm = 610\n", "cut_on_nm = 370\n"))
    assert "(1 wavelengths)" in low  # 720 nm: half of it is below 370
    assert _second_order_warnings(wavelengths="[500, 710]") == []
