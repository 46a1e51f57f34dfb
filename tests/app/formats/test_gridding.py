"""Scattered values onto a grid: directions in any order, off any grid, of a turned sample, and at several wavelengths."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from goniotwin.app.formats.content import ScatteredBsdf, nodes
from goniotwin.app.formats.gridding import grid_table
from goniotwin.app.formats.table import BsdfTable
from goniotwin.twin.optics import arc_direction, from_specular, to_specular


def lobe(values: ScatteredBsdf, width_deg: float = 20.0) -> np.ndarray:
    """A lobe about the specular direction, brighter by a part on the side of growing azimuth."""
    theta, phi = values.specular()
    return np.asarray(np.exp(-((theta / width_deg) ** 2)) * (1.0 + 0.3 * np.sin(np.radians(theta)) * np.sin(np.radians(phi))))


def at(sigma: np.ndarray, polar: np.ndarray, azimuth: np.ndarray, psi: float = 0.0, isotropic: bool = True) -> ScatteredBsdf:
    sigma, polar, azimuth = (each.ravel() for each in np.broadcast_arrays(sigma, polar, azimuth))
    size = sigma.size
    empty = ScatteredBsdf(
        sigma,
        np.full(size, psi),
        polar,
        np.mod(azimuth + psi, 360.0),
        np.zeros(size),
        u=np.full(size, 0.01),
        wavelength_nm=np.full(size, 550.0),
        sample="paint",
        isotropic=isotropic,
    )
    return replace(empty, values=lobe(empty))


def rings(psi: float = 0.0, isotropic: bool = True, step_deg: float = 5.0, whole: bool = True) -> ScatteredBsdf:
    azimuth = np.arange(0.0, 360.0 if whole else 181.0, step_deg)
    return at(np.array([0.0, 40.0])[:, None, None], np.arange(0.0, 81.0, step_deg)[:, None], azimuth, psi, isotropic)


def joined(*parts: ScatteredBsdf) -> ScatteredBsdf:
    names = ("sigma_deg", "psi_deg", "polar_deg", "azimuth_deg", "values", "u", "wavelength_nm", "flags")
    columns: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return ScatteredBsdf(**columns, isotropic=parts[0].isotropic)


def worst(values: ScatteredBsdf, table: BsdfTable | None = None) -> float:
    """The largest deviation of a table's known nodes, well above the horizon, from the lobe; of a peak of 1."""
    table = grid_table(values) if table is None else table
    assert table.known is not None
    known = nodes(replace(table, values=np.where(table.known, table.values, 0.0)))
    known = known.where((known.flags == "") & (known.polar_deg < 70.0))
    expected = lobe(known)
    if values.isotropic:
        expected = 0.5 * (expected + lobe(replace(known, azimuth_deg=2.0 * known.psi_deg - known.azimuth_deg)))
    assert known.size > 500
    return float(np.max(np.abs(known.values - expected)))


def test_steps_as_wide_as_most_are_interpolated_and_wider_gaps_are_holes() -> None:
    coarse = rings(step_deg=10.0)
    assert worst(coarse) < 0.02
    with pytest.raises(ValueError, match=r"no node of the grid has measured directions around it"):
        grid_table(replace(at(np.array([40.0]), np.array([[10.0], [70.0]]), np.array([20.0, 160.0])), widest_gap_deg=3.0))
    away = np.abs(coarse.polar_deg - 40.0) > 15.0
    table = grid_table(coarse.where(away))
    assert table.known is not None
    polar = np.degrees(np.arccos(from_specular(0.0, table.theta_deg, 0.0)[..., 2]))
    assert not table.known[0, 0, 0, 0, (polar > 26.0) & (polar < 54.0)].any()
    assert table.known[0, 0, 0, 0, polar < 20.0].all()


def test_a_turned_sample_has_both_halves_of_the_azimuths() -> None:
    both = joined(rings(0.0, isotropic=False), rings(90.0, isotropic=False))
    table = grid_table(both)
    assert table.psi_deg.tolist() == [0.0, 90.0]
    assert table.phi_deg[-1] == 360.0
    assert worst(both, table) < 0.01


def test_one_half_of_a_turned_sample_is_mirrored_and_named() -> None:
    half = joined(rings(0.0, isotropic=False, whole=False), rings(90.0, isotropic=False, whole=False))
    table = grid_table(half)
    assert table.phi_deg[-1] == 180.0
    assert any("the other half is taken as their mirror image" in line for line in table.comments)


def test_unlike_halves_of_what_is_taken_as_symmetric_are_stated() -> None:
    """A sample without symmetry at one rotation, as IMX455_stageRotation210.txt (ua-loft/bsdf-tools), is taken as isotropic."""
    values = rings(step_deg=20.0)
    assert any(line.startswith("the sample is taken as symmetric") for line in grid_table(values).comments)
    image = lobe(replace(values, azimuth_deg=360.0 - values.azimuth_deg))
    same = replace(values, values=0.5 * (values.values + image))
    assert not any("taken as symmetric" in line for line in grid_table(same).comments)


