"""Export: interpolation to specular coordinates, .ddr and CSV files."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.campaign.reduction.export import export_csv, export_ddr
from goniotwin.app.campaign.reduction.overlaps import overlaps
from goniotwin.app.campaign.reduction.reduction import BsdfDataset, BsdfPoints
from goniotwin.app.campaign.reduction.specular_grid import regrid
from goniotwin.app.errors import UserError
from goniotwin.app.formats import read_ddr, read_points_csv
from goniotwin.app.rig import read_rig
from goniotwin.twin.optics import arc_direction, from_specular, to_specular
from tests.conftest import RIG


def points_of(sigma: float, zenith: np.ndarray, azimuth: np.ndarray, blocked: np.ndarray | None = None) -> BsdfPoints:
    """Points of a BSDF that is smooth over the sphere, 1/sr; see `smooth`."""
    zenith, azimuth = (each.ravel() for each in np.broadcast_arrays(zenith, azimuth))
    theta, phi = to_specular(sigma, arc_direction(zenith, azimuth))
    none, zeros = np.zeros(zenith.size, dtype=bool), np.zeros(zenith.size)
    return BsdfPoints(
        wavelength_nm=zeros + 550.0, sigma_deg=zeros + sigma, gamma_deg=zeros, beta_deg=azimuth, shift_deg=zeros,
        photodiode=np.arange(zenith.size), zenith_deg=zenith, azimuth_deg=azimuth, theta_deg=theta, phi_deg=phi,
        bsdf=smooth(zenith, azimuth), u_bsdf=zeros + 0.01, shadowed=none if blocked is None else blocked.ravel(), clipped=none,
        no_etalon=none, dead=none, uncertified=none, drifted=none, under_range=none, back=none, transmitted=none,
        signature=zeros + np.nan, mirrored=none, u_field=zeros,
    )  # fmt: skip


def smooth(zenith: np.ndarray, azimuth: np.ndarray) -> np.ndarray:
    """Symmetric about the plane of incidence, bilinear in zenith and folded azimuth, one value at the normal."""
    folded = np.minimum(np.mod(azimuth, 360.0), 360.0 - np.mod(azimuth, 360.0))
    return np.asarray(1.0 + zenith / 100.0 + zenith / 100.0 * folded / 180.0)


@settings(deadline=None)
@given(st.floats(0.0, 80.0), st.integers(0, 36), st.floats(0.0, 80.0))
def test_the_grid_reproduces_the_measured_bsdf(sigma: float, column: int, theta: float) -> None:
    points = points_of(sigma, np.arange(0.0, 90.1, 2.5)[:, None], np.arange(0.0, 180.1, 3.0)[None, :])
    grid = regrid(points)
    node = int(np.argmin(np.abs(grid.theta_deg - theta)))
    direction = from_specular(sigma, grid.theta_deg[node], grid.phi_deg[column])
    zenith = math.degrees(math.acos(min(1.0, max(-1.0, float(direction[2])))))
    azimuth = math.degrees(math.atan2(float(direction[1]), float(direction[0])))
    if zenith > 90.0:
        assert not grid.measured[0, column, node]
    else:
        assert grid.measured[0, column, node]
        assert grid.bsdf[0, column, node] == pytest.approx(float(smooth(np.array(zenith), np.array(azimuth))), rel=2e-3)


def test_measurements_in_the_plane_of_incidence_give_two_columns() -> None:
    grid = regrid(points_of(30.0, np.arange(0.0, 89.6, 0.5)[:, None], np.array([0.0, 180.0])[None, :]))
    assert grid.phi_deg.tolist() == [0.0, 180.0]
    assert grid.theta_deg[1] == 0.5
    assert grid.measured[0, 1].sum() == 120  # from the specular direction at 30 deg to 89.5 deg, in half degrees
    assert grid.measured[0, 0].sum() == 240  # over the normal, and down to 89.5 deg on the light's side


def test_there_is_no_interpolation_between_distant_azimuths() -> None:
    grid = regrid(points_of(30.0, np.arange(0.0, 89.6, 0.5)[:, None], np.array([0.0, 90.0, 180.0])[None, :]))
    sideways = grid.measured[0, grid.phi_deg == 90.0][0]
    assert not sideways[grid.theta_deg > 1.0][:50].any()
    assert grid.measured[0, 0, grid.theta_deg <= 119.0].all()  # in the plane of incidence nothing changes


def test_blocked_nodes_are_not_marked_as_measured() -> None:
    zenith, azimuth = np.arange(0.0, 89.6, 0.5)[:, None], np.array([0.0, 180.0])[None, :]
    blocked = np.broadcast_to(zenith <= 3.5, (zenith.size, 2))
    grid = regrid(points_of(0.0, zenith, azimuth, blocked))
    assert not grid.measured[0, :, grid.theta_deg <= 3.5].any()
    assert np.isfinite(grid.bsdf).all()


def test_a_grid_without_any_value_is_refused() -> None:
    zenith = np.arange(0.0, 80.0, 5.0)
    points = points_of(0.0, zenith, np.zeros(zenith.size), np.ones(zenith.size, dtype=bool))
    with pytest.raises(ValueError, match="no direction"):
        regrid(points)


@pytest.fixture
def reduced() -> BsdfDataset:
    zenith, azimuth = np.arange(0.0, 89.6, 0.5)[:, None], np.array([0.0, 180.0])[None, :]
    points = points_of(30.0, zenith, azimuth, np.broadcast_to((zenith > 26.0) & (zenith < 34.0) & (azimuth == 0.0), (180, 2)))
    return BsdfDataset("test", read_rig(RIG), True, {"gaussian-5": points}, {"gaussian-5": overlaps(points, 0.0)}, ("a note",))


def test_a_ddr_marks_simulated_data_and_continued_nodes(reduced: BsdfDataset, tmp_path: Path) -> None:
    count = export_ddr(reduced, None, tmp_path / "a.ddr")
    table = read_ddr(tmp_path / "a.ddr")
    text = "\n".join(table.comments)
    assert "SIMULATED" in text
    assert "sigma 30, phi 0: theta 56.5 to 63.5" in text
    assert table.sigma_deg.tolist() == [0.0, 30.0, 90.0]  # repeated at the ends, because readers extrapolate
    assert table.channels == (550.0,)
    assert count == 120 + 240 - 15
    node = int(np.searchsorted(table.theta_deg, 10.0))
    assert table.values[0, 0, 1, 1, node] == pytest.approx(math.pi * float(smooth(np.array(40.0), np.array(180.0))))


def test_a_csv_has_every_point(reduced: BsdfDataset, tmp_path: Path) -> None:
    assert export_csv(reduced, None, tmp_path / "a.csv") == 360
    points = read_points_csv(tmp_path / "a.csv")
    assert any("SIMULATED" in comment for comment in points.comments)
    assert len(points.columns["bsdf_per_sr"]) == 360
    assert list(np.unique(points.columns["flags"])) == ["", "shadowed"]


def test_a_csv_has_the_fields_component_and_a_flag_where_it_is_unknown(reduced: BsdfDataset, tmp_path: Path) -> None:
    ((name, points),) = reduced.samples.items()
    known = points.zenith_deg > 20.0
    partly_known = replace(points, u_field=np.where(known, 0.002, np.nan))
    export_csv(replace(reduced, samples={name: partly_known}), None, tmp_path / "a.csv")
    table = read_points_csv(tmp_path / "a.csv")
    assert np.array_equal(table.columns["u_field_per_sr"], partly_known.u_field, equal_nan=True)
    flagged = np.array(["field" in flags.split() for flags in table.columns["flags"]])
    assert np.array_equal(flagged, ~known & points.good)
    assert any("u_field_per_sr" in comment for comment in table.comments)


def test_an_unknown_sample_is_refused_by_name(reduced: BsdfDataset, tmp_path: Path) -> None:
    for export in (export_csv, export_ddr):
        with pytest.raises(UserError, match="no measured sample 'satin'"):
            export(reduced, "satin", tmp_path / "a")
    assert list(tmp_path.iterdir()) == []
