"""Templates of schedules: the directions that they measure against closed forms, and what fits a rig and a time."""

import math
from collections.abc import Iterator

import numpy as np
import pytest

from goniotwin import examples
from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.templates import TEMPLATES, MadeSchedule, make_schedule
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from goniotwin.arrays import Floats
from tests.conftest import RIG, Writer

RIGS = {"virtual": read_rig(RIG), "first": read_rig(examples.FIRST_RIG)}
NORMAL = np.array([0.0, 0.0, 1.0])
UPPER = "upper_deg = [0, 5, 10, 15, 20, 25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75, 80, 85]"

ADC = [f', "twin://virtual/adc-{k}"' for k in range(5)]


def made(template: str, rig: str = "virtual", longest_h: float = 4.0) -> MadeSchedule:
    sample, etalon = ("opal", "white-tile") if template == "transmitted" else ("gaussian-5", "etalon")
    return make_schedule(template, RIGS[rig], "x.toml", sample, etalon, 0.01, longest_h)


def light(sigma_deg: float) -> Floats:
    """Unit vector towards the light."""
    return np.array([math.sin(math.radians(sigma_deg)), 0.0, math.cos(math.radians(sigma_deg))])


def seen(found: MadeSchedule, sigma_deg: float, lower: bool = False) -> Iterator[Floats]:
    """Unit vectors towards the photodiodes at an incidence, from the angles of the axes and of the photodiodes alone."""
    photodiodes = found.plan.rig.file.photodiodes
    polar_deg = photodiodes.lower_deg if lower else photodiodes.upper_deg
    for _, sigma, beta, shift in found.plan.of_samples.poses.angles.tolist():
        for polar in polar_deg if sigma == sigma_deg else ():
            p, b = math.radians(polar + shift), math.radians(beta)
            yield np.array([math.sin(p) * math.cos(b), math.sin(p) * math.sin(b), (-1.0 if lower else 1.0) * math.cos(p)])


def nearest_deg(found: MadeSchedule, sigma_deg: float, wanted: Floats, lower: bool = False) -> float:
    """Angle from a direction to the nearest one that is measured."""
    return min(math.degrees(math.atan2(np.linalg.norm(np.cross(v, wanted)), v @ wanted)) for v in seen(found, sigma_deg, lower))


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("template", TEMPLATES)
def test_each_template_is_a_valid_schedule_of_each_example_rig_within_the_time(template: str, rig: str) -> None:
    found = made(template, rig)
    result = check_plan(found.plan)
    assert result.duration_s <= 4.0 * 3600.0
    assert not any("[target]" in each for each in result.warnings)
    assert found.notes == ()
    file = parse_schedule(found.text, "x.toml").file
    assert file.target is not None
    assert (file.target.relative_u, file.target.longest_h) == (0.01, 4.0)
    assert found.text.startswith(f"# {TEMPLATES[template].title}.\n# From a template for {RIGS[rig].file.name}, u of ")
    assert all(len(line) <= 128 for line in found.text.splitlines())
    assert not any("drift checks" in each for each in result.warnings)  # all photodiodes have light in them


def test_light_at_45_is_seen_from_the_normal_and_light_at_the_normal_at_45_deg_in_two_planes() -> None:
    found, half = made("45:0"), math.sqrt(0.5)
    assert nearest_deg(found, 45.0, NORMAL) < 1e-6
    assert nearest_deg(found, 0.0, np.array([-half, 0.0, half])) < 1e-6
    assert nearest_deg(found, 0.0, np.array([0.0, half, half])) < 1e-6


@pytest.mark.parametrize("aspecular_deg", [-15.0, 15.0, 25.0, 45.0, 75.0, 110.0])
def test_an_aspecular_angle_is_from_the_specular_direction_towards_the_normal(aspecular_deg: float) -> None:
    """By Rodrigues' formula: the specular direction, turned about the normal of the plane of incidence."""
    specular = 2.0 * (NORMAL @ light(45.0)) * NORMAL - light(45.0)
    axis = np.cross(specular, NORMAL)
    axis /= np.linalg.norm(axis)
    turn = math.radians(aspecular_deg)
    wanted = math.cos(turn) * specular + math.sin(turn) * np.cross(axis, specular)
    assert abs(wanted @ light(0.0) - math.cos(math.radians(45.0 - aspecular_deg))) < 1e-12  # 45 deg: along the normal
    assert nearest_deg(made("aspecular"), 45.0, wanted) < 1e-6


@pytest.mark.parametrize("sigma_deg", [20.0, 60.0, 85.0])
def test_gloss_is_measured_in_the_specular_direction_and_about_it(sigma_deg: float) -> None:
    found = made("gloss")
    specular = light(sigma_deg) * [-1.0, 1.0, 1.0]
    assert nearest_deg(found, sigma_deg, specular) < 1e-6
    across = np.array([-math.sin(math.radians(sigma_deg)), math.tan(math.radians(2.0)), math.cos(math.radians(sigma_deg))])
    assert nearest_deg(found, sigma_deg, across) < 1.0


@pytest.mark.parametrize("sigma_deg", [15.0, 30.0, 45.0, 60.0, 75.0])
def test_the_plane_of_incidence_is_measured_on_both_sides_of_the_normal(sigma_deg: float) -> None:
    found = made("plane")
    assert all(abs(each[1]) < 1e-12 for each in seen(found, sigma_deg))
    for polar in range(-80, 81, 10):
        assert nearest_deg(found, sigma_deg, light(polar)) < 0.26


