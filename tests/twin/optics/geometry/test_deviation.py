"""A deviation turns about x, then y, then z, and then shifts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.twin.optics.geometry.deviation import Deviation, check_deviations, rotation_and_shift

ANGLE = st.floats(-180.0, 180.0)


def test_the_default_deviation_is_zero() -> None:
    matrix, shift = rotation_and_shift(Deviation())
    assert np.array_equal(matrix, np.eye(3))
    assert not np.any(shift)


def test_each_angle_is_a_right_handed_turn_about_its_own_axis() -> None:
    x, y, z = np.eye(3)
    assert rotation_and_shift(Deviation(rx_deg=90.0))[0] @ y == pytest.approx(z, abs=1e-15)
    assert rotation_and_shift(Deviation(ry_deg=90.0))[0] @ z == pytest.approx(x, abs=1e-15)
    assert rotation_and_shift(Deviation(rz_deg=90.0))[0] @ x == pytest.approx(y, abs=1e-15)


@given(ANGLE, ANGLE, ANGLE)
def test_the_three_turns_are_about_fixed_axes_in_the_order_x_y_z(rx: float, ry: float, rz: float) -> None:
    matrix, shift = rotation_and_shift(Deviation(rx, ry, rz, 1.0, 2.0, 3.0))
    one_by_one = [
        rotation_and_shift(Deviation(**{name: angle}))[0] for name, angle in (("rx_deg", rx), ("ry_deg", ry), ("rz_deg", rz))
    ]
    assert matrix == pytest.approx(one_by_one[2] @ one_by_one[1] @ one_by_one[0], abs=1e-12)
    assert matrix @ matrix.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.array_equal(shift, [1.0, 2.0, 3.0])


def test_invalid_deviations_are_refused() -> None:
    with pytest.raises(ValueError, match="ry_deg is nan"):
        Deviation(ry_deg=float("nan"))
    with pytest.raises(ValueError, match="'lens': no such element; known are mirror_1, mirror_2"):
        check_deviations({"lens": Deviation()}, ("mirror_1", "mirror_2"))
    with pytest.raises(ValueError, match="give a Deviation"):
        check_deviations({"mirror_1": 0.05}, ("mirror_1",))  # type: ignore[dict-item]
