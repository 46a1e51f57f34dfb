"""A file format that this file alone adds: `simulate`, `rehearse`, rig files and `export` know it, and so does their help."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from goniotwin.app.cli.main import app
from goniotwin.app.errors import UserError
from goniotwin.app.formats import BsdfTable, FormatError, PointStream, read_ddr, registry
from goniotwin.app.formats.content import BsdfFile
from goniotwin.app.formats.file import read_file, write_file
from goniotwin.app.formats.registry import Format, Holds
from goniotwin.app.rig import read_rig
from goniotwin.app.rig.samples import parse_sample
from goniotwin.twin.optics import evaluate, from_specular, light_direction
from tests.conftest import RIG, SCHEDULE, Writer

pytestmark = pytest.mark.usefixtures("quick_errors")
MARK = b"my table\n"
AXES = ("sigma_deg", "phi_deg", "theta_deg")
DETECTORS = ("--polar", "0:85:5", "--azimuth", "0:180:10")


class MyTable:
    """A table as JSON after a first line: BRDF or BTDF, with uncertainties."""

    def recognise(self, head: bytes) -> bool:
        return head.startswith(MARK)

    def read(self, path: Path) -> BsdfFile:
        content = read_file(path)
        if not content.startswith(MARK):
            raise FormatError(path, "is not such a table", "give another file")
        found: dict[str, Any] = json.loads(content.removeprefix(MARK))
        return BsdfFile((BsdfTable(**found | {name: np.array(found[name]) for name in (*AXES, "values", "u", "known")}),))

    def write(self, path: Path, content: BsdfFile) -> None:
        table = content.only_table()
        assert table.u is not None
        lists = {name: getattr(table, name).tolist() for name in (*AXES, "values", "u", "known")}
        words = {name: getattr(table, name) for name in ("wavelengths_nm", "transmitted", "generated", "comments")}
        write_file(path, MARK + json.dumps({**lists, **words}).encode())


MY_TABLE = Format(
    "my",
    "a table of the test",
    (".my",),
    frozenset({Holds.GRID, Holds.SIGMAS, Holds.WAVELENGTHS, Holds.REFLECTED, Holds.TRANSMITTED, Holds.UNCERTAINTY, Holds.MASK}),
    MyTable(),
)


@pytest.fixture(autouse=True)
def added() -> Iterator[None]:
    """The format is there for one test."""
    with registry.registered(MY_TABLE):
        yield


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    """The JSON object that a command prints."""
    capsys.readouterr()
    assert not app([*map(str, arguments), "--json"], standalone_mode=False)
    result: dict[str, Any] = json.loads(capsys.readouterr().out)
    return result


@pytest.fixture
def simulated(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Path:
    """A Gaussian of 10 deg as `simulate` writes it, in the added format."""
    path = tmp_path / "lobe.my"
    result = run(capsys, "simulate", "sample", "--sample", "gaussian:width_deg=10", "--sigma", "30", *DETECTORS, "--out", path)
    assert result["files"] == [str(path)]  # the uncertainties are in the same file
    return path


def test_simulate_writes_the_format_and_reads_it(simulated: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    table = registry.read(simulated).only_table()
    assert table.generated
    assert table.u is not None
    assert np.all(table.u[0, 0, 1, :, 0] < 0.01 * table.values[0, 0, 1, :, 0])
    other = tmp_path / "b.ddr"
    run(capsys, "simulate", "sample", "--sample", f"table:{simulated}", "--sigma", "30", *DETECTORS, "--out", other)
    assert np.pi * table.values[0, 0, 1, 0, 0] == pytest.approx(read_ddr(other).values[0, 0, 1, 0, 0], rel=0.03)


def test_a_wrong_suffix_does_not_matter(simulated: Path) -> None:
    expected = evaluate(parse_sample(f"table:{simulated}"), light_direction(30.0), from_specular(30.0, 3.0, 90.0))
    renamed = simulated.rename(simulated.with_suffix(".bsdf"))
    assert evaluate(parse_sample(f"table:{renamed}"), light_direction(30.0), from_specular(30.0, 3.0, 90.0)) == expected


def test_a_rig_file_has_it_as_a_sample(simulated: Path, write_rig: Writer) -> None:
    text = '[twin.samples.paper]\nmodel = "table"\nfile = "lobe.my"\n\n[twin.samples.etalon]'
    model = read_rig(write_rig(("[twin.samples.etalon]", text))).model()
    assert model is not None
    directions = from_specular(30.0, np.array([0.0, 2.0, 4.0]), 90.0)
    words = parse_sample(f"table:{simulated}")
    np.testing.assert_array_equal(
        evaluate(model.samples["paper"], light_direction(30.0), directions), evaluate(words, light_direction(30.0), directions)
    )


def test_rehearse_takes_it_and_export_writes_it(
    simulated: Path, capsys: pytest.CaptureFixture[str], write_schedule: Writer, tmp_path: Path
) -> None:
    journal = tmp_path / "a.journal"
    sample = f"gaussian-5=table:{simulated}"
    result = run(capsys, "rehearse", write_schedule(), "--rig", RIG, "--sample", sample, "--out", journal)
    assert result["state"] == "done"
    exported = run(capsys, "export", journal, "--format", "my", "--out", tmp_path / "measured.my")
    assert exported["files"] == [str(tmp_path / "measured.my")]
    measured = registry.read(tmp_path / "measured.my").only_table()
    assert measured.wavelengths_nm == (550.0,)
    assert measured.sigma_deg.tolist() == [0.0, 30.0, 90.0]
    # The lobe of the file was measured: at its peak as high as the file has it.
    given = registry.read(simulated).only_table()
    assert measured.values[0, 0, 1].max() == pytest.approx(given.values[0, 0, 1, 0, 0], rel=0.05)


class MyPoints:
    """Points as a count of each column's values, part by part."""

    def recognise(self, head: bytes) -> bool:
        return False

    def read(self, path: Path) -> Any:
        raise NotImplementedError

    def write(self, path: Path, content: PointStream) -> None:
        counts = [{name: len(np.asarray(column)) for name, column in part.items()} for part in content.parts]
        write_file(path, json.dumps(counts).encode())


