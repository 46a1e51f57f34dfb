"""`Dataset.at`: values between the measured ones, with their uncertainty."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import goniotwin
from goniotwin.app.data.opening import dataset_of_file
from goniotwin.app.formats.content import BsdfFile, ScatteredBsdf
from goniotwin.app.formats.specular_grid import grid_of_points, interpolate
from goniotwin.app.formats.table import BsdfTable
from goniotwin.twin.optics import arc_direction, to_specular
from tests.app.data.made import gaussian, lambertian, rings, table

POLAR, AZIMUTH = np.arange(0.0, 86.0, 1.0), np.arange(0.0, 181.0, 5.0)


def dataset(*parts: ScatteredBsdf | BsdfTable) -> goniotwin.Dataset:
    return dataset_of_file(BsdfFile(parts), "made.csv")


def test_on_a_measured_direction_it_is_the_measured_value() -> None:
    d = dataset(rings(gaussian(5.0), 30.0, POLAR, AZIMUTH, u=0.01))
    k = 700
    value, u = d.at(sigma_deg=30, theta_deg=d.theta_deg[k], phi_deg=d.phi_deg[k])
    assert value == pytest.approx(d.bsdf[k], rel=1e-9)
    assert u == pytest.approx(d.u[k], rel=1e-6)
    same = d.at(polar_deg=d.polar_deg[k], azimuth_deg=d.azimuth_deg[k])
    assert same.value == pytest.approx(d.bsdf[k], rel=1e-9)


@pytest.mark.parametrize("kind", ["rings", "table"])
def test_between_them_a_lobe_is_within_u(kind: str) -> None:
    lobe = gaussian(5.0)
    made = rings(lobe, 30.0, POLAR, AZIMUTH) if kind == "rings" else table(lobe, np.array([0.0, 30.0, 60.0]))
    d = dataset(replace(made, u=1e-9 * made.values))
    rng = np.random.default_rng(2)
    theta, phi = rng.uniform(0.0, 12.0, 1000), rng.uniform(0.0, 360.0, 1000)
    value, u = d.at(sigma_deg=30, theta_deg=theta, phi_deg=phi)
    error = np.abs(value - lobe(theta, phi))
    # Rings cross the lobe in steps of 5 deg of azimuth: half a width on the sphere.
    assert error.max() < (0.02 if kind == "rings" else 0.003)
    assert np.percentile(error / u, 99) < 3.0
    assert np.median(u) < 0.005
    unknown = dataset(made).at(sigma_deg=30, theta_deg=theta, phi_deg=phi)
    assert np.isnan(unknown.u).all()
    np.testing.assert_allclose(unknown.value, value, rtol=1e-9)


def test_of_a_journal_it_is_the_interpolation_of_exported_tables() -> None:
    d = dataset(rings(gaussian(15.0), 20.0, POLAR, AZIMUTH, u=0.02))
    grid = grid_of_points(d.polar_deg, d.azimuth_deg, d.bsdf, np.zeros(d.size), d.u)
    expected, u_expected = interpolate(grid, np.array([33.3]), np.array([171.2]))
    value, u = d.at(polar_deg=33.3, azimuth_deg=171.2)
    assert value == pytest.approx(expected[0], rel=1e-12)
    # The rest is the estimate of the interpolation's error.
    assert u_expected[0] < u < u_expected[0] + 0.01 * value


def test_between_two_incidences_and_wavelengths_it_is_linear() -> None:
    def at(sigma_deg: float, wavelength_nm: float, value: float) -> ScatteredBsdf:
        part = rings(lambertian(math.pi * value), sigma_deg, POLAR, AZIMUTH, u=0.01)
        return replace(part, wavelength_nm=np.full(part.size, wavelength_nm))

    d = dataset(at(0.0, 500.0, 1.0), at(40.0, 500.0, 2.0), at(0.0, 600.0, 3.0), at(40.0, 600.0, 4.0))
    value, u = d.at(sigma_deg=10, wavelength_nm=550, theta_deg=5, phi_deg=90)
    assert value == pytest.approx(0.5 * (1.25 + 3.25))
    assert u > 0.01 * value
    assert d.at(sigma_deg=40, wavelength_nm=600, theta_deg=5, phi_deg=90).u == pytest.approx(0.04)
    # A parabola with its vertex at one of the two incidences is a quarter of their difference away in the middle.
    u_middle = d.at(sigma_deg=20, wavelength_nm=500, theta_deg=5, phi_deg=90).u
    assert u_middle == pytest.approx(math.hypot(0.015, 0.25 / math.sqrt(3.0)))
    for arguments, message in (
        ({"sigma_deg": 41, "wavelength_nm": 500}, r"sigma_deg 41: .* the nearest is 40"),
        ({"sigma_deg": 40}, r"wavelength_nm: is missing; .* 500, 600"),
        ({"wavelength_nm": 500}, r"sigma_deg: is missing; .* 0, 40"),
        ({"sigma_deg": 10, "wavelength_nm": 400}, r"wavelength_nm 400: .* the nearest is 500"),
    ):
        with pytest.raises(goniotwin.GoniotwinError, match=message):
            d.at(theta_deg=5, phi_deg=90, **arguments)  # type: ignore[arg-type]


def test_where_there_are_no_values_around_it_names_the_nearest() -> None:
    d = dataset(rings(gaussian(5.0), 30.0, np.arange(0.0, 61.0, 2.0), np.array([0.0, 180.0])))
    assert d.at(theta_deg=7, phi_deg=0).value > 0.0  # in the plane of incidence
    with pytest.raises(goniotwin.GoniotwinError, match=r"theta 60, phi 90: .* the nearest directions with a value are theta"):
        d.at(theta_deg=60, phi_deg=90)
    with pytest.raises(goniotwin.GoniotwinError, match=r"theta 80, phi 180: is below the horizon at sigma 30"):
        d.at(theta_deg=80, phi_deg=180)
    several = d.at(theta_deg=[0.0, 7.0, 60.0], phi_deg=[0.0, 0.0, 90.0])
    assert np.isfinite(several.value).tolist() == [True, True, False]


def test_between_two_incidences_it_names_the_one_at_which_the_direction_is_below_the_horizon() -> None:
    polar, azimuth = np.arange(0.0, 86.0, 5.0), np.arange(0.0, 181.0, 10.0)
    d = dataset(*(rings(lambertian(1.0), sigma, polar, azimuth) for sigma in (30.0, 60.0)))
    why = "below the horizon at sigma 60 deg, which the values at sigma 45 deg are interpolated from"
    with pytest.raises(goniotwin.GoniotwinError, match=f"theta 44, phi 180: is {why}"):
        d.at(sigma_deg=45.0, theta_deg=44.0, phi_deg=180.0)


@pytest.mark.parametrize("flag", ["clipped", "shadowed"])
def test_over_a_saturated_peak_or_a_blocked_direction_there_is_no_value(flag: str) -> None:
    """The value there may be anything: the neighbours do not show it. Further away the same values stand."""
    whole = rings(gaussian(15.0), 30.0, POLAR, AZIMUTH, u=0.01)
    theta, _ = to_specular(whole.sigma_deg, arc_direction(whole.polar_deg, whole.azimuth_deg))
    lost = theta < 4.0
    made = replace(whole, values=np.where(lost, np.nan, whole.values), flags=np.where(lost, flag, ""))
    d, undisturbed = dataset(made), dataset(whole)
    with pytest.raises(goniotwin.GoniotwinError, match=f"nothing is interpolated beside {flag} directions; the nearest"):
        d.at(sigma_deg=30, theta_deg=1.3, phi_deg=40)
    far, same = (each.at(sigma_deg=30, theta_deg=21.3, phi_deg=40) for each in (d, undisturbed))
    assert far == same
    assert goniotwin.compare(undisturbed, d).lights[0].index.size == np.sum(~lost)
    dead = dataset(replace(made, flags=np.where(lost, "dead", "")))
    assert math.isfinite(dead.at(sigma_deg=30, theta_deg=1.3, phi_deg=40).value)


def test_where_the_cubic_crosses_the_chord_u_stays() -> None:
    """Both agree in one point of a flank's cell, and not with the lobe."""
    lobe, azimuth = gaussian(12.0), np.arange(0.0, 181.0, 10.0)
    made = rings(lobe, 60.0, np.arange(0.0, 90.0, 5.0), azimuth, u=1e-4)
    d = dataset(made)
    at = np.linspace(160.5, 169.5, 200)
    theta, phi = to_specular(np.full(200, 60.0), arc_direction(np.full(200, 60.0), at))
    value, u = d.at(sigma_deg=60, polar_deg=np.full(200, 60.0), azimuth_deg=at)
    assert np.max(np.abs(value - lobe(theta, phi)) / u) < 3.0


