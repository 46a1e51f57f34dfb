"""The public API of `import goniotwin`: journals and simulations for scripts."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import goniotwin
from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.rig import read_rig
from tests.conftest import Writer


def test_a_journal_is_reduced_by_path_or_open(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    path = tmp_path / "small.journal"
    run_campaign(make_plan(read_schedule(write_schedule()), read_rig(write_rig())), path)
    by_name = goniotwin.reduce_journal(str(path))
    with goniotwin.open_journal(path) as journal:
        opened = goniotwin.reduce_journal(journal)
    assert by_name.simulated
    np.testing.assert_array_equal(by_name.samples["gaussian-5"].bsdf, opened.samples["gaussian-5"].bsdf)
    assert by_name.samples["gaussian-5"].bsdf.size > 0


@pytest.mark.usefixtures("quick_errors")
def test_the_luminance_factor_of_a_simulated_diffuser_is_its_reflectance() -> None:
    simulation = goniotwin.simulate("lambertian:reflectance=0.5", [30.0])
    # A Lambertian sample's luminance factor is its reflectance, whatever the direction.
    np.testing.assert_allclose(simulation.table[simulation.known], 0.5, rtol=1e-6)


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
    with pytest.raises(goniotwin.UserError, match=message):
        goniotwin.simulate(**{"sample": "lambertian", **arguments})


@pytest.mark.parametrize("path", [None, 3, b"a.journal"])
def test_what_is_not_a_path_is_refused(path: Any) -> None:
    with pytest.raises(goniotwin.UserError, match="journal"):
        goniotwin.open_journal(path)
    with pytest.raises(goniotwin.UserError, match="journal"):
        goniotwin.reduce_journal(path)


def test_a_file_that_is_not_a_journal_is_refused(tmp_path: Path) -> None:
    with pytest.raises(goniotwin.UserError, match=r"none\.journal"):
        goniotwin.open_journal(tmp_path / "none.journal")
