"""Illumination of the sample by the forward and the adjoint estimator: compared with each other and with closed forms."""

import math
from dataclasses import replace
from typing import Any

import numba
import numpy as np
import pytest

from goniotwin.twin.optics.geometry.deviation import Deviation
from goniotwin.twin.optics.illumination.adjoint import adjoint_illumination, illumination_figure
from goniotwin.twin.optics.illumination.beam import Illumination
from goniotwin.twin.optics.illumination.forward import forward_illumination
from goniotwin.twin.optics.illumination.spectrum import luminous_spectrum, xenon_spectrum
from goniotwin.twin.optics.illumination.unit import ELEMENTS, IlluminationUnit
from goniotwin.twin.optics.montecarlo import CHUNK
from tests.sizes import parted
from tests.twin.optics.agreement import agree

UNIT = IlluminationUnit()
# Far beyond the tolerances, so that every element clips or moves the light, each in a different way.
AWRY = IlluminationUnit(
    deviations={
        "arc": Deviation(3.0, 2.0, 1.0, 0.15, 0.2, -0.3),
        "reflector": Deviation(0.2, 0.1, -0.15, 0.05, 0.3, 0.02),
        "input_condenser": Deviation(1.0, 5.0, -1.5, 0.6, -0.4, 0.5),
        "slit": Deviation(2.0, 8.0, -3.0, 0.03, 0.4, -0.05),
        "output_condenser": Deviation(-1.0, 4.0, 2.0, -0.04, 0.1, 0.05),
        "unit": Deviation(0.05, 10.0, -0.06, 0.1, 1.0, 0.2),
    }
)
BOTH = [forward_illumination, adjoint_illumination]


def check_agreement(forward: Illumination, adjoint: Illumination) -> None:
    agree(forward.irradiance, forward.irradiance_error, adjoint.irradiance, adjoint.irradiance_error)
    agree(forward.angular_flux, forward.angular_flux_error, adjoint.angular_flux, adjoint.angular_flux_error)
    assert abs(forward.flux - adjoint.flux) < 4.0 * math.hypot(forward.flux_error, adjoint.flux_error)
    (width, error), (other, other_error) = forward.full_width_deg, adjoint.full_width_deg
    assert abs(width - other) < 4.0 * math.hypot(error, other_error)


@pytest.mark.long
@pytest.mark.parametrize("unit", [pytest.param(UNIT, id="straight"), pytest.param(AWRY, id="awry")])
def test_forward_and_adjoint_agree(unit: IlluminationUnit) -> None:
    forward = forward_illumination(unit, rays=12_000_000, seed=11)
    check_agreement(forward, adjoint_illumination(unit, rays=200_000, seed=12))


