"""Directions in the rig's frame and in specular coordinates: conversions are inverse to each other."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.twin.optics import arc_direction, from_specular, light_direction, specular_direction, to_specular
from goniotwin.twin.optics.geometry.coordinates import (
    TOLERANCE_DEG,
    detector_rows,
    fold_azimuth,
    incidence_deg,
    is_lit_from_behind,
    opposite_sigma_deg,
    round_deg,
    turn_about_x,
    wrap_azimuth,
    zenith_and_azimuth,
)

SIGMA = st.floats(0.0, 180.0)


def test_a_direction_calculated_by_hand() -> None:
    # Calculated by hand: R_y(30 deg) (0, sin 10 deg, cos 10 deg).
    assert from_specular(30.0, 10.0, 90.0) == pytest.approx([-0.492404, 0.173648, 0.852869], abs=1e-6)


@given(SIGMA, st.floats(1e-4, 179.999), st.floats(0.0, 360.0, exclude_max=True))
def test_specular_coordinates_survive_a_round_trip(sigma: float, theta: float, phi: float) -> None:
    theta_back, phi_back = to_specular(sigma, from_specular(sigma, theta, phi))
    assert theta_back == pytest.approx(theta, abs=1e-9)
    assert np.sin(np.radians(theta)) * ((phi_back - phi + 180.0) % 360.0 - 180.0) == pytest.approx(0.0, abs=1e-9)
    assert 0.0 <= phi_back < 360.0


@given(SIGMA, st.floats(0.0, 180.0), st.floats(-360.0, 360.0))
def test_directions_survive_a_round_trip(sigma: float, polar: float, azimuth: float) -> None:
    direction = arc_direction(polar, azimuth)
    assert np.linalg.norm(direction) == pytest.approx(1.0)
    assert from_specular(sigma, *to_specular(sigma, direction)) == pytest.approx(direction, abs=1e-12)


@given(SIGMA)
def test_the_specular_direction_is_the_light_mirrored_in_the_sample(sigma: float) -> None:
    light, specular = light_direction(sigma), specular_direction(sigma)
    assert specular == pytest.approx(light * [-1.0, 1.0, 1.0], abs=1e-15)
    theta, phi = to_specular(sigma, specular)
    assert theta == pytest.approx(0.0, abs=1e-12)
    assert 0.0 <= phi < 360.0


def test_phi_zero_is_in_the_plane_of_incidence_towards_the_normal() -> None:
    assert from_specular(40.0, 40.0, 0.0) == pytest.approx([0.0, 0.0, 1.0], abs=1e-15)
    assert from_specular(40.0, 80.0, 0.0) == pytest.approx(light_direction(40.0))
    assert to_specular(40.0, [0.0, 0.0, 1.0])[0] == pytest.approx(40.0)


def test_the_lower_arc_is_the_upper_one_mirrored_in_the_samples_plane() -> None:
    polar, azimuth = np.array([0.0, 20.0, 85.0]), 30.0
    upper, lower = arc_direction(polar, azimuth), arc_direction(polar, azimuth, lower=True)
    assert upper.shape == (3, 3)
    assert lower == pytest.approx(upper * [1.0, 1.0, -1.0])


def test_coordinates_keep_the_shape_and_accept_any_length() -> None:
    theta, phi = to_specular(30.0, 7.0 * from_specular(30.0, np.full((2, 5), 3.0), 45.0))
    assert theta.shape == phi.shape == (2, 5)
    assert theta == pytest.approx(3.0)
    assert phi == pytest.approx(45.0)


def test_invalid_directions_are_refused() -> None:
    with pytest.raises(ValueError, match="shape"):
        to_specular(30.0, [1.0, 0.0])
    with pytest.raises(ValueError, match="one row per detector"):
        detector_rows([0.0, 0.0, 1.0])
    with pytest.raises(ValueError, match=r"directions\[1\]"):
        detector_rows([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    with pytest.raises(ValueError, match=r"directions\[0\]"):
        detector_rows([[np.nan, 0.0, 1.0]])


@given(st.floats(0.0, 180.0), st.floats(-360.0, 360.0))
def test_zenith_and_azimuth_of_a_direction(polar: float, azimuth: float) -> None:
    zenith, back = zenith_and_azimuth(3.0 * arc_direction(polar, azimuth))
    assert zenith == pytest.approx(polar, abs=1e-9)
    assert 0.0 <= back < 360.0
    assert arc_direction(zenith, back) == pytest.approx(arc_direction(polar, azimuth), abs=1e-12)


@given(st.floats(-1e4, 1e4) | st.sampled_from([-1e-17, 360.0, -360.0]))
def test_a_wrapped_azimuth_is_the_same_direction_and_a_folded_one_its_mirror_image(azimuth: float) -> None:
    x, y = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
    wrapped, folded = np.radians(wrap_azimuth(azimuth)), np.radians(fold_azimuth(azimuth))
    assert 0.0 <= wrapped < 2.0 * np.pi
    assert 0.0 <= folded <= np.pi
    assert (np.cos(wrapped), np.sin(wrapped)) == pytest.approx((x, y), abs=1e-11)
    assert (np.cos(folded), np.sin(folded)) == pytest.approx((x, abs(y)), abs=1e-11)


@given(st.integers(0, 179_999).filter(lambda thousandths: thousandths != 90_000))
def test_incidence_is_the_angle_from_the_normal_of_the_lit_side(thousandths: int) -> None:
    sigma = thousandths / 1000.0
    x, _, z = light_direction(sigma)
    assert is_lit_from_behind(sigma) == (z < 0.0)
    assert incidence_deg(sigma) == pytest.approx(np.degrees(np.arctan2(x, abs(z))), abs=1e-9)
    assert turn_about_x(light_direction(sigma)) == pytest.approx(light_direction(opposite_sigma_deg(sigma)), abs=1e-12)


@given(st.integers(-(10**9), 10**9), st.floats(-0.49, 0.49))
def test_angles_within_the_tolerance_are_equal_numbers(millionths: int, error: float) -> None:
    assert round_deg(millionths / 1e6 + error * TOLERANCE_DEG) == millionths / 1e6


def test_directions_of_both_arcs_in_one_array() -> None:
    both = arc_direction(np.full(2, 20.0), np.full(2, 30.0), np.array([False, True]))
    assert both[0] == pytest.approx(arc_direction(20.0, 30.0))
    assert both[1] == pytest.approx(arc_direction(20.0, 30.0, lower=True))
