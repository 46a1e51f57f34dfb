"""The estimated duration of a plan equals the duration of its run."""

from pathlib import Path

import pytest

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.plan import NewPlan, make_plan
from goniotwin.app.campaign.rehearsal.without_wires import rows_without_wires
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.rig import RigDescription, parse_rig, read_rig
from tests.app.campaign.planning.planner_bench import HEAD, LARGE, RUN, time_checks
from tests.conftest import RIG

VIRTUAL = read_rig(RIG)
TOLERANCE = 0.05
LIGHT_DEPENDENT = {
    "auto-range": 'sigma_deg = [10, 70]\nbeta_deg = { start = 0, stop = 180, step = 45 }\ngains_v_per_a = "automatic"\n'
    'wavelength_nm = [400, 700]\nside = "both"\nlight = "both"\n',
    "averaging": "sigma_deg = [30]\nbeta_deg = [0, 90, 180]\nwavelength_nm = { start = 400, stop = 700, step = 25 }\n"
    "gains_v_per_a = [1e10]\n[averaging]\nrelative_uncertainty = 0.003\nlongest_s = 5\n",
    "both, with the empty sample unit": "sigma_deg = [0, 40]\nbeta_deg = [0, 90, 180]\nwavelength_nm = [500, 600]\n"
    'light = "transmitted"\nopen_beam = true\nsignature = true\ngains_v_per_a = "automatic"\n'
    "[averaging]\nrelative_uncertainty = 0.01\n",
    "both, at two gains, dark readings in between": "sigma_deg = [20]\nbeta_deg = { start = 0, stop = 180, step = 20 }\n"
    "wavelength_nm = [500, 600]\ngains_v_per_a = [1e8, 1e10]\ndark_every_s = 20\n[averaging]\nrelative_uncertainty = 0.005\n",
}
FIXED = {
    "drift checks and uneven steps": "gains_v_per_a = [1e8, 1e10]\nsigma_deg = [0, 30]\nwavelength_nm = [450, 650]\n"
    "beta_deg = [0, 90, 170, 175, 180]\n[drift]\nevery_s = 20\nsigma_deg = 45\nbeta_deg = 90\nwavelength_nm = 550\n"
    "limit = 0.5\n",
    "repeats and signature": "gains_v_per_a = [1e10]\nrepeats = 2\nsignature = true\nsigma_deg = [10, 60]\n"
    "beta_deg = [0, 45, 90]\nwavelength_nm = [500, 600]\nreadings = 16\n",
}


def variants(texts: dict[str, str], *quick: str) -> pytest.MarkDecorator:
    """Schedules by name: those of `make test`, and all of them in the long run."""
    marks = {name: [] if name in quick else [pytest.mark.long] for name in texts}
    return pytest.mark.parametrize("text", [pytest.param(texts[name], id=name, marks=marks[name]) for name in texts])


def planned(text: str, rig: RigDescription = VIRTUAL) -> NewPlan:
    return make_plan(parse_schedule(HEAD + text, "x.toml"), rig)


@variants(FIXED, "drift checks and uneven steps")
def test_the_duration_of_fixed_readings_is_within_one_percent(text: str, tmp_path: Path) -> None:
    plan = planned(text)
    assert run_campaign(plan, tmp_path / "run.journal").seconds == pytest.approx(plan.seconds, rel=0.01)


@variants(LIGHT_DEPENDENT, "auto-range")
def test_the_duration_of_light_dependent_readings_is_within_five_percent(text: str, tmp_path: Path) -> None:
    plan = planned(text)
    assert run_campaign(plan, tmp_path / "run.journal").seconds == pytest.approx(plan.seconds, rel=TOLERANCE)
    checked = check_plan(plan)
    least, most = checked.duration_range_s
    assert checked.least_s <= plan.seconds
    assert least <= plan.seconds <= most
    assert any("It uses the expected signal of the twin at up to 40 poses" in each for each in checked.warnings)


@pytest.mark.long
@pytest.mark.parametrize("text", RUN.values(), ids=RUN)
def test_the_durations_of_five_different_schedules_are_within_five_percent(text: str, tmp_path: Path) -> None:
    plan = planned(text)
    assert run_campaign(plan, tmp_path / "run.journal").seconds == pytest.approx(plan.seconds, rel=TOLERANCE)


def test_the_expected_exposure_at_a_real_rig_is_from_the_twin_that_its_file_describes() -> None:
    text = RIG.read_text(encoding="utf-8").partition("# ---- what the virtual rig is")[0].replace("[simulated]\nseed = 1\n", "")
    for name in ("axes", "mono", "adc-0", "adc-1", "adc-2", "adc-3", "adc-4"):
        text = text.replace(f"twin://virtual/{name}", f"/dev/{name}" if name in ("axes", "mono") else f"{name}:502")
    text = text.replace("twin://virtual/monitor", "1313:8078:P0012345")
    plan = planned(LIGHT_DEPENDENT["auto-range"], parse_rig(text, RIG.parent, "real"))
    assert set(plan.expected_reading_s) == {"etalon", "gaussian-5"}
    assert any("with assumed samples" in each for each in check_plan(plan).warnings)


def test_the_expected_exposure_is_reproducible_and_fast() -> None:
    """A hundred thousand rows with auto-range: one second on an idle machine; the limit allows for a busy one."""
    text = LARGE["100,000 rows"].replace("gains_v_per_a = [1e10]", 'gains_v_per_a = "automatic"')
    assert planned(LIGHT_DEPENDENT["averaging"]).seconds == planned(LIGHT_DEPENDENT["averaging"]).seconds
    (found,) = time_checks(VIRTUAL, {"100,000 rows": text})
    assert found["check_s"] < 10.0


@pytest.mark.long
def test_the_expected_exposure_has_no_largest_number_of_readings() -> None:
    """Rows of some eight thousand readings; the scatter of the expected ones is known to 4 %, and so is their number to 9 %."""
    plan = planned(
        "sigma_deg = [30]\nbeta_deg = [0, 90, 180]\nwavelength_nm = [550]\ngains_v_per_a = [1e10]\n"
        "[averaging]\nrelative_uncertainty = 1e-4\nlongest_s = 900\n"
    )
    model = VIRTUAL.model()
    assert model is not None
    rows = [each for each in rows_without_wires(plan, model) if (each.row.kind, each.row.sample) == ("measure", "etalon")]
    read_s = [len(each.data.readings[0].counts) * VIRTUAL.file.photodiodes.period_s for each in rows]
    assert min(read_s) > 600.0
    assert plan.expected_reading_s["etalon"] == pytest.approx(sum(read_s) / len(read_s), rel=0.1)
