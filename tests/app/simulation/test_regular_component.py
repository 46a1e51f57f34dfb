"""The regular component: the table has what the detectors see of it, and files and summary state this."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from goniotwin.app.data.simulation import dataset_of_simulation
from goniotwin.app.errors import UserError
from goniotwin.app.formats import registry
from goniotwin.app.rig.samples import parse_sample
from goniotwin.app.simulation.files import assumptions, summary, task_of_files, write_simulation
from goniotwin.app.simulation.simulate import Simulation, Task, regular_half_angle_deg, simulate
from goniotwin.twin.optics import Instrument, apply_spectrum, lambertian, regular, specular_direction, throughput
from tests.sizes import few_check_rays

pytestmark = [pytest.mark.usefixtures("quick_errors"), pytest.mark.xdist_group("regular component")]
OPEN = Instrument(obstruction=False)


def simulate_sample(sample: str, sigmas: tuple[float, ...] = (30.0,), **settings: Any) -> Simulation:
    few = {
        "polar_deg": np.concatenate([[0.0, 10.0, 20.0], np.arange(28.0, 32.1, 0.5), [40.0, 60.0, 85.0]]),
        "azimuth_deg": np.concatenate([[0.0, 60.0, 120.0, 160.0], np.arange(176.0, 180.1, 1.0)]),
    }
    return simulate(Task(parse_sample(sample), np.array(sigmas), **{"instrument": OPEN, **few, **settings}))


def test_its_luminance_factor_is_the_throughput_in_the_mirror_direction_over_the_etalons() -> None:
    mirror = simulate_sample("regular:reflectance=0.9")
    directions = specular_direction(30.0)[None]
    expected = throughput(OPEN, 30.0, directions, regular(0.9)) / throughput(OPEN, 30.0, directions, lambertian())
    assert mirror.table[0, 0, :, 0] == pytest.approx(np.full(mirror.phi_deg.size, expected[0]), rel=1e-6)
    assert expected[0] > 1000.0  # all of the light within 1 deg
    at = mirror.at[0]
    theta = np.degrees(np.arccos(np.clip(at.directions @ specular_direction(30.0), -1.0, 1.0)))
    assert np.all(at.ratio.factor[0, theta > regular_half_angle_deg(OPEN)] == 0.0)
    assert np.all(at.ratio.factor[0, theta < 0.5] > 0.0)


@pytest.mark.parametrize("transmitted", [False, True])
def test_in_a_sum_it_is_added_to_the_other_models(transmitted: bool) -> None:
    way = ",transmits=true" if transmitted else ""
    rest = "lambertian:reflectance=0.4,transmittance=0.3"
    whole = simulate_sample(f"{rest}+regular:reflectance=0.04{way}", transmitted=transmitted)
    parts = [simulate_sample(each, transmitted=transmitted) for each in (rest, f"regular:reflectance=0.04{way}")]
    np.testing.assert_allclose(whole.table, parts[0].table + parts[1].table, rtol=1e-9)
    assert whole.table[0, 0, 0, -1] == pytest.approx(0.3 if transmitted else 0.4)


def test_the_assumptions_give_its_direction_and_that_its_factor_depends_on_the_instrument() -> None:
    mirror = simulate_sample("lambertian:reflectance=0.5+regular:reflectance=0.04", (0.0, 30.0), instrument=Instrument())
    hidden, seen = summary(mirror, [Path("a.ddr")])["regular"]
    # At normal incidence mirror 3 is in the mirror direction.
    assert (hidden["sigma"], hidden["hidden"], hidden["largest_luminance_factor"]) == (0.0, True, None)
    assert (seen["sigma"], seen["share"], seen["polar_deg"], seen["azimuth_deg"]) == (30.0, 0.04, 30.0, 180.0)
    assert seen["largest_luminance_factor"] == pytest.approx(mirror.table[0, 1, 0, 0], rel=1e-6)
    text = "\n".join(assumptions(mirror))
    assert "regular component: 0.04 of the light leaves in the mirror direction, theta = 0" in text
    assert "not a property of the sample" in text
    assert "no detector sees it at sigma 0" in text
    plain = simulate_sample("lambertian:reflectance=0.5")
    assert summary(plain, [Path("a.ddr")])["regular"] == []
    assert "regular" not in "\n".join(assumptions(plain))


def test_a_component_of_the_other_side_is_not_listed() -> None:
    both = "lambertian:reflectance=0.5,side=both+regular:reflectance=0.04,side=back"
    assert summary(simulate_sample(both), [Path("a.ddr")])["regular"] == []
    (peak,) = summary(simulate_sample(both, back=True), [Path("a.ddr")])["regular"]
    assert peak["share"] == 0.04
    assert peak["largest_luminance_factor"] > 10.0


def test_a_refracted_lobe_has_the_direction_of_snells_law() -> None:
    refracted = simulate_sample(
        "gaussian:width_deg=3,transmits=true,refraction=1.5", transmitted=True, polar_deg=None, azimuth_deg=None
    )
    axis = np.degrees(np.arcsin(np.sin(np.radians(30.0)) / 1.5))
    at = refracted.at[0]
    brightest = at.directions[np.argmax(at.ratio.factor[0])]
    assert np.degrees(np.arccos(-brightest[2])) == pytest.approx(axis, abs=1e-6)
    assert any(f"polar angles {axis:.2f} at sigma 30" in line for line in assumptions(refracted))


PAINT = "lambertian:reflectance=0.5+regular:reflectance=0.04"


@pytest.fixture(scope="module")
def apart() -> Simulation:
    with few_check_rays():
        return simulate_sample(PAINT, (30.0,), regular="apart", wavelengths_nm=np.array([450.0, 650.0]))


def test_apart_it_is_no_spike_in_the_values_but_a_factor(apart: Simulation) -> None:
    np.testing.assert_allclose(apart.table[apart.known], 0.5, rtol=1e-9)
    assert apart.regular is not None
    assert apart.regular.values.tolist() == [[[0.04]], [[0.04]]]
    result = summary(apart, [Path("a.ddr"), Path("a.sdr")])
    assert result["regular"] == []
    assert result["regular_apart"] == [{"sigma": 30.0, "share": [0.04, 0.04]}]
    assert any("it is no part of the values" in line for line in result["assumptions"])
    dataset = dataset_of_simulation(apart)
    assert dataset.only.regular[0].values.tolist() == apart.regular.values.tolist()


def test_every_file_has_what_it_can_hold_and_what_is_omitted_is_stated(apart: Simulation, tmp_path: Path) -> None:
    paths = [tmp_path / f"a{suffix}" for suffix in (".ddr", ".sdr", ".ssdd", ".csv", ".h5")]
    for path in paths:
        write_simulation(apart, path)
    kinds = {path.suffix: [type(part).__name__ for part in registry.recognise(path).read(path).parts] for path in paths}
    assert kinds == {
        ".ddr": ["BsdfTable"],
        ".sdr": ["RegularTable"],
        ".ssdd": ["BsdfTable", "RegularTable"],
        ".csv": ["ScatteredBsdf"],
        ".h5": ["BsdfTable", "ScatteredBsdf", "RegularTable"],
    }
    (factors,) = registry.read(tmp_path / "a.sdr").regular
    assert (factors.values.tolist(), factors.generated) == ([[[0.04]], [[0.04]]], True)
    notes = summary(apart, paths)["notes"]
    assert [note.split(": ", 1)[0] for note in notes] == [str(tmp_path / name) for name in ("a.ddr", "a.sdr", "a.csv")]
    assert "without the regular component, which is in" in notes[0]
    assert "the scattered part is omitted" in notes[1]
    # The file is the same sample again.
    again = simulate_sample(f"table:{tmp_path / 'a.ssdd'}", regular="alone")
    assert again.regular is not None
    assert again.regular.values.tolist() == [[[0.04]], [[0.04]]]


@pytest.mark.parametrize(
    ("names", "regular"),
    [(["a.ddr", "a.csv"], "seen"), (["a.ddr", "a.sdr"], "apart"), (["a.h5"], "apart"), (["a.sdr"], "alone")],
)
def test_the_files_decide_whether_it_is_apart(names: list[str], regular: str, tmp_path: Path) -> None:
    found = task_of_files(Task(parse_sample(PAINT), np.array([30.0])), [tmp_path / name for name in names])
    assert found.regular == regular
    assert task_of_files(Task(parse_sample("lambertian"), np.array([30.0])), [tmp_path / "a.h5"]).regular == "seen"


def test_alone_it_takes_no_rays(tmp_path: Path) -> None:
    mirror = simulate_sample("regular:reflectance=0.9,side=back", (0.0, 30.0), regular="alone", back=True)
    assert mirror.at == ()
    assert summary(mirror, [tmp_path / "a.sdr"])["notes"] == []
    write_simulation(mirror, tmp_path / "a.sdr")
    (part,) = registry.read(tmp_path / "a.sdr").regular
    assert (part.values.ravel().tolist(), part.back) == ([0.9, 0.9], True)


@pytest.mark.parametrize(
    ("sample", "names", "message"),
    [
        ("lambertian", ["a.sdr"], r"holds regular reflectance or transmittance, and 'lambertian' has none here"),
        ("lambertian+regular:side=back", ["a.sdr"], r"has none here"),
        ("regular", ["a.sdr", "a.ddr"], r"a\.ddr: the sample has nothing but a regular component"),
    ],
)
def test_a_file_for_which_there_is_nothing_is_refused(sample: str, names: list[str], message: str, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=message):
        task_of_files(Task(parse_sample(sample), np.array([30.0])), [tmp_path / name for name in names])


def test_its_share_follows_the_spectrum() -> None:
    sample = apply_spectrum([450.0, 650.0], [1.0, 0.5], regular(0.04))
    found = simulate(Task(sample, np.array([30.0]), regular="alone"))
    assert found.regular is not None
    np.testing.assert_allclose(found.regular.values[:, 0, 0], [0.04, 0.02])
