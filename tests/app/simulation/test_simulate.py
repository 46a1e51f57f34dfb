"""Simulations by the scheme of figure 7: both estimators, obstructed directions, files."""

import dataclasses
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from goniotwin.app.errors import UserError
from goniotwin.app.formats import DdrTable, read_ddr, read_points_csv, write_ddr
from goniotwin.app.rig import read_rig
from goniotwin.app.rig.samples import parse_sample
from goniotwin.app.simulation.estimate import EstimatorSettings
from goniotwin.app.simulation.files import bsdf_table, check_file_names, summary, write_simulation
from goniotwin.app.simulation.simulate import Simulation, Task, simulate
from goniotwin.twin.optics import Deviation, Instrument, evaluate, from_specular, light_direction, luminance_factor
from tests.conftest import Writer
from tests.sizes import few_check_rays
from tests.twin.optics.agreement import agree

pytestmark = pytest.mark.xdist_group("simulate")

# Detectors wider than the instrument's, so that many of few paths arrive at one.
WIDE = Instrument(detector_diameter_mm=30.0, field_deg=6.0)
OPEN = Instrument(obstruction=False)
FEW = {"polar_deg": np.arange(0.0, 86.0, 5.0), "azimuth_deg": np.arange(0.0, 181.0, 10.0)}
NEAR = {"polar_deg": np.arange(24.0, 36.5, 0.5), "azimuth_deg": np.arange(164.0, 181.0, 1.0)}
"""Detectors about the specular direction of 30 deg, with the default step."""
ALL_LONG = pytest.param({}, id="all detectors", marks=pytest.mark.long)
BROAD = "gaussian:width_deg=25,reflectance=0.4+lambertian:reflectance=0.3"


def task(sample: str = "gaussian:width_deg=5", sigmas: tuple[float, ...] = (30.0,), **settings: Any) -> Task:
    return Task(parse_sample(sample), np.array(sigmas), **settings)


def small(sample: str, **settings: Any) -> Task:
    """A task with a few detectors, so far apart that no path arrives at two."""
    grid = {"polar_deg": np.arange(5.0, 80.0, 12.0), "azimuth_deg": np.array([0.0, 60.0, 120.0, 180.0])}
    return task(sample, **{**grid, "instrument": WIDE, **settings})


TWO_OR_THREE = [
    pytest.param((0.0, 30.0), id="two sigmas"),
    pytest.param((0.0, 30.0, 60.0), id="three sigmas", marks=pytest.mark.long),
]


@pytest.fixture(scope="session", params=TWO_OR_THREE)
def some(request: pytest.FixtureRequest) -> Simulation:
    with few_check_rays():
        return simulate(task(sigmas=request.param))


def test_the_table_has_the_values_of_detectors_at_its_nodes(some: Simulation) -> None:
    for k, sigma in enumerate(some.task.sigma_deg.tolist()):
        nodes = from_specular(sigma, some.theta_deg[None, :], some.phi_deg[:, None])
        near = some.known[0, k] & (some.theta_deg[None, :] <= 10.0)
        assert near.sum() > 220
        expected = luminance_factor(OPEN, sigma, nodes[near], some.task.sample, rays=1024)
        # The error of the interpolation; a linear one would have 0.8 % rms for steps of 0.5 deg.
        relative = some.table[0, k][near] / expected - 1.0
        assert np.sqrt(np.mean(relative**2)) < 0.002
        assert np.max(np.abs(relative)) < 0.01


OFF = replace(OPEN, deviations={"mirror_3": Deviation(rx_deg=0.1)})
"""A tilt of a mirror out of the plane of incidence: the lobe is 0.2 deg beside it."""


