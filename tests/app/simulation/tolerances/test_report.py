"""What a tolerance study shows: tables with their assumptions, JSON, CSV and the figure; each states that it is simulated."""

import csv
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from goniotwin.app.cli.main import INTERRUPTED, app
from goniotwin.app.simulation.tolerances import result as computation
from goniotwin.app.simulation.tolerances.result import StudyResult, compute_study
from goniotwin.app.simulation.tolerances.study import read_study
from tests.conftest import REPOSITORY
from tests.system.command import goniotwin, invoke

pytestmark = pytest.mark.xdist_group("report of tolerances")

FOLDER = REPOSITORY / "examples" / "tolerances"
MISSES = "light that misses the sample's hole"
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


def paper_rows(number: int, result: dict[str, Any]) -> Iterator[str]:
    """Rows of the page's table of limits."""
    units: set[str] = set()
    for case in result["cases"]:
        found = {each["deviation"][-3:].strip("_") for each in case["deviations"]} - units
        units |= found if not case["name"] else set()
        for unit in sorted(found):
            own = [each for each in case["deviations"] if each["deviation"].endswith(unit)]
            alone = min(each["alone"][0] for each in own if each["alone"][0] is not None)
            common, individual = (min(each[name] for each in own) for name in ("common", "individual"))
            kind = {"deg": "angular", "mm": "spatial"}[unit] + (f", {case['name']}" if case["name"] else "")
            enough = "at least " if case["common_factor"] == 1.0 else ""
            limits = f"+-{alone:.3f} {unit} | {enough}+-{common:.4f} {unit} | from +-{individual:.4f} {unit}"
            yield f"| {number} | {kind} | +-{result['paper'][unit]:g} {unit} | {limits} |"


def case_row(case: dict[str, Any]) -> str:
    """The values of a case in the page's table of combinations."""
    drawn, worst_alone = case["combinations"], max(each["at_minus_percent"] for each in case["deviations"])
    worst_alone = max(worst_alone, *(each["at_plus_percent"] for each in case["deviations"]))
    shares = [
        f"{100.0 * each['share']:.1f}" + (f"({100.0 * each['standard_error']:.1f})" if each["standard_error"] else "")
        for each in drawn["within"]
    ]
    middle = f"{drawn['median_percent']:.2f} | {case['worst_percent']:.2f}"
    return f"| {worst_alone:.2f} | {middle} | {' | '.join(shares)} | {case['common_factor']:.4f} |"


@pytest.mark.long
@pytest.mark.parametrize("number", [1, 2])
def test_the_page_has_the_values_of_the_command(number: int) -> None:
    done = goniotwin("tolerances", FOLDER / f"table{number}.toml", "--json")
    assert done.returncode == 0
    result, page = json.loads(done.stdout), " ".join(DOCUMENT.split())
    for row in (*paper_rows(number, result), *(case_row(each) for each in result["cases"])):
        assert row in page
    share = result["cases"][0]["combinations"]["within"][0]["share"]
    words = [f"{100.0 * (1.0 - share):.0f} % of {'those of ' if number == 1 else 'the combinations of '}Table {number}"]
    if number == 2:
        limits = {each["name"]: each["worst"] for each in result["recentred"]["limitations"]}
        lights = {each["light"]: each for each in result["illumination"]["lights"]}
        shifts = result["cases"][-1]
        words += [
            f"raise it from {shifts['aligned_percent']:.2f} to {shifts['worst_percent']:.2f} %",
            f"no corner exceeds {result['recentred']['worst_percent']:.2f} %",
            f"({limits['place of the light on the sample']:.2f} mm)",
            f"({limits[MISSES]:.2f} %)",
            f"up to {limits['incidence']:.2f} deg off",
            f"{lights['anew']['worst_percent']:.2f} % instead of {lights['frozen']['worst_percent']:.2f} %",
            f"{lights['anew']['median_flux']:.3f} instead of {lights['frozen']['median_flux']:.3f}",
        ]
    else:
        even = result["uniformity"]
        lost, error = 100.0 * (1.0 - even["by_rays"]["flux"]), 100.0 * even["by_rays"]["flux_error"]
        words += [
            f"{even['by_rays']['rays']} adjoint rays lose {lost:.2f}({error:.2f}) %",
            f"uniformity is {even['at_worst']:.2f} where the flux is still {even['flux_at_worst']:.2f}",
        ]
    for each in words:
        assert each in page


def test_the_page_has_the_closed_forms_of_shifts() -> None:
    """A mirror at 45 deg, shifted by 1 mm along its normal, moves the light by 1.41 mm; the pupil is 800 mm away."""
    assert pytest.approx(1.0 / (3.0 * math.sqrt(2.0) + 1.0), abs=0.005) == 0.19
    assert math.degrees(math.sqrt(2.0) * 0.1 / 800.0) == pytest.approx(0.01, abs=5e-4)
    for words in ("(3 x 1.41 + 1) x 0.19 mm = 1 mm", "a shift of 0.1 mm changes a direction by 0.01 deg at most"):
        assert words in " ".join(DOCUMENT.split())
    assert {f"table{k}-elements.png" in DOCUMENT and f"tolerances-table{k}.png" in DOCUMENT for k in (1, 2)} == {True}
