"""Values, samples and albedos of the models say the same, and what cannot be a sample is refused."""

import math
from typing import Any

import numpy as np
import pytest

from twin.optics import (
    Scatterer,
    albedo,
    evaluate,
    from_specular,
    gaussian,
    lambertian,
    light_direction,
    tabulated,
    to_specular,
)
from twin.optics.bsdf import density, sample

SIGMA_AXIS, PHI_AXIS, THETA_AXIS = [0.0, 30.0, 60.0], [0.0, 90.0, 180.0], [0.0, 10.0, 30.0, 90.0]
TABLE = tabulated(
    SIGMA_AXIS, PHI_AXIS, THETA_AXIS,
    0.05 + 0.1 * np.arange(3)[:, None, None] + 0.03 * np.arange(3)[:, None] + 0.2 * np.exp(-np.arange(4.0)),
)  # fmt: skip
MODELS = [
    lambertian(0.8), gaussian(5.0), gaussian(25.0), gaussian(60.0),
    gaussian(8.0, "half_width", "intensity", peak=2.0), TABLE,
]  # fmt: skip


def named(scatterer: Scatterer) -> str:
    return scatterer.name


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


def test_theta_follows_the_light_that_actually_comes() -> None:
    light = light_direction(30.0) + np.array([0.0, 0.02, 0.0])
    light /= np.linalg.norm(light)
    assert evaluate(gaussian(1.0, peak=1.0), light, light * [-1.0, -1.0, 1.0]) == pytest.approx(1.0)


@pytest.mark.parametrize("model", MODELS, ids=named)
def test_nothing_is_scattered_to_or_from_behind(model: Scatterer) -> None:
    up, down = light_direction(30.0), light_direction(150.0)
    assert evaluate(model, up, down) == evaluate(model, down, up) == evaluate(model, down, down) == 0.0


@pytest.mark.parametrize("model", [m for m in MODELS if "intensity" not in m.name and m.name != "table"], ids=named)
def test_light_may_go_either_way(model: Scatterer) -> None:
    ends = from_specular(0.0, np.linspace(1.0, 80.0, 40), np.linspace(0.0, 3000.0, 40))
    forth, back = evaluate(model, ends[:20], ends[20:]), evaluate(model, ends[20:], ends[:20])
    assert forth == pytest.approx(back, rel=1e-9, abs=1e-300)


@pytest.mark.parametrize("quantity", ["luminance", "intensity"])
@pytest.mark.parametrize("width_deg", [0.05, 2.0, 30.0, 200.0])
def test_a_stated_reflectance_is_what_comes_back_at_normal_incidence(width_deg: float, quantity: Any) -> None:
    assert albedo(gaussian(width_deg, quantity=quantity), 0.0) == pytest.approx(0.9, rel=1e-6)
    assert albedo(gaussian(width_deg, quantity=quantity, reflectance=0.3), 0.0) == pytest.approx(0.3, rel=1e-6)


def test_the_albedo_of_a_narrow_lobe_is_its_volume_times_the_cosine() -> None:
    # I0 pi w^2 cos(sigma), to second order in w.
    width = math.radians(0.5)
    assert albedo(gaussian(0.5, peak=100.0), 60.0) == pytest.approx(100.0 * math.pi * width**2 * 0.5, rel=2e-4)
    assert albedo(lambertian(0.7), 75.0) == pytest.approx(0.7, rel=1e-6)


def draws(model: Scatterer, sigma_deg: float, count: int) -> tuple[Any, Any]:
    """Directions (count, 3) that the model draws for the light at sigma, and their densities."""
    x, y, z = (float(c) for c in light_direction(sigma_deg))
    uniform = np.random.default_rng(7).random((count, 3))
    drawn = np.array([sample(model.kind, model.params, x, y, z, float(u), float(v), float(c)) for u, v, c in uniform])
    densities = [density(model.kind, model.params, x, y, z, float(a), float(b), float(c)) for a, b, c in drawn]
    return drawn, np.array(densities)


