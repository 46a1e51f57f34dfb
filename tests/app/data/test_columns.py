"""`Dataset.from_table` and `Dataset.save`: columns, and files of the registry's formats."""

import copy
import math
import operator
import pickle
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest
from typer.testing import CliRunner

import goniotwin
from goniotwin.app.cli.main import app
from goniotwin.app.data.conversion import Choice, convert_content
from goniotwin.app.data.opening import dataset_of_file
from goniotwin.app.data.values import COLUMNS
from goniotwin.app.formats import BsdfTable, registry
from goniotwin.app.formats.content import BsdfFile, RegularTable
from goniotwin.app.formats.registry import BSDF, Holds
from goniotwin.twin.optics import arc_direction
from tests.app.data.made import gaussian, lambertian, rings, table

POLAR, AZIMUTH = np.arange(0.0, 86.0, 5.0), np.arange(0.0, 181.0, 15.0)
DIFFUSE = {
    "sigma_deg": [0.0, 0.0, 0.0],
    "theta_deg": [0.0, 10.0, 20.0],
    "phi_deg": [0.0, 0.0, 90.0],
    "bsdf": [1.0 / math.pi] * 3,
}
BOTH = ("polar_deg", "azimuth_deg")
CSV_NAMED = {"bsdf": None, "bsdf_per_sr": [0.3, 0.3, 0.3]}
BELOW = "theta_deg has 80 in row 2, which at phi 180 and sigma 60 is 140 deg from the normal; give directions to 90"


def of_every_origin(journal: goniotwin.Dataset, folder: Path) -> dict[str, goniotwin.Dataset]:
    """A dataset of each origin: a journal, each format that is written, a simulation, columns, a theory."""
    found = {"journal": journal, "theory": goniotwin.theory(journal), "table": goniotwin.Dataset.from_table(DIFFUSE)}
    found["simulation"] = goniotwin.simulate("lambertian:reflectance=0.5", [0.0])
    for form in registry.BUILT_IN:
        if not form.writes or not form.holds & BSDF - {Holds.REGULAR} or form.resamples:
            continue
        made = table(lambertian(0.5), np.array([0.0, 30.0]), 10.0, u=0.01)
        part = replace(made, transmitted=Holds.REFLECTED not in form.holds)
        path = folder / f"{form.name}{form.suffixes[0]}"
        convert_content(BsdfFile((part,)), path, form, Choice())
        found[form.name] = goniotwin.load(path)
        assert found[form.name].origin == form.name
    return found


def columns_of(d: goniotwin.Dataset) -> dict[str, Any]:
    return {name: getattr(d, name) for name in (*COLUMNS, "good", "luminance_factor")}


def test_datasets_of_every_origin_are_copied_and_sent_and_their_arrays_cannot_be_written(
    dataset: goniotwin.Dataset, tmp_path: Path
) -> None:
    every = of_every_origin(dataset, tmp_path)
    assert len(every) >= 12
    joblib.dump(every, tmp_path / "every.joblib", compress=3)
    loaded = joblib.load(tmp_path / "every.joblib")
    # Each goes to another process, is copied there, and comes back.
    returned = joblib.Parallel(n_jobs=2, backend="loky")(joblib.delayed(copy.deepcopy)(each) for each in every.values())
    for name, other in zip(every, returned, strict=True):
        one = every[name]
        for same in (one, loaded[name], other, copy.deepcopy(one), pickle.loads(pickle.dumps(one, protocol=5))):
            assert repr(same) == repr(one)
            for title, column in columns_of(same).items():
                np.testing.assert_array_equal(column, getattr(one, title), err_msg=f"{name} {title}")
                assert not column.flags.writeable
                assert not column[1:].flags.writeable
                with pytest.raises(ValueError, match="read-only"):
                    column[:1] = column[:1]
            assert (same.whole, same.simulated, same.notes) == (one.whole, one.simulated, one.notes)
    light: dict[str, Any] = {"sigma_deg": 30.0, "theta_deg": 12.0, "phi_deg": 20.0}
    same = returned[list(every).index("ddr")]
    assert same.at(**light).value == every["ddr"].at(**light).value == pytest.approx(0.5 / math.pi)
    np.testing.assert_array_equal(returned[0].covariance(), dataset.covariance())


def arrays_of(held: Any, title: str) -> Iterator[tuple[str, Any]]:
    """The arrays that can be reached from an object, with how, but for those of the rig and of the reduction's settings."""
    if isinstance(held, np.ndarray):
        yield title, held
    elif isinstance(held, Mapping):
        for key, each in held.items():
            yield from arrays_of(each, f"{title}[{key}]")
    elif isinstance(held, tuple | list):
        for k, each in enumerate(held):
            yield from arrays_of(each, f"{title}[{k}]")
    elif hasattr(held, "__dict__"):
        for name, each in vars(held).items():
            if name not in ("grids", "settings", "rig"):
                yield from arrays_of(each, f"{title}.{name}")