def test_a_format_of_points_gets_every_point_in_parts(
    capsys: pytest.CaptureFixture[str], write_schedule: Writer, tmp_path: Path
) -> None:
    holds = frozenset({Holds.POINTS, Holds.COLUMNS, Holds.SIGMAS, Holds.REFLECTED, Holds.WAVELENGTHS})
    registry.register(Format("dots", "points of the test", (".dots",), holds, MyPoints(), reads=False))
    journal = tmp_path / "a.journal"
    run(capsys, "run", write_schedule(), "--rig", RIG, "--out", journal)
    exported = run(capsys, "export", journal, "--format", "dots", "--out", tmp_path / "a.dots")
    simulated = run(
        capsys, "simulate", "sample", "--sample", "lambertian", "--sigma", "30", *DETECTORS, "--out", tmp_path / "b.dots"
    )
    for name, points in (("a.dots", exported["values"]), ("b.dots", simulated["detectors"]["30"])):
        (counts,) = json.loads((tmp_path / name).read_text(encoding="utf-8"))
        assert set(counts.values()) == {points}
        assert {"wavelength_nm", "sigma_deg", "theta_deg", "phi_deg", "luminance_factor", "flags"} <= counts.keys()


def test_the_help_of_the_commands_lists_it(capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("simulate sample", "rehearse", "export"):
        app([*command.split(), "--help"], standalone_mode=False)
        text = " ".join(capsys.readouterr().out.split())
        assert "my (.my) a table of the test" in text, command
        assert "ddr (.ddr) Lumicept table of a BRDF" in text, command


def test_an_error_offers_it(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"ends with \.ddr, \.ddt, .* or \.my"):
        app(["simulate", "sample", "--sample", "lambertian", "--out", str(tmp_path / "a.txt")], standalone_mode=False)
    with pytest.raises(UserError, match=r"there is no such format .*; give ddr, ddt, .* or my"):
        app(["export", str(SCHEDULE), "--format", "his", "--out", str(tmp_path / "a")], standalone_mode=False)
    with pytest.raises(UserError, match=r"table:FILE \(\.ddr, \.ddt, .*\.bsdf, .*\.my\)"):
        parse_sample("phong")
    with pytest.raises(UserError, match=r"the format zemax does not hold several wavelengths; use .* my \(\.my\)"):
        app(
            ["simulate", "sample", "--sample", "lambertian", "--wavelength", "450,650", "--out", str(tmp_path / "a.bsdf")],
            standalone_mode=False,
        )
