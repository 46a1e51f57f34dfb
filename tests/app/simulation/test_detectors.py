"""Lists of numbers in options, the detectors' grid, and the nodes of the output grid."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.errors import UserError
from goniotwin.app.simulation.detectors import Detectors, detector_grid, output_phi, output_theta, parse_list
from goniotwin.twin.optics import specular_direction


@settings(deadline=None)
@given(st.lists(st.integers(0, 890), min_size=1, unique=True).map(sorted))
def test_a_list_has_the_numbers_of_its_text(tenths: list[int]) -> None:
    values = [tenth / 10 for tenth in tenths]
    assert parse_list(",".join(map(str, values)), "--sigma", 0.0, 89.0).tolist() == values


def test_a_range_includes_its_stop() -> None:
    assert parse_list("0:2:0.5,5,10:20:5", "--theta", 0.0, 180.0).tolist() == [0.0, 0.5, 1.0, 1.5, 2.0, 5.0, 10.0, 15.0, 20.0]
    assert parse_list("0:0.3:0.1", "--theta", 0.0, 180.0).size == 4


@pytest.mark.parametrize(
    "text",
    ["", "a", "1,,2", "nan", "inf", "-1", "90", "2,1", "1,1", "0:10", "0:10:0", "10:0:1", "0:10:-1", "0:1:1e-9", "0:nan:1"],
)
def test_an_invalid_list_is_refused_with_its_name(text: str) -> None:
    with pytest.raises(UserError, match=r"^--sigma: "):
        parse_list(text, "--sigma", 0.0, 89.0)


@pytest.mark.parametrize("sigma_deg", [0.0, 1.0, 30.0, 60.0, 85.0, 89.0])
def test_detectors_are_close_together_near_the_specular_direction(sigma_deg: float) -> None:
    for mirrored in (True, False):
        detectors = detector_grid(sigma_deg, mirrored)
        polar, azimuth = detectors.polar_deg, detectors.azimuth_deg
        assert polar[0] == 0.0
        assert 87.0 <= polar[-1] < 90.0
        assert azimuth[0] == 0.0
        assert azimuth[-1] == (180.0 if mirrored else 360.0)
        assert np.all(np.diff(polar) > 0.0)
        assert np.all(np.diff(azimuth) > 0.0)
        assert np.all(np.diff(polar) <= 5.0)
        assert np.all(np.diff(azimuth) <= 5.0)
        assert polar.size * azimuth.size < 12_000
        # One detector is in the specular direction, and the next ones are half a degree away.
        near = np.degrees(np.arccos(np.clip(detectors.directions(False) @ specular_direction(sigma_deg), -1.0, 1.0)))
        assert near.min() < 1e-6
        assert np.unique(np.round(near, 4))[1] <= 0.5


@pytest.mark.parametrize(("sigma_deg", "axis_deg"), [(60.0, 35.3), (20.0, 30.9), (0.0, 0.0), (80.0, 87.0), (30.0, 30.2)])
def test_detectors_are_close_together_near_a_refracted_lobe(sigma_deg: float, axis_deg: float) -> None:
    polar = detector_grid(sigma_deg, True, [axis_deg]).polar_deg
    assert np.all(np.diff(polar) > 0.0)
    assert polar[0] == 0.0
    assert 87.0 <= polar[-1] < 90.0
    for centre in (sigma_deg, axis_deg):
        assert np.min(np.abs(polar - centre)) < 1e-9
        assert np.all(np.diff(polar[np.abs(polar - centre) < 3.0]) <= 0.5 + 1e-9)


def test_output_nodes_cover_the_ranges_that_readers_expect() -> None:
    theta = output_theta(np.array([1.0, 50.0]))
    assert theta.tolist() == [0.0, 1.0, 50.0, 180.0]
    assert output_phi(np.array([90.0]), True).tolist() == [0.0, 90.0, 180.0]
    assert output_phi(None, False)[-1] == 360.0
    with pytest.raises(UserError, match=r"--phi"):
        output_phi(np.array([0.0, 270.0]), True)


def test_a_given_grid_is_not_changed() -> None:
    detectors = Detectors(np.array([10.0, 20.0]), np.array([170.0, 180.0]), True)
    assert detectors.directions(False).shape == (4, 3)
    assert np.all(detectors.directions(True)[:, 2] < 0.0)
