"""Result of `check`, and blocked directions against traced rays."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.campaign.geometry.arcs import observed_directions
from goniotwin.app.campaign.geometry.shadow import blocked_by_mirrors, clear_of_mirrors
from goniotwin.app.campaign.planning.check import check_plan, describe_check
from goniotwin.app.campaign.planning.plan import NewPlan, make_plan
from goniotwin.app.campaign.schedule.file import parse_schedule, read_schedule
from goniotwin.app.campaign.wording import duration_text
from goniotwin.app.rig import nominal_instrument, read_rig
from goniotwin.twin.optics import arc_direction, visible_fraction
from tests.app.campaign.planning.planner_bench import HEAD, LARGE, time_checks
from tests.conftest import RIG, SCHEDULE

VIRTUAL = read_rig(RIG)


def planned(text: str) -> NewPlan:
    return make_plan(parse_schedule(HEAD + "gains_v_per_a = [1e8]\nwavelength_nm = [550]\n" + text, "x"), VIRTUAL)


def test_check_gives_rows_duration_order_blocked_directions_and_warnings() -> None:
    plan = make_plan(read_schedule(SCHEDULE), VIRTUAL)
    result = check_plan(plan)
    assert result.rows == 130
    assert result.duration_s == pytest.approx(plan.seconds)
    assert result.least_s <= result.duration_s <= 1.05 * result.least_s
    assert result.order == ["shift", "sigma", "beta"]
    assert result.why.startswith("shift inside: 4 min 41 s; ")
    assert result.kinds == {"mount": 2, "dark": 8, "measure": 120}
    assert result.axes_deg["beta"] == [0.0, 180.0]
    assert (result.directions, result.shadowed) == (1077, 45)
    assert sum(len(each.zenith_azimuth) for each in result.shadowed_deg) == 45
    assert [each.sigma for each in result.shadowed_deg if each.specular] == [0.0]
    assert "at sigma 0 deg the mirror unit blocks the specular direction" in result.warnings[0]
    words = describe_check(plan, result)
    assert "from the innermost loop: shift, sigma, beta" in words
    assert "15 at sigma 0 with the specular direction" in words


def test_overlaps_are_counted_and_check_warns_if_there_are_none() -> None:
    alone = check_plan(planned("sigma_deg = [30]\nbeta_deg = [0, 90]\nshift_deg = [0, 1]\n"))
    assert alone.overlaps == 0
    assert any("[overlap] points = 1 adds poses at shift 5 deg" in warning for warning in alone.warnings)
    # At each beta 17 of the 18 photodiodes move to the position of the next one.
    shared = check_plan(planned("sigma_deg = [30]\nbeta_deg = [0, 90]\nshift_deg = [0, 5]\n"))
    assert shared.overlaps == 2 * 17
    assert not any("overlap" in warning for warning in shared.warnings)


def test_poses_omitted_by_symmetry_are_counted() -> None:
    plan = planned("sigma_deg = [30]\nbeta_deg = [0, 90, 180, 270]\n")
    assert check_plan(plan).left_out == 1
    assert "omitted     1 poses that are equivalent to others by the symmetry: isotropic" in describe_check(
        plan, check_plan(plan)
    )


def test_transmitted_directions_are_blocked_only_at_the_etalon() -> None:
    """At the sample no transmitted light is blocked: the mirror unit is on its other side."""
    plan = planned('light = "transmitted"\nsigma_deg = [0, 30]\nbeta_deg = [0, 90, 180]\n')
    result = check_plan(plan)
    reflected = check_plan(planned("sigma_deg = [0, 30]\nbeta_deg = [0, 90, 180]\n"))
    assert result.shadowed == result.shadowed_only_for_etalon == reflected.shadowed > 0
    assert reflected.shadowed_only_for_etalon == 0
    assert "of transmission, by the mirror unit. Of 2 the etalon's reading alone is blocked" in describe_check(plan, result)
    assert any("blocks the direction straight through" in each for each in result.warnings)
    assert not any("specular" in each for each in result.warnings)


def test_an_estimated_duration_is_reported_with_its_range() -> None:
    result = check_plan(planned("sigma_deg = [30]\nbeta_deg = [0, 90]\n[averaging]\nrelative_uncertainty = 0.01\n"))
    least, most = result.duration_range_s
    assert least < result.duration_s < most
    assert any("the duration is an estimate" in warning for warning in result.warnings)
    exact = check_plan(planned("sigma_deg = [30]\nbeta_deg = [0, 90]\n"))
    assert exact.duration_range_s == (exact.duration_s, exact.duration_s)


def test_check_warns_of_a_duration_beyond_the_target() -> None:
    grids = "sigma_deg = [30]\nbeta_deg = [0, 90]\nshift_deg = [0, 1]\n"
    plan = planned(grids)
    hours = plan.seconds / 3600.0
    for longest_h, too_long in ((1.01 * hours, False), (0.5 * hours, True)):
        warnings = check_plan(planned(f"{grids}[target]\nlongest_h = {longest_h}\n")).warnings
        assert any("more than [target] longest_h = " in each for each in warnings) is too_long
    assert any(f"is {duration_text(0.5 * plan.seconds)} more than" in each for each in warnings)


def test_check_warns_of_open_beam_old_dark_readings_and_second_order() -> None:
    grids = "sigma_deg = [30]\nbeta_deg = [0, 90]\n"
    assert any("open beam" in each for each in check_plan(planned(f"open_beam = true\n{grids}")).warnings)
    slow = check_plan(planned(f"readings = 100\ndark_every_s = 5\n{grids}"))
    assert any("a dark reading gets" in each for each in slow.warnings)
    red = make_plan(parse_schedule(f"{HEAD}gains_v_per_a = [1e8]\nwavelength_nm = [700, 720]\n{grids}", "x"), VIRTUAL)
    assert any("above 710 nm (1 wavelengths)" in each for each in check_plan(red).warnings)


def test_front_and_back_have_the_same_blocked_directions() -> None:
    counts = [
        [(each.directions, len(each.blocked_deg), each.specular_blocked) for each in seen]
        for seen in (
            observed_directions(plan.schedule.file, VIRTUAL.file, plan.mountings[1][0].poses.angles)
            for plan in (
                planned(f'side = "{side}"\nsigma_deg = [0, 20, 40]\nbeta_deg = [0, 90, 180]\n') for side in ("front", "back")
            )
        )
    ]
    assert counts[0] == counts[1][::-1]


@settings(deadline=None)
@given(
    sigma=st.one_of(st.floats(0.0, 87.0), st.floats(93.0, 180.0)),
    gamma=st.floats(0.0, 360.0),
    angles=st.lists(st.tuples(st.floats(0.0, 180.0), st.floats(0.0, 360.0)), min_size=1, max_size=30),
    near=st.floats(-8.0, 8.0),
)
def test_directions_that_are_certainly_clear_are_clear_for_traced_rays(
    sigma: float, gamma: float, angles: list[tuple[float, float]], near: float
) -> None:
    instrument = nominal_instrument(VIRTUAL.file)
    zenith, azimuth = np.array([*angles, (abs(sigma + near), 0.0), (abs(sigma - near), near)]).T
    directions = arc_direction(zenith, azimuth)
    clear = clear_of_mirrors(instrument, VIRTUAL.file.geometry.shadow_margin_deg, sigma, directions)
    visible = visible_fraction(instrument, sigma, directions, gamma_deg=gamma)
    assert np.all(visible[clear] > 1.0 - 1e-9)
    assert not blocked_by_mirrors(VIRTUAL.file, sigma, zenith, azimuth, gamma)[clear].any()
    assert blocked_by_mirrors(VIRTUAL.file, sigma, zenith, azimuth, gamma)[visible < 1.0 - 1e-9].all()


def test_a_hundred_thousand_rows_are_checked_within_seconds() -> None:
    """One second on an idle machine (`python -m benchmarks.planner`); the limit allows for a busy one."""
    (found,) = [each for each in time_checks(VIRTUAL, {"100,000 rows": LARGE["100,000 rows"]}) if each["rows"] > 100_000]
    assert found["check_s"] < 10.0


def test_the_duration_is_within_its_own_range() -> None:
    """Also where the time limit comes before the target, after a number of lots that is not known in advance."""
    averaging = "readings = 1\nsignature = true\n[averaging]\nrelative_uncertainty = 0.0005\nlongest_s = 0.5\n"
    result = check_plan(planned(f"sigma_deg = [30]\nbeta_deg = [0, 90]\n{averaging}"))
    least, most = result.duration_range_s
    assert least <= result.duration_s <= most
