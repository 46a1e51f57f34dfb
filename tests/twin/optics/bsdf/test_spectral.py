"""Samples with spectra: linear between the wavelengths, each part of a sum with its own spectrum."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.twin.optics import (
    Scatterer,
    apply_spectrum,
    evaluate,
    from_specular,
    gaussian,
    lambertian,
    light_direction,
    spectral_table,
    sum_samples,
)

LIGHT, OBSERVER = light_direction(30.0), from_specular(30.0, 6.0, 40.0)
GREY = sum_samples(lambertian(0.4), gaussian(5.0, reflectance=0.4))
wavelengths = st.floats(300.0, 900.0)


def seen(model: Scatterer, wavelength_nm: float | None = None) -> float:
    return float(evaluate(model, LIGHT, OBSERVER, wavelength_nm))


@settings(deadline=None)
@given(wavelengths)
def test_a_spectral_sample_is_the_grey_one_times_its_factor(wavelength_nm: float) -> None:
    nm, factors = [400.0, 500.0, 700.0], [0.2, 1.0, 0.5]
    factor = np.interp(wavelength_nm, nm, factors)
    assert seen(apply_spectrum(nm, factors, GREY), wavelength_nm) == pytest.approx(factor * seen(GREY))


@settings(deadline=None)
@given(wavelengths)
def test_each_part_of_a_sum_keeps_its_spectrum(wavelength_nm: float) -> None:
    red, blue = (
        apply_spectrum([600.0, 700.0], [0.0, 1.0], lambertian(0.3)),
        apply_spectrum([450.0, 650.0], [1.0, 0.2], gaussian(9.0)),
    )
    parts = seen(red, wavelength_nm) + seen(blue, wavelength_nm) + seen(GREY, wavelength_nm)
    assert seen(sum_samples(red, blue, GREY), wavelength_nm) == pytest.approx(parts, rel=1e-12)


@settings(deadline=None)
@given(wavelengths)
def test_a_spectral_table_is_linear_between_wavelengths_and_constant_beyond(wavelength_nm: float) -> None:
    values = np.array([1.0, 3.0, 2.0])[:, None, None, None] * np.ones((3, 2, 1, 2))
    table = spectral_table([400.0, 500.0, 700.0], [0.0, 60.0], [0.0], [0.0, 90.0], values)
    assert seen(table, wavelength_nm) == pytest.approx(np.interp(wavelength_nm, [400.0, 500.0, 700.0], [1.0, 3.0, 2.0]))


def test_a_spectral_table_may_be_anisotropic_and_have_both_sides() -> None:
    values = np.arange(1.0, 5.0).reshape(2, 2, 1, 1, 1)
    table = spectral_table(
        [400.0, 600.0], [30.0], [0.0], [0.0], values, psi_deg=[0.0, 90.0], symmetry="orthotropic", side="both"
    )
    assert [seen(table, nm) for nm in (400.0, 500.0, 600.0)] == pytest.approx([1.0, 2.0, 3.0])
    turned = evaluate(table, LIGHT, OBSERVER, 600.0, gamma_deg=90.0)
    assert turned == pytest.approx(4.0)
    back = evaluate(table, LIGHT * [1.0, 1.0, -1.0], OBSERVER * [1.0, 1.0, -1.0], 500.0)
    assert back == pytest.approx(2.0)


def test_weights_are_one_without_a_spectrum_and_given_for_many_wavelengths_at_once() -> None:
    assert GREY.weights() == pytest.approx([1.0, 1.0])
    coloured = sum_samples(apply_spectrum([400.0, 600.0], [0.0, 1.0], lambertian(0.5)), lambertian(0.5))
    assert coloured.weights([400.0, 450.0, 800.0]) == pytest.approx(np.array([[0.0, 0.25, 1.0], [1.0, 1.0, 1.0]]))


def test_a_spectral_sample_needs_a_wavelength() -> None:
    with pytest.raises(ValueError, match="wavelength_nm is missing"):
        seen(apply_spectrum([400.0, 700.0], [0.1, 0.2], GREY))
    for wrong in (-5.0, 0.0, math.nan):
        with pytest.raises(ValueError, match="wavelength_nm is"):
            seen(GREY, wrong)


@pytest.mark.parametrize(
    ("nm", "factors", "message"),
    [
        ([500.0, 400.0], [1.0, 1.0], "wavelengths_nm is not ascending"),
        ([400.0, 400.0], [1.0, 1.0], "wavelengths_nm is not ascending"),
        ([0.0, 400.0], [1.0, 1.0], r"wavelengths_nm\[0\] is 0.0"),
        ([400.0, math.nan], [1.0, 1.0], r"wavelengths_nm\[1\] is nan"),
        ([400.0, 500.0], [1.0, -0.1], "the weight at 500 nm is -0.1"),
        ([400.0, 500.0], [math.nan, 0.1], "the weight at 400 nm is nan"),
        ([400.0, 500.0], [0.1], r"factors has the shape \(1,\)"),
        ([], [], "give a list of at least one"),
    ],
)
def test_an_invalid_spectrum_is_refused(nm: Any, factors: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        apply_spectrum(nm, factors, GREY)


def test_a_second_spectrum_is_refused() -> None:
    with pytest.raises(ValueError, match="depends on the wavelength already"):
        apply_spectrum([400.0], [0.5], apply_spectrum([400.0], [0.5], GREY))


def test_a_hole_in_a_spectral_table_is_reported_with_its_wavelength() -> None:
    values = np.ones((2, 1, 1, 2))
    values[1, 0, 0, 1] = math.nan
    with pytest.raises(ValueError, match="at 500 nm: values has nan at sigma 0, phi 0, theta 90"):
        spectral_table([400.0, 500.0], [0.0], [0.0], [0.0, 90.0], values)
    with pytest.raises(ValueError, match="give a table for each wavelength"):
        spectral_table([400.0], [0.0], [0.0], [0.0, 90.0], values)
    with pytest.raises(ValueError, match="wavelengths_nm is not ascending"):
        spectral_table([500.0, 400.0], [0.0], [0.0], [0.0, 90.0], np.ones((2, 1, 1, 2)))


def test_a_sum_of_no_samples_is_refused() -> None:
    with pytest.raises(ValueError, match="scatterers is empty"):
        sum_samples()
