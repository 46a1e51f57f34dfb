"""The archive of a journal: uncertainties and covariances rebuilt from the file by h5py and numpy alone."""

import json
import re
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.budget import budget_of_reflectance, budget_of_value, reflectance
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.campaign.studies.reflectance import integration_settings
from goniotwin.app.cli.main import app
from goniotwin.app.data.archive import write_archive
from goniotwin.app.data.export import scattered_points
from goniotwin.app.formats import BsdfTable, FormatError, archive, registry
from goniotwin.app.formats.content import ScatteredBsdf
from goniotwin.app.rig import parse_rig
from goniotwin.arrays import Floats
from tests.app.campaign.studies.test_standards import ETALON
from tests.app.campaign.studies.test_verification import HALF_SPHERE, PAINT
from tests.app.data.archive_reader import effects
from tests.conftest import RIG, SMALL, changed

pytestmark = pytest.mark.xdist_group("archive")

WHITE = 'model = "lambertian"\nreflectance = 0.99\nside = "both"\n'
GOLDEN = Path(__file__).parents[2] / "golden" / "data" / "finished.journal"


@pytest.fixture(scope="module")
def archived(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A journal with the directions of a half sphere, and its archive."""
    folder = tmp_path_factory.mktemp("archive")
    journal, path = folder / "half-sphere.journal", folder / "half-sphere.h5"
    plan = parse_schedule(changed(SMALL, HALF_SPHERE), "small.toml")
    run_without_wires(make_plan(plan, parse_rig(changed(RIG.read_text(), (PAINT,)), RIG.parent, "rig.toml")), journal)
    with Journal.open(journal) as opened:
        write_archive(opened, reduce_journal(opened), path)
    return journal, path


# The rule of docs/exchange/archive.md, with h5py and numpy alone: archive_reader.py.


def unit(count: int, index: int) -> Floats:
    found = np.zeros(count)
    found[index] = 1.0
    return found


def test_the_uncertainty_of_every_value_is_rebuilt(archived: tuple[Path, Path]) -> None:
    with h5py.File(archived[1]) as file:
        part = file["entry/part_1"]
        values, u = part["values"][()], part["values_errors"][()]
        assert part.attrs["NX_class"] == "NXdata"
        some = np.flatnonzero(np.isfinite(values))
        assert some.size > 80
        for k in some[::7].tolist():
            shared, alone = effects(part, unit(values.size, k))
            assert np.sum(shared**2) + alone == pytest.approx(u[k] ** 2, rel=1e-9)
        assert np.sum(part["components"][()][some] ** 2, axis=1) == pytest.approx(u[some] ** 2, rel=1e-12)


def test_a_value_has_the_budget_that_the_program_gives(archived: tuple[Path, Path]) -> None:
    with Journal.open(archived[0]) as journal:
        found = budget_of_value(evaluate_journal(journal).reduction, {"sigma": 30.0, "zenith": 40.0, "azimuth": 45.0})
    with h5py.File(archived[1]) as file:
        part, inputs = file["entry/part_1"], file["entry/inputs"]
        columns = {each: part[each][()] for each in ("sigma_deg", "wavelength_nm", "polar_deg", "azimuth_deg", "transmitted")}
        (k,) = np.flatnonzero(
            (columns["sigma_deg"] == 30.0)
            & (np.abs(columns["polar_deg"] - 40.0) < 1e-6)
            & (np.abs(columns["azimuth_deg"] - 45.0) < 1e-6)
            & ~columns["transmitted"]
        )
        assert part["values"][k] == found.value
        assert part["values_errors"][k] == pytest.approx(found.u, rel=1e-9)
        shared, _ = effects(part, unit(part["values"].size, int(k)))
        names = inputs["name"].asstr()[()].tolist()
        lines = [re.sub(r"(?<=slit_image)\[\d+\]", "", name) for name in names]  # of modes a budget has one line
        for each in found.components:
            if each.input is not None and each.u > 1e-9 * found.u:
                assert np.linalg.norm(shared[[line == each.name for line in lines]]) == pytest.approx(each.u, rel=1e-9)
        assert {"sigma_zero", "certificate[level]"} <= set(names)


def test_the_covariance_of_two_values_is_rebuilt(archived: tuple[Path, Path]) -> None:
    with Journal.open(archived[0]) as journal:
        reduction = evaluate_journal(journal).reduction
        (name, points), *_ = reduce_journal(journal).samples.items()
        good = points.where(points.good)
        expected = effects_of(good, reduction.settings).covariance(np.arange(0, good.size, 9), np.arange(0, good.size, 9))
        keys = place(scattered_points(good, name, isotropic=True, generated=True))
    with h5py.File(archived[1]) as file:
        part = file["entry/part_1"]
        columns = [part[each][()] for each in ("wavelength_nm", "sigma_deg", "polar_deg", "azimuth_deg", "transmitted")]
        here = {tuple(each): k for k, each in enumerate(np.round(np.stack(columns, axis=1), 6).tolist())}
        chosen = [here[tuple(each)] for each in keys[::9].tolist()]
        found = [effects(part, unit(part["values"].size, int(k))) for k in chosen]
    rebuilt = np.array([[float(one @ other) for other, _ in found] for one, _ in found])
    rebuilt += np.diag([alone for _, alone in found])
    u = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(rebuilt / np.outer(u, u), expected / np.outer(u, u), atol=1e-9)
    assert (np.abs(expected / np.outer(u, u))[~np.eye(u.size, dtype=bool)] > 0.1).any()


def place(points: ScatteredBsdf) -> Floats:
    columns = (points.wavelength_nm, points.sigma_deg, points.polar_deg, points.azimuth_deg, points.transmitted)
    return np.asarray(np.round(np.stack(columns, axis=1).astype(np.float64), 6), dtype=np.float64)


def test_the_uncertainty_of_a_reflectance_is_rebuilt(archived: tuple[Path, Path]) -> None:
    with Journal.open(archived[0]) as journal:
        expected = budget_of_reflectance(evaluate_journal(journal).reduction, {"sigma": 30.0})
    with h5py.File(archived[1]) as file:
        part = file["entry/part_1"]
        wanted = {"sigma_deg": 30.0, "wavelength_nm": 550.0, "transmitted": False}
        (title,) = [
            name
            for name in part
            if name.startswith("reflectance_") and all(part[name].attrs[k] == v for k, v in wanted.items())
        ]
        integral = part[title]
        weight = np.zeros(part["values"].size)
        weight[integral["index"][()]] = integral["weight"][()]
        value = np.sum(np.where(weight != 0.0, weight * part["values"][()], 0.0))
        shared, alone = effects(part, weight)
        own = integral.attrs["u_interpolation"] ** 2 + integral.attrs["u_filled"] ** 2
        assert value == pytest.approx(expected.value, rel=1e-12)
        assert integral.attrs["u"] == pytest.approx(expected.u, rel=1e-12)
        assert np.sqrt(np.sum(shared**2) + alone + own) == pytest.approx(expected.u, rel=1e-9)


@pytest.mark.parametrize("light", ["reflected", pytest.param("both", marks=pytest.mark.long)])
def test_a_program_without_ours_finds_the_u_of_reflected_and_transmitted_light(light: str, tmp_path: Path) -> None:
    """Of all values, of a reflectance and a transmittance, with a second standard; in a process of its own."""
    journal, path = tmp_path / "opal.journal", tmp_path / "opal.h5"
    schedule = changed(SMALL, (*HALF_SPHERE[:2], ('samples = ["gaussian-5"]', f'samples = ["opal"]\nlight = "{light}"')))
    schedule += '[second_standard]\nname = "second"\nradiance_factor = 0.99\nrelative_uncertainty = 0.003\n'
    rig = changed(RIG.read_text(), ((ETALON, f"[twin.samples.second]\n{WHITE}\n[twin.samples.etalon]\n{WHITE}"),))
    run_without_wires(make_plan(parse_schedule(schedule, "opal.toml"), parse_rig(rig, RIG.parent, "rig.toml")), journal)
    expected = {}
    with Journal.open(journal) as opened:
        reduced = reduce_journal(opened)
        write_archive(opened, reduced, path)
        settings = evaluate_journal(opened).reduction.settings
        (points,) = (BsdfPoints.join(list(each.settings())) for each in reduced.samples.values())
        for each in integration_settings(points):
            found = reflectance(settings, "opal", points, each)
            expected[each.transmitted, each.sigma_deg, each.wavelength_nm] = found.value, found.u
    command = [sys.executable, "-I", str(Path(__file__).with_name("archive_reader.py")), str(path)]
    read = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    (part,) = read["parts"]
    assert read["loaded"] == []
    assert part["second"] > 80
    assert {bool(each[0]) for each in part["reflectances"]} == {False, light == "both"}
    assert {tuple(place): tuple(values) for *place, values in ((*each[:3], each[3:]) for each in part["reflectances"])} == {
        place: (pytest.approx(value, rel=1e-9), pytest.approx(u, rel=1e-9)) for place, (value, u) in expected.items()
    }
    rebuilt = np.array(part["u"])
    with h5py.File(path) as file:
        u = file["entry/part_1/values_errors"][()]
    assert np.sum(np.isfinite(rebuilt)) > 80
    np.testing.assert_allclose(rebuilt[np.isfinite(rebuilt)], u[np.isfinite(rebuilt)], rtol=1e-9)


def test_what_was_recorded_is_in_it(tmp_path: Path) -> None:
    journal, path = tmp_path / "finished.journal", tmp_path / "finished.h5"
    journal.write_bytes(GOLDEN.read_bytes())
    with Journal.open(journal) as opened:
        reduced = reduce_journal(opened)
        done = write_archive(opened, reduced, path)
        rows, texts = list(opened.rows()), {each: opened.value(each) for each in ("schedule", "rig")}
    content = archive.read(path)
    (scattered,), (table,) = content.scattered, content.tables
    assert content.simulated
    assert (done.values, done.without_table) == (np.isfinite(scattered.values).sum(), ())
    assert content.metadata == reduced.metadata[scattered.sample]
    assert isinstance(table, BsdfTable)
    points = reduced.samples[scattered.sample]
    assert (
        np.sort(scattered.values[np.isfinite(scattered.values)]).tolist()
        == np.sort(points.bsdf[np.isfinite(points.bsdf)]).tolist()
    )
    assert {word for each in scattered.flags.tolist() for word in each.split()} <= set(points.flags)
    with h5py.File(path) as file:
        recorded = file["entry/journal"]
        assert {each: recorded[each].asstr()[()] for each in texts} == texts
        assert recorded["row_number"][()].tolist() == [each.row.number for each in rows]
        readings = [(each.row.number, one) for each in rows for one in each.data.readings]
        for k, (number, reading) in enumerate(readings):
            begin, shape = recorded["reading_begin"][k], (recorded["reading_readings"][k], recorded["reading_photodiodes"][k])
            raw = recorded["counts"][begin : begin + shape[0] * shape[1]].reshape(shape)
            assert np.array_equal(raw, reading.counts)
            assert recorded["reading_row"][k] == number


def test_a_folder_that_is_missing_is_named_first(tmp_path: Path) -> None:
    journal = tmp_path / "finished.journal"
    journal.write_bytes(GOLDEN.read_bytes())
    with Journal.open(journal) as opened, pytest.raises(FormatError, match="there is no folder"):
        write_archive(opened, reduce_journal(opened), tmp_path / "no" / "finished.h5")
    assert list(tmp_path.iterdir()) == [journal]


def test_export_writes_the_archive(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    journal, path = tmp_path / "finished.journal", tmp_path / "finished.h5"
    journal.write_bytes(GOLDEN.read_bytes())
    app(["export", str(journal), "--out", str(path), "--format", "archive", "--json"], standalone_mode=False)
    result = json.loads(capsys.readouterr().out)
    with h5py.File(path) as file:
        assert (result["format"], result["values"]) == ("archive", int(np.sum(file["entry/part_1/good"][()])))
        assert file["entry/journal/counts"].size
    app(["convert", str(path), str(tmp_path / "again.csv")], standalone_mode=False)
    assert (tmp_path / "again.csv").is_file()


def test_a_table_is_the_same_by_every_way(
    archived: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of the journal, of its CSV, of its archive, and of a table with other filling: the widest gap goes along."""
    journal, archive_file = archived
    app(["export", str(journal), "--out", str(tmp_path / "points.csv")], standalone_mode=False)
    found = []
    app(["export", str(journal), "--out", str(tmp_path / "held.ddr")], standalone_mode=False)
    for source in (journal, tmp_path / "points.csv", archive_file, tmp_path / "held.ddr"):
        out = tmp_path / f"of-{source.suffix[1:]}.ddr"
        capsys.readouterr()
        app(["convert", str(source), str(out), "--fill", "fit", "--json"], standalone_mode=False)
        result = json.loads(capsys.readouterr().out)
        (share,) = result["not_measured"]
        found.append(
            (result["values"], share["share"], *(registry.read(Path(each)).only_table().values for each in result["files"]))
        )
    for other in found[1:]:
        assert other[1] == pytest.approx(found[0][1], rel=1e-7)
        np.testing.assert_allclose(other[2], found[0][2], rtol=1e-7, atol=1e-9)
        np.testing.assert_array_equal(other[4], found[0][4])
    for other in found[1:3]:  # the points know what neighbouring values share
        np.testing.assert_allclose(other[3], found[0][3], rtol=1e-6, atol=1e-9)
