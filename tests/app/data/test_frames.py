"""`Dataset.to_dataframe` and `to_xarray`."""

import sys

import numpy as np
import pytest

import goniotwin
from goniotwin.app.data.opening import dataset_of_file
from goniotwin.app.data.values import COLUMNS
from goniotwin.app.formats.content import BsdfFile
from goniotwin.app.formats.table import BsdfTable
from tests.app.data.made import gaussian, rings

THETA = np.array([0.0, 10.0, 90.0])
TABLE = BsdfTable(
    np.array([0.0, 60.0]),
    np.array([0.0, 180.0]),
    THETA,
    np.arange(24.0).reshape(2, 1, 2, 2, 3),
    (500.0, 600.0),
    u=0.1 * np.arange(24.0).reshape(2, 1, 2, 2, 3),
)


def test_a_dataframe_has_a_row_for_each_value(dataset: goniotwin.Dataset) -> None:
    pytest.importorskip("pandas")
    frame = dataset.to_dataframe()
    assert tuple(frame.columns) == COLUMNS
    assert len(frame) == dataset.size
    np.testing.assert_array_equal(frame["bsdf"], dataset.bsdf)
    assert frame["flags"].tolist() == dataset.flags.tolist()


def test_a_table_is_on_its_axes() -> None:
    pytest.importorskip("xarray")
    made = dataset_of_file(BsdfFile((TABLE,)), "a.ddr").to_xarray()
    assert made["bsdf"].dims == ("wavelength_nm", "psi_deg", "sigma_deg", "phi_deg", "theta_deg")
    assert made["bsdf"].attrs["units"] == "1/sr"
    assert made["theta_deg"].attrs["units"] == "deg"
    assert made["theta_deg"].attrs["long_name"] == "aspecular angle"
    for each in made.variables.values():
        assert each.attrs["long_name"]
        assert each.attrs["units"]
    assert float(made["u"].sel(wavelength_nm=600, sigma_deg=0, phi_deg=180, theta_deg=10, psi_deg=0)) == pytest.approx(1.6)
    # Below the horizon there is nothing.
    below = made["bsdf"].sel(sigma_deg=60, phi_deg=180, theta_deg=90, psi_deg=0, wavelength_nm=500)
    assert np.isnan(float(below))
    assert made.attrs["simulated"] == 0
    part = dataset_of_file(BsdfFile((TABLE,)), "a.ddr").select(wavelength_nm=500, phi_deg=0).to_xarray()
    assert part["bsdf"].sel(phi_deg=0).shape == (1, 1, 2, 3)


def test_measured_values_are_a_list() -> None:
    pytest.importorskip("xarray")
    made = dataset_of_file(BsdfFile((rings(gaussian(5.0), 30.0, np.array([10.0]), np.array([0.0, 180.0])),)), "a").to_xarray()
    assert made["bsdf"].dims == ("value",)
    assert set(made.data_vars) == {"bsdf", "u", "u_shared", "low95", "high95", "interval", "flags"}
    assert made["sigma_deg"].values.tolist() == [30.0, 30.0]
    assert all(each.attrs["long_name"] and each.attrs["units"] for each in made.variables.values())


@pytest.mark.parametrize(("method", "module"), [("to_xarray", "xarray"), ("to_dataframe", "pandas")])
def test_a_missing_extra_is_one_line_with_the_command(
    method: str, module: str, dataset: goniotwin.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(goniotwin.GoniotwinError, match=rf"{module} is not installed; run pip install 'goniotwin\[xarray\]'"):
        getattr(dataset, method)()