def test_no_array_that_is_reached_from_a_dataset_can_be_made_one_to_write(dataset: goniotwin.Dataset, tmp_path: Path) -> None:
    every = of_every_origin(dataset, tmp_path)
    mirror = RegularTable(np.array([0.0, 30.0]), np.full((1, 1, 2), 0.9), u=np.full((1, 1, 2), 0.01))
    every["regular"] = dataset_of_file(BsdfFile((mirror,)), "mirror")
    grid = table(lambertian(0.5), np.array([0.0, 30.0]), 30.0)
    every["mask"] = dataset_of_file(BsdfFile((replace(grid, known=grid.values > 0.0),)), "mask")
    seen = set()
    for name, one in every.items():
        for same in (
            one,
            copy.deepcopy(one),
            pickle.loads(pickle.dumps(one, protocol=2)),
            one.where(np.arange(one.size)[::-1]),
        ):
            for title, array in arrays_of([same, same.only.lights, same.only.good, same.bsdf], name):
                seen.add(title.rpartition(".")[2])
                assert not array.flags.writeable, title
                with pytest.raises(ValueError, match="cannot set WRITEABLE"):
                    array.setflags(write=True)
    assert {"values", "u", "known", "theta_deg", "index", "bsdf", "places"} <= seen
    gridded = every["ddr"]
    light: dict[str, Any] = {"sigma_deg": 30.0, "theta_deg": [12.0, 20.0], "phi_deg": 20.0}
    results = [gridded.at(**light), gridded.covariance(), dataset.covariance(), dataset.components]
    results += [gridded.reflectance(sigma_deg=0.0), goniotwin.compare(dataset, goniotwin.theory(dataset)).lights]
    spectral = goniotwin.simulate("lambertian:reflectance=0.5", [0.0], wavelengths_nm=[450.0, 550.0])
    results += [spectral.reflectance(wavelength_nm=[450.0, 550.0])]
    assert len(list(arrays_of(results, "results"))) > 20
    for title, array in arrays_of(results, "results"):
        with pytest.raises(ValueError, match="cannot set WRITEABLE"):
            array.setflags(write=True)
        assert not array.flags.writeable, title


def test_columns_are_copied() -> None:
    values = np.full(3, 0.3)
    d = goniotwin.Dataset.from_table({**DIFFUSE, "bsdf": values})
    values[:] = 7.0
    assert d.bsdf.tolist() == [0.3] * 3
    assert np.isnan(d.u).all()
    assert (d.origin, d.simulated, d.samples) == ("table", False, ("",))


def test_what_is_masked_is_not_known_and_either_name_of_a_column_is_read() -> None:
    masked = np.ma.masked_array([0.1, 0.2, 0.3], [False, True, False])
    plain = goniotwin.Dataset.from_table({**DIFFUSE, "bsdf": masked, "u": masked})
    csv_named = {name: column for name, column in {**DIFFUSE, **CSV_NAMED, "u": masked}.items() if column is not None}
    for d, values in ((plain, [0.1, math.nan, 0.3]), (goniotwin.Dataset.from_table(csv_named), [0.3, 0.3, 0.3])):
        np.testing.assert_array_equal(d.bsdf, values)
        np.testing.assert_array_equal(d.u, [0.1, math.nan, 0.3])
    assert plain.good.tolist() == [True, False, True]


def test_directions_in_both_frames_that_differ_by_their_digits_are_one() -> None:
    lobe = rings(gaussian(20.0), 30.0, POLAR, AZIMUTH, u=0.01)
    theta, phi = lobe.specular()
    own = {name: getattr(lobe, "values" if name == "bsdf" else name) for name in ("sigma_deg", *BOTH, "bsdf")}
    d = goniotwin.Dataset.from_table({**own, "theta_deg": np.round(theta, 3), "phi_deg": np.round(phi, 3)})
    np.testing.assert_array_equal(d.polar_deg, lobe.polar_deg)


