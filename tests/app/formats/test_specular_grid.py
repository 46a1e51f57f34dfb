"""The resampling onto specular coordinates: against closed forms, published values and statistics of its uncertainty."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.formats.specular_grid import PolarGrid, SpecularCut, grid_of_points, interpolate, resample, specular_table
from goniotwin.app.simulation.detectors import detector_grid, output_phi, output_theta
from goniotwin.twin.optics import arc_direction, from_specular, to_specular
from tests.sizes import parted

X = np.array([7.99, 8.09, 8.19, 8.70, 9.20, 10.0, 12.0, 15.0, 20.0])
F = np.array([0.0, 0.27643e-4, 0.43749e-1, 0.16918, 0.46943, 0.94374, 0.99864, 0.99992, 0.99999])
SLOPES = np.array([5.52510e-4, 0.33587, 0.34944, 0.59696, 6.03260e-2, 8.98335e-4])
"""Data of the NAG library's example program e01bfc, with the slopes that its routine e01bec (PCHIM) has at the inner nodes; the
last of these needs more digits of the values than are printed."""
AT = np.array([9.191, 10.392, 11.593, 12.794, 13.995])
VALUES = np.array([0.4640, 0.9645, 0.9965, 0.9992, 0.9998])
"""Results of the NAG library's example program e01bec, in intervals whose slopes do not depend on the ends of the list."""


