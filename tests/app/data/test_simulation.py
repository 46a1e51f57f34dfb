"""`goniotwin.simulate`: a dataset of the virtual detectors."""

from typing import Any

import numpy as np
import pytest

import goniotwin


@pytest.mark.usefixtures("quick_errors")
def test_the_luminance_factor_of_a_simulated_diffuser_is_its_reflectance() -> None:
    dataset = goniotwin.simulate("lambertian:reflectance=0.5", [30.0])
    assert isinstance(dataset, goniotwin.Dataset)
    assert dataset.simulated
    assert dataset.good.any()
    # A Lambertian sample's luminance factor is its reflectance, whatever the direction.
    np.testing.assert_allclose(dataset.luminance_factor[dataset.good], 0.5, rtol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"sample": "mirror"}, "mirror"),
        ({"sample": None}, "sample"),
        ({"sigma_deg": [90.0]}, "sigma_deg"),
        ({"sigma_deg": [30.0, 0.0]}, "sigma_deg"),
        ({"sigma_deg": 30.0}, "sigma_deg"),
        ({"sigma_deg": ["x"]}, "sigma_deg"),
        ({"sigma_deg": [[0.0, 30.0]]}, "sigma_deg"),
        ({"sigma_deg": [float("nan")]}, "sigma_deg"),
        ({"wavelengths_nm": [600.0, 500.0]}, "wavelengths_nm"),
        ({"wavelengths_nm": []}, "wavelengths_nm"),
        ({"wavelengths_nm": 550.0}, "wavelengths_nm"),
        ({"wavelengths_nm": [1e9]}, "wavelengths_nm"),
    ],
)
def test_invalid_arguments_are_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(goniotwin.GoniotwinError, match=message):
        goniotwin.simulate(**{"sample": "lambertian", **arguments})
