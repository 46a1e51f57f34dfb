"""Tables from values at scattered directions: accuracy, and errors for holes and duplicates."""

import math
from typing import Any

import numpy as np
import pytest

from goniotwin.arrays import Floats
from goniotwin.twin.optics import Scatterer, evaluate, from_specular, light_direction, scattered_points
from tests.twin.optics.models import points

SIGMAS = [0.0, 30.0, 60.0]


def true_value(sigma: Floats, zenith: Floats, azimuth: Floats) -> Floats:
    """A lobe of 20 deg about the specular direction on a diffuse ground, in 1/sr."""
    s, z, a = np.radians(sigma), np.radians(zenith), np.radians(azimuth)
    cosine = np.cos(s) * np.cos(z) - np.sin(s) * np.sin(z) * np.cos(a)
    result: Floats = 0.2 + 1.5 * np.exp(-((np.arccos(np.clip(cosine, -1.0, 1.0)) / math.radians(20.0)) ** 2))
    return result


def table_of(rows: Floats, values: Floats, **options: Any) -> Scatterer:
    """Table of values at rows of sigma, zenith and azimuth."""
    return scattered_points(rows[:, 0], rows[:, 1], rows[:, 2], values, spherical=True, **options)


def table_at(step_deg: float, **options: Any) -> Scatterer:
    spread = points(SIGMAS, step_deg)
    return table_of(spread, true_value(*spread.T), **options)


@pytest.mark.parametrize(("step_deg", "worst"), [(6.0, 0.1), (3.0, 0.03), pytest.param(1.5, 0.01, marks=pytest.mark.long)])
def test_the_error_decreases_with_the_distance_of_the_points(step_deg: float, worst: float) -> None:
    model, random = table_at(step_deg), np.random.default_rng(1)
    for sigma in SIGMAS:
        zenith, azimuth = np.degrees(np.arccos(random.random(300))), 360.0 * random.random(300)
        expected = true_value(np.full(300, sigma), zenith, azimuth)
        # Relative to the peak of the lobe: the error is due to the curvature over a step, and decreases as its square.
        measured = evaluate(model, light_direction(sigma), from_specular(0.0, zenith, azimuth))
        assert np.max(np.abs(measured - expected)) < worst * 1.7


def test_points_on_a_regular_grid_of_specular_coordinates_are_reproduced() -> None:
    theta, phi = (each.ravel() for each in np.meshgrid(np.arange(5.0, 176.0, 5.0), np.arange(0.0, 360.0, 5.0)))
    theta, phi = np.append(theta, 0.0), np.append(phi, 0.0)
    values = 0.1 + np.exp(-theta / 20.0) * (1.2 + np.sin(np.radians(phi)))
    model = scattered_points(np.full(theta.size, 30.0), theta, phi, values)
    above = from_specular(30.0, theta, phi)[:, 2] > 1e-9
    measured = evaluate(model, light_direction(30.0), from_specular(30.0, theta, phi)[above])
    assert measured == pytest.approx(values[above], rel=1e-6)


def test_a_constant_stays_constant_and_there_is_no_overshoot() -> None:
    spread = points(SIGMAS, 5.0)
    everywhere = from_specular(0.0, np.linspace(0.0, 89.9, 400), np.linspace(0.0, 9000.0, 400))
    flat = table_of(spread, np.full(spread.shape[0], 0.25))
    assert evaluate(flat, light_direction(40.0), everywhere) == pytest.approx(0.25, rel=1e-9)
    rough = table_of(spread, np.random.default_rng(3).choice([0.0, 1.0], spread.shape[0]))
    values = evaluate(rough, light_direction(40.0), everywhere)
    assert values.min() >= 0.0
    assert values.max() <= 1.0 + 1e-12


def test_the_order_of_the_points_has_no_effect() -> None:
    spread = points(SIGMAS, 8.0)
    mixed = np.random.default_rng(4).permutation(spread)
    one, other = (table_of(each, true_value(*each.T)) for each in (spread, mixed))
    assert one.lobes[0].values == pytest.approx(other.lobes[0].values, rel=1e-9)


