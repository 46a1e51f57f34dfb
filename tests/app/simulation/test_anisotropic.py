"""Anisotropic samples: values at each azimuth psi of the light, in every file."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import goniotwin
from goniotwin.app.data.opening import open_dataset
from goniotwin.app.data.simulation import dataset_of_simulation
from goniotwin.app.errors import UserError
from goniotwin.app.formats import BsdfTable, registry
from goniotwin.app.formats.content import BsdfFile
from goniotwin.app.rig.samples import MeasuredTable, parse_sample, sample_scatterer
from goniotwin.app.simulation.files import check_file_names, summary, task_of_files, write_simulation
from goniotwin.app.simulation.simulate import Simulation, Task, simulate
from goniotwin.twin.optics import Instrument
from tests.sizes import few_check_rays

pytestmark = [pytest.mark.usefixtures("quick_errors"), pytest.mark.xdist_group("anisotropic")]
WARD = "ward:alpha_x=0.3,alpha_y=0.5,direction_deg=20"
FEW = {"polar_deg": np.arange(10.0, 75.0, 20.0), "azimuth_deg": np.arange(0.0, 361.0, 45.0)}


def task(sample: str = WARD, **settings: Any) -> Task:
    return Task(parse_sample(sample), np.array([30.0]), **{"instrument": Instrument(obstruction=False), **FEW, **settings})


@pytest.fixture(scope="module")
def turned() -> Simulation:
    with few_check_rays():
        return simulate(task(psi_deg=np.array([0.0, 50.0, 180.0])))


def agrees(dataset: goniotwin.Dataset, sample: str) -> None:
    """The values are those of the model at the light's azimuth, up to the size of the aperture."""
    truth = goniotwin.theory(dataset, sample)
    near = dataset.good & (truth.bsdf > 0.05)
    assert near.sum() > 20
    np.testing.assert_allclose(dataset.bsdf[near], truth.bsdf[near], rtol=2e-3)


@pytest.mark.parametrize(("back", "transmitted"), [(False, True), (True, False), (True, True)])
def test_each_psi_has_the_values_of_the_model_on_every_side(back: bool, transmitted: bool) -> None:
    sample = f"{WARD},side={'back' if back else 'front'},transmits={'true' if transmitted else 'false'}"
    found = simulate(task(sample, psi_deg=np.array([0.0, 50.0]), back=back, transmitted=transmitted))
    dataset = dataset_of_simulation(found)
    assert np.unique(dataset.psi_deg).tolist() == [0.0, 50.0]
    agrees(dataset, sample)


def test_the_values_turn_with_psi_and_are_the_same_after_half_a_turn(turned: Simulation) -> None:
    agrees(dataset_of_simulation(turned), WARD)
    first, second, third = (at.ratio.factor for at in turned.at)
    assert np.abs(second / first - 1.0).max() > 0.1
    np.testing.assert_array_equal(third, first)
    counts = summary(turned, [Path("a.ddr")])
    assert (counts["psi"], counts["detectors"]["30"]) == ([0.0, 50.0, 180.0], 3 * first.size)


@pytest.mark.parametrize("name", ["a.csv", "a.astm", "a.brdf", "a.h5"])
def test_files_of_points_have_the_psi(turned: Simulation, name: str, tmp_path: Path) -> None:
    write_simulation(turned, tmp_path / name)
    dataset = open_dataset(tmp_path / name)
    assert np.unique(dataset.psi_deg).tolist() == [0.0, 50.0, 180.0]
    agrees(dataset, WARD)


def test_a_table_has_the_psi_and_is_a_sample_with_the_same_psi(turned: Simulation, tmp_path: Path) -> None:
    write_simulation(turned, tmp_path / "a.ddr")
    table = registry.read(tmp_path / "a.ddr").only_table()
    assert table.psi_deg.tolist() == [0.0, 50.0, 180.0]
    np.testing.assert_allclose(np.pi * table.values[0, 1, 1], turned.table[1, 0], rtol=1e-8)  # sigma 0 repeats the first
    assert task(f"table:{tmp_path / 'a.ddr'}").psis_deg.tolist() == [0.0, 50.0, 180.0]


def test_the_psi_of_a_table_with_symmetry_go_round(tmp_path: Path) -> None:
    ends = np.array([0.0, 90.0]), np.array([0.0, 180.0, 360.0]), np.array([0.0, 180.0])
    values = np.ones((1, 3, 2, 3, 2))
    registry.format_named("archive", registry.BSDF).write(
        tmp_path / "a.h5", BsdfFile((BsdfTable(*ends, 0.1 * values, psi_deg=np.array([0.0, 30.0, 90.0])),))
    )
    # The key has no form in one line of text.
    sample = sample_scatterer(MeasuredTable(model="table", file="a.h5", symmetry="orthotropic"), tmp_path, "paper")
    psis = Task(sample, np.array([30.0])).psis_deg
    assert psis.tolist() == [0.0, 30.0, 90.0, 150.0, 180.0, 210.0, 270.0, 330.0]


def test_the_default_of_a_formula_goes_round_in_steps_and_an_isotropic_sample_has_one() -> None:
    assert task().psis_deg.tolist() == np.arange(0.0, 360.0, 15.0).tolist()
    assert task("gaussian:width_deg=5").psis_deg.tolist() == [0.0]
    assert task("anisotropic-gaussian:along_deg=5,across_deg=5").psis_deg.tolist() == [0.0]
    # Of a lobe that transmits, reflected light does not depend.
    assert task(f"gaussian:width_deg=5,reflectance=0.2+{WARD},transmits=true").psis_deg.tolist() == [0.0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sample": "gaussian:width_deg=5", "psi_deg": np.array([0.0, 30.0])}, "--psi: this sample is isotropic"),
        ({"psi_deg": np.array([0.0, 360.0])}, "--psi: 360 is out of range"),
    ],
)
def test_an_impossible_psi_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        simulate(task(**change))


def test_a_table_of_one_psi_states_so(tmp_path: Path) -> None:
    one = simulate(task(psi_deg=np.array([50.0])))
    write_simulation(one, tmp_path / "a.ddr")
    table = registry.read(tmp_path / "a.ddr").only_table()
    assert table.phi_deg[-1] == 360.0
    assert any("simulated at psi 50 deg alone" in line for line in table.comments)


def test_a_named_format_is_that_of_the_files_with_its_suffix(tmp_path: Path) -> None:
    own = [tmp_path / "a.bsdf", tmp_path / "a.csv"]
    assert check_file_names(own, [], False, "rgl") is False
    assert task_of_files(task(), own, "rgl").psis_deg.size == 24
    with pytest.raises(UserError, match=r"--format: no --out has a suffix of rgl: \.bsdf"):
        check_file_names(own[1:], [], False, "rgl")
    with pytest.raises(UserError, match="format 'merl'"):
        check_file_names(own, [], False, "merl")
