"""The correction for the field of view: exact for lobes of closed form, right on the twin, whatever the order of the points."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.campaign.geometry.arcs import arc_views
from goniotwin.app.campaign.measurement_model.field import correct_logarithm, directions_covariance
from goniotwin.app.campaign.measurement_model.slopes import Directions, Slopes, local_parabola
from goniotwin.app.campaign.reduction.field_of_view import (
    FieldOfView,
    correct_field_of_view,
    merge_directions,
)
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.rig import read_rig
from goniotwin.arrays import Floats
from goniotwin.twin.optics import (
    Instrument,
    arc_direction,
    evaluate,
    gaussian,
    light_direction,
    luminance_factor,
    ward,
)
from tests.app.campaign.reduction.lobe_bench import EVERYWHERE, PLANE, SETTINGS, axes_of, covariance_of, known, points_of
from tests.conftest import RIG


@pytest.mark.parametrize("width", [2.0, 5.0, 15.0])
def test_the_correction_inverts_the_mean_over_directions_of_a_gaussian_lobe(width: float) -> None:
    """In a plane: the lobe of variance s^2, averaged over directions of covariance C, is one of the covariance s^2 + C."""
    of_lobe = 0.5 * width**2 * np.array([[1.0, 0.2], [0.2, 0.8]])
    field = np.array([[0.062, -0.01], [-0.01, 0.045]])
    inverse = np.linalg.inv(of_lobe + field)
    reduced = 0.5 * math.log(np.linalg.det(of_lobe) / np.linalg.det(of_lobe + field))
    offsets = np.arange(-3.0, 3.01, 0.5) * width / 4.0
    x, z = (each.ravel() for each in np.meshgrid(offsets, offsets))
    at = np.stack([x, z], axis=1)

    def mean(place: Floats) -> Floats:
        return np.asarray(reduced - 0.5 * np.einsum("ni,ij,nj->n", place, inverse, place))

    lines = np.repeat(np.arange(x.size), 5)
    steps = np.tile(np.arange(-2.0, 3.0) * 0.1, x.size)
    fits = []
    for axis in np.eye(2):
        fit = local_parabola(lines, steps, mean(at[lines] + steps[:, None] * axis), np.zeros(steps.size), 0.25, 1.0)
        fits.append(replace(fit, **{name: each[2::5] for name, each in vars(fit).items()}))
    along, across = fits
    slopes = Slopes(
        along.first,
        across.first,
        along.second,
        across.second,
        np.full(x.size, -inverse[0, 1]),
        along,
        across,
        across,
        np.zeros((x.size, 5, 5)),
        np.ones(x.size, dtype=bool),
        *np.zeros((4, x.size)),
    )
    found = correct_logarithm(slopes, np.tile([field[0, 0], field[1, 1], field[0, 1]], (x.size, 1)))
    original = np.linalg.inv(of_lobe)
    assert mean(at) + found.logarithm == pytest.approx(-0.5 * np.einsum("ni,ij,nj->n", at, original, at), abs=1e-6)
    assert found.gradient == pytest.approx(-at @ original, abs=1e-6)
    assert found.bend == pytest.approx(-np.tile(np.diag(original), (x.size, 1)), rel=1e-6)
    # What each derivative adds is its sensitivity, with the other sign.
    for k, name in enumerate(("first_along", "first_across", "second_along", "second_across", "mixed")):
        moved = correct_logarithm(
            replace(slopes, **{name: getattr(slopes, name) + 1e-5}), np.tile([0.062, 0.045, -0.01], (x.size, 1))
        )
        assert (found.logarithm - moved.logarithm) / 1e-5 == pytest.approx(found.sensitivity[:, k], rel=2e-3, abs=2e-6)


POSES = [(0.0, 10.0, 0.0, 1, False), (65.0, -60.0, 0.0, 1, False), (40.0, 35.0, 150.0, 1, False), (50.0, -40.0, 40.0, -1, True)]


@pytest.mark.parametrize("field", [0.5, 1.0, 1.5, 2.5])
def test_the_covariance_of_directions_is_that_of_rays_from_the_pupil_over_the_spot_to_the_disc(field: float) -> None:
    """A Monte Carlo of its own: points of pupil, spot and disc; rays outside of the cone do not count."""
    rng, n = np.random.default_rng(11), 120_000 if field < 1.0 else 50_000
    instrument = Instrument(field_deg=field)
    for sigma, polar, azimuth, up, transmitted in POSES:
        light, mirrored = light_direction(sigma), np.array([-1.0, -1.0, 1.0])
        p, a = math.radians(polar), math.radians(azimuth)
        seen = np.array([math.sin(p) * math.cos(a), math.sin(p) * math.sin(a), up * math.cos(p)])
        along = np.array([math.cos(p) * math.cos(a), math.cos(p) * math.sin(a), -up * math.sin(p)])
        across = np.cross(seen, along)

        def disc(radius: float, one: Floats, other: Floats) -> Floats:
            r, turn = radius * np.sqrt(rng.random(n)), 2.0 * math.pi * rng.random(n)
            return np.asarray((r * np.cos(turn))[:, None] * one + (r * np.sin(turn))[:, None] * other)

        spot = np.column_stack([(rng.random((n, 2)) - 0.5) * instrument.spot_side_mm, np.zeros(n)])
        inward, level = np.array([-light[2], 0.0, light[0]]), np.array([0.0, 1.0, 0.0])
        came = instrument.pupil_distance_mm * light + disc(instrument.pupil_radius_mm, inward, level) - spot
        went = instrument.arc_radius_mm * seen + disc(0.5 * instrument.detector_diameter_mm, along, across) - spot
        came, went = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in (came, went))
        taken = went @ seen >= math.cos(math.radians(0.5 * field))
        turned = -came[taken] if transmitted else mirrored * came[taken]
        offset = went[taken] - np.cross(np.cross(-light if transmitted else mirrored * light, turned), went[taken])
        rays = np.cov(np.stack([offset @ along, offset @ across]))
        one = np.ones(1)
        number = np.ones(1, dtype=np.int64)
        direction = Directions(number, number, number, p * one, a * one, up * one, one, one, one)
        found = directions_covariance(instrument, direction, math.radians(sigma) * one, np.array([transmitted]))[0]
        assert found[:2] == pytest.approx(np.diag(rays), rel=0.03)
        assert found[2] == pytest.approx(rays[0, 1], abs=0.015 * math.sqrt(rays[0, 0] * rays[1, 1]))


TWIN = [
    # width, field, sigma, step, beta, and bounds in percent: above half of the peak, and from 1e-3 to 1e-4 of it
    (2.0, 0.5, 40.0, 0.5, PLANE, 0.1, 0.6),
    (2.0, 1.5, 40.0, 0.5, PLANE, 0.2, 3.0),
    (5.0, 0.5, 65.0, 0.5, PLANE, 0.05, 0.15),
    (2.0, 0.5, 40.0, 2.5, PLANE, 0.1, 0.6),
    (5.0, 0.5, 40.0, 1.0, tuple(np.arange(160.0, 200.1, 2.0)), 0.05, 0.15),
    (2.0, 0.5, 40.0, 0.25, (177.0,), 0.1, 0.8),
]


@pytest.mark.parametrize(("width", "field", "sigma", "step", "beta", "at_peak", "far_down"), TWIN)
def test_the_twins_values_are_corrected_to_those_of_the_nominal_direction(
    width: float, field: float, sigma: float, step: float, beta: tuple[float, ...], at_peak: float, far_down: float
) -> None:
    instrument, sample = Instrument(field_deg=field, obstruction=False), gaussian(width, peak=1.0)
    points = points_of(1.0, np.arange(0.0, 80.0, step), beta, sigma)
    seen = arc_direction(points.zenith_deg, points.azimuth_deg)
    true = np.maximum(evaluate(sample, light_direction(sigma), seen), 1e-30)
    points = replace(
        points,
        bsdf=luminance_factor(instrument, sigma, seen, sample) / math.pi,
        own={"noise": np.zeros(true.size) + 1e-24},
    )
    share = true / true.max()
    before = np.log(np.maximum(points.bsdf, 1e-30) / true)
    left = before + FieldOfView.of(points, instrument).correction
    for chosen, bound in ((share > 0.5, at_peak), ((share < 1e-3) & (share > 1e-4), far_down)):
        if chosen.any():
            assert 100.0 * math.sqrt(float(np.mean(left[chosen] ** 2))) < bound
            assert math.sqrt(float(np.mean(before[chosen] ** 2))) > 7.0 * math.sqrt(float(np.mean(left[chosen] ** 2)))


@pytest.mark.parametrize(("sigma", "least_error"), [(30.0, 0.0), (60.0, 0.01), (70.0, 0.03)])
def test_a_rough_surfaces_lobe_is_narrower_across_the_plane_within_what_is_stated(sigma: float, least_error: float) -> None:
    """Ward's half vectors: at grazing incidence a round lobe's correction is too small, unless other beta were measured."""
    instrument, sample = Instrument(field_deg=1.5, obstruction=False), ward(0.06, 0.06)
    largest = []
    for beta in ((180.0,), tuple(np.arange(176.0, 184.1, 0.5))):
        points = points_of(1.0, np.arange(0.0, 86.0, 1.0), beta, sigma)
        seen = arc_direction(points.zenith_deg, points.azimuth_deg)
        points = replace(
            points,
            bsdf=luminance_factor(instrument, sigma, seen, sample) / math.pi,
            own={"noise": np.zeros(points.size) + 1e-24},
        )
        true = evaluate(sample, light_direction(sigma), seen)
        found = FieldOfView.of(points, instrument)
        here = (true > 0.3 * true.max()) & (points.azimuth_deg == 180.0)
        left = np.abs(np.log(points.bsdf / true) + found.correction)[here]
        largest.append(float(left.max()))
        assert np.all(left < 1.96 * found.limit[here] + 0.002)
        assert float(np.max(found.limit[here])) < largest[-1] + 0.002
    assert largest[0] > least_error
    assert largest[1] < 0.1 * least_error + 0.003


@pytest.mark.parametrize("step", [0.5, 1.0, 2.5, 5.0])
@pytest.mark.parametrize("width", [2.0, 5.0, 15.0])
def test_a_gaussian_lobe_is_corrected_exactly_for_any_spacing_of_its_values(width: float, step: float) -> None:
    points = points_of(width, np.arange(0.0, 85.1, step), u=1e-200)
    near = points.where(points.theta_deg <= 3.0 * width)
    found = correct_field_of_view(points, SETTINGS).where(points.theta_deg <= 3.0 * width)
    correction, slope = known(width, near)
    assert found.field_correction == pytest.approx(correction, rel=2e-3, abs=1e-5)
    assert found.slope_along == pytest.approx(slope[:, 0], rel=1e-6, abs=1e-6)
    assert found.slope_across == pytest.approx(slope[:, 1], abs=1e-6)
    assert found.bsdf == pytest.approx(near.bsdf * np.exp(found.field_correction), rel=1e-12)
    # Neighbours beyond a factor of ten; no other point of a Gaussian is steep.
    theta, sign = near.theta_deg, step * np.array([[-1.0], [1.0]])
    factor = np.max(np.abs((theta + sign) ** 2 - theta**2), axis=0) / width**2
    clear = np.abs(factor - math.log(10.0)) > 0.01
    assert np.array_equal(found.flag("steep")[clear], (factor > math.log(10.0))[clear])


@pytest.mark.parametrize("beta", [165.0, 150.0, 135.0, 200.0])
def test_arcs_beside_the_lobe_give_the_same_by_its_symmetry(beta: float) -> None:
    points = points_of(15.0, beta=(beta,))
    near = points.theta_deg <= 40.0
    found, (correction, slope) = correct_field_of_view(points, SETTINGS), known(15.0, points)
    assert found.field_correction[near] == pytest.approx(correction[near], rel=0.02, abs=5e-5)
    assert np.stack([found.slope_along, found.slope_across], axis=1)[near] == pytest.approx(slope[near], rel=0.02, abs=2e-3)


def test_measurements_at_other_beta_give_the_slopes_across() -> None:
    points = points_of(15.0, beta=tuple(np.arange(0.0, 360.0, 4.0)))
    near = (points.theta_deg <= 30.0) & (points.zenith_deg > 12.0) & (np.abs(points.azimuth_deg - 180.0) < 170.0)
    found, (correction, slope) = correct_field_of_view(points, SETTINGS), known(15.0, points)
    assert found.slope_across[near] == pytest.approx(slope[near, 1], abs=2e-3)
    assert found.field_correction[near] == pytest.approx(correction[near], rel=0.05, abs=1e-4)


@pytest.mark.parametrize("sigma", [0.0, 35.0, 60.0, 145.0])
def test_the_lobes_centre_and_the_axes_are_those_of_the_point_on_both_sides_and_in_both_lights(sigma: float) -> None:
    rig = read_rig(RIG).file
    for view in (view for beta in (20.0, 180.0) for view in arc_views(rig, (0.0, sigma, beta, 2.5))):
        points = points_of(1.0, view.polar, (0.0,), sigma)
        points = replace(
            points,
            zenith_deg=view.zenith,
            azimuth_deg=view.azimuth,
            theta_deg=view.theta,
            back=np.full(view.theta.size, view.back),
            transmitted=np.full(view.theta.size, view.transmitted),
        )
        values = merge_directions(points)
        assert np.degrees(np.arccos(values.directions.middle))[values.which] == pytest.approx(view.theta, abs=1e-5)
        centre = np.array([-1.0, -1.0, 1.0]) * light_direction(sigma) if not view.transmitted else -light_direction(sigma)
        seen, along, across = axes_of(points)
        sign = np.where(values.opposite, -1.0, 1.0)
        assert seen @ centre == pytest.approx(values.directions.middle[values.which], abs=1e-9)
        assert along @ centre == pytest.approx((sign * values.directions.along[values.which]), abs=1e-9)
        assert across @ centre == pytest.approx((sign * values.directions.across[values.which]), abs=1e-9)


def test_measurements_at_other_beta_show_a_lobe_that_is_not_rotationally_symmetric() -> None:
    zenith, azimuth = np.meshgrid(EVERYWHERE, np.arange(170.0, 190.1, 2.0), indexing="ij")
    seen = arc_direction(zenith.ravel(), azimuth.ravel())
    # A lobe of 12 deg in the plane of incidence and of 3 deg across it.
    along = np.degrees(np.arcsin(seen @ np.array([math.cos(math.radians(30.0)), 0.0, math.sin(math.radians(30.0))])))
    across = np.degrees(np.arcsin(seen[:, 1]))
    narrow = np.exp(-((along / 12.0) ** 2) - (across / 3.0) ** 2)
    points = points_of(narrow, beta=tuple(np.arange(170.0, 190.1, 2.0)))
    peak = int(np.argmin(points.theta_deg))
    field = covariance_of(points)[peak]
    expected = -0.5 * math.log((1.0 - field[0, 0] * 2.0 / 144.0) * (1.0 - field[1, 1] * 2.0 / 9.0))
    assert correct_field_of_view(points, SETTINGS).field_correction[peak] == pytest.approx(expected, rel=0.01)
    plane = points.where(points.azimuth_deg == 180.0)
    alone = correct_field_of_view(plane, SETTINGS).field_correction[int(np.argmin(plane.theta_deg))]
    assert 0.0 < alone < 0.2 * expected


def columns(points: BsdfPoints) -> Floats:
    return np.stack([points.slope_along, points.slope_across, points.field_correction, points.bsdf, points.u_bsdf])


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 1e3))
def test_neither_the_scale_nor_the_order_of_points_nor_chunks_change_a_slope(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    points = points_of(5.0, np.arange(5.0, 60.0, 2.5), (90.0, 176.0, 180.0), u=1e-5)
    points = replace(points, bsdf=points.bsdf * (1.0 + 0.01 * rng.standard_normal(points.size)))
    found = columns(correct_field_of_view(points, SETTINGS))
    scaled = replace(points, bsdf=scale * points.bsdf, own={"noise": scale**2 * points.components["noise"]})
    unit = np.array([[1.0], [1.0], [1.0], [scale], [scale]])
    assert columns(correct_field_of_view(scaled, SETTINGS)) == pytest.approx(unit * found, rel=1e-6, abs=1e-9, nan_ok=True)
    order = rng.permutation(points.size)
    assert columns(correct_field_of_view(points.where(order), SETTINGS)) == pytest.approx(
        found[:, order], rel=1e-9, nan_ok=True
    )
    other = replace(points, places=points.places + np.array([10.0, 0.0, 0.0, 0.0, 0.0]), bsdf=2.0 * points.bsdf)
    both = BsdfPoints.join([points, other])
    small = columns(correct_field_of_view(both, SETTINGS, at_once=10))
    assert np.array_equal(small, columns(correct_field_of_view(both, SETTINGS)), equal_nan=True)