def test_half_of_the_directions_are_enough_with_mirror_symmetry() -> None:
    spread = points(SIGMAS, 3.0)
    half = spread[spread[:, 2] <= 180.0]
    model = table_of(half, true_value(*half.T), mirrored=True)
    one_side, other_side = (from_specular(30.0, 25.0, phi) for phi in (70.0, 290.0))
    light = light_direction(30.0)
    assert evaluate(model, light, one_side) == evaluate(model, light, other_side)
    assert evaluate(model, light, one_side) == pytest.approx(float(evaluate(table_at(3.0), light, one_side)), abs=0.02)
    with pytest.raises(ValueError, match="values has a hole at sigma 0"):
        table_of(half, true_value(*half.T))


def test_points_of_an_anisotropic_sample_are_relative_to_the_light() -> None:
    spread, psis = points([30.0], 4.0), [0.0, 120.0, 240.0]
    # An isotropic lobe, measured at three azimuths of the light in the sample's frame: psi makes no difference.
    rows = np.concatenate([np.column_stack([spread + np.array([0.0, 0.0, psi]), np.full(len(spread), psi)]) for psi in psis])
    values = true_value(rows[:, 0], rows[:, 1], rows[:, 2] - rows[:, 3])
    model = scattered_points(rows[:, 0], rows[:, 1], rows[:, 2] % 360.0, values, psi_deg=rows[:, 3], spherical=True)
    light, observer = light_direction(30.0), from_specular(30.0, 15.0, 60.0)
    turned = [float(evaluate(model, light, observer, gamma_deg=gamma)) for gamma in (0.0, 50.0, 240.0)]
    assert turned == pytest.approx([turned[0]] * 3, rel=1e-6)


def arguments_with(**changes: Any) -> dict[str, Any]:
    """Valid arguments with one change; a pair (i, value) changes one entry of a list."""
    spread = points([0.0, 30.0], 6.0)
    given: dict[str, Any] = {"sigma_deg": spread[:, 0], "theta_deg": spread[:, 1], "phi_deg": spread[:, 2]}
    given["values"] = true_value(*spread.T)
    for name, change in changes.items():
        if isinstance(change, tuple):
            given[name] = given[name].copy()
            given[name][change[0]] = change[1]
        else:
            given[name] = change
    return given


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"values": (7, -0.5)}, r"values\[7\] is -0.5"),
        ({"values": (8, math.nan)}, r"values\[8\] is nan"),
        ({"values": (9, math.inf)}, r"values\[9\] is inf"),
        ({"sigma_deg": (3, 91.0)}, r"sigma_deg\[3\] is 91.0: keep it in 0 to 90"),
        ({"theta_deg": (3, 95.0)}, r"theta_deg\[3\] is 95.0: keep it in 0 to 90"),
        ({"phi_deg": (3, math.nan)}, r"phi_deg\[3\] is nan"),
        ({"phi_deg": [1.0, 2.0]}, r"phi_deg has the shape \(2,\)"),
        ({"values": []}, "give a list, one value per point"),
        ({"sigma_deg": (5, 10.0)}, "values has a hole at sigma 10"),
        ({"gap_deg": 2.0}, "no point within 2 deg of it"),
        ({"gap_deg": -1.0}, "gap_deg is -1.0"),
    ],
)
def test_invalid_points_are_refused(changes: dict[str, Any], message: str) -> None:
    scattered_points(**arguments_with(), spherical=True)
    with pytest.raises(ValueError, match=message):
        scattered_points(**arguments_with(**changes), spherical=True)


def test_two_values_in_one_direction_are_refused() -> None:
    given = arguments_with()
    doubled: dict[str, Any] = {name: np.append(values, values[17]) for name, values in given.items()}
    with pytest.raises(ValueError, match=rf"points 17 and {given['values'].size}, at sigma 0, have the same direction"):
        scattered_points(**doubled, spherical=True)


def test_an_incidence_without_points_is_refused() -> None:
    spread = points([0.0, 30.0], 6.0)
    psi = np.where(spread[:, 0] == 0.0, 0.0, 90.0)
    with pytest.raises(ValueError, match="there is no point at sigma 30, psi 0"):
        table_of(spread, true_value(*spread.T), psi_deg=psi)
