"""Tables: values at and between the nodes, at the ends, and errors for holes."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.arrays import Floats
from goniotwin.twin.optics import Scatterer, evaluate, from_specular, light_direction, table_sample
from tests.twin.optics.models import PSI_AXIS, SIGMA_AXIS, TABLE, THETA_AXIS, TURN_AXIS, UNEVEN


def seen(model: Scatterer, psi: float, sigma: float, theta: float, phi: float) -> float:
    """Value for the light at azimuth psi and specular coordinates."""
    cos, sin = math.cos(math.radians(psi)), math.sin(math.radians(psi))
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return float(evaluate(model, turn @ light_direction(sigma), turn @ from_specular(sigma, theta, phi)))


def smooth(psi: Floats, sigma: Floats, phi: Floats, theta: Floats) -> Floats:
    """Function of four angles in deg, periodic where they are, on their grid."""
    p, s, f, t = np.meshgrid(np.radians(psi), np.radians(sigma), np.radians(phi), np.radians(theta), indexing="ij")
    lobe = np.exp(-4.0 * t**2) * (2.0 + np.cos(2.0 * p)) * (1.0 + s)
    result: Floats = lobe + 0.3 * np.sin(t) * (1.5 + np.cos(f + p)) + 0.05
    return result


def angles(least: float, most: float, count: int) -> st.SearchStrategy[list[float]]:
    """Ascending lists of angles at least 0.5 deg apart."""
    steps = st.lists(st.integers(int(2 * least), int(2 * most)), min_size=1, max_size=count, unique=True)
    return steps.map(lambda halves: [0.5 * half for half in sorted(halves)])


@settings(deadline=None)
@given(angles(1, 80, 5), angles(1, 179, 6), angles(0, 89, 6), angles(0, 359, 5), st.data())
def test_a_table_of_a_smooth_function_reproduces_it_at_its_nodes(
    sigma: list[float], phi: list[float], theta: list[float], psi: list[float], data: Any
) -> None:
    turn = [0.0, *(2.0 * each for each in phi), 360.0]
    values = smooth(np.array(psi), np.array(sigma), np.array(turn), np.array(theta))
    model = table_sample(sigma, turn, theta, values, psi_deg=psi)
    n, i, j, k = (data.draw(st.integers(0, len(axis) - 1)) for axis in (psi, sigma, turn, theta))
    if from_specular(sigma[i], theta[k], turn[j])[2] <= 1e-9:
        return
    # phi is undefined where theta is 0, and its two ends are the same direction.
    expected = values[n, i, 0 if theta[k] == 0.0 else j, k]
    assert seen(model, psi[n], sigma[i], theta[k], turn[j]) == pytest.approx(expected, rel=1e-9)


@settings(deadline=None)
@given(st.floats(1.0, 59.0), st.floats(0.0, 360.0), st.floats(0.0, 89.0), st.floats(0.0, 360.0))
def test_between_its_nodes_a_table_is_within_their_values(sigma: float, phi: float, theta: float, psi: float) -> None:
    model = table_sample(SIGMA_AXIS, TURN_AXIS, THETA_AXIS, UNEVEN, psi_deg=PSI_AXIS)
    value = seen(model, psi, sigma, theta, phi)
    if from_specular(sigma, theta, phi)[2] <= 1e-9:
        return
    i, j, k = (
        max(int(np.searchsorted(axis, x)), 1) for axis, x in ((SIGMA_AXIS, sigma), (TURN_AXIS, phi), (THETA_AXIS, theta))
    )
    n = int(np.searchsorted(PSI_AXIS, psi))
    # Half a step more on each side: at a node, rounding may select the neighbouring interval.
    corners = UNEVEN[np.ix_([(n - 1) % 4, n % 4], range(i - 1, i + 1), range(j - 1, j + 1), range(k - 1, k + 1))]
    assert corners.min() * (1.0 - 1e-6) <= value <= corners.max() * (1.0 + 1e-6)


def test_a_table_reproduces_its_values_and_interpolates() -> None:
    values = TABLE.lobes[0].values[0]
    for i, sigma_deg in enumerate(SIGMA_AXIS):
        light = light_direction(sigma_deg)
        for k, theta in enumerate(THETA_AXIS[:3]):
            if sigma_deg + theta < 90.0:
                at_node = evaluate(TABLE, light, from_specular(sigma_deg, theta, [0.0, 90.0, 180.0]))
                # phi is undefined where theta is 0: the value of the first one holds.
                assert at_node == pytest.approx(values[i, :, k] if theta else values[i, 0, k], rel=1e-6)
    # Linear over phi and theta, at an incidence of the table.
    middle = evaluate(TABLE, light_direction(SIGMA_AXIS[1]), from_specular(SIGMA_AXIS[1], 20.0, 45.0))
    assert middle == pytest.approx(values[1, 0:2, 1:3].mean())


def test_a_table_has_no_kink_and_no_overshoot_over_the_incidence() -> None:
    steep = table_sample([10.0, 30.0, 50.0, 70.0], [0.0], [0.0], [[[1.0]], [[1.1]], [[2.0]], [[20.0]]])

    def value(sigma_deg: float) -> float:
        return float(evaluate(steep, light_direction(sigma_deg), from_specular(sigma_deg, 0.0, 0.0)))

    sigmas = np.linspace(5.0, 75.0, 1401)
    values = np.array([value(float(sigma)) for sigma in sigmas])
    assert np.all(np.diff(values) >= 0.0)
    for node in (10.0, 30.0, 50.0, 70.0):
        before, after = value(node) - value(node - 1e-3), value(node + 1e-3) - value(node)
        assert after == pytest.approx(before, abs=2e-6)


def test_a_table_is_constant_beyond_its_ends() -> None:
    table = table_sample([10.0, 20.0], [0.0], [5.0, 15.0], [[[1.0, 2.0]], [[3.0, 4.0]]])
    assert evaluate(table, light_direction(0.0), from_specular(0.0, 1.0, 0.0)) == 1.0
    assert evaluate(table, light_direction(60.0), from_specular(60.0, 40.0, 0.0)) == 4.0


def test_a_table_over_180_deg_is_mirrored_and_one_over_360_deg_is_not() -> None:
    light, phis = light_direction(30.0), np.array([45.0, 315.0])
    half = table_sample([30.0], [0.0, 90.0, 180.0], [0.0], [[[1.0], [2.0], [3.0]]])
    full = table_sample([30.0], [0.0, 90.0, 180.0, 270.0, 360.0], [0.0], [[[1.0], [2.0], [3.0], [4.0], [1.0]]])
    assert evaluate(half, light, from_specular(30.0, 20.0, phis)) == pytest.approx([1.5, 1.5])
    assert evaluate(full, light, from_specular(30.0, 20.0, phis)) == pytest.approx([1.5, 2.5])


def over_psi(psi: list[float], values: list[float], symmetry: Any = "none") -> Scatterer:
    """Table with a value that depends on psi, larger by 10 and 20 at phi of 90 and 270."""
    more = np.array([0.0, 10.0, 0.0, 20.0, 0.0])
    table = np.array(values)[:, None, None, None] + more[None, None, :, None]
    return table_sample([30.0], [0.0, 90.0, 180.0, 270.0, 360.0], [20.0], table, psi_deg=psi, symmetry=symmetry)


def test_a_table_is_linear_and_periodic_over_psi() -> None:
    for table in (over_psi([30.0, 120.0, 300.0], [1.0, 2.0, 4.0]), over_psi([0.0, 120.0, 300.0, 360.0], [2.0, 2.0, 4.0, 2.0])):
        assert seen(table, 120.0, 30.0, 20.0, 0.0) == pytest.approx(2.0)
        assert seen(table, 210.0, 30.0, 20.0, 0.0) == pytest.approx(3.0)
        assert seen(table, 300.0, 30.0, 20.0, 270.0) == pytest.approx(24.0)
    wrapped = over_psi([30.0, 120.0, 300.0], [1.0, 2.0, 4.0])
    # From 300 deg to 30 deg, 90 deg farther.
    assert [seen(wrapped, psi, 30.0, 20.0, 0.0) for psi in (345.0, 0.0, 15.0)] == pytest.approx([2.5, 2.0, 1.5])


@pytest.mark.parametrize(
    ("symmetry", "psi", "same"),
    [
        ("half_turn", [0.0, 60.0, 100.0], [(20.0, 90.0), (200.0, 90.0)]),
        ("mirror", [0.0, 60.0, 180.0], [(20.0, 90.0), (340.0, 270.0)]),
        ("orthotropic", [0.0, 60.0, 90.0], [(20.0, 90.0), (160.0, 270.0), (200.0, 90.0), (340.0, 270.0)]),
    ],
)
def test_a_symmetric_table_repeats_according_to_its_symmetry(
    symmetry: str, psi: list[float], same: list[tuple[float, float]]
) -> None:
    table = over_psi(psi, [1.0, 4.0, 7.0], symmetry)
    assert [seen(table, azimuth, 30.0, 20.0, phi) for azimuth, phi in same] == pytest.approx([12.0] * len(same))


def test_a_table_with_one_psi_is_isotropic() -> None:
    model = over_psi([0.0], [3.0])
    assert seen(model, 77.0, 30.0, 20.0, 0.0) == pytest.approx(seen(model, 0.0, 30.0, 20.0, 0.0))


@pytest.mark.parametrize(
    ("sigma", "phi", "theta", "value", "message"),
    [
        ([10.0, 10.0], [0.0], [0.0], 1.0, "sigma_deg is not ascending"),
        ([10.0], [0.0, 90.0], [0.0], 1.0, "phi_deg runs from 0 to 90"),
        ([10.0], [0.0], [0.0, math.nan], 1.0, "theta_deg has a value that is not finite"),
        ([10.0], [0.0], [], 1.0, "theta_deg has the shape"),
        ([95.0], [0.0], [0.0], 1.0, "sigma_deg runs from 95"),
        ([10.0], [0.0], [0.0], math.nan, "values has nan at sigma 10, phi 0, theta 0"),
        ([10.0], [0.0], [0.0], -1e-3, "values has -0.001"),
        ([10.0], [0.0], [0.0], math.inf, "values has inf"),
    ],
)
def test_a_table_with_holes_or_without_order_is_refused(sigma: Any, phi: Any, theta: Any, value: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        table_sample(sigma, phi, theta, np.full((len(sigma), len(phi), len(theta)), value))


@pytest.mark.parametrize(
    ("psi", "symmetry", "message"),
    [
        ([0.0, 200.0], "half_turn", "it repeats after 180 deg"),
        ([0.0, 80.0], "orthotropic", "for the symmetry 'orthotropic' give 0 to 90 deg"),
        ([10.0, 180.0], "mirror", "for the symmetry 'mirror' give 0 to 180 deg"),
        ([0.0, 360.0], "none", "values at psi 0 and 360 differ by up to 1"),
        ([0.0, 400.0], "none", "psi_deg runs from 0 to 400"),
        ([90.0, 0.0], "none", "psi_deg is not ascending"),
        ([0.0, 90.0], "round", "symmetry is 'round'"),
    ],
)
def test_azimuths_inconsistent_with_the_symmetry_are_refused(psi: list[float], symmetry: Any, message: str) -> None:
    values = np.array([1.0, 2.0])[:, None, None, None]
    with pytest.raises(ValueError, match=message):
        table_sample([10.0], [0.0], [0.0], values, psi_deg=psi, symmetry=symmetry)


def test_inconsistent_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"values has the shape \(2,\): with its axes \(sigma, phi, theta\)"):
        table_sample([10.0], [0.0], [0.0, 1.0], [1.0, 2.0])
    with pytest.raises(ValueError, match=r"with its axes \(psi, sigma, phi, theta\) give \(2, 1, 1, 2\)"):
        table_sample([10.0], [0.0], [0.0, 1.0], np.ones((1, 1, 2)), psi_deg=[0.0, 90.0])
    with pytest.raises(ValueError, match="values has nan at psi 90, sigma 10, phi 0, theta 1"):
        table_sample([10.0], [0.0], [0.0, 1.0], np.array([1.0, 1.0, 1.0, math.nan]).reshape(2, 1, 1, 2), psi_deg=[0.0, 90.0])
    with pytest.raises(ValueError, match="psi_deg is missing"):
        table_sample([10.0], [0.0], [0.0], [[[1.0]]], symmetry="half_turn")
