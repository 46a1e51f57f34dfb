"""Front and back, reflection and transmission, turned samples, exchanged directions: relations between values."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.arrays import Floats
from goniotwin.twin.optics import (
    Scatterer,
    albedo,
    combine_sides,
    evaluate,
    from_specular,
    gaussian,
    lambertian,
    light_direction,
    regular,
    sum_samples,
    ward,
    wide_tailed,
)
from tests.twin.optics.models import ANISOTROPIC, BRUSHED, POINTS, TABLE, canonical_directions, model_name

FRONT = [lambertian(0.8), gaussian(15.0), gaussian(30.0, quantity="intensity"), TABLE, ANISOTROPIC, BRUSHED, POINTS]


def direction(zenith_deg: float, azimuth_deg: float) -> Floats:
    return from_specular(0.0, zenith_deg, azimuth_deg)


directions = st.builds(direction, st.floats(0.0, 180.0), st.floats(0.0, 360.0))
models = st.sampled_from(FRONT)


@settings(deadline=None)
@given(models, directions, directions)
def test_light_from_the_back_is_light_on_the_sample_turned_about_x(model: Scatterer, light: Floats, observer: Floats) -> None:
    turned = evaluate(
        combine_sides(back_reflection=model), canonical_directions(light, -1, False), canonical_directions(observer, -1, False)
    )
    assert turned == evaluate(model, light, observer)


@settings(deadline=None)
@given(models, directions, directions)
def test_a_transmitted_direction_is_a_reflected_one_mirrored_in_the_sample(
    model: Scatterer, light: Floats, observer: Floats
) -> None:
    front = combine_sides(front_transmission=model)
    assert evaluate(front, light, canonical_directions(observer, 1, True)) == evaluate(model, light, observer)
    back = combine_sides(back_transmission=model)
    through = canonical_directions(canonical_directions(observer, 1, True), -1, False)
    assert evaluate(back, canonical_directions(light, -1, False), through) == evaluate(model, light, observer)


@settings(deadline=None)
@given(models, directions, directions, st.floats(0.0, 360.0))
def test_a_turned_sample_with_turned_directions_has_the_same_value(
    model: Scatterer, light: Floats, observer: Floats, gamma: float
) -> None:
    cos, sin = math.cos(math.radians(gamma)), math.sin(math.radians(gamma))
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    if abs(light[2]) > 1.0 - 1e-9 or min(abs(light[2]), abs(observer[2])) < 1e-9:
        # Light along the normal has no azimuth, and rounding may move a direction through the sample's plane.
        return
    if min(abs(light[0]), abs(light[1])) < 1e-9:
        return  # on an axis of symmetry a table of random numbers is discontinuous
    turned_value = evaluate(model, turn @ light, turn @ observer, gamma_deg=gamma)
    assert turned_value == pytest.approx(float(evaluate(model, light, observer)), rel=1e-6, abs=1e-9)


def test_gamma_changes_anisotropic_samples_only() -> None:
    light, observer = light_direction(30.0), from_specular(30.0, 20.0, [10.0, 130.0, 250.0])
    for model in FRONT:
        changed = not np.allclose(evaluate(model, light, observer, gamma_deg=50.0), evaluate(model, light, observer))
        assert changed == (model in (ANISOTROPIC, BRUSHED))
    # The sample turned by gamma sees the light at the azimuth -gamma (optics.md, section 2).
    own = [math.sin(math.radians(30.0)) * math.cos(math.radians(-50.0)), 0.5 * math.sin(math.radians(-50.0)), light[2]]
    specular = [-own[0], -own[1], own[2]]
    turned = evaluate(ANISOTROPIC, light, from_specular(30.0, 0.0, 0.0), gamma_deg=50.0)
    assert turned == pytest.approx(float(evaluate(ANISOTROPIC, own, specular)), rel=1e-6)


RECIPROCAL = [
    lambertian(0.7),
    lambertian(0.3, 0.6),
    gaussian(2.0),
    gaussian(5.0, "half_width"),
    gaussian(30.0),
    gaussian(120.0),
    gaussian(10.0, transmits=True),
    wide_tailed(10.0, transmits=True),
    ward(0.1, 0.1, transmits=True),
    sum_samples(lambertian(0.2, 0.2, side="both"), gaussian(20.0, side="both"), gaussian(8.0, transmits=True, side="both")),
]


@settings(deadline=None)
@given(st.sampled_from(RECIPROCAL), directions, directions)
def test_reciprocal_models_are_symmetric_in_light_and_observer(model: Scatterer, light: Floats, observer: Floats) -> None:
    forth, back = float(evaluate(model, light, observer)), float(evaluate(model, observer, light))
    assert forth == pytest.approx(back, rel=1e-6, abs=1e-30)


@pytest.mark.parametrize(
    "model",
    [gaussian(20.0, quantity="intensity"), gaussian(20.0, transmits=True, refraction=1.5, side="both"), TABLE],
    ids=model_name,
)
def test_other_models_are_not_reciprocal(model: Scatterer) -> None:
    light, observer = from_specular(0.0, 20.0, 0.0), from_specular(0.0, 50.0, 180.0)
    if model.lobes[0].transmits:
        observer = observer * [1.0, 1.0, -1.0]
    assert evaluate(model, light, observer) != pytest.approx(float(evaluate(model, observer, light)), rel=1e-3)


def test_each_pair_of_sides_has_its_own_model() -> None:
    sheet = combine_sides(lambertian(0.1), lambertian(0.2), lambertian(0.3), lambertian(0.4))
    shares = [albedo(sheet, sigma, transmitted) for sigma in (20.0, 160.0) for transmitted in (False, True)]
    assert shares == pytest.approx([0.1, 0.2, 0.3, 0.4], rel=1e-6)
    up, down = light_direction(20.0), light_direction(160.0)
    values = [float(math.pi * evaluate(sheet, light, d)) for light, d in ((up, up), (up, down), (down, down), (down, up))]
    assert values == pytest.approx([0.1, 0.2, 0.3, 0.4])


def test_a_transmitted_lobe_goes_straight_through_from_either_side() -> None:
    sheet = gaussian(1.0, peak=1.0, transmits=True)
    for sigma in (0.0, 25.0, 60.0, 100.0, 150.0, 180.0):
        assert evaluate(sheet, light_direction(sigma), -light_direction(sigma)) == pytest.approx(1.0)


def test_a_model_of_another_side_is_refused() -> None:
    bent = gaussian(5.0, transmits=True, refraction=1.5)
    assert albedo(combine_sides(back_transmission=bent), 150.0, transmitted=True) > 0.0
    with pytest.raises(ValueError, match="front_reflection has a lobe that transmits light from the front"):
        combine_sides(front_reflection=bent)
    with pytest.raises(ValueError, match="front_reflection has a lobe that reflects light from the back"):
        combine_sides(front_reflection=lambertian(side="back"))
    with pytest.raises(ValueError, match="back_reflection has a lobe that transmits"):
        combine_sides(back_reflection=sum_samples(lambertian(0.1), regular(0.5, transmits=True)))
    with pytest.raises(ValueError, match="no model is given"):
        combine_sides()
