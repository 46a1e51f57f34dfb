"""The dataset of `goniotwin.open`: samples, columns and selection."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import goniotwin
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.data.conversion import Choice, convert_reduced, format_to_write
from goniotwin.app.data.opening import dataset_of_file
from goniotwin.app.data.values import COLUMNS
from goniotwin.app.formats import registry, writing
from goniotwin.app.formats.content import BsdfFile, ScatteredBsdf
from goniotwin.app.formats.registry import Holds
from goniotwin.app.formats.table import BsdfTable
from tests.app.data.made import gaussian, table

PUBLIC: Any = goniotwin
"""For calls that a type checker refuses, too."""


def scattered(sample: str, psi_deg: float = 0.0) -> ScatteredBsdf:
    """Values of one light on three rings."""
    polar, azimuth = (each.ravel() for each in np.meshgrid([0.0, 20.0, 40.0], [0.0, 90.0, 180.0, 270.0], indexing="ij"))
    n = polar.size
    return ScatteredBsdf(np.full(n, 30.0), np.full(n, psi_deg), polar, azimuth, np.arange(1.0, n + 1.0), sample=sample)


def test_a_journal_has_the_values_of_its_reduction(dataset: goniotwin.Dataset, journal: Path) -> None:
    with Journal.open(journal) as opened:
        points = reduce_journal(opened).samples["gaussian-5"]
    assert dataset.samples == ("gaussian-5",)
    assert dataset.origin == "journal"
    assert dataset.simulated
    assert "SIMULATED" in repr(dataset)
    np.testing.assert_array_equal(dataset.bsdf, points.bsdf)
    np.testing.assert_array_equal(dataset.u, points.u_bsdf)
    np.testing.assert_array_equal(dataset.good, points.good)
    np.testing.assert_array_equal(dataset.photodiode, points.photodiode)
    for name, flag in points.flags.items():
        assert [name in each.split() for each in dataset.flags] == flag.tolist()
    # The specular coordinates of the reduction are those of the directions, in the other way to them.
    theta, phi = dataset.only.values.specular()
    np.testing.assert_allclose(dataset.theta_deg, theta, atol=1e-6)
    np.testing.assert_allclose(np.cos(np.radians(dataset.phi_deg - phi)), 1.0, atol=1e-12)


def test_nothing_is_left_open(journal: Path) -> None:
    opened = goniotwin.open(journal)
    journal.rename(journal.with_suffix(".away"))
    try:
        assert opened.only.measured is not None
        history = opened.only.measured.settings.history
        assert history is not None
        assert history.mounted(opened.only.measured.points.row)[0]
    finally:
        journal.with_suffix(".away").rename(journal)


def test_all_columns_have_one_length(dataset: goniotwin.Dataset) -> None:
    assert {getattr(dataset, name).shape for name in (*COLUMNS, "luminance_factor", "good")} == {(dataset.size,)}


def test_samples_are_never_mixed() -> None:
    both = dataset_of_file(BsdfFile((scattered("paper"), scattered("steel"), scattered("paper", 90.0))), "two.csv")
    assert both.samples == ("paper", "steel")
    assert list(both) == ["paper", "steel"]
    assert "paper" in both
    assert both["paper"].size == 24
    assert both["paper"].psi_deg.tolist() == [0.0] * 12 + [90.0] * 12
    assert np.isnan(both["steel"].u).all()
    for name in (*COLUMNS, "good", "luminance_factor"):
        with pytest.raises(goniotwin.GoniotwinError, match="'paper', 'steel'"):
            getattr(both, name)
    with pytest.raises(goniotwin.GoniotwinError, match=r"several samples"):
        both.select(sigma_deg=30)
    with pytest.raises(goniotwin.GoniotwinError, match="'wood'; it has 'paper', 'steel'"):
        both["wood"]


def test_a_table_keeps_its_axes_also_at_the_pole() -> None:
    axes = np.array([0.0, 60.0]), np.array([0.0, 90.0, 180.0]), np.array([0.0, 10.0, 30.0, 90.0])
    table = BsdfTable(*axes, np.arange(24.0).reshape(1, 1, 2, 3, 4), known=np.arange(24).reshape(1, 1, 2, 3, 4) != 5)
    d = dataset_of_file(BsdfFile((table,)), "a.ddr")
    cut = d.select(sigma_deg=0, phi_deg=90)
    # At theta 0 any phi is the same direction, and the table has a node there for each phi.
    assert cut.theta_deg.tolist() == [0.0, 0.0, 10.0, 30.0, 90.0, 0.0]
    assert cut.bsdf.tolist() == [0.0, 4.0, 5.0, 6.0, 7.0, 8.0]
    assert cut.good.tolist() == [True, True, False, True, True, True]
    assert cut.flags.tolist() == ["", "", "filled", "", "", ""]
    # Below the horizon there is nothing: sigma 60, phi 180, theta 90.
    assert 90.0 not in d.select(sigma_deg=60, phi_deg=180).theta_deg


def test_select_is_exact_and_names_the_neighbours(dataset: goniotwin.Dataset) -> None:
    zenith = np.unique(dataset.polar_deg)
    here = dataset.select(sigma_deg=30, polar_deg=zenith[3])
    assert here.size == (dataset.polar_deg == zenith[3]).sum() > 0
    assert here.only.measured is not None
    np.testing.assert_array_equal(here.only.measured.points.bsdf, here.bsdf)
    several = dataset.select(polar_deg=zenith[[3, 5]].tolist(), transmitted=False, back=False)
    assert sorted(set(several.polar_deg)) == zenith[[3, 5]].tolist()
    # A part in a million of a degree is rounding; a thousandth is another angle.
    assert dataset.select(sigma_deg=30.0000005).size == dataset.size
    with pytest.raises(
        goniotwin.GoniotwinError, match=r"sigma_deg 30\.001: few \(gaussian-5\) has no values there; the nearest"
    ):
        dataset.select(sigma_deg=30.001)
    between = 0.5 * (zenith[3] + zenith[4])
    with pytest.raises(goniotwin.GoniotwinError, match=f"with sigma_deg 30.*the nearest are {zenith[3]:g} and {zenith[4]:g}"):
        dataset.select(sigma_deg=30, polar_deg=between)
    with pytest.raises(goniotwin.GoniotwinError, match=r"transmitted True: .* it has False"):
        dataset.select(transmitted=True)


def test_azimuths_repeat_after_a_turn() -> None:
    d = dataset_of_file(BsdfFile((scattered(""),)), "a.csv")
    # The pole has any azimuth.
    assert d.select(azimuth_deg=-90).polar_deg.tolist() == [0.0, 0.0, 0.0, 0.0, 20.0, 40.0]
    assert d.select(azimuth_deg=-90).bsdf.tolist()[-2:] == [8.0, 12.0]
    assert d.select(psi_deg=360).size == d.size


@pytest.mark.parametrize(
    "arguments",
    [
        {"sigma_deg": "30"},
        {"sigma_deg": float("nan")},
        {"sigma_deg": []},
        {"sigma_deg": [[30.0]]},
        {"sigma_deg": True},
        {"sigma_deg": object()},
        {"channel": 3},
        {"channel": "red"},
        {"transmitted": 1},
        {"back": "no"},
        {"photodiode": 1e6},
        {"wavelength_nm": 1.0},
        {"sigma_deg": 10**400},
        {"sigma_deg": 1j},
        {"sigma": 30},
        {"transmitted": [True]},
    ],
)
def test_what_cannot_be_selected_is_refused(dataset: goniotwin.Dataset, arguments: dict[str, Any]) -> None:
    with pytest.raises(goniotwin.GoniotwinError, match=next(iter(arguments))):
        dataset.select(**arguments)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda d: d.select(sigma=30), r"select: there is no argument 'sigma'; it takes wavelength_nm, channel, sigma_deg, .*"),
        (lambda d: d.select(30), r"select: name the arguments, as in select\(wavelength_nm=\.\.\., channel=\.\.\.\); it takes"),
        (lambda d: d.at(30, 12, 0), r"at: name the arguments, as in at\(theta_deg=\.\.\., phi_deg=\.\.\.\); it takes theta"),
        (lambda _: PUBLIC.theory(1, 2, 3), "theory: too many positional arguments; it takes dataset, sample"),
        (lambda d: d.at(theta=3), "at: there is no argument 'theta'"),
        (lambda d: d.reflectance(angle=3), "reflectance: there is no argument 'angle'"),
        (lambda d: d.where(), "where: missing a required argument: 'chosen'"),
        (lambda _: PUBLIC.open(), "open: missing a required argument: 'path'"),
        (lambda _: goniotwin.open("a" * 5000), "aaa"),
        (lambda d: PUBLIC.plot(d, colour="red"), "plot: there is no argument 'colour'"),
        (lambda d: PUBLIC.compare(d, d, in_plane="no"), "in_plane: 'no': give True or False"),
        (lambda d: PUBLIC.theory(d, model="x"), "theory: there is no argument 'model'"),
        (lambda _: PUBLIC.simulate("lambertian", sigma=[3]), "simulate: there is no argument 'sigma'"),
        (lambda d: d[["gaussian-5"]], r"there is no sample \['gaussian-5'\]"),
        (lambda d: d.at(theta_deg=3, transmitted="no"), "transmitted: 'no': give True or False"),
    ],
)
def test_a_call_with_other_arguments_names_those_that_there_are(dataset: goniotwin.Dataset, call: Any, message: str) -> None:
    with pytest.raises(goniotwin.GoniotwinError, match=message):
        call(dataset)


def test_the_length_is_the_number_of_values(dataset: goniotwin.Dataset) -> None:
    assert len(dataset) == dataset.size == dataset.bsdf.size
    assert len(dataset.where([])) == 0
    assert dataset.where([])  # without values it is still a dataset


def test_a_mask_or_indices_choose_values(dataset: goniotwin.Dataset) -> None:
    assert dataset.where(dataset.good).good.all()
    assert dataset.where(np.array([3, 1])).bsdf.tolist() == dataset.bsdf[[3, 1]].tolist()
    for wrong in (np.array([dataset.size]), np.array([1.0]), np.array([True]), np.zeros((2, 2), dtype=bool)):
        with pytest.raises(goniotwin.GoniotwinError, match="where"):
            dataset.where(wrong)


@pytest.mark.parametrize("path", [None, 3, b"a.journal"])
def test_what_is_not_a_path_is_refused(path: Any) -> None:
    with pytest.raises(goniotwin.GoniotwinError, match="is not a path"):
        goniotwin.open(path)


def test_files_that_are_nothing_are_refused(tmp_path: Path) -> None:
    for name, content in (("none.journal", None), ("a.txt", b"hello"), ("b.journal", b"SQLite format 3\0 and no more")):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(goniotwin.GoniotwinError, match=name):
            goniotwin.open(tmp_path / name)
    with pytest.raises(goniotwin.GoniotwinError, match=tmp_path.name):
        goniotwin.open(tmp_path)


def test_uncertainties_and_mask_beside_a_table_belong_to_it(tmp_path: Path) -> None:
    made = table(gaussian(5.0), np.array([0.0, 30.0, 90.0]), 5.0, u=0.02)
    known = np.ones(made.values.shape, dtype=bool)
    known[..., 3] = False
    path = tmp_path / "a.ddr"
    files = writing.write(path, BsdfFile((replace(made, known=known),)), registry.format_named("ddr", {Holds.GRID}))
    assert len(files) == 3
    d = goniotwin.open(path)
    assert d.origin == "ddr"
    np.testing.assert_allclose(d.u, 0.02 * d.bsdf, rtol=1e-6)
    assert np.unique(d.theta_deg[d.flags == "filled"]).tolist() == [15.0]
    for beside in files[1:]:
        with pytest.raises(goniotwin.GoniotwinError, match=r"it has the .* of a\.ddr, not values"):
            goniotwin.open(beside)
    coarse = table(gaussian(5.0), np.array([0.0, 30.0, 90.0]), 10.0)
    registry.format_named("ddr", {Holds.GRID}).write(path, BsdfFile((coarse,)))
    other = goniotwin.open(path)
    assert np.isnan(other.u).all()
    assert any("a.u.ddr is beside it, and has not the same grid" in note for note in other.notes)


def test_an_exported_csv_has_the_values_of_its_journal(dataset: goniotwin.Dataset, journal: Path, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    with Journal.open(journal) as opened:
        reduced = reduce_journal(opened)
    convert_reduced(reduced, path, format_to_write(path), Choice())
    d = goniotwin.open(path)
    assert d.origin == "csv"
    assert d.simulated
    assert d.samples == dataset.samples
    for name in ("bsdf", "u", "sigma_deg", "theta_deg", "phi_deg", "polar_deg", "wavelength_nm"):
        np.testing.assert_allclose(getattr(d, name), getattr(dataset, name), rtol=1e-8, atol=2e-6, err_msg=name)
    assert d.flags.tolist() == dataset.flags.tolist()
