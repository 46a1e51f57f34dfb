"""The field of view's correction and what the slopes add to u: lobes of known answer, rays of its own, and the twin."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.campaign.geometry.arcs import arc_views
from goniotwin.app.campaign.measurement_model.field import correct_logarithm, directions_covariance
from goniotwin.app.campaign.measurement_model.slopes import Directions, Slopes, local_parabola, slopes_of
from goniotwin.app.campaign.reduction import field_of_view
from goniotwin.app.campaign.reduction.components import COVERAGE, interval, mostly_added
from goniotwin.app.campaign.reduction.field_of_view import (
    FieldOfView,
    correct_field_of_view,
    merge_directions,
    pose_variance_deg2,
)
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.settings import reduction_settings
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.comparison import deviations_in_u
from goniotwin.app.rig import nominal_instrument, read_rig
from goniotwin.app.rig.inputs import FIELD_OF_VIEW
from goniotwin.arrays import Floats
from goniotwin.twin.optics import (
    Instrument,
    anisotropic_gaussian,
    arc_direction,
    evaluate,
    gaussian,
    light_direction,
    luminance_factor,
    to_specular,
    ward,
)
from tests.app.campaign.reduction.made_points import made_points
from tests.conftest import RIG, SMALL

EVERYWHERE = np.arange(0.0, 85.1, 1.0)
PLANE = (0.0, 180.0)
SETTINGS = reduction_settings(read_rig(RIG).file, parse_schedule(SMALL, "small.toml").file, None, "")
INSTRUMENT = nominal_instrument(SETTINGS.rig)
WIDE_TAILS_DEG = 2.0


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


def covariance_of(points: BsdfPoints, instrument: Instrument = INSTRUMENT) -> Floats:
    """Covariance (n, 2, 2) of the directions at each point, deg^2."""
    values = merge_directions(points)
    c1, c2, c12 = (
        math.degrees(1.0) ** 2
        * directions_covariance(instrument, values.directions, values.sigma, values.transmitted)[values.which].T
    )
    return np.stack([np.stack([c1, c12], axis=-1), np.stack([c12, c2], axis=-1)], axis=-2)


def axes_of(points: BsdfPoints) -> tuple[Floats, Floats, Floats]:
    """Directions and both axes of the slopes, (n, 3) each, as `BsdfPoints` defines them."""
    zenith, azimuth = np.radians(points.zenith_deg), np.radians(points.azimuth_deg)
    up = np.where(points.zenith_deg > 90.0, -1.0, 1.0)
    seen = arc_direction(points.zenith_deg, points.azimuth_deg)
    along = np.stack([np.cos(zenith) * np.cos(azimuth), np.cos(zenith) * np.sin(azimuth), -np.sin(zenith)], axis=1)
    along *= up[:, None]
    return seen, along, np.cross(seen, along)


def known(width_deg: float, points: BsdfPoints) -> tuple[Floats, Floats]:
    """Correction (n,) and slopes (n, 2), per degree, of y = exp(-(theta / a)^2): matrices, not the reduction's formulas."""
    a, theta = math.radians(width_deg), np.radians(points.theta_deg)
    centre = arc_direction(points.sigma_deg, 180.0)
    _, along, across = axes_of(points)
    away = np.stack([np.sum(-centre * each, axis=1) for each in (along, across)], axis=1)
    size = np.linalg.norm(away, axis=1, keepdims=True)
    away = np.where(size > 1e-9, away / np.maximum(size, 1e-9), [1.0, 0.0])
    aside = np.stack([-away[:, 1], away[:, 0]], axis=1)
    round_it = np.where(theta > 1e-6, theta / np.tan(np.maximum(theta, 1e-6)), 1.0)
    radial, tangential = (np.einsum("ni,nj->nij", each, each) for each in (away, aside))
    second = -2.0 / a**2 * (radial + round_it[:, None, None] * tangential)
    first = -2.0 * (theta / a**2)[:, None] * away
    field = covariance_of(points) * math.radians(1.0) ** 2
    one = np.eye(2) + field @ second
    pulled = np.linalg.solve(one, np.einsum("nij,nj->ni", field, first)[..., None])[..., 0]
    slope = np.linalg.solve(np.swapaxes(one, 1, 2), first[..., None])[..., 0]
    return -0.5 * np.log(np.linalg.det(one)) - 0.5 * np.sum(first * pulled, axis=1), np.radians(slope)


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


