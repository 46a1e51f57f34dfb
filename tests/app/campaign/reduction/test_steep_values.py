"""Values that the correction for the field of view flags as steep, or leaves alone: wide tails, gaps, too few neighbours."""

import math
from dataclasses import replace

import numpy as np
import pytest

from goniotwin.app.campaign.measurement_model.slopes import Directions, slopes_of
from goniotwin.app.campaign.reduction.field_of_view import (
    FieldOfView,
    correct_field_of_view,
    pose_variance_deg2,
)
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.rig.inputs import FIELD_OF_VIEW
from goniotwin.arrays import Floats
from goniotwin.twin.optics import (
    Instrument,
)
from tests.app.campaign.reduction.lobe_bench import PLANE, SETTINGS, points_of

WIDE_TAILS_DEG = 2.0


def wide_tails(step: float, offset: float = 0.0) -> tuple[BsdfPoints, Floats]:
    """A lobe (1 + (theta / w)^2)^-2 in the plane of incidence, and the true slope along, per degree."""
    points = points_of(1.0, np.arange(offset, 85.1, step), (180.0,))
    x = points.zenith_deg - 30.0
    points = replace(points, bsdf=(1.0 + (x / WIDE_TAILS_DEG) ** 2) ** -2.0)
    return points, -4.0 * x / (WIDE_TAILS_DEG**2 + x**2)


# Errors of the slopes over the steepest, 1 per degree, of a field that is much narrower than the lobe: rms within 8 deg.
@pytest.mark.parametrize(("step", "error", "steep"), [(0.5, 0.015, 0.0), (1.0, 0.05, 0.0), (2.5, 0.2, 0.8), (5.0, 0.45, 1.0)])
def test_slopes_of_wide_tails_are_off_by_what_is_stated_and_flagged(step: float, error: float, steep: float) -> None:
    narrow = Instrument(field_deg=0.05, spot_side_mm=0.5, pupil_radius_mm=0.5)
    off, stated, flagged = [], [], []
    for offset in np.linspace(0.0, step, 8, endpoint=False).tolist():
        points, slope = wide_tails(step, offset)
        found = FieldOfView.of(points, narrow)
        near = np.abs(points.zenith_deg - 30.0) < 8.0
        off.append((found.slope[:, 0] - slope)[near])
        stated.append(found.unresolved[near, 0])
        flagged.append(found.steep[near & (points.theta_deg < 2.0)])
    rms, stated_rms = (math.sqrt(float(np.mean(np.concatenate(each) ** 2))) for each in (off, stated))
    assert rms < error
    assert rms < stated_rms < 2.0 * rms
    assert float(np.mean(np.concatenate(flagged))) >= steep
    assert step > 1.0 or float(np.mean(np.concatenate(flagged))) < 0.3


@pytest.mark.parametrize("middle", [1.0, 1.0 - 1.1e-16])
@pytest.mark.parametrize("along", [0.0, 3e-16, -3e-16])
def test_at_the_very_centre_of_a_lobe_there_is_no_slope(middle: float, along: float) -> None:
    """Whatever rounding makes of a direction that is the specular one."""
    theta = np.radians(np.arange(-5.0, 5.1, 1.0))
    number, one, none = np.zeros(theta.size, dtype=np.int64), np.ones(theta.size), np.zeros(theta.size)
    at = theta == 0.0
    directions = Directions(
        number,
        number,
        number,
        theta + 0.5,
        none + math.pi,
        one,
        np.where(at, middle, np.cos(theta)),
        np.where(at, along, -np.sin(theta)),
        none,
    )
    found = slopes_of(directions, -(((theta - 0.001) / 0.05) ** 2), none + 1e-6, math.radians(1.2))
    centre = np.flatnonzero(at)[0]
    assert abs(found.first_across[centre]) < 1e-3
    assert found.first_along[centre] == pytest.approx(0.8, rel=1e-6)
    assert found.second_across[centre] == pytest.approx(-800.0, rel=1e-3)


def test_values_beside_a_gap_with_the_lobes_centre_are_steep() -> None:
    """The lobe may be anything in between; a diffuser was seen on both sides."""
    polar = np.arange(5.0, 40.1, 5.0)
    points = points_of(np.full(2 * polar.size, 0.3), polar, PLANE, 0.0, 1e-4)
    found = correct_field_of_view(points, SETTINGS)
    assert np.array_equal(found.flag("steep"), points.theta_deg < 5.5)
    complete = points_of(np.full(2 * polar.size + 2, 0.3), np.append(0.0, polar), PLANE, 0.0, 1e-4)
    assert not correct_field_of_view(complete, SETTINGS).flag("steep").any()


def test_values_with_too_few_neighbours_are_not_corrected_and_flagged() -> None:
    points = points_of(5.0, np.array([0.0, 25.0, 30.0]), (180.0,))
    lone = correct_field_of_view(points, SETTINGS)
    assert np.isnan(lone.u_field).all()
    assert lone.flags["field"].all()
    # Where a neighbour is darker by more than a factor of ten, u has the change towards it, times the angle that is unknown.
    # Of a neighbour in the dark no more is known than that it is below three u, 1e-9.
    slope, angle = (math.log(10.0) - 1.0 - math.log(3e-9)) / 25.0, math.sqrt(pose_variance_deg2(points, SETTINGS)[1, 0])
    assert lone.u_bsdf[1] / lone.bsdf[1] == pytest.approx(math.sqrt(2.0) * angle * slope, rel=0.05)
    assert lone.u_bsdf[2] == points.u_bsdf[2]
    assert lone.bsdf.tolist() == points.bsdf.tolist()
    enough = points_of(15.0, np.array([20.0, 25.0, 30.0]), (180.0,))
    complete = correct_field_of_view(enough, SETTINGS)
    assert not complete.flags["field"].any()
    u_field = SETTINGS.rig.uncertainty.u(FIELD_OF_VIEW) * np.abs(complete.field_correction) * complete.bsdf
    assert complete.budget["field"] == pytest.approx(u_field)
    assert complete.budget["field"].all()


def test_a_peak_between_values_without_light_has_no_component() -> None:
    points = points_of(0.5, np.arange(0.0, 85.1, 5.0), u=1e-6)
    u_field = correct_field_of_view(points, SETTINGS).u_field
    assert np.isnan(u_field[np.argmin(points.theta_deg)])
    assert np.isfinite(u_field[points.theta_deg > 20.0]).all()


def test_a_lobe_narrower_than_its_field_is_flagged_and_left_alone() -> None:
    points = points_of(0.45, np.arange(25.0, 35.0, 0.1), (180.0,), u=1e-60)
    found = correct_field_of_view(points, SETTINGS)
    assert found.flag("field").all()
    assert np.array_equal(found.bsdf, points.bsdf)
    assert not found.field_correction.any()


def test_flagged_values_are_no_neighbours() -> None:
    clean = points_of(15.0)
    flagged = np.arange(clean.bsdf.size) % 7 == 3
    wrong = replace(clean, bsdf=np.where(flagged, 3.0 * clean.bsdf, clean.bsdf)).flagged({"drift": flagged})
    found = correct_field_of_view(wrong, SETTINGS)
    assert np.isnan(found.u_field[flagged]).all()
    assert not found.field_correction[flagged].any()
    near = ~flagged & (clean.theta_deg < 30.0)
    expected = correct_field_of_view(clean, SETTINGS).field_correction
    assert found.field_correction[near] == pytest.approx(expected[near], rel=0.02, abs=1e-5)
