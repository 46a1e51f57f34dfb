"""Slopes across the plane of incidence, of lobes that are round or need not be."""

import math
from dataclasses import replace

import numpy as np
import pytest

from goniotwin.app.campaign.measurement_model.slopes import Directions, slopes_of
from goniotwin.app.campaign.reduction.components import COVERAGE
from goniotwin.app.campaign.reduction.field_of_view import (
    FieldOfView,
    correct_field_of_view,
)
from goniotwin.app.campaign.reduction.points import BsdfPoints
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
)
from tests.app.campaign.reduction.lobe_bench import INSTRUMENT, SETTINGS, axes_of, points_of


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