def test_a_diffuser_with_noise_keeps_its_values_and_their_uncertainty() -> None:
    rng = np.random.default_rng(7)
    polar = np.arange(0.0, 85.1, 0.5)
    for beta in (PLANE, (90.0,), tuple(np.arange(0.0, 181.0, 5.0))):
        flat = 0.01 * (1.0 + 0.003 * rng.standard_normal(polar.size * len(beta)))
        points = points_of(flat, polar, beta, u=3e-5)
        found = correct_field_of_view(points, SETTINGS)
        grown = found.u_bsdf / points.u_bsdf
        assert float(np.median(grown)) < 1.05
        assert float(np.max(grown)) < 2.0
        assert float(np.median(np.abs(found.field_correction))) < 0.1 * 0.003
        assert not found.flag("steep").any()


@pytest.mark.parametrize("step", [0.5, 1.0])
def test_the_noise_of_corrected_values_is_that_of_their_components(step: float) -> None:
    """300 noisy copies of one scan of a lobe of 2 deg, as rotations of the sample: each has slopes of its own."""
    rng, copies = np.random.default_rng(5), 300
    clean = points_of(2.0, np.arange(20.0, 40.01, step), (180.0,))
    clean = clean.where(clean.theta_deg < 6.0)
    noisy = []
    for k in range(copies):
        places = clean.places.copy()
        places[:, 1] = 0.1 * k  # gamma
        bsdf = clean.bsdf * (1.0 + 0.01 * rng.standard_normal(clean.size))
        noisy.append(replace(clean, places=places, bsdf=bsdf, own={"noise": (0.01 * clean.bsdf) ** 2}))
    found = FieldOfView.of(BsdfPoints.join(noisy), INSTRUMENT)
    logs = (np.log(BsdfPoints.join(noisy).bsdf) + found.correction).reshape(copies, -1)
    stated = np.mean(found.noise.reshape(copies, -1) ** 2 + 0.01**2, axis=0)
    ratio = np.var(logs, axis=0) / stated
    assert float(np.mean(ratio)) == pytest.approx(1.0, abs=0.05)
    assert (np.abs(ratio - 1.0) < 5.0 * math.sqrt(2.0 / copies)).all()
    assert float(stated.max()) > 1.1 * 0.01**2


def test_at_a_peak_the_second_order_of_the_unknown_angle_is_a_component() -> None:
    points = points_of(5.0, np.arange(0.0, 85.1, 0.5))
    found = correct_field_of_view(points, SETTINGS)
    peak = int(np.argmin(points.theta_deg))
    drawn = np.random.default_rng(1).normal(size=(200_000, 2)) * np.sqrt(pose_variance_deg2(points, SETTINGS)[peak])
    bent = 1.0 / (0.5 * 25.0 - covariance_of(points)[peak].trace() / 2.0)
    low = np.exp(-0.5 * bent * np.sum(drawn**2, axis=1)) - 1.0
    stated = found.budget["second_order"][peak] / found.bsdf[peak]
    assert stated == pytest.approx(math.sqrt(np.mean(low**2)), rel=0.02)


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


def test_for_values_lost_in_noise_the_values_themselves_are_fitted() -> None:
    rng = np.random.default_rng(8)
    points = points_of(5.0, u=1e-4)
    noisy = replace(points, bsdf=points.bsdf + 1e-4 * rng.standard_normal(points.bsdf.size))
    dark = points.theta_deg > 25.0
    found = correct_field_of_view(noisy, SETTINGS)
    assert np.isfinite(found.u_field[dark]).all()
    assert float(np.max(found.u_field[dark])) < 0.5 * 1e-4
    lost = noisy.bsdf < 3e-4
    assert not found.field_correction[lost].any()
    assert np.array_equal(found.bsdf[lost], noisy.bsdf[lost])
    assert np.isnan(found.slope_along[lost]).all()


