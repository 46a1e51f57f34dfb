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
    anisotropic_gaussian,
    evaluate,
    from_specular,
    gaussian,
    lambertian,
    light_direction,
    regular,
    ward,
    wide_tailed,
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


def test_a_gaussian_of_two_widths_has_each_in_its_own_direction() -> None:
    up = light_direction(0.0)
    for form, value in (("one_over_e", math.exp(-1.0)), ("half_width", 0.5)):
        lobe = anisotropic_gaussian(4.0, 12.0, 30.0, form, peak=2.0)  # type: ignore[arg-type]
        assert evaluate(lobe, up, up) == pytest.approx(2.0)
        for azimuth, width in ((30.0, 4.0), (210.0, 4.0), (120.0, 12.0)):
            turn = math.radians(azimuth)
            sine = math.sin(math.radians(width))
            observer = [sine * math.cos(turn), sine * math.sin(turn), math.cos(math.radians(width))]
            # The chord of a lobe at the normal is steeper than the sample's plane by half of theta.
            tilt = math.cos(math.radians(0.5 * width)) ** 2 if azimuth != 120.0 else 0.0
            exponent = (width / 4.0) ** 2 * tilt + (width / 12.0) ** 2 * (1.0 - tilt)
            assert evaluate(lobe, up, observer) == pytest.approx(2.0 * value**exponent, rel=1e-9)


@settings(deadline=None)
@given(st.floats(0.0, 80.0), st.floats(0.0, 50.0), st.floats(0.0, 360.0), st.floats(0.0, 360.0), st.sampled_from([0.0, 57.0]))
def test_the_lobes_of_two_widths_and_wide_tails_are_reciprocal(
    sigma: float, theta: float, phi: float, azimuth: float, gamma: float
) -> None:
    light, observer = light_direction(sigma), from_specular(sigma, theta, phi)
    samples = anisotropic_gaussian(20.0, 40.0, azimuth), wide_tailed(5.0), ward(0.3, 0.6, azimuth)
    for sample in samples if observer[2] > 0.0 else ():
        there, back = evaluate(sample, light, observer, gamma_deg=gamma), evaluate(sample, observer, light, gamma_deg=gamma)
        assert there == pytest.approx(back, rel=1e-9)
    equal = anisotropic_gaussian(15.0, 15.0, azimuth, peak=1.0)
    assert evaluate(equal, light, observer) == pytest.approx(evaluate(gaussian(15.0, peak=1.0), light, observer), rel=1e-9)


def test_a_lobe_with_wide_tails_falls_as_the_fourth_power_of_its_angle() -> None:
    lobe = wide_tailed(2.0, peak=8.0)
    values = [float(evaluate(lobe, light_direction(30.0), from_specular(30.0, theta, 70.0))) for theta in (0.0, 2.0, 20.0)]
    assert values == pytest.approx([8.0, 2.0, 8.0 / 101.0**2])
    assert albedo(wide_tailed(2.0, reflectance=0.3), 0.0) == pytest.approx(0.3)
    theta = np.radians(np.linspace(0.0, 90.0, 200_001))
    expected = np.trapezoid(
        2.0 * math.pi * np.sin(theta) * np.cos(theta) * (1.0 + (theta / math.radians(2.0)) ** 2) ** -2, theta
    )
    assert albedo(lobe, 0.0) == pytest.approx(8.0 * expected, rel=1e-6)


def test_wards_model_has_the_bounded_form_and_at_most_its_reflectance() -> None:
    a, b, light, observer = 0.2, 0.4, light_direction(40.0), from_specular(40.0, 15.0, 60.0)
    half = light + observer
    slope = half[:2] / half[2]
    expected = 0.6 / (math.pi * a * b) * (half @ half) / half[2] ** 4 * math.exp(-((slope[0] / a) ** 2 + (slope[1] / b) ** 2))
    assert evaluate(ward(a, b, 0.0, 0.6), light, observer) == pytest.approx(expected)
    assert evaluate(ward(b, a, 90.0, 0.6), light, observer) == pytest.approx(expected)
    albedos = [albedo(ward(0.1, 0.3, 0.0, 0.6), sigma) for sigma in (0.0, 40.0, 80.0)]
    assert albedos[0] == pytest.approx(0.6, rel=0.05)
    assert max(albedos) <= 0.6


def test_a_direction_of_the_sample_is_the_same_from_its_back() -> None:
    sample = anisotropic_gaussian(4.0, 20.0, 30.0, side="both")
    turn = math.radians(30.0)
    along = np.array([0.05 * math.cos(turn), 0.05 * math.sin(turn)])
    for up in (1.0, -1.0):
        light, observer = np.array([0.0, 0.0, up]), np.array([*along, up * math.sqrt(1.0 - along @ along)])
        assert evaluate(sample, light, observer) == pytest.approx(evaluate(sample, [0.0, 0.0, 1.0], [*along, abs(observer[2])]))
        aside = [-along[1], along[0], observer[2]]
        assert evaluate(sample, light, aside) > 1.5 * evaluate(sample, light, observer)


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
    ("sample", "arguments", "message"),
    [
        (anisotropic_gaussian, {"along_deg": 0.001, "across_deg": 5.0}, "along_deg is 0.001"),
        (anisotropic_gaussian, {"along_deg": 5.0, "across_deg": -1.0}, "across_deg is -1"),
        (anisotropic_gaussian, {"along_deg": 5.0, "across_deg": 5.0, "direction_deg": math.inf}, "direction_deg is inf"),
        (wide_tailed, {"width_deg": 5.0, "reflectance": 1.5}, "reflectance is 1.5"),
        (wide_tailed, {"width_deg": 5.0, "side": "top"}, "side is 'top'"),
        (ward, {"alpha_x": 0.0, "alpha_y": 0.1}, "alpha_x is 0.0"),
        (ward, {"alpha_x": 0.1, "alpha_y": 1e-6}, "alpha_y is 1e-06: give at least 8.7e-05"),
        (ward, {"alpha_x": 0.1, "alpha_y": 0.1, "reflectance": 0.0}, "reflectance is 0.0"),
    ],
)
def test_invalid_arguments_of_further_lobes_are_refused(sample: Any, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sample(**arguments)


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