@pytest.mark.parametrize("template", ["isotropic", "anisotropic", "transmitted"])
def test_whole_hemispheres_leave_no_gap(template: str) -> None:
    found, lower = made(template), template == "transmitted"
    sigmas = {each[1] for each in found.plan.of_samples.poses.angles.tolist()}
    gammas = {each[0] for each in found.plan.of_samples.poses.angles.tolist()}
    assert len(gammas) >= 8 if template == "anisotropic" else gammas == {0.0}
    for sigma in sigmas:
        directions = np.array([*seen(found, sigma, lower)])
        for zenith in (10.0, 40.0, 70.0):
            for azimuth in (10.0, 100.0, 170.0, *([250.0] if template == "anisotropic" else [])):
                z, a = math.radians(zenith), math.radians(azimuth)
                wanted = [math.sin(z) * math.cos(a), math.sin(z) * math.sin(a), (-1.0 if lower else 1.0) * math.cos(z)]
                assert math.degrees(math.acos(min(1.0, float(np.max(directions @ wanted))))) < 7.1  # half of 10 by 10 deg


def test_light_straight_through_is_measured() -> None:
    assert nearest_deg(made("transmitted"), 20.0, -light(20.0), lower=True) < 1e-6


@pytest.mark.long
def test_more_time_gives_finer_steps_and_too_little_is_stated() -> None:
    rows = [len(made("isotropic", longest_h=hours).plan.rows) for hours in (0.2, 0.5, 1.0, 4.0, 100.0)]
    assert rows == sorted(set(rows))
    found = made("isotropic", longest_h=0.01)
    over_s = found.plan.seconds - 36.0
    assert len(found.notes) == 1
    minutes, seconds = divmod(round(over_s), 60)
    assert f"takes {minutes} min {seconds:02d} s more than 0.01 h" in found.notes[0]
    assert f"# {found.notes[0]}\n" in found.text


def test_photodiodes_between_the_named_directions_reach_them_with_the_shift(write_rig: Writer) -> None:
    rig = read_rig(write_rig((UPPER, f"upper_deg = {[0, *range(2, 83, 5)]}")))
    found = make_schedule("aspecular", rig, "x.toml", "gaussian-5", "etalon", 0.01, 4.0)
    assert found.notes == ()
    for polar in (60.0, 30.0, 20.0, 0.0, -30.0, -65.0):  # from 45 deg less the aspecular angle
        assert nearest_deg(found, 45.0, light(-polar)) < 1e-6


def test_the_nearest_direction_is_taken_and_noted_where_no_photodiode_looks_there(write_rig: Writer) -> None:
    every_ten = (UPPER, f"upper_deg = {[*range(0, 81, 10)]}")
    rig = read_rig(write_rig(every_ten, (ADC[4], ""), ("upper_deg = 5.5", "upper_deg = 2.0")))
    found = make_schedule("45:0", rig, "x.toml", "gaussian-5", "etalon", 0.01, 4.0)
    assert found.notes == ("At sigma 0 deg no photodiode looks 45 deg from the normal. The nearest: 42 deg.",)
    assert f"# {found.notes[0]}\n" in found.text
    assert nearest_deg(found, 0.0, light(-42.0)) < 1e-6
    assert nearest_deg(found, 45.0, NORMAL) < 1e-6


def test_limits_of_the_axes_and_of_the_monochromator_are_kept_and_noted(write_rig: Writer) -> None:
    rig = read_rig(
        write_rig(("gear = 36.0\nlower_deg = 0.0\nupper_deg = 180.0", "gear = 36.0\nlower_deg = 0.0\nupper_deg = 70.0"))
    )
    found = make_schedule("gloss", rig, "x.toml", "gaussian-5", "etalon", 0.01, 4.0)
    assert found.notes == ("Omitted: sigma 85 deg, beyond the limits of the axis.",)
    narrow = read_rig(write_rig(('kind = "cornerstone"', 'kind = "cornerstone"\nlowest_nm = 450.0')))
    found = make_schedule("45:0", narrow, "x.toml", "gaussian-5", "etalon", 0.01, 4.0)
    assert found.notes == ("Omitted: 3 wavelengths beyond the range of the monochromator.",)


@pytest.mark.parametrize(
    ("template", "relative_u", "longest_h", "reason"),
    [
        ("matt", 0.01, 1.0, "template 'matt': there is none of this name; choose one of 45:0, aspecular, "),
        ("45:0", 1.0, 1.0, "x.toml: a target u of 1 within 1 h: u is from 0 to 1"),
        ("45:0", math.nan, 1.0, "x.toml: a target u of nan"),
        ("45:0", 0.01, 0.0, "within 0 h"),
        ("45:0", 0.01, math.inf, "within inf h"),
    ],
)
def test_what_is_no_template_or_no_target_is_refused(template: str, relative_u: float, longest_h: float, reason: str) -> None:
    with pytest.raises(UserError) as refusal:
        make_schedule(template, RIGS["virtual"], "x.toml", "gaussian-5", "etalon", relative_u, longest_h)
    assert reason in str(refusal.value)


def test_a_rig_without_photodiodes_on_the_far_arc_measures_no_transmitted_light(write_rig: Writer) -> None:
    rig = read_rig(write_rig((UPPER.replace("upper", "lower"), "lower_deg = []"), (ADC[4], ""), (ADC[3], "")))
    with pytest.raises(UserError, match="has no photodiodes on the arc that sees this light"):
        make_schedule("transmitted", rig, "x.toml", "opal", "white-tile", 0.01, 4.0)