def test_beside_values_lost_in_noise_the_slope_is_that_of_the_other_side() -> None:
    """At steps of 1 deg a lobe of 2 deg falls to a twentieth: of the last value with light a neighbour is lost."""
    points = points_of(2.0, u=1e-4)
    found, (_, slope) = correct_field_of_view(points, SETTINGS), known(2.0, points)
    last = (points.bsdf > 3e-4) & (points.theta_deg > 5.5)
    assert last.sum() == 2
    assert found.slope_along[last] == pytest.approx(slope[last, 0], rel=1e-3)
    assert found.flag("steep")[last].all()


def turned_lobe(beta: tuple[float, ...], step: float = 0.5) -> tuple[BsdfPoints, Floats]:
    """A lobe of 10 by 2 deg, turned by 30 deg, through the twin's fast estimator; and its true slopes (n, 2)."""
    sample = anisotropic_gaussian(10.0, 2.0, 30.0, reflectance=0.5)
    instrument = Instrument(obstruction=False)
    points = points_of(1.0, np.arange(28.0, 50.0, step), beta, 40.0)

    def logarithms(zenith: Floats, azimuth: Floats) -> Floats:
        return np.log(evaluate(sample, light_direction(40.0), arc_direction(zenith, azimuth)))

    z, a, d = points.zenith_deg, points.azimuth_deg, 1e-3
    along = (logarithms(z + d, a) - logarithms(z - d, a)) / (2.0 * d)
    across = (logarithms(z, a + d) - logarithms(z, a - d)) / (2.0 * d * np.sin(np.radians(z)))
    bsdf = luminance_factor(instrument, 40.0, arc_direction(z, a), sample) / math.pi
    points = replace(points, bsdf=bsdf, own={"noise": np.zeros(z.size) + 1e-24})
    return points, np.stack([along, across], axis=1)


STATED = {
    symmetry: replace(SETTINGS, schedule=SETTINGS.schedule.model_copy(update={"symmetry": symmetry}))
    for symmetry in ("isotropic", "plane-symmetric", "anisotropic")
}


def test_a_lobe_that_need_not_be_round_is_flagged_where_nothing_was_measured_across() -> None:
    points, slope = turned_lobe((180.0,))
    lobe_itself = points.theta_deg < 8.0
    found = {symmetry: correct_field_of_view(points, each) for symmetry, each in STATED.items()}
    assert not found["isotropic"].flag("steep")[lobe_itself].any()
    for symmetry in ("plane-symmetric", "anisotropic"):
        assert found[symmetry].flag("steep")[lobe_itself].all()
        assert found[symmetry].bsdf == pytest.approx(found["isotropic"].bsdf, rel=1e-12)  # none across is 0, as in the plane
    assert float(np.max(np.abs(found["anisotropic"].slope_across - slope[:, 1])[lobe_itself])) > 0.5
    # A diffuser has no lobe, and with other beta the slope across is measured.
    diffuse = replace(points_of(np.full(86, 0.3), beta=(180.0,)), own={"noise": np.full(86, 1e-6)})
    assert not correct_field_of_view(diffuse, STATED["anisotropic"]).flag("steep").any()
    measured, _ = turned_lobe((178.0, 179.0, 180.0, 181.0, 182.0))
    middle = (measured.azimuth_deg == 180.0) & (measured.theta_deg < 8.0)
    assert not correct_field_of_view(measured, STATED["anisotropic"]).flag("steep")[middle].any()


@pytest.mark.parametrize("step", [0.5, 1.0, 2.5, 5.0])
def test_beside_its_centre_a_round_lobe_has_the_slope_across_of_the_values_around(step: float) -> None:
    """A gloss of 6 deg on a paint, on an arc that passes its centre 8.5 deg away. True slopes by the lobe's own formula."""
    polar = np.arange(0.0, 85.1, step)
    theta, _ = to_specular(35.0, arc_direction(polar, 165.0 + 0.0 * polar))
    lobes = 0.3 + 0.8 * np.exp(-((theta / 6.0) ** 2))
    rng, errors, stated = np.random.default_rng(3), [], []
    for _ in range(30):
        points = points_of(lobes * (1.0 + 1e-3 * rng.standard_normal(polar.size)), polar, (165.0,), 35.0, 2.5e-4)
        found = correct_field_of_view(points, SETTINGS)
        _, _, across = axes_of(points)
        aside = np.sum(arc_direction(35.0, 180.0) * across, axis=1) / np.sin(np.radians(theta))
        slope = 2.0 * theta / 36.0 * (lobes - 0.3) / lobes * aside
        errors.append((found.slope_across - slope)[theta < 12.0])
        stated.append(slope[theta < 12.0])
    off, size = (np.sqrt(np.mean(np.square(each), axis=0)) for each in (errors, stated))
    assert float(np.min(size)) > 0.02
    assert np.all(off < 0.15 * size + 0.01)


