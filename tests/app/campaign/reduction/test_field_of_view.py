"""The field's component of the uncertainty, estimated from neighbouring values: compared with lobes of known answer."""

import math
from dataclasses import replace

import numpy as np
import pytest

from goniotwin.app.campaign.geometry.arcs import arc_views
from goniotwin.app.campaign.reduction.field_of_view import (
    correct_field_of_view,
    field_uncertainty,
    field_variance,
    merge_directions,
)
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.reduction import reduction_settings
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.rig import nominal_instrument, read_rig
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Instrument, arc_direction, evaluate, gaussian, light_direction, luminance_factor, to_specular
from tests.app.campaign.reduction.made_points import made_points
from tests.conftest import RIG, SMALL

VARIANCE = field_variance(Instrument())
EVERYWHERE = np.arange(0.0, 85.1, 1.0)
PLANE = (0.0, 180.0)
SETTINGS = reduction_settings(read_rig(RIG).file, parse_schedule(SMALL, "small.toml").file, None, "")


def lobe(width_deg: float, theta_deg: Floats) -> Floats:
    return np.asarray(10.0 * np.exp(-((theta_deg / width_deg) ** 2)))


def points_of(
    values: Floats | float, polar: Floats = EVERYWHERE, beta: tuple[float, ...] = PLANE, sigma: float = 30.0, u: float = 1e-9
) -> BsdfPoints:
    """Points on arcs at some beta; `values` is the width of a Gaussian lobe, or a value for each direction.

    A value below three `u` counts as without light.
    """
    zenith, azimuth = (each.ravel() for each in np.broadcast_arrays(polar[:, None], np.array(beta)))
    theta, _ = to_specular(sigma, arc_direction(zenith, azimuth))
    return made_points(sigma, zenith, azimuth, lobe(values, theta) if isinstance(values, float) else values, u)


def share(points: BsdfPoints) -> Floats:
    return field_uncertainty(points, VARIANCE) / np.maximum(points.bsdf, 1e-300)


def known(width_deg: float, theta_deg: Floats) -> Floats:
    """Relative field component of a Gaussian lobe of 1/e width a.

    f = exp(-(theta / a)^2): f'' = (4 theta^2 / a^4 - 2 / a^2) f along theta, and f' cot(theta) across it.
    """
    a, theta = math.radians(width_deg), np.radians(theta_deg)
    across = 2.0 / a**2 * np.where(theta > 1e-6, theta / np.tan(np.maximum(theta, 1e-6)), 1.0)
    return np.asarray(0.5 * VARIANCE * (np.abs(4.0 * theta**2 / a**4 - 2.0 / a**2) + np.abs(across)))


@pytest.mark.parametrize(("field", "spot", "pupil"), [(0.5, 5.0, 5.0), (2.5, 5.0, 5.0), (0.5, 1.0, 3.5), (1.0, 5.0, 7.0)])
def test_the_variance_explains_the_lowered_peak_on_the_twin(field: float, spot: float, pupil: float) -> None:
    instrument = Instrument(field_deg=field, spot_side_mm=spot, pupil_radius_mm=pupil, obstruction=False)
    for sigma in (10.0, 40.0):
        wide, specular = gaussian(20.0, peak=1.0), arc_direction(np.array([sigma]), np.array([180.0]))
        seen = luminance_factor(instrument, sigma, specular, wide) / math.pi
        lost = -2.0 * field_variance(instrument) / math.radians(20.0) ** 2
        assert float(seen[0] / evaluate(wide, light_direction(sigma), specular)[0]) - 1.0 == pytest.approx(lost, rel=0.2)


@pytest.mark.parametrize("step", [0.5, 1.0, 2.5, 5.0])
@pytest.mark.parametrize("width", [2.0, 5.0, 15.0])
def test_a_gaussian_lobe_has_the_exact_component_for_any_spacing_of_its_values(width: float, step: float) -> None:
    points = points_of(width, np.arange(0.0, 85.1, step), u=1e-200)
    near = points.theta_deg <= 3.0 * width
    estimated, exact = share(points)[near], known(width, points.theta_deg)[near]
    middle = points.theta_deg[near] <= math.degrees(5.0 * math.sqrt(VARIANCE))
    assert estimated[~middle] == pytest.approx(exact[~middle], rel=0.05, abs=2e-4)
    assert (estimated[middle] > 0.95 * exact[middle]).all()
    assert (estimated[middle] < 2.0 * exact[middle] + 2e-4).all()


def test_arcs_beside_the_lobe_give_the_same_by_its_symmetry() -> None:
    for beta in (165.0, 150.0, 135.0, 90.0):
        points = points_of(15.0, beta=(beta,))
        near = points.theta_deg <= 40.0
        a, theta = math.radians(15.0), np.radians(points.theta_deg[near])
        changed = 0.5 * VARIANCE * np.abs(4.0 * theta**2 / a**4 - 2.0 / a**2 * (1.0 + theta / np.tan(theta)))
        # The derivatives depend on the arc. The sum of their moduli is never less than the modulus of their sum.
        assert (share(points)[near] > 0.95 * changed).all()
        assert (share(points)[near] < changed + 2.0 * VARIANCE / a**2).all()