def along(x: np.ndarray, values: np.ndarray, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The interpolation along polar angles alone, with an uncertainty of 1 of each value."""
    grid = PolarGrid(x, np.zeros(1), values[:, None], np.ones((x.size, 1)), np.zeros((x.size, 1)), mirrored=True)
    return interpolate(grid, at, np.zeros(at.size))


def test_the_monotone_cubic_has_the_published_values() -> None:
    np.testing.assert_allclose(along(X, F, AT)[0], VALUES, atol=0.5e-4)


def test_the_monotone_cubic_has_the_published_slopes() -> None:
    step = 1e-3
    one, two, three = (along(X, F, X[1:7] + k * step)[0] for k in (1, 2, 3))
    slopes = (18.0 * one - 9.0 * two + 2.0 * three - 11.0 * F[1:7]) / (6.0 * step)  # exact for a cubic
    np.testing.assert_allclose(slopes, SLOPES, rtol=2e-5)  # the last digit of 0.34944 is cut off, not rounded


@pytest.mark.parametrize("width_deg", [2.0, 5.0])
def test_a_gaussian_is_followed_ten_times_as_well_as_by_a_linear_interpolation(width_deg: float) -> None:
    x, at = np.arange(0.0, 60.5, 0.5), np.arange(20.05, 40.0, 0.1)
    lobe = np.exp(-(((x - 30.0) / width_deg) ** 2))
    expected = np.exp(-(((at - 30.0) / width_deg) ** 2))
    near = expected > 0.01
    cubic, linear = along(x, lobe, at)[0], np.interp(at, x, lobe)
    error, error_linear = (np.sqrt(np.mean((each / expected - 1.0)[near] ** 2)) for each in (cubic, linear))
    # Linear: step^2 / 8 times the second derivative; the cubic: the third power of the step, but at the peak.
    assert error < 0.1 * error_linear


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_interpolation_does_not_overshoot(seed: int) -> None:
    generator = np.random.default_rng(seed)
    polar = np.sort(generator.choice(88, 6, replace=False)).astype(float)
    azimuth = np.concatenate([[0.0], np.sort(generator.choice(np.arange(1, 180), 4, replace=False)), [180.0]])
    table = generator.random((6, 6))
    grid = PolarGrid(polar, azimuth, table, np.full((6, 6), 0.1), np.zeros((6, 6)), mirrored=True)
    values, u = interpolate(grid, generator.uniform(polar[0], polar[-1], 50), generator.uniform(0.0, 180.0, 50))
    assert np.all((values >= table.min() - 1e-12) & (values <= table.max() + 1e-12))
    assert np.all(u > 0.0)
    nodes, u_nodes = interpolate(grid, *np.meshgrid(polar, azimuth, indexing="ij"))
    np.testing.assert_allclose(nodes, table, rtol=1e-9)
    np.testing.assert_allclose(u_nodes, 0.1, rtol=1e-12)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.booleans())
def test_the_uncertainty_is_that_of_the_local_linearisation(seed: int, mirrored: bool) -> None:
    """Against differences: each value is changed a little, and the squares of the effects are added."""
    generator = np.random.default_rng(seed)
    polar = np.array([0.0, 2.0, 5.0, 9.0])
    azimuth = np.array([0.0, 50.0, 110.0, 180.0]) if mirrored else np.array([0.0, 100.0, 220.0, 360.0])
    table, none = 1.0 + generator.random((4, 4)), np.zeros((4, 4))
    u = 0.01 + 0.02 * generator.random((4, 4))
    table[0], u[0] = table[0, 0], u[0, 0]  # the pole is one direction
    if not mirrored:
        table[:, -1], u[:, -1] = table[:, 0], u[:, 0]
    at = generator.uniform(0.1, 8.9, 20), generator.uniform(0.0, azimuth[-1] - 60.0, 20)
    values, found = interpolate(PolarGrid(polar, azimuth, table, u, none, mirrored), *at)
    variance, step = np.zeros(20), 1e-7
    for i, j in np.ndindex(4, 4):
        if i == 0 and j > 0:
            continue
        changed = table.copy()
        changed[i, slice(None) if i == 0 else j] += step
        effect = (interpolate(PolarGrid(polar, azimuth, changed, u, none, mirrored), *at)[0] - values) / step
        variance += (effect * u[i, j]) ** 2
    np.testing.assert_allclose(found, np.sqrt(variance), rtol=1e-4)


@parted(8)
def test_the_uncertainty_is_the_scatter_of_noisy_values(part: int) -> None:
    generator = np.random.default_rng(7)
    x, at = np.arange(20.0, 41.0, 1.0), np.array([25.5, 27.2, 29.9, 33.5])
    lobe, count = np.exp(-(((x - 30.0) / 8.0) ** 2)), 4000 // part
    sigma = 1e-4
    drawn = lobe + sigma * generator.standard_normal((count, x.size))
    found = np.array([along(x, each, at)[0] for each in drawn])
    stated = along(x, lobe, at)[1] * sigma
    # The standard deviation of n draws is known to 1 / sqrt(2 n): five of these, and 1 % for the curvature.
    np.testing.assert_allclose(found.std(axis=0), stated, rtol=5.0 / np.sqrt(2.0 * count) + 0.01)


def test_values_of_one_direction_are_averaged_with_their_uncertainty() -> None:
    grid = grid_of_points(
        np.array([0.0, 0.0, 10.0, 10.0]),
        np.array([0.0, 90.0, 30.0, 330.0]),
        np.array([1.0, 3.0, 5.0, 7.0]),
        np.full(4, 0.2),
        np.full(4, 0.1),
    )
    assert (grid.polar_deg.tolist(), grid.azimuth_deg.tolist()) == ([0.0, 10.0], [0.0, 30.0, 90.0])
    np.testing.assert_allclose(grid.values, [[2.0, 2.0, 2.0], [np.nan, 6.0, np.nan]])
    there = np.where(np.isfinite(grid.values), 1.0, np.nan)
    np.testing.assert_allclose(grid.u, 0.2 / np.sqrt(2.0) * there)
    np.testing.assert_allclose(grid.shared, 0.1 * there)


def test_what_values_share_is_not_averaged_out() -> None:
    """A relative uncertainty of the scale is that of the result, wherever it is: the interpolation is of degree 1."""
    x, at = np.arange(20.0, 41.0, 1.0), np.arange(20.0, 40.0, 0.13)
    lobe = np.exp(-(((x - 30.0) / 8.0) ** 2))[:, None]
    grid = PolarGrid(x, np.zeros(1), lobe, np.zeros_like(lobe), 0.02 * lobe, mirrored=True)
    values, u = interpolate(grid, at, np.zeros(at.size))
    np.testing.assert_allclose(u, 0.02 * values, rtol=1e-12)


def polar_grid(sigma_deg: float, mirrored: bool, of_directions: np.ndarray | None = None) -> tuple[PolarGrid, np.ndarray]:
    """The grid of the detectors of a simulation, with ones or given values, and its directions (n, 3)."""
    detectors = detector_grid(sigma_deg, mirrored)
    directions = detectors.directions(False)
    values = np.ones(len(directions)) if of_directions is None else of_directions
    return detectors.grid(values, np.full(len(directions), 0.01)), directions


@pytest.mark.parametrize("mirrored", [True, False])
@pytest.mark.parametrize("sigma_deg", [0.0, 7.0, 45.0, 85.0])
def test_a_smooth_lobe_is_interpolated_to_the_output_grid(sigma_deg: float, mirrored: bool) -> None:
    def lobe(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
        even = 1.0 + 0.2 * np.cos(np.radians(phi)) * np.sin(np.radians(theta))
        odd = 0.0 if mirrored else 0.2 * np.sin(np.radians(phi)) * np.sin(np.radians(theta))
        value: np.ndarray = (even + odd) * np.exp(-((theta / 5.0) ** 2))
        return value

    values = lobe(*to_specular(sigma_deg, polar_grid(sigma_deg, mirrored)[1]))
    phi, theta = output_phi(None, mirrored), output_theta(None)
    cut = resample(polar_grid(sigma_deg, mirrored, values)[0], sigma_deg, phi, theta)
    expected = lobe(theta[None, :], phi[:, None])
    assert np.max(np.abs(cut.values - expected)[cut.known]) < 0.003
    # All nodes above the last detectors are known, and no node below the horizon.
    height = from_specular(sigma_deg, theta[None, :], phi[:, None])[..., 2]
    assert np.all(cut.known[height > np.cos(np.radians(87.0)) + 1e-6])
    assert not np.any(cut.known[height < 0.0])
    assert np.all(cut.values >= 0.0)


def test_a_missing_detector_affects_only_the_nodes_around_it() -> None:
    directions = polar_grid(30.0, True)[1]
    values = np.where(directions @ arc_direction(50.0, 90.0) > np.cos(np.radians(4.0)), np.nan, 1.0)
    phi, theta = output_phi(np.arange(0.0, 181.0, 1.0), True), np.arange(0.0, 181.0, 1.0)
    cut = resample(polar_grid(30.0, True, values)[0], 30.0, phi, theta)
    away = from_specular(30.0, theta[None, :], phi[:, None]) @ arc_direction(50.0, 90.0)
    assert not cut.known[away > np.cos(np.radians(2.0))].any()
    height = from_specular(30.0, theta[None, :], phi[:, None])[..., 2]
    assert cut.known[(away < np.cos(np.radians(15.0))) & (height > 0.1)].all()
    np.testing.assert_allclose(cut.values, 1.0, rtol=1e-12)
    np.testing.assert_array_equal(cut.u[~cut.known], cut.values[~cut.known])
    assert np.all(cut.u[cut.known] <= 0.01 * (1.0 + 1e-9))  # between equal values the errors are averaged


@pytest.mark.parametrize(("u", "expected"), [(0.02, 0.02), (0.0, 1.0 / np.pi)])
def test_a_continued_zero_is_not_stated_as_exact(u: float, expected: float) -> None:
    # The measured values and all but one uncertainty are exactly 0, as in a simulation far from a lobe.
    known = np.array([[True, True, False, False]])
    cut = SpecularCut(np.zeros((1, 4)), np.array([[u, 0.0, 0.0, 0.0]]), known)
    table = specular_table(
        np.array([30.0]),
        np.zeros(1),
        np.array([0.0, 1.0, 2.0, 3.0]),
        [[cut]],
        None,
        transmitted=False,
        generated=True,
        comments=[],
        done="simulated",
    )
    assert table.u is not None
    assert table.u[0, 0, 1, 0].tolist() == [u, 0.0, expected, expected]
    assert table.u[0, 0, [0, 2], 0].min() > 0.0


def test_a_table_covers_all_sigmas_and_lists_the_continued_nodes() -> None:
    phi, theta = np.array([0.0, 180.0]), np.array([0.0, 60.0, 180.0])
    cuts = [[resample(polar_grid(sigma, True)[0], sigma, phi, theta) for sigma in (20.0, 40.0)]]
    table = specular_table(
        np.array([20.0, 40.0]), phi, theta, cuts, None, transmitted=False, generated=True, comments=["a"], done="simulated"
    )
    assert table.sigma_deg.tolist() == [0.0, 20.0, 40.0, 90.0]
    assert table.values.shape == (1, 1, 4, 2, 3)
    np.testing.assert_allclose(table.values, 1.0)
    assert table.u is not None
    np.testing.assert_allclose(table.u[0, 0, 1], [[0.01, 0.01, 1.0], [0.01, 0.01, 1.0]], rtol=0.3)
    np.testing.assert_array_equal(table.u[0, 0, [0, 3]], 1.0)
    assert table.comments[0] == "a"
    assert "sigma 20, phi 0: theta 180 to 180" in table.comments
    assert "sigma 40, phi 180: theta 60 to 180" in table.comments