@pytest.mark.parametrize("read_csv", [False, True])
def test_a_dataframe_of_a_dataset_is_the_dataset_again(read_csv: bool, dataset: goniotwin.Dataset, tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    frame = dataset.to_dataframe()
    if read_csv:
        frame = pandas.read_csv(dataset.save(tmp_path / "a.csv").files[0], comment="#")
    same = goniotwin.Dataset.from_table(frame, simulated=True if read_csv else None)
    for name in COLUMNS:
        some = dataset.polar_deg > (0.0 if name == "azimuth_deg" else -1.0)  # at the pole any azimuth is the same direction
        column, expected = getattr(same, name)[some], getattr(dataset, name)[some]
        if column.dtype.kind == "f":
            np.testing.assert_allclose(column, expected, rtol=1e-8 if read_csv else 1e-12, atol=1e-12)
        else:
            np.testing.assert_array_equal(column, expected)
    assert (same.samples, same.simulated) == (dataset.samples, dataset.simulated)
    assert not goniotwin.Dataset.from_table(frame, simulated=False).simulated
    frame.loc[:, "bsdf_per_sr" if read_csv else "bsdf"] = 0.0
    assert dataset.bsdf.max() > 1.0


def test_directions_are_given_in_either_frame() -> None:
    lobe = rings(gaussian(20.0), 30.0, POLAR, AZIMUTH, u=0.01)
    own = {name: getattr(lobe, "values" if name == "bsdf" else name) for name in ("sigma_deg", *BOTH, "bsdf", "u")}
    own["azimuth_deg"] = own["azimuth_deg"] + 90.0
    one = goniotwin.Dataset.from_table({**own, "sample": np.full(lobe.size, "paint"), "psi_deg": np.full(lobe.size, 90.0)})
    assert one.sample == "paint"
    names = ("sigma_deg", "psi_deg", "theta_deg", "phi_deg", "bsdf", "u")
    other = goniotwin.Dataset.from_table({name: getattr(one, name) for name in names}, isotropic=True)
    here, there = (arc_direction(*(getattr(each, name) for name in BOTH)) for each in (one, other))
    np.testing.assert_allclose(there, here, atol=1e-7)
    kept = one.at(polar_deg=41.0, azimuth_deg=250.0)
    assert other.at(polar_deg=41.0, azimuth_deg=250.0).value == pytest.approx(kept.value, rel=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"bsdf": None}, "the column bsdf is missing; give the values, 1/sr"),
        ({"sigma_deg": None}, "the column sigma_deg is missing"),
        ({"phi_deg": None}, "the column phi_deg is missing; give the direction by"),
        ({"theta_deg": None, "phi_deg": None, "polar_deg": [1.0] * 3}, "the column azimuth_deg is missing"),
        ({"bsfd": [1.0] * 3}, "there is no column 'bsfd'; there are sigma_deg"),
        ({"bsdf": ["a", "b", "c"]}, "the column bsdf has 'a' in row 0, which is no number; give numbers"),
        ({"bsdf": [1.0, math.inf, 2.0]}, "the column bsdf has inf in row 1"),
        ({"theta_deg": [0.0, 10.0, 190.0]}, "the column theta_deg has 190 in row 2; give numbers from 0 to 180"),
        ({"sigma_deg": [0.0, math.nan, 0.0]}, "the column sigma_deg has no number in row 1; give numbers from 0 to 90"),
        ({"u": [0.1, -0.1, 0.1]}, "the column u has -0.1 in row 1; give numbers from 0 on"),
        ({"u": [0.1, 0.1]}, r"the shapes .*u \(2,\); give lists, all of the same length"),
        ({"u": [0.1, [0.1], 0.1]}, "the column u is not a list with one number or text for each row; give one"),
        ({"transmitted": ["no"] * 3}, "the column transmitted has 'no' in row 0; give True or False"),
        ({"transmitted": [True, 1, False]}, "the column transmitted has 1 in row 0; give True or False"),
        ({"sigma_deg": [0.0, 0.0, 60.0], "theta_deg": [0.0, 10.0, 80.0], "phi_deg": [0.0, 0.0, 180.0]}, BELOW),
        ({"bsdf": [1.0, 1.0, 1j]}, "the column bsdf has .* in row 0, which is no number"),
        ({"bsdf": np.array([1.0, 1.0, 1j], dtype=object)}, "the column bsdf has 1j in row 2, which is no number"),
        ({"sigma_deg": np.ma.masked_array([0.0] * 3, [False, True, False])}, "the column sigma_deg has no number in row 1"),
        ({"transmitted": np.ma.masked_array([True] * 3, [False, True, False])}, "the column transmitted has None in row 1"),
        ({"photodiode": [1, 1.5, 2]}, "the column photodiode has 1.5 in row 1; give whole numbers from -1 on, or none"),
        ({"low95": [0.1, 0.2, 0.3], "high95": [0.2, 0.1, 0.4]}, "low95 has 0.2 in row 1, which is more than high95, 0.1;"),
        ({"interval": ["linear", "foo", ""]}, "the column interval has 'foo' in row 1; give linear or logarithmic or drawn"),
        (
            {"u": [0.1] * 3, "u_shared": [0.1, 0.2, 0.0]},
            "the column u_shared has 0.2 in row 1, which is more than u, 0.1; give",
        ),
        ({"wavelength_nm": [550.0, 0.0, math.nan]}, "the column wavelength_nm has 0 in row 1; give numbers above 0, or none"),
        (
            {"polar_deg": [0.0, 10.0, 20.0], "azimuth_deg": [0.0, 0.0, 91.0]},
            "theta_deg has 20 in row 2, which with phi 90 is not",
        ),
        ({**CSV_NAMED, "sigma_deg": [0.0, 100.0, 0.0]}, "the column sigma_deg has 100 in row 1; give numbers from 0 to 90"),
        ({**CSV_NAMED, "sigma_deg": [0.0, math.inf, 0.0]}, "the column sigma_deg has inf in row 1; give numbers from 0 to 90"),
        ({**CSV_NAMED, "u": [0.1, -1.0, 0.1]}, "the column u has -1 in row 1; give numbers from 0 on"),
        ({**CSV_NAMED, "u_bsdf_per_sr": [0.1, -1.0, 0.1]}, "the column u_bsdf_per_sr has -1 in row 1; give numbers from 0 on"),
        ({**CSV_NAMED, "u": [0.1] * 3, "u_bsdf_per_sr": [0.1] * 3}, "u and u_bsdf_per_sr are one column; give one of them"),
        (
            {**CSV_NAMED, "light": ["", "Transmitted", ""]},
            "column light has 'Transmitted' in row 1; give reflected or transmitted",
        ),
        ({**CSV_NAMED, "sigma_deg": None}, "the column sigma_deg is missing"),
    ],
)
def test_a_column_that_is_wrong_is_named(change: dict[str, Any], message: str) -> None:
    given = {name: column for name, column in {**DIFFUSE, **change}.items() if column is not None}
    with pytest.raises(goniotwin.GoniotwinError, match=f"from_table: .*{message}"):
        goniotwin.Dataset.from_table(given)


