"""Directions in the rig's frame and in specular coordinates: conversions are inverse to each other."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.twin.optics import arc_direction, from_specular, light_direction, specular_direction, to_specular
from goniotwin.twin.optics.geometry.coordinates import direction_rows

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
        direction_rows([0.0, 0.0, 1.0])
    with pytest.raises(ValueError, match=r"directions\[1\]"):
        direction_rows([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    with pytest.raises(ValueError, match=r"directions\[0\]"):
        direction_rows([[np.nan, 0.0, 1.0]])
