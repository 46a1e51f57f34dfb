"""Values at standard geometries: those of the interpolation, where it accepts the geometry."""

import math

import numpy as np
import pytest

from goniotwin.app.campaign.schedule.standard_geometries import STANDARD_GEOMETRIES
from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.standard_values import standard_values
from goniotwin.twin.optics import from_specular
from goniotwin.twin.optics.geometry.coordinates import zenith_and_azimuth
from tests.app.data.made import gaussian, rings

POLAR = np.arange(0.0, 90.0, 5.0)
AZIMUTH = np.arange(0.0, 360.0, 5.0)


def made(*sigma_deg: float, wavelengths: int = 1, **columns: object) -> Dataset:
    """A lobe on rings 5 deg apart, at incidences and wavelengths, with u of 1 %."""
    frames = []
    for sigma in sigma_deg:
        part = rings(gaussian(20.0), sigma, POLAR, AZIMUTH, 0.01)
        frames += [
            {
                "sigma_deg": part.sigma_deg,
                "psi_deg": part.psi_deg,
                "polar_deg": part.polar_deg,
                "azimuth_deg": part.azimuth_deg,
                "bsdf": part.values,
                "u": part.u,
                "wavelength_nm": np.full(part.values.size, 400.0 + k),
            }
            for k in range(wavelengths)
        ]
    joined = {name: np.concatenate([np.asarray(each[name]) for each in frames]) for name in frames[0]}
    return Dataset.from_table(joined | columns, isotropic=True)


def test_the_directions_of_the_standards_are_as_they_name_them() -> None:
    found = {}
    for each in STANDARD_GEOMETRIES:
        polar, azimuth = zenith_and_azimuth(from_specular(each.sigma_deg, *each.theta_phi_deg))
        signed = float(polar) * (-1.0 if abs(azimuth) < 1.0 or abs(azimuth - 360.0) < 1.0 else 1.0)
        found[each.name] = (each.sigma_deg, round(signed, 6))
    # Positive on the specular side: 45 deg as A is at 45 - A.
    assert found == {
        "45:0": (45.0, pytest.approx(0.0, abs=1e-6)),
        "0:45": (0.0, 45.0),
        "45 as -15": (45.0, 60.0),
        "45 as 15": (45.0, 30.0),
        "45 as 25": (45.0, 20.0),
        "45 as 45": (45.0, pytest.approx(0.0, abs=1e-6)),
        "45 as 75": (45.0, -30.0),
        "45 as 110": (45.0, -65.0),
        "gloss 20": (20.0, 20.0),
        "gloss 60": (60.0, 60.0),
        "gloss 85": (85.0, 85.0),
    }


def test_measured_directions_have_their_value_and_others_that_of_the_interpolation() -> None:
    dataset = made(0.0, 45.0)
    found = standard_values(dataset)
    by_name = {each.geometry: each for each in found.values}
    assert set(by_name) == {"45:0, 45 as 45", "0:45", *(f"45 as {k}" for k in (-15, 15, 25, 75, 110)), "specular"}
    assert found.missing == ("gloss 20", "gloss 60", "gloss 85")  # nothing between incidences
    assert by_name["45 as 25"].source == "measured"
    assert by_name["45 as 25"].bsdf == pytest.approx(math.exp(-((25.0 / 20.0) ** 2)), rel=1e-9)
    assert by_name["45 as 25"].expanded_u == pytest.approx(0.02 * by_name["45 as 25"].bsdf, rel=1e-6)
    value, u = dataset.at(sigma_deg=45.0, theta_deg=25.0, phi_deg=0.0)
    assert (by_name["45 as 25"].bsdf, by_name["45 as 25"].expanded_u) == (value, 2.0 * u)
    assert by_name["45 as 25"].radiance_factor == (math.pi * value, 2.0 * math.pi * u)
    assert (by_name["0:45"].polar_deg, by_name["0:45"].azimuth_deg) == (45.0, 180.0)


def test_a_direction_between_measured_ones_is_interpolated_and_one_beside_a_blocked_one_is_left_out() -> None:
    rings_of_4 = standard_values(made(62.0))
    assert [(each.geometry, each.source) for each in rings_of_4.values] == [("specular", "interpolated")]
    dataset = made(62.0)
    blocked = np.where(np.abs(dataset.polar_deg - 60.0) < 0.1, "shadowed", "")
    found = standard_values(made(62.0, flags=blocked))
    assert found.values == ()
    assert "specular" in found.missing


def test_of_many_wavelengths_some_are_stated() -> None:
    found = standard_values(made(45.0, wavelengths=12))
    assert found.wavelengths == (9, 12)
    assert {each.wavelength_nm for each in found.values} >= {400.0, 411.0}
