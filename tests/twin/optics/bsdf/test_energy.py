"""No sample scatters more light than it receives; albedos agree with closed forms."""

import math
from typing import Any

import numpy as np
import pytest

from goniotwin.twin.optics import (
    Scatterer,
    albedo,
    anisotropic_gaussian,
    apply_spectrum,
    evaluate,
    gaussian,
    lambertian,
    light_direction,
    regular,
    sum_samples,
    table_sample,
    ward,
    wide_tailed,
)
from tests.twin.optics.models import BRUSHED, TABLE, model_name

INCIDENCES = [0.0, 15.0, 45.0, 70.0, 85.0, 89.0]
DEFAULTS = [
    lambertian(),
    regular(),
    *[
        gaussian(width, form, quantity)
        for width in (0.5, 2.0, 5.0, 15.0, 30.0, 90.0)
        for form in ("one_over_e", "half_width")
        for quantity in ("luminance", "intensity")
    ],
    anisotropic_gaussian(0.5, 20.0),
    anisotropic_gaussian(40.0, 10.0, 60.0),
    wide_tailed(0.5),
    wide_tailed(30.0),
    ward(0.02, 0.3, reflectance=1.0),
    ward(0.8, 0.5, 45.0, reflectance=1.0),
]


@pytest.mark.parametrize("model", DEFAULTS, ids=model_name)
def test_in_a_furnace_no_default_sample_is_brighter_than_the_walls(model: Scatterer) -> None:
    for sigma in INCIDENCES:
        assert albedo(model, sigma) <= 1.0 + 1e-9
        assert albedo(model, sigma, transmitted=True) == 0.0


@pytest.mark.parametrize("sigma_deg", [*INCIDENCES, 91.0, 120.0, 180.0])
def test_in_a_furnace_a_white_diffuser_is_as_bright_as_the_walls(sigma_deg: float) -> None:
    white = lambertian(0.4, 0.6, side="both")
    assert albedo(lambertian(side="both"), sigma_deg) == pytest.approx(1.0, rel=1e-6)
    assert albedo(white, sigma_deg) + albedo(white, sigma_deg, transmitted=True) == pytest.approx(1.0, rel=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("sigma_deg", [0.0, 40.0, 75.0])
def test_in_a_furnace_a_reciprocal_sample_has_the_radiance_of_its_albedo(sigma_deg: float) -> None:
    # Radiance 1 from everywhere: the radiance towards d is the integral of f(l, d) cos(l) over l, the albedo of light from d.
    height, azimuth = np.meshgrid((np.arange(1200) + 0.5) / 1200, (np.arange(1200) + 0.5) * (2.0 * math.pi / 1200))
    # Uniform over the squared sine of the zenith angle: the cosine law.
    sine = np.sqrt(height)
    lights = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.sqrt(1.0 - height)], axis=-1)
    of_two_widths = anisotropic_gaussian(20.0, 40.0, 20.0), ward(0.3, 0.5, 110.0)
    for model in (lambertian(0.8), gaussian(20.0), gaussian(40.0, "half_width"), wide_tailed(20.0), *of_two_widths):
        seen = math.pi * float(evaluate(model, lights, light_direction(sigma_deg)).mean())
        assert seen == pytest.approx(albedo(model, sigma_deg), rel=2e-5)


def test_the_albedo_of_a_sum_is_the_sum_of_the_albedos() -> None:
    parts = [lambertian(0.2), gaussian(5.0, reflectance=0.3), regular(0.1), TABLE, BRUSHED]
    for sigma in (0.0, 40.0, 70.0):
        each = [albedo(part, sigma, gamma_deg=30.0) for part in parts]
        assert albedo(sum_samples(*parts), sigma, gamma_deg=30.0) == pytest.approx(sum(each), rel=1e-12)


def test_the_albedo_depends_on_the_spectrum() -> None:
    sample = sum_samples(apply_spectrum([400.0, 700.0], [0.2, 0.8], lambertian(0.5)), regular(0.1))
    assert [albedo(sample, 30.0, wavelength_nm=nm) for nm in (400.0, 550.0, 700.0)] == pytest.approx([0.2, 0.35, 0.5])


@pytest.mark.parametrize("quantity", ["luminance", "intensity"])
@pytest.mark.parametrize("width_deg", [0.05, 2.0, 30.0, 200.0])
def test_a_stated_reflectance_is_the_albedo_at_normal_incidence(width_deg: float, quantity: Any) -> None:
    assert albedo(gaussian(width_deg, quantity=quantity), 0.0) == pytest.approx(0.9, rel=1e-6)
    assert albedo(gaussian(width_deg, quantity=quantity, reflectance=0.3), 0.0) == pytest.approx(0.3, rel=1e-6)
    passed = gaussian(width_deg, quantity=quantity, reflectance=0.3, transmits=True, refraction=1.5)
    assert albedo(passed, 0.0, transmitted=True) == pytest.approx(0.3, rel=1e-6)


def test_the_albedo_of_a_narrow_lobe_is_its_volume_times_the_cosine() -> None:
    # I0 pi w^2 cos of the lobe's own axis, to second order in w.
    volume = 100.0 * math.pi * math.radians(0.5) ** 2
    assert albedo(gaussian(0.5, peak=100.0), 60.0) == pytest.approx(volume * 0.5, rel=2e-4)
    bent = gaussian(0.5, peak=100.0, transmits=True, refraction=1.5)
    cosine = math.sqrt(1.0 - (math.sin(math.radians(60.0)) / 1.5) ** 2)
    assert albedo(bent, 60.0, transmitted=True) == pytest.approx(volume * cosine, rel=2e-4)
    assert albedo(lambertian(0.7), 75.0) == pytest.approx(0.7, rel=1e-6)


def test_the_albedo_of_a_table_is_that_of_its_function() -> None:
    # f = a cos(zenith), whose albedo is 2 pi a / 3 at every incidence, here at normal.
    theta = np.arange(0.0, 91.0, 1.0)
    table = table_sample([0.0], [0.0], theta, 0.4 * np.cos(np.radians(theta))[None, None])
    assert albedo(table, 0.0) == pytest.approx(0.8 * math.pi / 3.0, rel=1e-4)


@pytest.mark.parametrize("sigma_deg", [90.0, -1.0, 181.0, math.nan])
def test_an_invalid_incidence_is_refused(sigma_deg: float) -> None:
    with pytest.raises(ValueError, match="sigma_deg"):
        albedo(lambertian(), sigma_deg)