@pytest.mark.parametrize("sigma_deg", [0.0, 30.0, 75.0])
@pytest.mark.parametrize("model", MODELS, ids=named)
def test_samples_weighted_by_value_over_density_give_the_albedo(model: Scatterer, sigma_deg: float) -> None:
    count = 20_000
    drawn, densities = draws(model, sigma_deg, count)
    assert np.linalg.norm(drawn, axis=1) == pytest.approx(1.0)
    weights = evaluate(model, light_direction(sigma_deg), drawn) * np.maximum(drawn[:, 2], 0.0) / densities
    error = weights.std(ddof=1) / math.sqrt(count)
    # One number of 18: 4.5 standard errors are exceeded once in 8000 suites; constant weights have rounding only.
    assert weights.mean() == pytest.approx(albedo(model, sigma_deg), abs=4.5 * error + 1e-6)


@pytest.mark.parametrize("model", MODELS, ids=named)
def test_samples_fall_as_their_density_says(model: Scatterer) -> None:
    sigma_deg, count = 40.0, 20_000
    theta_edges, sectors = np.array([0.0, 2.0, 4.0, 7.0, 12.0, 20.0, 35.0, 60.0, 90.0, 130.0, 180.0]), 6
    drawn, _ = draws(model, sigma_deg, count)
    theta, phi = to_specular(sigma_deg, drawn)
    seen, _, _ = np.histogram2d(theta, phi, [theta_edges, np.linspace(0.0, 360.0, sectors + 1)])
    expected = np.zeros_like(seen)
    light = [float(c) for c in light_direction(sigma_deg)]
    steps = (np.arange(24) + 0.5) / 24
    for i in range(theta_edges.size - 1):
        thetas = theta_edges[i] + steps * (theta_edges[i + 1] - theta_edges[i])
        area = np.radians(theta_edges[i + 1] - theta_edges[i]) / 24 * np.sin(np.radians(thetas)) * 2 * math.pi / sectors
        for j in range(sectors):
            directions = from_specular(sigma_deg, thetas[:, None], 60.0 * (j + steps[::2]))
            values = [density(model.kind, model.params, *light, *map(float, d)) for d in directions.reshape(-1, 3)]
            expected[i, j] = count * np.sum(np.reshape(values, (24, 12)).mean(axis=1) * area)
    assert expected.sum() == pytest.approx(count, rel=2e-3)
    full = expected > 20.0
    chi2, freedom = float(np.sum((seen - expected)[full] ** 2 / expected[full])), int(full.sum()) - 1
    # The normal approximation of Wilson and Hilferty: 4 is exceeded once in 30,000.
    assert freedom >= 9
    assert ((chi2 / freedom) ** (1 / 3) - 1.0 + 2.0 / (9 * freedom)) / math.sqrt(2.0 / (9 * freedom)) < 4.0
    assert seen[~full].sum() == pytest.approx(expected[~full].sum(), abs=4.5 * math.sqrt(expected[~full].sum() + 1.0))


def test_a_table_gives_its_own_values_and_what_is_between() -> None:
    for i, sigma_deg in enumerate(SIGMA_AXIS):
        light = light_direction(sigma_deg)
        for k, theta in enumerate(THETA_AXIS[:3]):
            if sigma_deg + theta < 90.0:
                at_node = evaluate(TABLE, light, from_specular(sigma_deg, theta, [0.0, 90.0, 180.0]))
                # Where theta is 0 there is no phi: the first one's value holds.
                assert at_node == pytest.approx(TABLE.values[i, :, k] if theta else TABLE.values[i, 0, k], rel=1e-6)
    # Lines over phi and theta, at an incidence of the table.
    middle = evaluate(TABLE, light_direction(SIGMA_AXIS[1]), from_specular(SIGMA_AXIS[1], 20.0, 45.0))
    assert middle == pytest.approx(TABLE.values[1, 0:2, 1:3].mean())


