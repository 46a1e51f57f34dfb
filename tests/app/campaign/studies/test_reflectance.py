"""The reflectance of measured values: exact for a constant, right for a lobe, and what directions without a value add."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.campaign.planning.templates import make_schedule
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.studies.reflectance import integration_settings, quadrature
from goniotwin.app.data.opening import open_dataset
from goniotwin.app.rig import read_rig
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import albedo, arc_direction, evaluate, gaussian, light_direction
from tests.app.campaign.reduction.made_points import made_points
from tests.conftest import RIG


def _grid(rings: Floats, azimuths: Floats) -> tuple[Floats, Floats]:
    zenith, azimuth = (each.ravel() for each in np.meshgrid(rings, azimuths, indexing="ij"))
    return zenith, azimuth


def _points(zenith: Floats, azimuth: Floats, bsdf: Floats, shadowed: Flags | None = None) -> BsdfPoints:
    return made_points(30.0, zenith, azimuth, bsdf, 0.01, {} if shadowed is None else {"shadowed": shadowed})


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(0.0, 89.0), min_size=1, max_size=9, unique=True), st.integers(1, 12), st.integers(0, 99))
def test_a_constant_is_integrated_exactly_whatever_is_missing(rings: list[float], azimuths: int, seed: int) -> None:
    zenith, azimuth = _grid(np.sort(rings), 360.0 * np.arange(azimuths) / azimuths)
    bad = np.random.default_rng(seed).random(zenith.size) < 0.3
    bad[0] = False
    for symmetry in ("isotropic", "anisotropic"):
        result = quadrature(_points(zenith, azimuth, np.full(zenith.size, 0.2), bad), symmetry)
        assert result.weight.sum() == pytest.approx(np.pi, rel=1e-9)
        assert result.coarse.sum(axis=2) == pytest.approx(np.pi, rel=1e-9)
        assert np.all(result.weight >= 0.0)
        assert np.all(result.weight[bad] == 0.0)
        assert np.all(result.obstructed + result.extrapolated <= result.weight + 1e-12)


@pytest.mark.parametrize("azimuths", [np.arange(0.0, 360.0, 5.0), np.arange(0.0, 181.0, 5.0)])
def test_a_lobe_has_the_reflectance_of_its_model(azimuths: Floats) -> None:
    sample = gaussian(15.0, reflectance=0.7)
    zenith, azimuth = _grid(np.arange(0.0, 90.0, 2.5), azimuths)
    value = evaluate(sample, light_direction(30.0), arc_direction(zenith, azimuth))
    points = _points(zenith, azimuth, value)
    symmetry = "isotropic" if azimuths[-1] == 180.0 else "anisotropic"
    result = quadrature(points, symmetry)  # type: ignore[arg-type]
    expected = albedo(sample, 30.0)
    error = abs(float(np.sum(result.weight * value)) - expected)
    assert result.hemisphere
    assert error < 0.01 * expected
    assert error < 3.0 * result.interpolation_error(value)
    (setting,) = integration_settings(points)
    assert str(setting) == "550 nm, sigma 30 deg"


@pytest.mark.parametrize("step_deg", [10.0, 15.0, 20.0, 30.0, 45.0, 60.0])
@pytest.mark.parametrize("near", [(), (170.0, 175.0)], ids=["even", "finer near the specular direction"])
@pytest.mark.parametrize("width_deg", [8.0, 15.0, 30.0])
def test_a_lobe_that_the_grid_does_not_resolve_is_within_u(step_deg: float, near: tuple[float, ...], width_deg: float) -> None:
    sample = gaussian(width_deg, reflectance=0.7)
    for sigma in (15.0, 30.0, 45.0, 60.0, 75.0):
        for polar_step_deg in (2.5, 5.0):
            azimuths = np.unique([*np.arange(0.0, 181.0, step_deg), *near])
            zenith, azimuth = _grid(np.arange(0.0, 88.0, polar_step_deg), azimuths)
            value = evaluate(sample, light_direction(sigma), arc_direction(zenith, azimuth))
            result = quadrature(_points(zenith, azimuth, value), "isotropic")
            off = abs(float(result.weight @ value) - albedo(sample, sigma))
            beyond = float(result.extrapolated @ value)  # has an uncertainty of its own
            assert off < 2.0 * result.interpolation_error(value) + beyond


def test_a_cosine_is_integrated_and_a_direction_measured_twice_counts_once() -> None:
    polar, beta = _grid(np.arange(0.0, 86.0, 5.0), np.arange(0.0, 180.1, 15.0))
    weight = quadrature(_points(polar, beta, np.ones(polar.size)), "isotropic").weight
    assert weight @ np.cos(np.radians(polar)) == pytest.approx(2.0 * np.pi / 3.0, rel=1e-3)
    twice = _points(np.append(polar, polar[40]), np.append(beta, beta[40]), np.ones(polar.size + 1))
    again = quadrature(twice, "isotropic").weight
    assert again.sum() == pytest.approx(np.pi, rel=1e-12)
    assert again[40] == again[-1] == pytest.approx(weight[40] / 2.0, rel=1e-12)


def test_a_few_directions_outside_the_rings_do_not_count() -> None:
    """An overlap measures single directions, here one at the horizon."""
    zenith, azimuth = _grid(np.arange(0.0, 89.0, 4.0), np.arange(0.0, 181.0, 10.0))
    with_one = _points(np.append(zenith, 90.0), np.append(azimuth, 0.0), np.full(zenith.size + 1, 0.2))
    result = quadrature(with_one, "isotropic")
    assert result.hemisphere
    assert result.weight[-1] == 0.0
    assert result.weight.sum() == pytest.approx(np.pi, rel=1e-9)


def test_finer_directions_near_the_specular_direction_leave_nothing_unmeasured() -> None:
    """They are on rings of their own, which go round nowhere: the others are as whole as without them."""
    zenith, azimuth = _grid(np.arange(0.0, 86.0, 5.0), np.arange(0.0, 181.0, 10.0))
    finer, about = _grid(np.arange(22.5, 40.0, 5.0), np.array([170.0, 175.0, 180.0]))
    points = _points(np.append(zenith, finer), np.append(azimuth, about), np.full(zenith.size + finer.size, 0.2))
    result = quadrature(points, "isotropic")
    assert result.hemisphere
    assert not result.obstructed.any()
    assert result.weight.sum() == pytest.approx(np.pi, rel=1e-9)


def test_blocked_directions_and_those_beyond_the_last_ring_are_stated() -> None:
    zenith, azimuth = _grid(np.arange(0.0, 81.0, 5.0), np.arange(0.0, 360.0, 15.0))
    blocked = (azimuth == 30.0) & (zenith > 20.0)
    value = np.full(zenith.size, 1.0 / np.pi)
    result = quadrature(_points(zenith, azimuth, value, blocked), "anisotropic")
    one_azimuth = (np.sin(np.radians(80.0)) ** 2 - np.sin(np.radians(22.5)) ** 2) / 24.0
    assert float(np.sum(result.obstructed * value)) == pytest.approx(one_azimuth, rel=0.02)
    assert float(np.sum(result.extrapolated * value)) == pytest.approx(np.cos(np.radians(80.0)) ** 2, rel=1e-9)
    in_plane = _points(*_grid(np.arange(0.0, 81.0, 5.0), np.array([0.0, 180.0])), np.full(34, 0.3))
    assert not quadrature(in_plane, "isotropic").hemisphere


@pytest.mark.long
@pytest.mark.parametrize("sample", ["gaussian-5", "white-tile"])
def test_the_campaign_of_a_template_has_the_reflectance_of_the_model(sample: str, tmp_path: Path) -> None:
    """Its directions are finer near the specular one. At normal incidence the peak is blocked, and u is that of a guess."""
    rig = read_rig(RIG)
    made = make_schedule("isotropic", rig, "x.toml", sample, "etalon", 0.01, 0.5)
    run_without_wires(made.plan, tmp_path / "a.journal")
    dataset, model = open_dataset(tmp_path / "a.journal"), rig.model()
    assert model is not None
    for sigma in np.unique(dataset.sigma_deg).tolist():
        found = dataset.reflectance(sigma_deg=sigma, wavelength_nm=550.0)
        assert abs(found.value - albedo(model.samples[sample], sigma)) < 2.0 * found.u
        assert found.u < 0.12 * found.value or sigma == 0.0
