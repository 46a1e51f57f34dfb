"""Analytic models: ideal diffuser, Gaussian, regular component; invalid arguments are refused."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.twin.optics import (
    Scatterer,
    albedo,
    evaluate,
    from_specular,
    gaussian,
    lambertian,
    light_direction,
    regular,
)
from tests.twin.optics.models import SINGLE, model_name


def test_the_ideal_diffuser_has_a_luminance_factor_of_one_everywhere() -> None:
    directions = from_specular(50.0, np.arange(0.0, 90.0, 5.0), 20.0)
    assert math.pi * evaluate(lambertian(), light_direction(50.0), directions) == pytest.approx(1.0)


@pytest.mark.parametrize("width_deg", [2.0, 5.0, 15.0, 30.0])
def test_the_two_forms_of_the_gaussian_at_its_width(width_deg: float) -> None:
    at_width = from_specular(20.0, width_deg, 30.0)
    for form, value in (("one_over_e", math.exp(-1.0)), ("half_width", 0.5)):
        lobe = gaussian(width_deg, form, peak=3.0)  # type: ignore[arg-type]
        assert evaluate(lobe, light_direction(20.0), at_width) == pytest.approx(3.0 * value, rel=1e-9)
        assert evaluate(lobe, light_direction(20.0), from_specular(20.0, 0.0, 0.0)) == pytest.approx(3.0)


def test_as_an_intensity_the_gaussian_is_divided_by_the_observers_cosine() -> None:
    light, observer = light_direction(40.0), from_specular(40.0, 12.0, 200.0)
    luminance = evaluate(gaussian(15.0, peak=1.0), light, observer)
    intensity = evaluate(gaussian(15.0, quantity="intensity", peak=1.0), light, observer)
    assert intensity == pytest.approx(luminance / observer[2])


def test_theta_is_measured_from_the_actual_light() -> None:
    light = light_direction(30.0) + np.array([0.0, 0.02, 0.0])
    light /= np.linalg.norm(light)
    assert evaluate(gaussian(1.0, peak=1.0), light, light * [-1.0, -1.0, 1.0]) == pytest.approx(1.0)
    assert evaluate(gaussian(1.0, peak=1.0, transmits=True), light, -light) == pytest.approx(1.0)


@settings(deadline=None)
@given(st.floats(0.0, 89.0), st.floats(0.0, 360.0), st.floats(0.3, 3.0))
def test_the_axis_of_a_refracted_lobe_follows_snells_law(sigma: float, azimuth: float, ratio: float) -> None:
    lobe = gaussian(3.0, peak=1.0, transmits=True, refraction=ratio)
    turn, sine = math.radians(azimuth), math.sin(math.radians(sigma)) / ratio
    light = [math.sin(math.radians(sigma)) * math.cos(turn), math.sin(math.radians(sigma)) * math.sin(turn)]
    light = [*light, math.cos(math.radians(sigma))]
    if sine >= 1.0:
        below = from_specular(0.0, np.linspace(91.0, 180.0, 50), 17.0)
        assert not np.any(evaluate(lobe, light, below))
        assert albedo(lobe, sigma, transmitted=True) == 0.0
        return
    axis = [-sine * math.cos(turn), -sine * math.sin(turn), -math.sqrt(1.0 - sine**2)]
    assert evaluate(lobe, light, axis) == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize("model", SINGLE, ids=model_name)
def test_light_and_observers_behind_the_sample_give_zero(model: Scatterer) -> None:
    up, down = light_direction(30.0), light_direction(150.0)
    assert evaluate(model, up, down) == evaluate(model, down, up) == evaluate(model, down, down) == 0.0


def test_a_regular_component_has_no_finite_value_and_the_albedo_of_its_list() -> None:
    mirror = regular([0.04, 0.05, 0.2, 1.0], sigma_deg=[0.0, 40.0, 70.0, 90.0])
    assert evaluate(mirror, light_direction(20.0), from_specular(20.0, 0.0, 0.0)) == 0.0
    assert [albedo(mirror, sigma) for sigma in (0.0, 40.0, 70.0)] == pytest.approx([0.04, 0.05, 0.2])
    between = [albedo(mirror, sigma) for sigma in np.linspace(0.0, 89.9, 300)]
    assert np.all(np.diff(between) >= 0.0)
    assert between[-1] < 1.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"width_deg": -5.0}, "width_deg"),
        ({"width_deg": math.nan}, "width_deg"),
        ({"width_deg": 5.0, "form": "gauss"}, "form is 'gauss'"),
        ({"width_deg": 5.0, "quantity": "flux"}, "quantity is 'flux'"),
        ({"width_deg": 5.0, "peak": -1.0}, "peak"),
        ({"width_deg": 5.0, "reflectance": 1.2}, "reflectance is 1.2"),
        ({"width_deg": 5.0, "peak": 1.0, "reflectance": 0.5}, "both"),
        ({"width_deg": 5.0, "refraction": 1.5}, "only a transmitted lobe is refracted"),
        ({"width_deg": 5.0, "refraction": 0.0, "transmits": True}, "refraction is 0.0"),
        ({"width_deg": 5.0, "side": "top"}, "side is 'top'"),
    ],
)
def test_invalid_arguments_of_a_gaussian_are_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        gaussian(**arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"reflectance": 1.1}, "reflectance is 1.1"),
        ({"reflectance": 0.0}, "reflectance is 0.0"),
        ({"reflectance": math.nan}, "reflectance is nan"),
        ({"reflectance": -0.1, "transmittance": 0.5}, "reflectance is -0.1"),
        ({"reflectance": 0.1, "transmittance": -0.5}, "transmittance is -0.5"),
        ({"reflectance": 0.0, "transmittance": 1.5}, "transmittance is 1.5"),
        ({"reflectance": 0.7, "transmittance": 0.4}, "add up to more than 1"),
        ({"side": "left"}, "side is 'left'"),
    ],
)
def test_a_diffuser_scatters_at_most_all_the_light(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        lambertian(**arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"reflectance": 1.1}, "reflectance is 1.1"),
        ({"reflectance": 0.0}, "reflectance is 0"),
        ({"reflectance": [0.1, 0.2]}, "or sigma_deg for a list"),
        ({"reflectance": [0.1, 0.2], "sigma_deg": [0.0, 10.0, 20.0]}, "with this sigma_deg give"),
        ({"reflectance": [0.1, math.nan], "sigma_deg": [0.0, 10.0]}, "reflectance is nan at sigma 10"),
        ({"reflectance": [0.1, 0.2], "sigma_deg": [10.0, 10.0]}, "sigma_deg is not ascending"),
        ({"reflectance": [0.1, 0.2], "sigma_deg": [0.0, 100.0]}, "sigma_deg runs from 0 to 100"),
    ],
)
def test_invalid_arguments_of_a_regular_component_are_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        regular(**arguments)


def test_inconsistent_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="last axis"):
        evaluate(lambertian(), [0.0, 1.0], [0.0, 1.0])