def test_where_theta_does_not_change_along_the_arc_the_slope_across_is_bounded() -> None:
    """Of an arc that goes round the lobe's centre, 90 deg away from it."""
    polar = np.radians(np.arange(0.0, 60.1, 5.0))
    none, one, number = np.zeros(polar.size), np.ones(polar.size), np.zeros(polar.size, dtype=np.int64)
    beside = Directions(number, number, number, polar, none, one, none, none, -one)
    y = -(polar**2)
    slopes = slopes_of(beside, y, none + 1e-12, math.radians(1.2))
    assert not slopes.first_across.any()
    assert slopes.limits(np.tile(np.eye(5)[1], (polar.size, 1))) == pytest.approx(slopes.bound, rel=1e-12)
    # The steepest of the values that are as bright, or by one less.
    steepest = np.array([np.max(2.0 * polar[y >= each - 1.0]) for each in y])
    assert slopes.bound == pytest.approx(math.sqrt(2.0 / 3.0) * steepest, rel=0.03)


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


def test_an_unknown_slope_across_is_within_what_was_measured_elsewhere() -> None:
    """Of a lobe of 10 by 2 deg, with other beta 8 deg away."""
    points, slope = turned_lobe(tuple(np.arange(140.0, 221.0, 12.0)))
    found = FieldOfView.of(points, INSTRUMENT, round_lobe=False)
    here = points.bsdf > 1e-2 * points.bsdf.max()
    assert found.steep[here].all()
    assert float(np.max(np.abs(found.slope[here, 1]))) < 0.02  # what the field of view makes of the slope along the arc
    ratio = slope[here, 1] / found.unresolved[here, 1]
    assert float(np.mean(np.abs(ratio) < COVERAGE)) > 0.94
    assert float(np.sqrt(np.mean(ratio**2))) > 0.5


def test_the_square_of_an_unknown_slope_across_is_in_u_of_the_correction() -> None:
    """A field of view of 1.5 deg, nothing measured across, no other errors: of one sign, by the light of the twin."""
    instrument, sample, beta = Instrument(field_deg=1.5, obstruction=False), gaussian(5.0, peak=1.0), (160.0, 170.0, 180.0)
    points = points_of(1.0, np.arange(0.0, 80.0, 1.25), beta, 42.0)
    seen = arc_direction(points.zenith_deg, points.azimuth_deg)
    light = luminance_factor(instrument, 42.0, seen, sample) / math.pi
    points = replace(points, bsdf=light, own={"noise": np.zeros(points.size) + 1e-24})
    true = evaluate(sample, light_direction(42.0), seen)
    found = FieldOfView.of(points, instrument, round_lobe=False)
    here = (true > 1e-2 * true.max()) & (found.limit > 1e-3) & (points.azimuth_deg != 180.0)
    left = (np.log(light / true) + found.correction)[here]
    assert here.sum() > 5
    assert float(left.max()) > 0.02
    ratio = left / np.hypot(found.limit, found.noise)[here]
    assert float(np.median(ratio)) > 0.5
    assert np.all(ratio < COVERAGE)


def test_a_turned_lobe_has_the_mixed_derivative_of_the_arcs_slopes() -> None:
    points, slope = turned_lobe((178.0, 179.0, 180.0, 181.0, 182.0))
    middle = (points.azimuth_deg == 180.0) & (points.theta_deg < 8.0)
    round_one, found = (correct_field_of_view(points, STATED[each]) for each in ("isotropic", "anisotropic"))
    errors = [
        np.max(np.abs(np.stack([each.slope_along, each.slope_across], axis=1) - slope)[middle]) for each in (round_one, found)
    ]
    assert errors[1] < 0.6 * errors[0]


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
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(field_of_view, "CHUNK_POINTS", 10)
        small = columns(correct_field_of_view(both, SETTINGS))
    assert np.array_equal(small, columns(correct_field_of_view(both, SETTINGS)), equal_nan=True)


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