def test_flagged_values_do_not_count() -> None:
    part = rings(lambertian(1.0), 0.0, POLAR, AZIMUTH, u=0.01)
    dead = (part.polar_deg < 10.0) & (part.azimuth_deg < 90.0)
    d = dataset(replace(part, values=np.where(dead, 5.0, part.values), flags=np.where(dead, "dead", "steep")))
    assert d.at(polar_deg=8.5, azimuth_deg=120).value == pytest.approx(1.0 / math.pi)
    # From the ring beyond, across the pole.
    assert d.at(polar_deg=8.5, azimuth_deg=30).value == pytest.approx(1.0 / math.pi)


def test_finer_directions_near_a_lobe_leave_no_gaps_elsewhere() -> None:
    lobe = gaussian(20.0)
    coarse = rings(lobe, 30.0, np.arange(0.0, 86.0, 5.0), np.arange(0.0, 360.0, 10.0))
    fine = rings(lobe, 30.0, np.arange(26.0, 35.0, 1.0), np.arange(171.0, 190.0, 1.0))
    d = dataset(coarse, fine)
    for polar, azimuth in ((72.5, 175.5), (28.5, 95.0), (31.5, 355.5), (30.2, 184.7)):
        value = d.at(polar_deg=polar, azimuth_deg=azimuth).value
        expected = rings(lobe, 30.0, np.array([polar]), np.array([azimuth])).values[0]
        assert value == pytest.approx(expected, abs=0.01), (polar, azimuth)