@pytest.mark.parametrize("given", [5, "a.csv", [1.0, 2.0], {}, {name: [] for name in DIFFUSE}])
def test_what_is_no_table_is_refused(given: Any) -> None:
    with pytest.raises(goniotwin.GoniotwinError, match="from_table: "):
        goniotwin.Dataset.from_table(given)


@pytest.mark.parametrize("name", ["csv", "astm", "bird", "archive", "ddr", "ssdd", "zemax"])
def test_what_is_saved_is_loaded_again(name: str, tmp_path: Path) -> None:
    form = next(each for each in registry.BUILT_IN if each.name == name)
    made = table(gaussian(20.0), np.array([0.0, 30.0]), 5.0, u=0.01)
    d = dataset_of_file(BsdfFile((made,)), "made")
    done = d.save(tmp_path / f"a{form.suffixes[0]}", format=name)
    same = goniotwin.load(done.files[0])
    assert (same.origin, done.format) == (name, name)
    direction: dict[str, Any] = {"sigma_deg": 30.0, "theta_deg": [7.5, 33.0], "phi_deg": [22.0, 100.0]}
    np.testing.assert_allclose(same.at(**direction).value, d.at(**direction).value, rtol=1e-6)
    # A part of it is saved as that part.
    some = d.select(sigma_deg=30).save(tmp_path / f"b{form.suffixes[0]}", format=name)
    part = goniotwin.load(some.files[0])
    if Holds.POINTS in form.holds:
        assert set(part.sigma_deg.tolist()) == {30.0}
    np.testing.assert_allclose(part.at(**direction).value, d.at(**direction).value, rtol=1e-6)


def test_a_journal_is_saved_as_the_command_exports_it(dataset: goniotwin.Dataset, journal: Path, tmp_path: Path) -> None:
    by_command = CliRunner().invoke(app, ["export", str(journal), "--out", str(tmp_path / "a.csv")])
    assert by_command.exit_code == 0, by_command.output
    done = dataset.save(tmp_path / "b.csv")
    assert done.files == (tmp_path / "b.csv",)
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    for path, message in ((tmp_path / "a.xyz", "format"), (5, "give a path")):
        with pytest.raises(goniotwin.GoniotwinError, match=message):
            dataset.save(path)  # type: ignore[arg-type]


