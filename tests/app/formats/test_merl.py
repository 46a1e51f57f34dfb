"""MERL files, held against the formulas of the database's own reader."""

import math
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.formats import FormatError, merl
from goniotwin.arrays import Floats
from goniotwin.twin.optics import from_specular, light_direction


def turned(vector: Floats, axis: Floats, angle: float) -> Floats:
    """`rotate_vector` of BRDFRead.cpp."""
    turn = vector * math.cos(angle) + axis * float(vector @ axis) * (1.0 - math.cos(angle))
    return np.asarray(turn + np.cross(axis, vector) * math.sin(angle))


def database_indices(light: Floats, out: Floats) -> tuple[float, float, float]:
    """`std_coords_to_half_diff_coords` of BRDFRead.cpp: theta_half, theta_diff, fi_diff in rad."""
    half = (light + out) / np.linalg.norm(light + out)
    theta_half, fi_half = math.acos(min(half[2], 1.0)), math.atan2(half[1], half[0])
    temp = turned(light, np.array([0.0, 0.0, 1.0]), -fi_half)
    diff = turned(temp, np.array([0.0, 1.0, 0.0]), -theta_half)
    return theta_half, math.acos(min(diff[2], 1.0)), math.atan2(diff[1], diff[0])


def write(path: Path, cells: Floats) -> None:
    path.write_bytes(merl.HEADER + cells.astype("<f8").tobytes())


def test_angles_are_those_of_the_databases_reader() -> None:
    random = np.random.default_rng(2)
    for sigma, theta, phi in random.uniform([1.0, 1.0, 0.0], [80.0, 80.0, 360.0], (50, 3)).tolist():
        light, out = light_direction(sigma), from_specular(sigma, theta, phi)
        found = [float(each[0]) for each in merl.half_difference(light, out[None])]
        theta_half, theta_diff, fi_diff = database_indices(light, out)
        assert found == pytest.approx(
            [math.degrees(theta_half), math.degrees(theta_diff), math.degrees(fi_diff) % 360.0], abs=1e-6
        )


def test_a_file_has_its_cells_scales_and_colours(tmp_path: Path) -> None:
    """Cells with a value that is linear in the indices of theta_h and theta_d, and a sine of phi_d with a period of 180 deg."""
    i, d, p = np.meshgrid(*(np.arange(each) for each in merl.COUNTS), indexing="ij")
    cell = 1000.0 + 5.0 * i + 3.0 * d + 50.0 * np.sin(2.0 * np.radians(p))
    cells = np.stack([cell, 2.0 * cell, 3.0 * cell])
    write(tmp_path / "paint.binary", cells)
    assert merl.recognise((tmp_path / "paint.binary").read_bytes()[:100])
    (table,) = merl.read(tmp_path / "paint.binary").tables
    assert (table.sample, table.colours, table.wavelengths_nm) == ("paint", ("red", "green", "blue"), None)
    assert table.known is not None
    for k, j, n in ((0, 0, 20), (6, 3, 30), (6, 50, 30), (12, 10, 45)):
        sigma, phi, theta = table.sigma_deg[k], table.phi_deg[j], table.theta_deg[n]
        theta_half, theta_diff, fi_diff = database_indices(light_direction(sigma), from_specular(sigma, theta, phi))
        expected = 1000.0 + 5.0 * 90.0 * math.sqrt(theta_half / (0.5 * math.pi)) + 3.0 * math.degrees(theta_diff)
        expected += 50.0 * math.sin(2.0 * fi_diff)
        scaled = [expected / 1500.0, 2.0 * expected * 1.15 / 1500.0, 3.0 * expected * 1.66 / 1500.0]
        assert table.values[:, 0, k, j, n] == pytest.approx(scaled, rel=1e-4)
        assert table.known[:, 0, k, j, n].all()


def test_a_negative_cell_has_no_value(tmp_path: Path) -> None:
    cells = np.ones((3, *merl.COUNTS))
    cells[1, 40:] = -1.0
    write(tmp_path / "hole.binary", cells)
    (table,) = merl.read(tmp_path / "hole.binary").tables
    assert table.known is not None
    assert table.known[0, 0, 0, 0, :45].all()
    assert not table.known[1, 0, 0, 0, 41:].any()
    assert not table.values[1, 0, 0, 0, 41:].any()


@pytest.mark.parametrize(
    ("raw", "wrong"),
    [
        pytest.param(np.array([90, 90, 360], "<i4").tobytes(), "its counts are 90 x 90 x 360, not 90 x 90 x 180", id="counts"),
        pytest.param(b"", "its counts are missing", id="nothing"),
        pytest.param(merl.HEADER + bytes(80), "has 92 bytes, not 34992012", id="short"),
        pytest.param(merl.HEADER + np.full(3 * 90 * 90 * 180, np.nan).tobytes(), "not finite", id="not finite"),
        pytest.param(bytes(merl.SIZE + 1), "has more than 34992012 bytes", id="long"),
    ],
)
def test_another_file_is_refused(raw: bytes, wrong: str, tmp_path: Path) -> None:
    path = tmp_path / "no.binary"
    path.write_bytes(raw)
    with pytest.raises(FormatError, match=wrong):
        merl.read(path)