def test_a_lobe_that_some_half_planes_cross_far_from_its_peak_is_within_u() -> None:
    """A table of a coarse measurement: two half planes in full, others from the flank on; the peak is one node of all."""
    lobe = gaussian(11.0)
    whole = table(lobe, np.array([0.0, 30.0, 60.0]))
    first = np.where(np.isin(whole.phi_deg, [0.0, 180.0]), 0.0, np.where(whole.phi_deg <= 30.0, 17.0, np.inf))
    known = (whole.theta_deg >= first[:, None]) | (whole.theta_deg == 0.0)
    d = dataset(replace(whole, u=1e-3 * whole.values, known=np.broadcast_to(known[None, None, None], whole.values.shape)))
    rng = np.random.default_rng(4)
    theta, phi = rng.uniform(0.0, 17.0, 500), rng.uniform(0.0, 30.0, 500)
    value, u = d.at(sigma_deg=30, theta_deg=theta, phi_deg=phi)
    assert np.mean(np.abs(value - lobe(theta, phi)) < 2.0 * u) > 0.9


@given(st.floats(0.0, 80.0), st.floats(-400.0, 800.0))
def test_an_anisotropic_sample_is_not_folded_and_goes_round(polar_deg: float, azimuth_deg: float) -> None:
    def one_sided(theta: Any, phi: Any) -> Any:
        return 2.0 + np.sin(np.radians(phi)) * np.sin(np.radians(theta))

    d = dataset(rings(one_sided, 0.0, POLAR, np.arange(0.0, 360.0, 5.0), isotropic=False))
    value = d.at(polar_deg=polar_deg, azimuth_deg=azimuth_deg).value
    assert value == pytest.approx(2.0 + math.sin(math.radians(azimuth_deg)) * math.sin(math.radians(polar_deg)), abs=2e-3)