def test_over_the_incidence_a_table_has_no_kink_and_no_overshoot() -> None:
    steep = tabulated([10.0, 30.0, 50.0, 70.0], [0.0], [0.0], [[[1.0]], [[1.1]], [[2.0]], [[20.0]]])

    def value(sigma_deg: float) -> float:
        return float(evaluate(steep, light_direction(sigma_deg), from_specular(sigma_deg, 0.0, 0.0)))

    sigmas = np.linspace(5.0, 75.0, 1401)
    values = np.array([value(float(sigma)) for sigma in sigmas])
    assert np.all(np.diff(values) >= 0.0)
    for node in (10.0, 30.0, 50.0, 70.0):
        before, after = value(node) - value(node - 1e-3), value(node + 1e-3) - value(node)
        assert after == pytest.approx(before, abs=2e-6)


def test_outside_of_its_lists_a_table_holds_its_ends() -> None:
    table = tabulated([10.0, 20.0], [0.0], [5.0, 15.0], [[[1.0, 2.0]], [[3.0, 4.0]]])
    assert evaluate(table, light_direction(0.0), from_specular(0.0, 1.0, 0.0)) == 1.0
    assert evaluate(table, light_direction(60.0), from_specular(60.0, 40.0, 0.0)) == 4.0


def test_a_table_over_180_deg_is_mirrored_and_one_over_360_is_not() -> None:
    light, phis = light_direction(30.0), np.array([45.0, 315.0])
    half = tabulated([30.0], [0.0, 90.0, 180.0], [0.0], [[[1.0], [2.0], [3.0]]])
    full = tabulated([30.0], [0.0, 90.0, 180.0, 270.0, 360.0], [0.0], [[[1.0], [2.0], [3.0], [4.0], [1.0]]])
    assert evaluate(half, light, from_specular(30.0, 20.0, phis)) == pytest.approx([1.5, 1.5])
    assert evaluate(full, light, from_specular(30.0, 20.0, phis)) == pytest.approx([1.5, 2.5])


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"width_deg": -5.0}, "width_deg"),
        ({"width_deg": math.nan}, "width_deg"),
        ({"width_deg": 5.0, "form": "gauss"}, "form is 'gauss'"),
        ({"width_deg": 5.0, "quantity": "flux"}, "quantity is 'flux'"),
        ({"width_deg": 5.0, "peak": -1.0}, "peak"),
        ({"width_deg": 5.0, "reflectance": 1.2}, "reflectance is 1.2"),
        ({"width_deg": 5.0, "peak": 1.0, "reflectance": 0.5}, "both"),
    ],
)
def test_a_gaussian_that_cannot_be_is_refused(arguments: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        gaussian(**arguments)


def test_a_diffuser_gives_back_at_most_all_the_light() -> None:
    with pytest.raises(ValueError, match="reflectance"):
        lambertian(1.1)
    with pytest.raises(ValueError, match="reflectance"):
        lambertian(0.0)


@pytest.mark.parametrize(
    ("sigma", "phi", "theta", "value", "says"),
    [
        ([10.0, 10.0], [0.0], [0.0], 1.0, "sigma_deg is not ascending"),
        ([10.0], [0.0, 90.0], [0.0], 1.0, "phi_deg runs from 0 to 90"),
        ([10.0], [0.0], [0.0, math.nan], 1.0, "theta_deg has a value that is not finite"),
        ([10.0], [0.0], [], 1.0, "theta_deg has the shape"),
        ([95.0], [0.0], [0.0], 1.0, "sigma_deg runs from 95"),
        ([10.0], [0.0], [0.0], math.nan, "values has nan at sigma 10, phi 0, theta 0"),
        ([10.0], [0.0], [0.0], -1e-3, "values has -0.001"),
        ([10.0], [0.0], [0.0], math.inf, "values has inf"),
    ],
)
def test_a_table_with_holes_or_disorder_is_refused(sigma: Any, phi: Any, theta: Any, value: float, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        tabulated(sigma, phi, theta, np.full((len(sigma), len(phi), len(theta)), value))


def test_shapes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match=r"values has the shape \(2,\)"):
        tabulated([10.0], [0.0], [0.0, 1.0], [1.0, 2.0])
    with pytest.raises(ValueError, match="last axis"):
        evaluate(lambertian(), [0.0, 1.0], [0.0, 1.0])
    with pytest.raises(ValueError, match="sigma_deg"):
        albedo(lambertian(), 90.0)