@parted(4)
def test_both_agree_over_the_whole_image_of_the_slit_and_its_edges(part: int) -> None:
    forward = forward_illumination(AWRY, rays=8_000_000 // part, side_mm=12.0, cells=8, seed=13)
    adjoint = adjoint_illumination(AWRY, rays=400_000 // part, side_mm=12.0, cells=8, seed=14)
    assert np.count_nonzero(adjoint.irradiance == 0.0) > 10
    check_agreement(forward, adjoint)


@pytest.mark.long
def test_both_agree_with_a_small_reflector_and_condenser() -> None:
    small = replace(UNIT, reflector_half_angle_deg=15.0, input_condenser_radius_mm=15.0)
    adjoint = adjoint_illumination(small, rays=100_000, seed=16)
    assert adjoint.flux < 0.7 * adjoint_illumination(UNIT, rays=10_000).flux
    check_agreement(forward_illumination(small, rays=8_000_000, seed=15), adjoint)


@parted(4)
@pytest.mark.parametrize(
    ("estimate", "opening_mm", "pupil_mm", "error"),
    [(adjoint_illumination, 0.05, 1.0, 0.001), (forward_illumination, 0.25, 3.0, 0.02)],
    ids=["adjoint", "forward"],
)
def test_the_flux_is_radiance_times_etendue(estimate: Any, opening_mm: float, pupil_mm: float, error: float, part: int) -> None:
    # Slit and pupil are so small that the light is that of the arc's centre, and every cosine almost one; no losses.
    unit = IlluminationUnit(
        slit_width_mm=opening_mm,
        height_stop_mm=opening_mm,
        exit_pupil_radius_mm=pupil_mm,
        input_condenser_magnification=1.0,
        reflector_reflectance=0.0,
        bulb_transmittance=1.0,
        monochromator_transmittance=1.0,
    )
    result = estimate(unit, relative_error=error * math.sqrt(part), cells=1, side_mm=16.0 * opening_mm)
    # Emission of the arc per volume and solid angle, along its cylinder's chords, averaged over the slit's image in it.
    chord_mm = 2.0 * unit.arc_radius_mm * (1.0 - (0.5 * opening_mm / unit.arc_radius_mm) ** 2 / 6.0)
    radiance_mm2sr = unit.band_flux / (4.0 * math.pi * unit.arc_volume_mm3) * chord_mm
    etendue_mm2sr = opening_mm**2 * math.pi * math.sin(math.atan(pupil_mm / unit.slit_distance_mm)) ** 2
    # The neglected cosines: those of the pupil's rim as seen from the arc.
    left_out = 2.0 * (pupil_mm / unit.slit_distance_mm) ** 2
    assert result.flux == pytest.approx(radiance_mm2sr * etendue_mm2sr, abs=4.0 * result.flux_error + left_out * result.flux)


def test_the_reflector_adds_its_light_after_all_losses() -> None:
    without = adjoint_illumination(replace(UNIT, reflector_reflectance=0.0), rays=50_000)
    share = adjoint_illumination(UNIT, rays=50_000).flux / without.flux - 1.0
    # Reflectance, the bulb twice more, arc and electrodes; its image of the arc is the arc.
    assert share == pytest.approx(0.95 * 0.9**2 * 0.8, rel=5e-3)


def test_the_efficiency_has_the_known_small_value() -> None:
    # 3e-5 to 1.3e-4 of the emitted flux arrives on the 5 x 5 mm.
    assert 3e-5 < adjoint_illumination(UNIT, rays=10_000).efficiency < 1.3e-4
    lossless = replace(UNIT, reflector_reflectance=0.0, bulb_transmittance=1.0, monochromator_transmittance=1.0)
    assert 3e-5 < adjoint_illumination(lossless, rays=10_000).efficiency < 1.3e-4


def test_the_irradiance_of_the_sample_agrees_with_the_signal_estimate() -> None:
    # 0.22 W/m^2 at 5 nm behind three mirrors and the beam splitter, from 2.0e3 W m^-2 sr^-1 nm^-1 in the arc.
    on_sample = adjoint_illumination(UNIT, rays=10_000).flux / 25e-6 * 0.95**3 * 0.91
    assert on_sample == pytest.approx(0.22, rel=0.1)
    per_mm3_sr_nm = UNIT.band_flux / 5.0 / (4.0 * math.pi * UNIT.arc_volume_mm3)
    assert per_mm3_sr_nm * 1e6 == pytest.approx(2.0e3, rel=0.1)


@parted(4)
def test_the_divergence_is_that_of_the_pupil_averaged_over_the_field(part: int) -> None:
    result = adjoint_illumination(UNIT, rays=2_000_000 // part)
    # Without rays, from evenly spread points (Roberts' sequence) of pupil and field. The radiance of a point of the pupil, seen
    # from a point of the field, follows from the tangents before the condenser, by similar triangles (slit 57.1 mm behind the
    # pupil, condenser 250 mm behind that, arc 50 mm): the fourth power of the cosine, and the oblique chord of an upright arc.
    even = (np.arange(1, 1_000_000 // part + 1)[:, None] * 0.8566748838545029 ** np.arange(1, 5)) % 1.0
    ring, turn = 5.0 * np.sqrt(even[:, 0]), 2.0 * np.pi * even[:, 1]
    pupil, field = np.array([ring * np.cos(turn), ring * np.sin(turn)]), 5.0 * (even[:, 2:].T - 0.5)
    slit = -field / 14.0
    tangent = (slit - 250.0 * (pupil - slit) / (800.0 / 14.0) + slit / 5.0) / 50.0
    square = np.sum(tangent**2, axis=0)
    bright = 1.0 / (1.0 + square) ** 2 / np.sqrt(1.0 - tangent[1] ** 2 / (1.0 + square))
    angle = np.degrees(np.arctan(np.hypot(*(pupil - field)) / 800.0))
    expected = np.histogram(angle, result.angle_edges_deg, weights=bright)[0]
    apart = np.abs(result.angular_flux / result.flux - expected / expected.sum())
    # The estimator's error, and that of the points.
    assert np.all(apart < 5.5 * result.angular_flux_error / result.flux + 1e-4 * part)
    assert replace(result, angular_flux=expected).full_width_deg[0] == pytest.approx(result.full_width_deg[0], abs=0.005)
    # The paper's 0.5 to 1 deg.
    assert 0.5 < result.full_width_deg[0] < 1.0


def test_a_unit_without_deviations_lights_the_field_uniformly_and_symmetrically() -> None:
    field = adjoint_illumination(UNIT, rays=1_000_000)
    even = field.irradiance / field.irradiance.mean()
    assert np.max(np.abs(even - 1.0)) < 2e-3
    assert field.uniformity > 0.998
    for mirrored in (field.irradiance[::-1], field.irradiance[:, ::-1]):
        agree(field.irradiance[:2], field.irradiance_error[:2], mirrored[:2], field.irradiance_error[:2])


def test_the_result_has_the_unit_of_the_lamp() -> None:
    watts = adjoint_illumination(UNIT, rays=1000)
    lumens = adjoint_illumination(replace(UNIT, lamp=luminous_spectrum(xenon_spectrum())), rays=1000)
    assert (watts.unit, lumens.unit) == ("W", "lm")
    assert watts.efficiency == pytest.approx(lumens.efficiency)
    # V(555 nm) is almost 1.
    assert lumens.flux / watts.flux == pytest.approx(683.0, rel=0.01)


@pytest.mark.parametrize("estimate", BOTH)
def test_a_relative_error_can_be_requested(estimate: Any) -> None:
    target = 0.02 if estimate is forward_illumination else 0.001
    result = estimate(UNIT, relative_error=target, cells=3)
    assert 0.0 < result.flux_error <= target * result.flux
    # The rays are those of a run with their number.
    again = estimate(UNIT, rays=result.rays, cells=3)
    assert again.flux == pytest.approx(result.flux, rel=1e-12)


@parted(4)
def test_the_standard_errors_are_those_of_repeated_runs(part: int) -> None:
    for estimate, rays in ((forward_illumination, 400_000 // part), (adjoint_illumination, 1000)):
        runs = [estimate(AWRY, rays=rays, seed=seed, cells=4, bins=10) for seed in range(60)]
        for value in ("irradiance", "angular_flux"):
            scatter = np.std([getattr(run, value) for run in runs], axis=0, ddof=1)
            stated = np.sqrt(np.mean([getattr(run, f"{value}_error") ** 2 for run in runs], axis=0))
            lit = stated > 0.05 * stated.max()
            # 60 runs give a standard deviation to 9 %. Equal numbers of rays in all cells can only reduce that of the rings.
            assert 0.8 < np.mean(scatter[lit] / stated[lit]) < 1.08
        scatter = np.std([run.flux for run in runs], ddof=1)
        assert scatter == pytest.approx(np.mean([run.flux_error for run in runs]), rel=0.35)


@pytest.mark.parametrize("estimate", BOTH)
def test_results_are_bit_identical_for_one_seed_and_any_number_of_threads(estimate: Any) -> None:
    rays, threads = 5 * CHUNK + 75, numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        one = estimate(UNIT, rays=rays, seed=3)
    finally:
        numba.set_num_threads(threads)
    many = estimate(UNIT, rays=rays, seed=3)
    for value in ("irradiance", "irradiance_error", "angular_flux", "angular_flux_error"):
        assert np.array_equal(getattr(one, value), getattr(many, value))
    assert (one.flux, one.flux_error) == (many.flux, many.flux_error)
    assert one.flux != estimate(UNIT, rays=rays, seed=4).flux


@pytest.mark.parametrize("estimate", BOTH)
def test_invalid_arguments_are_refused(estimate: Any) -> None:
    for wrong, what in (
        (dict(), "either rays or relative_error"),
        (dict(rays=100, relative_error=0.1), "either rays or relative_error"),
        (dict(rays=1), "rays is 1"),
        (dict(relative_error=0.0), "relative_error is 0.0"),
        (dict(relative_error=math.nan), "relative_error is nan"),
        (dict(rays=100, seed=-1), "seed is -1"),
        (dict(rays=100, cells=0), "cells is 0"),
        (dict(rays=100, bins=0), "bins is 0"),
        (dict(rays=100, side_mm=math.nan), "side_mm is nan"),
    ):
        with pytest.raises(ValueError, match=what):
            estimate(UNIT, **wrong)


def test_without_light_the_flux_is_zero_and_a_relative_error_is_refused() -> None:
    blocked = replace(UNIT, deviations={"slit": Deviation(x_mm=3.0)})
    result = adjoint_illumination(blocked, rays=1000)
    assert (result.flux, result.flux_error) == (0.0, 0.0)
    assert math.isnan(result.full_width_deg[0])
    for estimate in BOTH:
        with pytest.raises(ValueError, match="undefined without light"):
            estimate(blocked, relative_error=0.1)
        with pytest.raises(ValueError, match="more than"):
            estimate(UNIT, relative_error=1e-7)


@pytest.mark.parametrize("name", ELEMENTS)
@pytest.mark.parametrize("part", ["rx_deg", "ry_deg", "rz_deg", "x_mm", "y_mm", "z_mm"])
def test_each_deviation_within_tolerance_keeps_the_flux_on_the_field(name: str, part: str) -> None:
    # Table 1 of the paper: +-0.05 deg, +-0.025 mm; within 5 to 10 % of the undisturbed flux.
    undisturbed = adjoint_illumination(UNIT, rays=20_000).flux
    for sign in (-1.0, 1.0):
        size = sign * (0.05 if part.endswith("deg") else 0.025)
        deviating = replace(UNIT, deviations={name: Deviation(**{part: size})})
        assert adjoint_illumination(deviating, rays=20_000).flux == pytest.approx(undisturbed, rel=0.05)


def test_the_worst_case_of_all_tolerances_moves_the_image_of_the_slit_off_the_field() -> None:
    # Unit turned by 0.05 deg at 800 mm from the sample, lens and slit shifted: 0.70 + 15 * 0.025 + 14 * 0.025 + 0.025 mm in x
    # and in z; the 7 mm image has a margin of 1 mm.
    off = 800.0 * math.radians(0.05) + (15.0 + 14.0 + 1.0) * 0.025 - 1.0
    corner = {
        "unit": Deviation(rx_deg=0.05, rz_deg=-0.05, x_mm=0.025, z_mm=0.025),
        "output_condenser": Deviation(x_mm=0.025, z_mm=0.025),
        "slit": Deviation(x_mm=-0.025, z_mm=-0.025),
    }
    share = (
        adjoint_illumination(replace(UNIT, deviations=corner), rays=400_000).flux / adjoint_illumination(UNIT, rays=50_000).flux
    )
    assert share == pytest.approx((1.0 - off / 5.0) ** 2, abs=0.01)


def test_the_figure_has_the_enlarged_image_of_the_slit_and_the_divergence() -> None:
    figure = illumination_figure(UNIT, cells=20)
    half = 0.5 * (figure.edges_mm[1:] + figure.edges_mm[:-1])
    lit, dark = np.abs(half) < 3.25, np.abs(half) > 3.75
    inside = figure.irradiance[np.ix_(lit, lit)]
    assert np.max(np.abs(inside / inside.mean() - 1.0)) < 0.05
    assert not np.any(figure.irradiance[dark])
    assert not np.any(figure.irradiance[:, dark])
    assert figure.field.flux_error <= 0.001 * figure.field.flux
    assert figure.intensity.shape == figure.angle_deg.shape == figure.intensity_error.shape
    assert np.all(figure.intensity[figure.angle_deg > 0.65] == 0.0)