@pytest.mark.usefixtures("quick_errors")
def test_a_rig_that_is_off_is_simulated_at_all_azimuths() -> None:
    """Against single detectors; one half of the azimuths and its mirror image would be 10 % wrong on the other side."""
    whole: dict[str, Any] = {"polar_deg": np.arange(24.0, 36.5, 1.0), "azimuth_deg": np.arange(170.0, 191.0, 2.0)}
    found = simulate(task(instrument=OFF, **whole, phi_deg=np.arange(0.0, 361.0, 30.0), theta_deg=np.arange(0.0, 5.0)))
    at = found.at[0]
    expected = luminance_factor(OFF, 30.0, at.directions, found.task.sample)
    np.testing.assert_allclose(at.ratio.factor[0], expected, rtol=1e-4)  # seven rays against 1,024
    sides = expected.reshape(13, 11)
    assert np.max(np.abs(sides[:, ::-1] / sides - 1.0)) > 0.1
    below = (found.phi_deg > 180.0) & (found.phi_deg < 360.0)
    near = found.theta_deg <= 4.0
    nodes = from_specular(30.0, found.theta_deg[None, near], found.phi_deg[below][:, None])
    table = found.table[0, 0][np.ix_(below, near)]
    expected = luminance_factor(OFF, 30.0, nodes.reshape(-1, 3), found.task.sample).reshape(table.shape)
    np.testing.assert_allclose(table, expected, rtol=0.02)


@pytest.mark.parametrize(
    ("instrument", "symmetric"),
    [
        (OPEN, True),
        (replace(OPEN, deviations={"arc": Deviation()}), True),
        (OFF, False),
        (replace(OPEN, illumination={"unit": Deviation(rx_deg=0.02)}), False),
    ],
)
def test_half_of_the_azimuths_is_enough_where_sample_and_rig_are_symmetric(instrument: Instrument, symmetric: bool) -> None:
    beyond = task(instrument=instrument, polar_deg=np.array([29.0, 31.0]), azimuth_deg=np.array([179.0, 181.0]))
    if symmetric:
        with pytest.raises(
            UserError, match="--azimuth: sample and rig are symmetric about the plane of incidence; give 0 to 180"
        ):
            simulate(beyond)
    else:
        assert simulate(beyond).phi_deg[-1] == 360.0


@pytest.mark.usefixtures("quick_errors")
@pytest.mark.parametrize("grid", [pytest.param(FEW, id="few detectors"), ALL_LONG])
def test_obstructed_directions_have_no_value_and_are_counted(some: Simulation, grid: dict[str, Any]) -> None:
    result = summary(some, [Path("a.ddr")])
    assert result["hidden_directions"]["0"] > 200  # mirror 3 stands in the specular direction
    assert result["obstruction"] is True
    at = some.at[0]
    assert np.all(np.isnan(at.ratio.factor[0, at.obstructed]))
    assert not some.known[0, 0, :, 0].any()
    assert some.known[0, 1, :, 0].all()
    text = "\n".join(bsdf_table(some).comments)
    assert "SIMULATED" in text
    assert "sigma 0, phi 0: theta 0 to 3.5" in text  # the zone of mirror 3 (its 20 mm seen at 200 mm, and the aperture)
    free = simulate(task(sigmas=(0.0,), instrument=OPEN, **grid))
    assert free.known[0, 0, :, 0].all()
    result = summary(free, [Path("a.ddr")])
    assert result["hidden_directions"] == {"0": 0}
    assert result["obstruction"] is False
    assert any(line.startswith("obstruction: off") for line in result["assumptions"])


