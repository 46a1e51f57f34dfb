"""What a tolerance study shows: tables with their assumptions, JSON, CSV and the figure; each states that it is simulated."""

import csv
import json
import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.cli.main import INTERRUPTED, app
from goniotwin.app.simulation.tolerances import result as computation
from goniotwin.app.simulation.tolerances.result import StudyResult, compute_study
from goniotwin.app.simulation.tolerances.study import StudyFile, read_study
from goniotwin.app.toml_file import validate_table
from tests.conftest import REPOSITORY
from tests.system.command import goniotwin, invoke

pytestmark = pytest.mark.xdist_group("report of tolerances")

FOLDER = REPOSITORY / "examples" / "tolerances"
DOCUMENT = (REPOSITORY / "docs" / "physics" / "tolerances.md").read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def quick() -> StudyResult:
    steps: list[tuple[float, str]] = []
    result = compute_study(read_study(FOLDER / "quick.toml"), lambda share, step: steps.append((share, step)))
    shares = [share for share, _ in steps]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    return result


def test_the_stages_of_a_study_agree_with_each_other(quick: StudyResult) -> None:
    case = quick.case
    assert case.combinations.complete
    assert case.combinations.percent.size == 625
    assert case.worst.percent == case.combinations.worst_percent
    assert case.worst.percent > case.worst_alone[1] > case.aligned_percent
    assert case.common.worst.percent == pytest.approx(5.0, abs=1e-6)
    assert case.individual.worst.percent == pytest.approx(5.0, abs=1e-6)
    # An equal share of what each is permitted alone: the insensitive ones keep more than by one factor, the sensitive less.
    assert case.individual.limits.min() < case.common.limits.min() < case.individual.limits.max()
    np.testing.assert_allclose(np.ptp(case.individual.limits / case.alone.permitted[:, 0]), 0.0, atol=1e-9)
    # Every combination of the steps is worse in the median than an instrument within the limits, and that than a normal one.
    median = [np.median(each.percent) for each in (case.combinations, quick.yields["uniform"], quick.yields["normal"])]
    assert median[0] > median[1] > median[2]


def test_what_limits_the_deviations_is_the_incidence(quick: StudyResult) -> None:
    assert quick.recentred is not None
    found = {each.name: each for each in quick.recentred.limitations}
    # By the sensitivities: 1.06 of mirror 3, 1 of the sample, 0.87 of the beam, each times 0.05 deg.
    assert found["incidence"].worst == pytest.approx(0.05 * (1.0607 + 1.0 + 0.8660), abs=2e-4)
    assert found["incidence"].factor == pytest.approx(0.1 / found["incidence"].worst, abs=1e-3)
    assert found["relative RMS"].factor == pytest.approx(quick.case.common.factor)
    assert found["place of the light on the sample"].factor > 1.0


def test_the_command_gives_text_figure_and_tables(quick: StudyResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("goniotwin.app.cli.work.tolerances.compute_study", lambda _study, _report: quick)
    study, folder = FOLDER / "quick.toml", tmp_path / "new"
    text = invoke("tolerances", study, "--out", folder)
    assert text.returncode == 0
    for part in ("SIMULATED", "sample ry", "assumptions", "range of i", "explanations", "worst corner"):
        assert part in text.stdout
    assert (folder / "quick.png").read_bytes().startswith(b"\x89PNG")
    for name, column in (("deviations", "alone_5_percent"), ("combinations", "share_within")):
        lines = (folder / f"quick-{name}.csv").read_text(encoding="utf-8").splitlines()
        assert lines[0].startswith("# SIMULATED")
        rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
        assert all(math.isfinite(float(row[column])) for row in rows)
    done = json.loads(invoke("tolerances", study, "--json").stdout)
    assert done["simulated"] is True
    assert done["cases"][0]["worst_percent"] == quick.case.worst.percent
    assert done["cases"][0]["combinations"]["within"][0]["standard_error"] == 0.0
    assert done["yields"]["uniform"]["within"][0]["standard_error"] > 0.0
    assert {"criterion", "range of i", "beam", "deviations", "combinations"} <= set(done["assumptions"])


DARK = """name = "dark"
criterion = { kind = "gaussian", sigma_deg = [80], step_deg = 2.0 }
deviations = [{ elements = ["sample"], angles = ["ry"], limit_deg = 20 }]
alone = { largest_deg = 20 }
yields = { draws = 100 }
"""


def test_combinations_without_light_fail_and_are_stated(tmp_path: Path) -> None:
    study = tmp_path / "dark.toml"
    study.write_text(DARK, encoding="utf-8")
    done = invoke("tolerances", study, "--json")
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr
    result = json.loads(done.stdout)
    assert result["cases"][0]["worst_percent"] is None
    assert "cut on one side of the specular direction" in result["assumptions"]["range of i"]
    assert any("have directions without light" in each for each in result["explanations"])
    assert not any(re.search(r"\b(nan|inf)\b", each) for each in result["explanations"])


def test_a_criterion_that_fails_without_deviations_is_refused(tmp_path: Path) -> None:
    study = tmp_path / "narrow.toml"
    text = (FOLDER / "quick.toml").read_text(encoding="utf-8")
    study.write_text(text.replace("within_percent = [5]", "within_percent = [0.1]"), encoding="utf-8")
    done = invoke("tolerances", study)
    assert done.returncode == 2
    assert "without deviations the criterion is 0.614 % already, more than within_percent = 0.1" in " ".join(
        done.stderr.split()
    )


def test_a_folder_that_cannot_be_written_is_refused_before_anything_is_computed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("goniotwin.app.cli.work.tolerances.compute_study", lambda *_: pytest.fail("computed"))
    (tmp_path / "file").touch()
    done = invoke("tolerances", FOLDER / "quick.toml", "--out", tmp_path / "file")
    assert done.returncode == 2
    assert "choose another folder" in done.stderr


def test_ctrl_c_in_a_study_is_one_line(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(computation, "all_combinations", interrupt)
    assert app(["tolerances", str(FOLDER / "quick.toml")], standalone_mode=False) == INTERRUPTED
    assert capsys.readouterr().err.splitlines()[-1] == "goniotwin: stopped"


def test_the_study_of_the_document_is_valid() -> None:
    (block,) = re.findall(r"```toml\n(.*?)```", DOCUMENT, re.DOTALL)
    study = validate_table(StudyFile, tomllib.loads(block), "document")
    assert [each.name for each in study.variants] == ["the arc alone"]


@pytest.mark.long
@pytest.mark.parametrize("number", [1, 2])
def test_the_document_contains_the_output_of_the_command(number: int) -> None:
    printed = goniotwin("tolerances", FOLDER / f"table{number}.toml", COLUMNS="100")
    assert printed.returncode == 0
    for line in printed.stdout.splitlines():
        assert line.rstrip() in DOCUMENT
    assert f"tolerances-table{number}.png" in DOCUMENT
