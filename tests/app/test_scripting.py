"""The public API of `import goniotwin`: journals and simulations for scripts."""

from pathlib import Path

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


def test_the_luminance_factor_of_a_simulated_diffuser_is_its_reflectance() -> None:
    simulation = goniotwin.simulate("lambertian:reflectance=0.5", [30.0])
    # A Lambertian sample's luminance factor is its reflectance, whatever the direction.
    np.testing.assert_allclose(simulation.table[simulation.known], 0.5, rtol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(("mirror", [30.0]), "mirror"), (("lambertian", [90.0]), "sigma_deg"), (("lambertian", [30.0, 0.0]), "sigma_deg")],
)
def test_invalid_arguments_are_refused(arguments: tuple[str, list[float]], message: str) -> None:
    with pytest.raises(goniotwin.UserError, match=message):
        goniotwin.simulate(*arguments)


def test_a_file_that_is_not_a_journal_is_refused(tmp_path: Path) -> None:
    with pytest.raises(goniotwin.UserError, match=r"none\.journal"):
        goniotwin.open_journal(tmp_path / "none.journal")