@pytest.mark.usefixtures("quick_errors")
@pytest.mark.parametrize("grid", [pytest.param(NEAR, id="detectors near the lobe"), ALL_LONG])
def test_a_ddr_can_be_read_and_has_the_values(some: Simulation, grid: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "a.ddr"
    write_simulation(some, path)
    table = read_ddr(path)
    assert table.source == "Generated"
    assert table.symmetry == "PlaneSymmetrical"
    sigmas = some.task.sigma_deg.tolist()
    assert table.sigma_deg.tolist() == [*sigmas, 90.0]
    assert (table.phi_deg[0], table.phi_deg[-1], table.theta_deg[0], table.theta_deg[-1]) == (0.0, 180.0, 0.0, 180.0)
    assert table.channels == (None,)
    np.testing.assert_allclose(table.values[0, 0, :-1], some.table[0], rtol=1e-8, atol=1e-300)
    np.testing.assert_array_equal(table.values[0, 0, -1], table.values[0, 0, -2])
    # The file can be the sample of another simulation.
    again = simulate(task(f"table:{path}", **grid))
    assert again.table[0, 0, 0, 0] == pytest.approx(some.table[0, 1, 0, 0], rel=0.03)


def test_a_ddr_is_a_sample_of_a_rig_file_with_the_same_values(some: Simulation, write_rig: Writer, tmp_path: Path) -> None:
    write_simulation(some, tmp_path / "some.ddr")
    text = '[twin.samples.paper]\nmodel = "table"\nfile = "some.ddr"\n\n[twin.samples.etalon]'
    model = read_rig(write_rig(("[twin.samples.etalon]", text))).model()
    assert model is not None
    for k, sigma in enumerate(some.task.sigma_deg.tolist()):
        directions = from_specular(sigma, some.theta_deg[None, :], some.phi_deg[:, None])
        known = some.known[0, k]
        found = np.pi * evaluate(model.samples["paper"], light_direction(sigma), directions[known])
        np.testing.assert_allclose(found, some.table[0, k][known], rtol=1e-7, atol=1e-12)


def test_the_uncertainties_of_a_ddr_are_the_standard_errors(some: Simulation, tmp_path: Path) -> None:
    names = ("a.ddr", "a.u.ddr", "a.mask.ddr")
    assert write_simulation(some, tmp_path / "a.ddr") == tuple(tmp_path / name for name in names)
    table, u = read_ddr(tmp_path / "a.ddr"), read_ddr(tmp_path / "a.u.ddr")
    known = some.known[0]
    assert np.all(u.values[0, 0, :-1][~known] == table.values[0, 0, :-1][~known])
    for k, at in enumerate(some.at):
        # The node at theta 0 is the detector in the specular direction.
        here = np.argmin(np.abs(at.directions - from_specular(at.sigma_deg, 0.0, 0.0)).sum(axis=1))
        if known[k, 0, 0]:
            assert u.values[0, 0, k, 0, 0] == pytest.approx(at.ratio.standard_error[0, here], rel=1e-6)


def test_the_csv_has_every_detector_with_its_error(some: Simulation, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    write_simulation(some, path)
    points = read_points_csv(path)
    columns = points.columns
    assert any("SIMULATED" in line for line in points.comments)
    assert columns["sigma_deg"].size == sum(at.obstructed.size for at in some.at)
    seen = np.isfinite(columns["luminance_factor"])
    assert seen.sum() == summary(some, [path])["values"]
    ratio = columns["sample_m2sr"][seen] / columns["etalon_m2sr"][seen]
    np.testing.assert_allclose(ratio, columns["luminance_factor"][seen], rtol=1e-7)
    assert np.all(columns["flags"][~seen] == "hidden")
    assert np.all(columns["standard_error"][seen] > 0.0)


SPARSE = {name: angles[::4] for name, angles in NEAR.items()}


@pytest.mark.parametrize("grid", [pytest.param(SPARSE, id="every fourth detector near the lobe"), ALL_LONG])
def test_the_standard_errors_of_a_lobe_are_two_in_a_thousand_at_most(grid: dict[str, Any]) -> None:
    ratio = simulate(task(**grid)).at[0].ratio
    bright = ratio.factor > 1.0
    assert np.count_nonzero(bright) > 15
    assert np.all(ratio.standard_error[bright] < 2e-3 * ratio.factor[bright])


@pytest.mark.usefixtures("quick_errors")
@pytest.mark.parametrize("grid", [pytest.param(FEW, id="few detectors"), ALL_LONG])
def test_all_wavelengths_come_from_one_set_of_rays(grid: dict[str, Any], tmp_path: Path) -> None:
    simulation = simulate(task("lambertian:reflectance=0.5", wavelengths_nm=np.array([450.0, 650.0]), **grid))
    np.testing.assert_allclose(simulation.table[:, 0][:, simulation.known[0, 0]], 0.5, rtol=1e-9)
    write_simulation(simulation, tmp_path / "colour.ddr")
    assert read_ddr(tmp_path / "colour.ddr").channels == (450.0, 650.0)
    # A sample with a spectrum has its own list of wavelengths.
    spectral = simulate(task(f"table:{tmp_path / 'colour.ddr'}", **grid))
    assert spectral.wavelengths_nm is not None
    assert spectral.wavelengths_nm.tolist() == [450.0, 650.0]


def test_the_forward_estimator_simulates_each_wavelength_of_a_spectral_sample(tmp_path: Path) -> None:
    values = np.array([0.25, 0.5])[:, None, None, None, None] * np.ones((1, 2, 2, 2))
    ends = np.array([0.0, 90.0]), np.array([0.0, 180.0]), np.array([0.0, 180.0])
    write_ddr(tmp_path / "a.ddr", DdrTable("Measured", "PlaneSymmetrical", np.zeros(1), *ends, (450.0, 650.0), values))
    simulation = simulate(small(f"table:{tmp_path / 'a.ddr'}", estimator=EstimatorSettings("forward", paths=200_000))).at[0]
    many = simulation.ratio.standard_error[0] < 0.15 * simulation.ratio.factor[0]
    assert np.count_nonzero(many) >= 15
    for row, expected in enumerate((0.25, 0.5)):
        value, error = simulation.ratio.factor[row, many], simulation.ratio.standard_error[row, many]
        agree(value, error, np.full(value.shape, expected), 0.0)


@pytest.mark.usefixtures("quick_errors")
@pytest.mark.parametrize("grid", [pytest.param(NEAR, id="detectors near the lobe"), ALL_LONG])
def test_transmitted_light_has_its_own_table(grid: dict[str, Any], tmp_path: Path) -> None:
    simulation = simulate(task("gaussian:width_deg=5,transmits=true", (0.0, 30.0), transmitted=True, instrument=OPEN, **grid))
    # The lobe goes straight through: theta = 0, as in reflection.
    mirrored = simulate(task("gaussian:width_deg=5", (0.0, 30.0), instrument=OPEN, **grid))
    near = simulation.theta_deg <= 10.0
    np.testing.assert_allclose(simulation.table[..., near], mirrored.table[..., near], rtol=1e-6)
    write_simulation(simulation, tmp_path / "a.ddt")
    assert read_ddr(tmp_path / "a.ddt").values.max() == pytest.approx(simulation.table.max())


# The forward estimator is slow, so it has few paths here; its long tests are with the optics.
@pytest.mark.usefixtures("quick_errors")
@pytest.mark.parametrize("sample", ["lambertian:reflectance=0.8", "gaussian:width_deg=25"])
@pytest.mark.parametrize("sigma_deg", [0.0, 50.0])
def test_both_estimators_agree_within_their_errors(sample: str, sigma_deg: float) -> None:
    fast = simulate(small(sample, sigmas=(sigma_deg,))).at[0]
    settings = EstimatorSettings("forward", paths=200_000, seed=3)
    forward = simulate(small(sample, sigmas=(sigma_deg,), estimator=settings)).at[0]
    assert np.array_equal(fast.obstructed, forward.obstructed)
    # With few paths the error itself is uncertain.
    many = (forward.ratio.standard_error < 0.15 * forward.ratio.factor)[0]
    # It is uncertain too where the lobe is nearly zero and a few paths give all of the value.
    many &= fast.ratio.factor[0] > 1e-4
    assert np.count_nonzero(many) >= 15
    agree(forward.ratio.factor[0, many], forward.ratio.standard_error[0, many], fast.ratio.factor[0, many], 0.0)


def test_the_same_seed_gives_the_same_bits() -> None:
    def numbers(seed: int) -> bytes:
        simulation = simulate(small("lambertian", estimator=EstimatorSettings("forward", paths=20_000, seed=seed)))
        return simulation.table.tobytes() + simulation.at[0].ratio.standard_error.tobytes()

    assert numbers(1) == numbers(1)
    assert numbers(1) != numbers(2)
    first, second = (simulate(small(BROAD)) for _ in range(2))
    assert first.table.tobytes() == second.table.tobytes()


def test_either_estimator_reaches_a_given_error() -> None:
    coarse = simulate(small("lambertian", estimator=EstimatorSettings("forward", error_percent=8.0)))
    assert coarse.at[0].ratio.median_percent <= 8.0
    result = summary(coarse, [Path("a.ddr")])
    assert result["paths"] >= 2 << 20
    assert result["median_relative_standard_error_percent"] <= 8.0 <= 100.0
    fine = simulate(small("gaussian:width_deg=25", estimator=EstimatorSettings(error_percent=4e-3)))
    assert fine.at[0].ratio.median_percent <= 4e-3
    assert summary(fine, [Path("a.ddr")])["rays"] > 7
    with pytest.raises(UserError, match=r"--error"):
        simulate(small("gaussian:width_deg=25", estimator=EstimatorSettings(error_percent=1e-9)))


def test_a_detector_without_paths_is_counted_and_has_no_error() -> None:
    simulation = simulate(task(sigmas=(60.0,), instrument=OPEN, estimator=EstimatorSettings("forward", paths=20_000)))
    at = simulation.at[0]
    assert at.missed.sum() > 100
    assert not at.obstructed.any()
    assert summary(simulation, [Path("a.ddr")])["directions_without_hits"]["60"] == at.missed.sum()
    assert np.all(np.isnan(at.ratio.standard_error[0, at.missed]))


def test_progress_is_reported_from_0_to_1() -> None:
    fractions: list[float] = []
    simulate(small("lambertian", sigmas=(0.0, 30.0)), lambda fraction, step: fractions.append(fraction))
    assert fractions[0] == 0.0
    assert fractions[-1] == 1.0
    assert fractions == sorted(fractions)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"polar_deg": np.array([1.0, 2.0])}, "--azimuth: give both"),
        ({"polar_deg": np.array([1.0]), "azimuth_deg": np.array([0.0, 1.0])}, "at least two"),
        ({"polar_deg": np.array([1.0, 2.0]), "azimuth_deg": np.array([0.0, 270.0])}, "--azimuth"),
        ({"transmitted": True}, "transmits no light"),
    ],
)
def test_an_impossible_task_is_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError, match=message):
        simulate(dataclasses.replace(task(), **change))


