"""Flux and uniformity of many sets of deviations: compared with the adjoint estimator, and the paper's Table 1."""

from dataclasses import replace

import numba
import numpy as np
import pytest

from goniotwin.arrays import Floats
from goniotwin.twin.optics import Deviation, IlluminationUnit, adjoint_illumination, field_fluxes
from goniotwin.twin.optics.illumination.field_flux import CHUNK
from goniotwin.twin.optics.illumination.unit import ELEMENTS
from tests.sizes import parted

UNIT = IlluminationUnit()
LIMITS = np.array([0.05, 0.05, 0.05, 0.025, 0.025, 0.025])
"""Table 1 of the paper, deg and mm."""
PARTS = ("rx_deg", "ry_deg", "rz_deg", "x_mm", "y_mm", "z_mm")


def alone(values: Floats, element: str, name: str) -> Floats:
    """Relative change (n,) of the flux by one deviation with `values` (n,)."""
    sets = np.zeros((values.size + 1, 6, 6))
    sets[1:, ELEMENTS.index(element), PARTS.index(name)] = values
    flux, _ = field_fluxes(UNIT, sets)
    return np.asarray(flux[1:] / flux[0] - 1.0)


@parted(4)
@pytest.mark.parametrize("scale", [1.0, 4.0])
def test_flux_and_uniformity_are_those_of_the_adjoint_estimator(scale: float, part: int) -> None:
    random = np.random.default_rng(3)
    sets = random.uniform(-scale, scale, (8 // part, 6, 6)) * LIMITS
    flux, uniformity = field_fluxes(UNIT, sets)
    for n, rows in enumerate(sets):
        unit = replace(UNIT, deviations={name: Deviation(*row) for name, row in zip(ELEMENTS, rows, strict=True)})
        rays = adjoint_illumination(unit, rays=400_000 // part)
        # The rule's own error is below 1e-4; within it the edges are sharp.
        assert flux[n] == pytest.approx(rays.flux, abs=4.5 * rays.flux_error + 1e-4 * rays.flux)
        noise = 4.5 * rays.irradiance_error.max() / rays.irradiance.mean()
        assert uniformity[n] == pytest.approx(rays.uniformity, abs=noise + 0.03)


@parted(4)
@pytest.mark.parametrize(("element", "shift_mm", "loss"), [("slit", 1.5, 0.0324), ("output_condenser", 1.55, 0.0530)])
def test_an_image_of_the_slit_before_or_behind_the_field_is_as_dark_as_by_rays(
    element: str, shift_mm: float, loss: float, part: int
) -> None:
    """300 mm out of focus; within Table 1 it is 5 mm."""
    sets = np.zeros((2, 6, 6))
    sets[1, ELEMENTS.index(element), PARTS.index("y_mm")] = shift_mm
    (aligned, flux), (_, uniformity) = field_fluxes(UNIT, sets)
    unit = replace(UNIT, deviations={element: Deviation(y_mm=shift_mm)})
    rays = adjoint_illumination(unit, rays=400_000 // part)
    # 32 points of the pupil resolve its blur to 0.5 %.
    assert flux == pytest.approx(rays.flux, abs=4.5 * rays.flux_error + 5e-3 * rays.flux)
    assert uniformity == pytest.approx(rays.uniformity, abs=4.5 * rays.irradiance_error.max() / rays.irradiance.mean() + 0.03)
    assert 1.0 - flux / aligned == pytest.approx(loss, abs=2e-3)


def test_alone_nothing_within_table_1_changes_the_flux_by_more_than_half_a_percent() -> None:
    largest = {
        (element, name): np.abs(alone(np.array([-1.0, 1.0]) * limit, element, name)).max()
        for element in ELEMENTS
        for name, limit in zip(PARTS, LIMITS, strict=True)
    }
    # optics.md, section 7: reflector rz, 0.56 %.
    assert max(largest, key=lambda each: largest[each]) == ("reflector", "rz_deg")
    assert max(largest.values()) == pytest.approx(0.0056, abs=1e-4)


@pytest.mark.parametrize(
    ("element", "name", "limit"),
    [
        ("unit", "rx_deg", 0.089),
        ("output_condenser", "x_mm", 0.083),
        ("slit", "x_mm", 0.09),
        ("reflector", "x_mm", 0.127),
        ("input_condenser", "x_mm", 0.133),
        ("arc", "x_mm", 0.16),
        ("reflector", "rx_deg", 0.59),
    ],
)
def test_the_limits_alone_for_five_percent_are_the_known_ones(element: str, name: str, limit: float) -> None:
    # optics.md, section 7.
    values = np.linspace(0.9, 1.1, 201) * limit
    change = np.maximum(np.abs(alone(values, element, name)), np.abs(alone(-values, element, name)))
    assert values[np.argmax(change > 0.05)] == pytest.approx(limit, rel=0.015)


def test_all_deviations_together_are_far_worse_than_each_alone() -> None:
    signs = np.random.default_rng(1).choice([-1.0, 1.0], (4000, 6, 6))
    flux, uniformity = field_fluxes(UNIT, np.concatenate([np.zeros((1, 6, 6)), signs * LIMITS]))
    relative = flux[1:] / flux[0]
    # optics.md, section 7: 59 % within 5 %, 81 % within 10 %, worst 0.80, of 30 deviations that it does not name.
    assert np.mean(relative > 0.95) == pytest.approx(0.58, abs=0.03)
    assert np.mean(relative > 0.90) == pytest.approx(0.83, abs=0.03)
    assert relative.min() == pytest.approx(0.80, abs=0.01)
    assert uniformity.min() < 0.45


def test_a_rotation_of_the_whole_unit_about_the_beam_and_no_light_at_all() -> None:
    sets = np.zeros((3, 6, 6))
    sets[1, ELEMENTS.index("unit"), PARTS.index("ry_deg")] = 90.0
    sets[2, ELEMENTS.index("slit"), PARTS.index("x_mm")] = 3.0
    flux, uniformity = field_fluxes(UNIT, sets)
    # The slit's image is a square; the arc's upright cylinder then lies.
    assert flux[1] == pytest.approx(flux[0], rel=2e-3)
    assert flux[2] == 0.0
    assert np.isnan(uniformity[2])


def test_a_set_has_the_same_result_alone_and_for_any_number_of_threads() -> None:
    sets = np.random.default_rng(2).uniform(-1.0, 1.0, (2 * CHUNK + 3, 6, 6)) * LIMITS
    many = field_fluxes(UNIT, sets)
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        one = field_fluxes(UNIT, sets)
    finally:
        numba.set_num_threads(threads)
    last = field_fluxes(UNIT, sets[-1:])
    for each, single, own in zip(many, one, last, strict=True):
        assert np.array_equal(each, single)
        assert each[-1] == own[0]


def test_wrong_sets_are_refused() -> None:
    for sets, cells, what in (
        (np.zeros((6, 6)), 5, r"shape \(6, 6\): give \(n, 6, 6\)"),
        (np.full((1, 6, 6), np.nan), 5, "not finite"),
        (np.zeros((1, 6, 6)), 0, "cells is 0"),
    ):
        with pytest.raises(ValueError, match=what):
            field_fluxes(UNIT, sets, cells)