def test_at_normal_incidence_one_psi_is_enough() -> None:
    first, second = rings(0.0, isotropic=False), rings(90.0, isotropic=False)
    both = joined(first, second.where(second.sigma_deg > 0.0))
    table = grid_table(both)
    # In the sample's frame what was measured at normal incidence does not turn with psi, but phi is counted from the light.
    quarter = int(90.0 / (table.phi_deg[1] - table.phi_deg[0]))
    np.testing.assert_allclose(table.values[0, 1, 0, 0, :17], table.values[0, 0, 0, quarter, :17], atol=1e-9)
    assert abs(table.values[0, 1, 0, 0] - table.values[0, 0, 0, 0]).max() > 0.01


def test_random_directions_get_the_plane_through_those_around() -> None:
    generator = np.random.default_rng(3)
    n = 2500
    polar = np.degrees(np.arccos(1.0 - generator.random(n) * (1.0 - np.cos(np.radians(85.0)))))
    azimuth = 360.0 * generator.random(n)
    assert worst(at(np.array([40.0]), polar, azimuth)) < 0.1


def test_many_incidences_are_put_together_about_their_own_specular_direction() -> None:
    generator = np.random.default_rng(4)
    n = 3000
    sigma = 60.0 * generator.random(n)
    theta, phi = 40.0 * np.sqrt(generator.random(n)), 360.0 * generator.random(n)
    directions = from_specular(sigma, theta, phi)
    up = directions[:, 2] > 0.05
    polar = np.degrees(np.arccos(directions[up, 2]))
    azimuth = np.degrees(np.arctan2(directions[up, 1], directions[up, 0]))
    values = at(sigma[up], polar, np.mod(azimuth, 360.0))
    np.testing.assert_allclose(to_specular(values.sigma_deg, arc_direction(polar, azimuth))[0], theta[up], atol=1e-6)
    table = grid_table(values)
    assert table.sigma_deg.size <= 48
    np.testing.assert_allclose(table.values[0, 0, 10:20, :, 0], 1.0, atol=0.2)  # the peak, at every incidence


def test_what_is_not_to_be_trusted_does_not_count() -> None:
    values = rings()
    wild = values.where(np.arange(values.size) < 50)
    wild = replace(wild, values=np.full(50, 1e6), flags=np.full(50, "steep drift"))
    np.testing.assert_array_equal(grid_table(joined(values, wild)).values, grid_table(values).values)


def test_a_wavelength_without_a_sigma_is_refused() -> None:
    blue = replace(rings(), wavelength_nm=np.full(rings().size, 450.0))
    both = joined(rings(), blue.where(blue.sigma_deg > 0.0))
    with pytest.raises(ValueError, match=r"^at 450 nm, sigma 0 no direction has a value$"):
        grid_table(both)
    assert grid_table(joined(rings(), blue)).wavelengths_nm == (450.0, 550.0)


def test_one_direction_at_an_incidence_is_at_the_node_nearest_to_it() -> None:
    """As in a list of the reflectance at 0 deg, with the light at several angles."""
    sigma = np.array([12.0, 22.0, 33.0])
    values = replace(at(sigma, np.zeros(3), np.zeros(3)), values=np.array([1.0, 2.0, 3.0]))
    table = grid_table(values)
    assert table.known is not None
    assert table.known.sum() == 3
    np.testing.assert_array_equal(table.values[0, 0, 1:4].min(axis=(1, 2)), [1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match=r"at sigma 12 no node of the grid has measured directions around it"):
        grid_table(replace(values, widest_gap_deg=3.0))


def test_values_without_an_uncertainty_make_a_table_without_one() -> None:
    values = rings()
    assert grid_table(replace(values, u=np.full(values.size, np.nan))).u is None
    some = grid_table(replace(values, u=np.where(values.polar_deg > 30.0, np.nan, 0.01))).u
    assert some is not None
    assert some.max() > 0.1


def test_steps_are_those_of_each_azimuth_of_the_light() -> None:
    """A grid in the sample's frame: the azimuths from the light's of all psi together are denser than any psi has them."""
    polar, azimuth = np.arange(0.0, 81.0, 10.0)[:, None], np.arange(0.0, 360.0, 30.0)
    grid = joined(*(at(np.array([30.0]), polar, azimuth - psi, psi, isotropic=False) for psi in np.arange(0.0, 360.0, 45.0)))
    table = grid_table(grid)
    assert table.known is not None
    above = np.degrees(np.arccos(from_specular(30.0, table.theta_deg, table.phi_deg[:, None])[..., 2])) < 79.0
    assert table.known[0, :, table.sigma_deg.tolist().index(30.0)][:, above].all()