def test_scattered_directions_are_on_no_grid() -> None:
    rng = np.random.default_rng(1)
    n = 200
    part = ScatteredBsdf(np.zeros(n), np.zeros(n), rng.uniform(0.0, 80.0, n), rng.uniform(0.0, 360.0, n), np.ones(n))
    with pytest.raises(goniotwin.GoniotwinError, match=r"on rings nor on a grid, .*; the nearest directions"):
        dataset(part).at(theta_deg=10, phi_deg=50)


def test_a_table_of_one_phi_is_the_same_at_all() -> None:
    theta = np.arange(0.0, 91.0, 1.0)
    d = dataset(BsdfTable(np.array([0.0]), np.array([0.0]), theta, np.cos(np.radians(theta)).reshape(1, 1, 1, 1, -1)))
    assert d.at(theta_deg=40.5, phi_deg=123).value == pytest.approx(math.cos(math.radians(40.5)), rel=1e-4)


def test_lights_that_are_not_clear_have_to_be_given() -> None:
    one = rings(lambertian(1.0), 0.0, POLAR, AZIMUTH)
    through = replace(one, transmitted=np.ones(one.size, dtype=bool), values=0.5 * one.values)
    red, turned = replace(one, channel=np.full(one.size, "red")), replace(one, psi_deg=np.full(one.size, 90.0))
    for other, argument, missing in (
        (through, {"transmitted": True}, "transmitted: is missing"),
        (red, {"channel": "red"}, "channel: is missing"),
        (turned, {"psi_deg": 450}, "psi_deg: is missing; .* 0, 90"),
    ):
        d = dataset(one, other)
        with pytest.raises(goniotwin.GoniotwinError, match=missing):
            d.at(theta_deg=10, phi_deg=0)
        expected = 0.5 / math.pi if other is through else 1.0 / math.pi
        assert d.at(theta_deg=10, phi_deg=0, **argument).value == pytest.approx(expected)


@pytest.mark.parametrize(
    "arguments",
    [
        {},
        {"theta_deg": 10},
        {"polar_deg": 10},
        {"theta_deg": 10, "polar_deg": 10},
        {"theta_deg": "x", "phi_deg": 0},
        {"theta_deg": -1, "phi_deg": 0},
        {"polar_deg": 91, "azimuth_deg": 0},
        {"theta_deg": float("nan"), "phi_deg": 0},
        {"theta_deg": [1, 2], "phi_deg": [1, 2, 3]},
        {"polar_deg": [1, 2], "azimuth_deg": [1, 2, 3]},
        {"theta_deg": 1, "phi_deg": 0, "sigma_deg": [0, 1]},
        {"theta_deg": 1, "phi_deg": 0, "wavelength_nm": 550},
        {"theta_deg": 1, "phi_deg": 0, "channel": "red"},
        {"theta_deg": 1, "phi_deg": 0, "back": True},
        {"theta_deg": 1, "phi_deg": 0, "sigma_deg": float("inf")},
        {"theta_deg": True, "phi_deg": 0},
    ],
)
def test_arguments_that_are_none_are_refused(arguments: dict[str, Any]) -> None:
    d = dataset(rings(lambertian(1.0), 0.0, POLAR, AZIMUTH))
    with pytest.raises(goniotwin.GoniotwinError):
        d.at(**arguments)