def test_wavelengths_broadcast_with_directions() -> None:
    part = rings(gaussian(20.0), 30.0, POLAR, AZIMUTH, u=0.01)
    spectral = [replace(part, values=part.values * nm / 500.0, wavelength_nm=np.full(part.size, nm)) for nm in (450.0, 550.0)]
    d = dataset_of_file(BsdfFile(tuple(spectral)), "made")
    nm, theta = np.array([[450.0], [500.0], [550.0]]), np.array([0.0, 12.0, 33.0, 40.0])
    found = d.at(wavelength_nm=nm, theta_deg=theta, phi_deg=30.0)
    assert found.value.shape == found.u.shape == (3, 4)
    for i, j in np.ndindex(3, 4):
        one = d.at(wavelength_nm=float(nm[i, 0]), theta_deg=float(theta[j]), phi_deg=30.0)
        assert (found.value[i, j], found.u[i, j]) == (pytest.approx(one.value), pytest.approx(one.u))
    np.testing.assert_allclose(found.value[1], 0.5 * (found.value[0] + found.value[2]), rtol=1e-12)
    with pytest.raises(goniotwin.GoniotwinError, match=r"the shapes \(3, 1\) and \(2, 2\)"):
        d.at(wavelength_nm=nm, theta_deg=np.ones((2, 2)), phi_deg=0.0)
    with pytest.raises(goniotwin.GoniotwinError, match="wavelength_nm 600"):
        d.at(wavelength_nm=[450.0, 600.0], theta_deg=1.0, phi_deg=0.0)
    with pytest.raises(goniotwin.GoniotwinError, match="wavelength_nm: 'red'"):
        d.at(wavelength_nm="red", theta_deg=1.0, phi_deg=0.0)  # type: ignore[arg-type]
    of_all = d.reflectance(wavelength_nm=[450.0, 550.0])
    values = [d.reflectance(wavelength_nm=nm).value for nm in (450.0, 550.0)]
    assert of_all.value.tolist() == values
    assert operator.truediv(*values) == pytest.approx(450.0 / 550.0)
    assert of_all.about == d.reflectance(wavelength_nm=450.0).about


def test_a_notebook_shows_a_table_of_each_sample(dataset: goniotwin.Dataset) -> None:
    shown = dataset._repr_html_()
    assert "SIMULATED" in shown
    assert shown.count("<table>") == 1
    assert "<td>550</td><td>nm</td>" in shown
    evil = goniotwin.Dataset.from_table({**DIFFUSE, "sample": ["<b>&"] * 3}, name="<script>")
    assert "<caption>&lt;b&gt;&amp;</caption>" in evil._repr_html_()
    assert "<script>" not in evil._repr_html_()
    assert "SIMULATED" not in evil._repr_html_()


def test_what_is_not_saved_has_its_remedy_in_python(tmp_path: Path) -> None:
    def one(**change: Any) -> BsdfTable:
        return replace(table(lambertian(0.5), np.array([0.0, 30.0]), 10.0), **change)

    grid = one()
    spectral = one(values=np.concatenate([grid.values] * 2), wavelengths_nm=(450.0, 550.0))
    refused = {
        (
            grid,
            one(sample="b"),
        ): r'the format ddr has one sample, and there are: .*; choose one with d\["NAME"\]\.save\(\.\.\.\)$',
        (spectral,): r"the format zemax has one wavelength, .*; choose one with d\.select\(wavelength_nm=\.\.\.\), or use",
        (grid, one(transmitted=True)): r"choose it with d\.select\(transmitted=False\) or d\.select\(transmitted=True\)$",
    }
    for (parts, message), path in zip(refused.items(), ("a.ddr", "a.bsdf", "a.astm"), strict=True):
        with pytest.raises(goniotwin.GoniotwinError, match=message):
            dataset_of_file(BsdfFile(parts), "made").save(tmp_path / path, format={"a.bsdf": "zemax"}.get(path))
    both = dataset_of_file(BsdfFile((grid, one(back=True))), "made")
    assert (
        "the values of the back are omitted; d.select(back=True).save(...) writes them" in both.save(tmp_path / "b.ddr").notes
    )
    assert both.select(back=True).save(tmp_path / "c.ddr").files[0] == tmp_path / "c.ddr"


def test_a_dataset_is_one_line_whatever_its_names() -> None:
    d = goniotwin.Dataset.from_table({**DIFFUSE, "sample": ["a\nb"] * 3}, name="c\nd")
    assert d.samples == ("a\nb",)
    assert len(repr(d).splitlines()) == 1
    with pytest.raises(goniotwin.GoniotwinError, match=r"^3 is not a path; give the name of a journal or of a file"):
        goniotwin.load(3)  # type: ignore[arg-type]
