"""The results of a dataset by their light: the pictures have the values of `goniotwin.open`; a long journal comes in parts."""

from pathlib import Path

import numpy as np
import pytest

import goniotwin
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.data.comparison import THEORY, compare, theory
from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.opening import LONG_ROWS, open_in_parts
from goniotwin.app.data.results import PREDICTION, Results, View
from goniotwin.app.figures.hemisphere import EDGE_DEG, PIXELS
from goniotwin.app.rig import read_rig
from tests.app.campaign.reduction.long_journal import write_long_journal
from tests.conftest import RIG, SMALL

HEMISPHERE = (
    SMALL.replace("[550]", "[500, 550, 600]")
    .replace("beta_deg = [180]", "beta_deg = { start = 0, stop = 340, step = 20 }")
    .replace("shift_deg = [0, 1]", "shift_deg = [0]")
)


@pytest.fixture(scope="module")
def journal(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A hemisphere at three wavelengths."""
    path = tmp_path_factory.mktemp("results") / "hemisphere.journal"
    run_without_wires(make_plan(parse_schedule(HEMISPHERE, "hemisphere.toml"), read_rig(RIG)), path)
    return path


@pytest.fixture(scope="module")
def dataset(journal: Path) -> Dataset:
    return goniotwin.open(journal)


def test_a_plane_through_the_cursor_has_the_directions_of_that_azimuth_on_both_sides(dataset: Dataset) -> None:
    results = Results(dataset)
    light = results.lights[0]
    shown = results.show(View(light, "cursor", _place(40.0, 120.0)))
    at = shown.data.column("azimuth_deg")[shown.plane]
    assert set(np.round(at[shown.data.column("polar_deg")[shown.plane] > 0.0] % 180.0, 6)) <= {120.0, 60.0}  # with images
    assert shown.plane_deg == pytest.approx(120.0)
    assert (np.diff(shown.abscissa) >= 0.0).all()
    assert shown.abscissa.min() < -60.0 < 60.0 < shown.abscissa.max()
    assert shown.beside is not None
    assert "120 deg" in shown.beside.x.label
    (series,) = shown.beside.series
    there = np.isfinite(series.y)
    values = shown.data.column("bsdf")[shown.plane]
    assert np.isin(np.round(series.y[there], 12), np.round(values, 12)).all()


def test_the_spectrum_at_the_cursor_has_the_values_of_its_direction(dataset: Dataset) -> None:
    results = Results(dataset)
    at = int(np.flatnonzero((dataset.theta_deg > 5.0) & (dataset.theta_deg < 15.0) & dataset.good)[0])
    polar, azimuth = float(dataset.polar_deg[at]), float(dataset.azimuth_deg[at])
    shown = results.show(View(results.lights[0], "spectrum", _place(polar, azimuth)))
    assert shown.beside is not None, shown.missing
    (series,) = shown.beside.series
    every = dataset.where((np.abs(dataset.polar_deg - polar) < 1e-6) & (np.abs(dataset.azimuth_deg - azimuth) < 1e-6))
    assert every.size == 3
    np.testing.assert_array_equal(series.x, every.wavelength_nm)
    np.testing.assert_array_equal(series.y, every.bsdf)
    single = Results(dataset.select(wavelength_nm=500.0))
    assert "no spectrum" in single.show(View(single.lights[0], "spectrum")).missing


def test_a_comparison_has_the_deviations_that_compare_gives(dataset: Dataset, journal: Path, tmp_path: Path) -> None:
    results = Results(dataset)
    light = results.lights[1]
    here = dataset.select(wavelength_nm=550.0)
    (found,) = compare(here, theory(here)).lights
    shown = results.show(View(light, other=THEORY))
    assert shown.compared is not None
    np.testing.assert_array_equal(shown.compared[2, found.index], found.z)
    np.testing.assert_array_equal(shown.compared[0, found.index], found.second)
    assert np.isnan(np.delete(shown.compared[2], found.index)).all()
    assert f"chi-square with the covariance {found.chi_square:.4g} of {found.degrees}" in shown.about
    assert shown.map.bar.colours == "deviations"
    assert shown.residual is not None
    drawn = np.concatenate([each.y for each in shown.residual.series])
    np.testing.assert_array_equal(np.sort(drawn), np.sort(shown.compared[2, shown.plane]))
    predicted = Results(dataset, journal).show(View(light, other=PREDICTION))
    assert predicted.compared is not None
    assert np.isfinite(predicted.compared[2]).sum() > 100
    assert np.nanmean(predicted.compared[2] ** 2) < 2.0
    assert np.nanmax(np.abs(predicted.compared[2])) > 0.05  # of another noise
    here.save(tmp_path / "same.csv")
    same = results.show(View(light, other=tmp_path / "same.csv"))
    assert same.compared is not None
    assert np.nanmax(np.abs(same.compared[0] - here.bsdf)) <= 1e-6 * np.nanmax(here.bsdf)
    other = results.show(View(results.lights[0], other=tmp_path / "same.csv"))
    assert other.compared is None
    assert other.about.startswith("not compared: ")
    assert other.beside is not None


def test_the_image_of_a_map_is_linear_between_its_directions() -> None:
    polar, azimuth = (each.ravel() for each in np.meshgrid(np.arange(5.0, 85.0, 5.0), np.arange(0.0, 360.0, 10.0)))
    x = polar * np.cos(np.radians(azimuth - 180.0))
    table = {
        "sigma_deg": np.full(polar.size, 30.0),
        "polar_deg": polar,
        "azimuth_deg": azimuth,
        "bsdf": 2.0 + 0.01 * x,
    }
    results = Results(Dataset.from_table(table))
    shown = results.show(View(results.lights[0]))
    assert shown.image is not None
    low, high = shown.map.bar.limits
    middle = EDGE_DEG * ((np.arange(PIXELS) + 0.5) * 2.0 / PIXELS - 1.0)
    across, up = np.meshgrid(middle, middle)
    inside = np.hypot(across, up) < 74.0
    expected = (2.0 + 0.01 * across - low) / (high - low)
    np.testing.assert_allclose(shown.image[inside], expected[inside], atol=1e-9)
    assert np.isnan(shown.image[np.hypot(across, up) > 81.0]).all()


def test_a_long_journal_comes_in_parts_and_the_first_one_has_the_values_of_the_whole(tmp_path: Path) -> None:
    write_long_journal(tmp_path / "long.journal", 1, LONG_ROWS // 10 + 10, step_deg=0.01)
    first, whole = open_in_parts(tmp_path / "long.journal")
    assert whole.size > first.size > 0
    assert "one setting" in first.notes[0]
    (light,) = first.only.lights
    same = whole.select(sigma_deg=light.sigma_deg, wavelength_nm=light.wavelength_nm)
    order, order_of_whole = (np.lexsort((each.bsdf, each.phi_deg, each.theta_deg)) for each in (first, same))
    for name in ("bsdf", "u", "theta_deg", "flags"):  # those of the whole are in the order of time
        np.testing.assert_array_equal(getattr(first, name)[order], getattr(same, name)[order_of_whole])
    write_long_journal(tmp_path / "short.journal", 1, 2)
    assert len(list(open_in_parts(tmp_path / "short.journal"))) == 1


def _place(polar_deg: float, azimuth_deg: float) -> tuple[float, float]:
    """The place of a direction in a map whose light is left."""
    turn = np.radians(azimuth_deg - 180.0)
    return float(polar_deg * np.cos(turn)), float(polar_deg * np.sin(turn))
