"""Spectra of lamps and the passband of a monochromator."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.twin.optics.illumination.spectrum import V_NM, Passband, Spectrum, V, luminous_spectrum, xenon_spectrum


def test_the_luminous_efficiency_has_its_published_integral() -> None:
    # CIE 1924: 106.857 nm.
    assert np.trapezoid(V, V_NM) == pytest.approx(106.857, abs=0.01)


def test_the_xenon_lamp_has_its_luminous_flux_and_a_flat_visible_spectrum() -> None:
    lamp = xenon_spectrum()
    assert luminous_spectrum(lamp).total == pytest.approx(3000.0)
    assert luminous_spectrum(lamp).unit == "lm"
    visible = lamp.at(np.arange(400.0, 771.0, 10.0))
    assert visible.min() / visible.mean() > 0.8
    assert visible.max() / visible.mean() < 1.25


def test_without_an_interval_the_band_is_a_triangle_with_the_bandwidth_as_its_half_width() -> None:
    band = Passband(555.0, 0.0, 5.0)
    assert list(band.transmittance([549.0, 550.0, 552.5, 555.0, 557.5, 560.0])) == [0.0, 0.0, 0.5, 1.0, 0.5, 0.0]
    # The area of a triangle.
    assert band.flux(Spectrum(np.array([300.0, 900.0]), np.array([2.0, 2.0]))) == pytest.approx(10.0)


def test_the_transmittance_of_an_interval_is_one() -> None:
    band = Passband(580.0, 400.0, 1.0)
    flat = Spectrum(np.array([300.0, 900.0]), np.array([2.0, 2.0]))
    assert band.flux(flat) == pytest.approx(2.0 * 401.0)
    assert band.transmittance(400.0) == 1.0


@given(st.floats(350.0, 800.0), st.floats(0.0, 300.0), st.floats(0.5, 40.0))
def test_the_flux_that_passes_is_the_integral(centre: float, interval: float, width: float) -> None:
    lamp, band = xenon_spectrum(), Passband(centre, interval, width)
    wavelength = np.linspace(379.0, 781.0, 402_001)
    expected = np.trapezoid(lamp.at(wavelength) * band.transmittance(wavelength), wavelength)
    assert band.flux(lamp) == pytest.approx(expected, rel=1e-4, abs=1e-4)


def test_wavelengths_are_distributed_as_the_passing_flux() -> None:
    drawn = Passband(555.0, 0.0, 5.0).sample(xenon_spectrum(), (np.arange(10_000) + 0.5) / 10_000)
    # The variance of a triangle is the square of its half width over six.
    assert drawn.mean() == pytest.approx(555.0, abs=0.01)
    assert drawn.std() == pytest.approx(5.0 / np.sqrt(6.0), rel=1e-3)


@pytest.mark.parametrize(
    ("wavelength", "flux", "wrong"),
    [
        ([400.0], [1.0], "at least 2"),
        ([400.0, 400.0], [1.0, 1.0], "ascend"),
        ([400.0, 500.0], [1.0], "one each"),
        ([400.0, 500.0], [1.0, np.nan], "holes"),
        ([400.0, 500.0], [1.0, -1.0], "holes"),
        ([400.0, 500.0], [0.0, 0.0], "holes"),
        ([np.nan, 500.0], [1.0, 1.0], "ascend"),
    ],
)
def test_an_invalid_spectrum_is_refused(wavelength: list[float], flux: list[float], wrong: str) -> None:
    with pytest.raises(ValueError, match=wrong):
        Spectrum(np.array(wavelength), np.array(flux))


def test_a_band_outside_the_lamps_table_passes_nothing() -> None:
    band = Passband(1000.0, 0.0, 5.0)
    assert band.flux(xenon_spectrum()) == 0.0
    with pytest.raises(ValueError, match="emits nothing in 995 to 1005 nm"):
        band.sample(xenon_spectrum(), np.array([0.5]))
    with pytest.raises(ValueError, match="luminous_flux_lm"):
        xenon_spectrum(0.0)
