"""`goniotwin plot`, `compare` and `report`: files, JSON, refusals."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from goniotwin.app.cli.main import app
from goniotwin.app.data.report.report import write_report
from goniotwin.app.errors import GoniotwinError
from goniotwin.app.formats import registry, writing
from goniotwin.app.formats.content import BsdfFile
from tests.app.data.made import gaussian, table
from tests.conftest import REPOSITORY

JOURNAL = REPOSITORY / "tests" / "golden" / "data" / "finished.journal"


def invoke(*arguments: object) -> Result:
    return CliRunner().invoke(app, [*map(str, arguments)])


def json_of(*arguments: object) -> Any:
    result = invoke(*arguments, "--json")
    assert result.exit_code == 0, result.exception
    return json.loads(result.stdout)


@pytest.fixture
def ddr(tmp_path: Path) -> Path:
    path = tmp_path / "made.ddr"
    made = table(gaussian(15.0), np.array([0.0, 30.0, 60.0, 90.0]), 2.5)
    writing.write(path, BsdfFile((made,)), registry.format_named("ddr", registry.BSDF))
    return path


def test_plot_writes_a_picture_of_a_journal_and_of_a_file(ddr: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.png"
    assert json_of("plot", JOURNAL, "--out", out, "--dpi", 50) == {
        "file": str(out),
        "kind": "cuts",
        "sample": "gaussian-5",
        "simulated": True,
    }
    assert out.read_bytes().startswith(b"\x89PNG")
    out = tmp_path / "a.svg"
    done = invoke("plot", ddr, "--out", out, "--kind", "polar", "--sigma", 30, "--log")
    assert (done.exit_code, done.stdout) == (0, f"polar: {out}\n")
    assert "sigma 30 deg" in out.read_text(encoding="utf-8")


def test_compare_gives_formula_5_with_its_range_and_a_picture(tmp_path: Path) -> None:
    out = tmp_path / "a.png"
    found = json_of("compare", JOURNAL, "theory", "--theta", 10, "--in-plane", "--out", out, "--dpi", 50)
    assert found["formula_5"]["range_of_i"].startswith("in the plane of incidence, theta to 10 deg, polar angle to 85 deg")
    assert found["formula_5"]["percent"] < 2.0
    assert [each["sigma_deg"] for each in found["lights"]] == [30.0]
    assert found["lights"][0]["share_within_2_u"] == 1.0
    assert found["simulated"] is True
    assert out.read_bytes().startswith(b"\x89PNG")


def test_a_model_is_compared_in_the_directions_of_the_other(ddr: Path) -> None:
    one = json_of("compare", ddr, "gaussian:width_deg=15,peak=1")
    other = json_of("compare", "gaussian:width_deg=15,peak=1", ddr)
    assert one["formula_5"]["percent"] == pytest.approx(other["formula_5"]["percent"])
    assert one["formula_5"]["percent"] < 1e-3
    refused = str(invoke("compare", ddr, "theory").exception)
    assert refused == "made.ddr: its sample is not one of a virtual rig; give its model, such as gaussian:width_deg=5"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("plot", JOURNAL, "--out", "a.pdf"), "a.pdf: a picture is a .png or .svg; choose such a name"),
        (("plot", JOURNAL, "--out", "a.png", "--sample", "paper"), "there is no sample 'paper'"),
        (("plot", JOURNAL, "--out", "a.png", "--kind", "spectrum"), "a spectrum needs values at two wavelengths"),
        (("compare", "gaussian:width_deg=5", "gaussian:width_deg=6"), "one of them has to be a journal or a file"),
        (("compare", "theory", JOURNAL), "theory: is the second of the two"),
        (("compare", JOURNAL, "gausian:width_deg=5"), "gausian"),
        (("compare", JOURNAL, "theroy"), "Or give a file, or theory: the sample of a virtual rig's journal"),
        (("compare", JOURNAL, "missing.ddr"), "missing.ddr: "),
        (("compare", JOURNAL, JOURNAL, "--sample", "a", "--sample", "b", "--sample", "c"), "--sample: may be given twice"),
        (("report", JOURNAL, "--out", JOURNAL), "is the journal itself"),
        (("report", JOURNAL, "--out", "schedule.toml"), "schedule.toml: a report is HTML or a PDF"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_one_line(
    arguments: tuple[object, ...], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = invoke(*arguments)
    assert isinstance(result.exception, GoniotwinError)
    assert message in str(result.exception)
    assert list(tmp_path.iterdir()) == []


def test_a_report_is_beside_its_journal_unless_another_place_is_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    without_pictures = partial(write_report, kinds=())  # they take most of the time
    monkeypatch.setattr("goniotwin.app.data.report.report.write_report", without_pictures)
    path = tmp_path / "finished.journal"
    path.write_bytes(JOURNAL.read_bytes())
    found = json_of("report", path)
    assert found["file"] == str(tmp_path / "finished.html")
    assert "<html" in (tmp_path / "finished.html").read_text(encoding="utf-8")
    assert found["chain"]["tip"] in (tmp_path / "finished.html").read_text(encoding="utf-8")