@pytest.mark.parametrize("sigma", [0.0, 35.0, 60.0, 145.0])
def test_the_lobes_centre_is_at_theta_0_on_both_sides_and_in_both_lights(sigma: float) -> None:
    rig = read_rig(RIG).file
    for view in (view for beta in (20.0, 180.0) for view in arc_views(rig, (0.0, sigma, beta, 2.5))):
        points = points_of(1.0, view.polar, (0.0,), sigma)
        points = replace(
            points, zenith_deg=view.zenith, azimuth_deg=view.azimuth, theta_deg=view.theta,
            back=np.full(view.theta.size, view.back), transmitted=np.full(view.theta.size, view.transmitted),
        )  # fmt: skip
        values, which = merge_directions(points)
        assert np.degrees(np.arccos(values.middle))[which] == pytest.approx(view.theta, abs=1e-5)
        between = 0.5 * (values.polar[1:] + values.polar[:-1])
        slope = np.diff(values.middle) / np.diff(values.polar)
        one_plane = np.diff(values.plane) == 0
        assert np.interp(between, values.polar, values.slope)[one_plane] == pytest.approx(slope[one_plane], abs=2e-3)


def test_measurements_at_other_beta_show_a_lobe_that_is_not_rotationally_symmetric() -> None:
    zenith, azimuth = np.meshgrid(EVERYWHERE, np.arange(170.0, 190.1, 2.0), indexing="ij")
    seen = arc_direction(zenith.ravel(), azimuth.ravel())
    # A lobe of 12 deg in the plane of incidence and of 3 deg across it.
    along = np.degrees(np.arcsin(seen @ np.array([math.cos(math.radians(30.0)), 0.0, math.sin(math.radians(30.0))])))
    across = np.degrees(np.arcsin(seen[:, 1]))
    narrow = np.exp(-((along / 12.0) ** 2) - (across / 3.0) ** 2)
    points = points_of(narrow, beta=tuple(np.arange(170.0, 190.1, 2.0)))
    peak = int(np.argmin(points.theta_deg))
    expected = 0.5 * VARIANCE * (2.0 / math.radians(3.0) ** 2 + 2.0 / math.radians(12.0) ** 2)
    assert share(points)[peak] == pytest.approx(expected, rel=0.05)
    plane = points.where(points.azimuth_deg == 180.0)
    assert share(plane)[int(np.argmin(plane.theta_deg))] < 0.2 * expected


def test_the_component_of_a_diffuser_with_noise_is_negligible() -> None:
    rng = np.random.default_rng(7)
    polar = np.arange(0.0, 85.1, 0.5)
    for beta in (PLANE, (90.0,), tuple(np.arange(0.0, 181.0, 5.0))):
        flat = 0.01 * (1.0 + 0.003 * rng.standard_normal(polar.size * len(beta)))
        points = points_of(flat, polar, beta, u=3e-5)
        grown = np.hypot(points.u_bsdf, field_uncertainty(points, VARIANCE)) / points.u_bsdf
        assert float(np.median(grown)) < 1.05
        assert float(np.max(grown)) < 2.0


def test_for_values_lost_in_noise_the_values_themselves_are_fitted() -> None:
    rng = np.random.default_rng(8)
    points = points_of(5.0, u=1e-4)
    noisy = replace(points, bsdf=points.bsdf + 1e-4 * rng.standard_normal(points.bsdf.size))
    dark = points.theta_deg > 25.0
    u_field = field_uncertainty(noisy, VARIANCE)[dark]
    assert np.isfinite(u_field).all()
    assert float(np.max(u_field)) < 0.5 * 1e-4


def test_values_with_too_few_neighbours_have_no_component_and_a_flag() -> None:
    points = points_of(5.0, np.array([0.0, 25.0, 30.0]), (180.0,))
    lone = correct_field_of_view(points, SETTINGS)
    assert np.isnan(lone.u_field).all()
    assert lone.flags["field"].all()
    assert lone.u_bsdf.tolist() == points.u_bsdf.tolist()
    enough = points_of(15.0, np.array([20.0, 25.0, 30.0]), (180.0,))
    complete = correct_field_of_view(enough, SETTINGS)
    assert not complete.flags["field"].any()
    assert complete.u_field == pytest.approx(field_uncertainty(enough, field_variance(nominal_instrument(SETTINGS.rig))))


def test_a_peak_between_values_without_light_has_no_component() -> None:
    points = points_of(0.5, np.arange(0.0, 85.1, 5.0), u=1e-6)
    u_field = field_uncertainty(points, VARIANCE)
    assert np.isnan(u_field[np.argmin(points.theta_deg)])
    assert np.isfinite(u_field[points.theta_deg > 20.0]).all()


def test_flagged_values_are_no_neighbours() -> None:
    clean = points_of(15.0)
    flagged = np.arange(clean.bsdf.size) % 7 == 3
    wrong = replace(clean, bsdf=np.where(flagged, 3.0 * clean.bsdf, clean.bsdf)).flagged({"drift": flagged})
    u_field = field_uncertainty(wrong, VARIANCE)
    assert np.isnan(u_field[flagged]).all()
    near = ~flagged & (clean.theta_deg < 30.0)
    assert u_field[near] == pytest.approx(field_uncertainty(clean, VARIANCE)[near], rel=0.05, abs=1e-5)