@pytest.mark.parametrize(
    "settings",
    [
        {"paths": 1000},
        {"kind": "forward", "rays": 8},
        {"rays": 9},
        {"rays": 0},
        {"kind": "forward", "paths": 1},
        {"rays": 8, "error_percent": 1.0},
        {"error_percent": 0.0},
        {"error_percent": float("nan")},
        {"seed": -1},
    ],
)
def test_settings_that_an_estimator_does_not_have_are_refused(settings: dict[str, Any]) -> None:
    with pytest.raises(UserError, match=r"^--"):
        EstimatorSettings(**settings)


def test_invalid_file_names_are_refused(tmp_path: Path) -> None:
    own = tmp_path / "a.ddr"
    for names in (["a.txt"], ["absent/a.ddr"], ["a.ddr", "a.ddr"], ["a.ddr", "a.ddt"], ["a.ddr"]):
        with pytest.raises(UserError):
            check_file_names([tmp_path / name for name in names], [own], False)
    (tmp_path / "b.u.ddr").write_text("notes of the user", encoding="utf-8")
    with pytest.raises(UserError, match=r"b\.u\.ddr, and another file is there"):
        check_file_names([tmp_path / "b.ddr"], [own], False)
    assert check_file_names([tmp_path / "b.csv"], [own], False) is False
    assert check_file_names([tmp_path / "b.ddt"], [own], False) is True


@pytest.mark.usefixtures("quick_errors")
def test_a_broad_sample_gives_its_own_bsdf() -> None:
    # For a lobe much wider than the aperture the ratio of the instrument is pi times the BSDF.
    simulation = simulate(task(BROAD, instrument=OPEN))
    nodes = from_specular(30.0, simulation.theta_deg[None, :], simulation.phi_deg[:, None])
    known = simulation.known[0, 0] & (simulation.theta_deg[None, :] <= 30.0)
    expected = np.pi * evaluate(simulation.task.sample, light_direction(30.0), nodes[known])
    np.testing.assert_allclose(simulation.table[0, 0][known], expected, rtol=5e-3)
