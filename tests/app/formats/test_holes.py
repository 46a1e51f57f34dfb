"""Holes of a table: what each way of filling makes of a hidden peak, and which share of the light is reported."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.formats.holes import FILLS, Fill, fill_holes, refuse_holes, unmeasured_share
from goniotwin.app.formats.specular_grid import SpecularCut, continued, specular_table
from goniotwin.app.formats.table import BsdfTable
from goniotwin.twin.optics import from_specular

SIGMA, PHI, THETA = np.array([0.0, 30.0]), np.arange(0.0, 180.1, 15.0), np.arange(0.0, 180.1, 0.5)
PEAK, WIDTH_DEG, HIDDEN_DEG = 118.0, 5.0, 4.0


def lobe(wide: bool) -> np.ndarray:
    square = (THETA / WIDTH_DEG) ** 2
    of_theta = PEAK * ((1.0 + square) ** -2 if wide else np.exp(-square))
    return np.asarray(of_theta * np.ones((SIGMA.size, PHI.size, 1)))


def hidden_peak() -> np.ndarray:
    """What is known: above the horizon, and at normal incidence not near the light, whose mirrors hide the peak."""
    known = from_specular(SIGMA[:, None, None], THETA, PHI[:, None])[..., 2] > 0.0
    known[0] &= THETA >= HIDDEN_DEG
    return np.asarray(known)


def filled(fill: Fill, wide: bool = False) -> BsdfTable:
    cuts = [
        continued(THETA, np.where(known, values, np.nan), 0.01 * values)
        for values, known in zip(lobe(wide), hidden_peak(), strict=True)
    ]
    options: dict[str, Any] = {"transmitted": False, "generated": False, "comments": [], "done": "measured"}
    return specular_table(SIGMA, PHI, THETA, [cuts], None, **options, fill=fill)


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("fill", ["neighbour", "fit"])
def test_a_hidden_peak_is_found_again(fill: Fill, wide: bool) -> None:
    table, expected = filled(fill, wide), lobe(wide)
    np.testing.assert_allclose(table.values[0, 0, 0, :, :8], expected[0, :, :8], rtol=1e-6)
    assert np.ptp(table.values[0, 0, 0, :, 0]) == pytest.approx(0.0, abs=1e-9)  # one direction, one value
    assert table.u is not None
    np.testing.assert_array_equal(table.u[0, 0, 0, :, :8], table.values[0, 0, 0, :, :8])  # nothing is known there


def test_held_a_hidden_peak_is_a_stump() -> None:
    stump = PEAK * np.exp(-((HIDDEN_DEG / WIDTH_DEG) ** 2))  # 62, as on the page on formats
    np.testing.assert_allclose(filled("hold").values[0, 0, 0, :, :8], stump, rtol=1e-12)


def test_the_share_of_the_light_that_was_not_measured_is_that_of_the_lobe() -> None:
    (line,) = (each for each in filled("fit").comments if each.startswith("share of the light"))
    found = float(line.partition("measured: ")[2].partition(" %")[0])
    # Of a narrow Gaussian the share within an angle is 1 - exp(-(angle / width)^2); the last node reaches half a step on.
    reach = (HIDDEN_DEG - 0.25) / WIDTH_DEG
    assert found == pytest.approx(100.0 * (1.0 - np.exp(-(reach**2))), rel=0.02)
    assert ", 0 % at sigma 30" in line or "e-" in line.partition(", ")[2]


def test_below_the_horizon_there_is_no_light_to_measure() -> None:
    known = hidden_peak()
    known[0] |= THETA < 90.0
    shares = unmeasured_share(SIGMA, PHI, THETA, np.ones((1, 1, *known.shape)), known[None, None])
    np.testing.assert_allclose(shares, 0.0, atol=1e-12)
    refuse_holes(SIGMA, PHI, THETA, np.ones((1, 1, *known.shape)), known[None, None])


def test_refused_holes_are_named() -> None:
    with pytest.raises(ValueError, match=r"^at sigma 0 .* % of the light was not measured, with gaps from theta 0 to 3\.5$"):
        filled("refuse")


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from(FILLS[:3]), st.floats(0.0, 1.0))
def test_no_known_value_is_changed_and_each_hole_has_a_number(seed: int, fill: Fill, share: float) -> None:
    generator = np.random.default_rng(seed)
    sigma, theta = np.array([0.0, 20.0, 50.0]), np.linspace(0.0, 90.0, 10)
    values = generator.normal(1.0, 1.0, (2, 1, 3, 3, 10)) * 10.0 ** generator.integers(-30, 30)
    known = generator.random(values.shape) < share
    cuts = [
        [continued(theta, np.where(k, v, np.nan), np.abs(v)) for v, k in zip(*each, strict=True)]
        for each in zip(values[:, 0], known[:, 0], strict=True)
    ]
    held = np.array([[cut.values for cut in each] for each in cuts])[:, None]
    found = fill_holes(theta, sigma, held, known, fill)
    np.testing.assert_array_equal(found[known], values[known])
    assert np.isfinite(found).all()


def test_a_cut_without_a_known_node_stays_as_it_is() -> None:
    none = SpecularCut(np.zeros((1, 2)), np.zeros((1, 2)), np.zeros((1, 2), dtype=bool))
    values = none.values[None, None, None]
    for fill in FILLS:
        assert not fill_holes(np.array([0.0, 1.0]), np.zeros(1), values, none.known[None, None, None], fill).any()
