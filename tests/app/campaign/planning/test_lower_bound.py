"""The lower bound of the machine time is below the duration of any plan and of any run; ages of dark readings."""

import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.plan import NewPlan, make_plan
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, parse_rig, read_rig
from tests.conftest import RIG

VIRTUAL = read_rig(RIG)
SLOW = parse_rig(
    RIG.read_text(encoding="utf-8")
    .replace("speed_deg_s = 30.0", "speed_deg_s = 1.0\nbacklash_deg = 0.3")
    .replace("lower_deg = 0.0\n", "lower_deg = -5.0\n"),
    RIG.parent,
    "slow",
)
HEAD = 'name = "x"\nsamples = ["gaussian-5"]\netalon = "etalon"\n'
TWO = "sigma_deg = [30]\nbeta_deg = [0, 180]\nwavelength_nm = [550]\n"
DRIFT = "[drift]\nevery_s = {}\nsigma_deg = 45\nbeta_deg = 90\nwavelength_nm = 550\nlimit = 0.5\n"


def planned(text: str, rig: RigDescription = VIRTUAL) -> NewPlan:
    return make_plan(parse_schedule(HEAD + text, "x.toml"), rig)


def sublists(values: list[float], longest: int) -> st.SearchStrategy[list[float]]:
    return st.lists(st.sampled_from(values), min_size=1, max_size=longest, unique=True)


@st.composite
def schedules(draw: st.DrawFn) -> str:
    seconds = st.sampled_from([1e-9, 0.5, 2.0, 5.0, 20.0, 60.0, 600.0])
    keys: dict[str, object] = {
        "sigma_deg": draw(sublists([0.0, 10.0, 35.0, 80.0], 3)),
        "gamma_deg": draw(sublists([0.0, 15.0, 200.0], 2)),
        "beta_deg": draw(sublists([0.0, 20.0, 90.0, 170.0, 180.0], 4)),
        "shift_deg": draw(sublists([0.0, 0.5, 2.0], 2)),
        "wavelength_nm": draw(sublists([400.0, 410.0, 700.0], 3)),
        "gains_v_per_a": draw(st.sampled_from(["automatic", [1e8], [1e6, 1e10]])),
        "symmetry": draw(st.sampled_from(["isotropic", "anisotropic"])),
        "light": draw(st.sampled_from(["reflected", "both"])),
        "signature": draw(st.booleans()),
        "open_beam": draw(st.booleans()),
        "repeats": draw(st.integers(1, 3)),
        "readings": draw(st.sampled_from([1, 4, 300])),
        "dark_every_s": draw(seconds),
        "order": draw(st.sampled_from(["fastest", ["shift", "beta", "gamma", "sigma", "wavelength"]])),
        "back_and_forth": draw(st.booleans()),
    }
    text = "".join(f"{key} = {json.dumps(value)}\n" for key, value in keys.items())
    tables = {
        "[averaging]\nrelative_uncertainty = 0.01\nlongest_s = 2.0\n": draw(st.booleans()),
        "[warm_up]\npercent_per_10min = 50\nlongest_s = 30\n": draw(st.booleans()),
        DRIFT.format(draw(seconds)): draw(st.booleans()),
    }
    return text + "".join(table for table, chosen in tables.items() if chosen)


@pytest.mark.long
@settings(deadline=None)
@given(text=schedules(), rig=st.sampled_from([VIRTUAL, SLOW]))
def test_no_plan_is_shorter_than_the_lower_bound(text: str, rig: RigDescription) -> None:
    try:
        plan = planned(text, rig)
    except UserError as error:
        assert "the arc would collide with the incoming beam" in str(error)  # noqa: PT017
        return
    assert plan.lower_bound_s <= plan.seconds
    previous = None
    for row in plan.rows:
        assert row.kind not in ("dark", "drift") or (row.kind, row.sample) != previous, "two in a row"
        previous = row.kind, row.sample


@pytest.mark.parametrize(
    "text",
    [
        TWO + "gains_v_per_a = [1e8]\nreadings = 1000\n",
        TWO + "gains_v_per_a = [1e8]\ndark_every_s = 1e-9\n",
        TWO + "gains_v_per_a = [1e8]\nreadings = 200\n" + DRIFT.format(1.0),
    ],
)
def test_a_row_longer_than_dark_every_s_has_one_dark_reading(text: str) -> None:
    plan = planned(text)
    assert plan.seconds / 1.5 <= plan.lower_bound_s <= plan.seconds


@pytest.mark.parametrize(
    "text",
    [
        TWO + 'gains_v_per_a = "automatic"\n',
        "sigma_deg = [10, 70]\nbeta_deg = [0, 90, 180]\nwavelength_nm = [400, 700]\n"
        'gains_v_per_a = "automatic"\nside = "both"\nlight = "both"\n',
        TWO + "gains_v_per_a = [1e10]\nreadings = 1\n[averaging]\nrelative_uncertainty = 0.003\nlongest_s = 5\n",
        TWO + 'light = "transmitted"\nopen_beam = true\nsignature = true\ngains_v_per_a = "automatic"\n'
        "[averaging]\nrelative_uncertainty = 0.01\n",
        TWO + "gains_v_per_a = [1e8, 1e10]\ndark_every_s = 5\n[warm_up]\npercent_per_10min = 50\nlongest_s = 5\n",
    ],
)
def test_no_run_is_shorter_than_the_lower_bound(text: str, tmp_path: Path) -> None:
    plan = planned(text)
    assert plan.lower_bound_s <= run_campaign(plan, tmp_path / "run.journal").seconds


def ages(plan: NewPlan) -> dict[str, float]:
    """Age of the last dark reading at the end of each row."""
    found, age = {}, float("nan")
    for row in plan.rows:
        age = 0.0 if row.kind == "dark" else age + row.seconds
        found[row.identity] = age
    return found


def warns_of_old_dark_reading(plan: NewPlan) -> bool:
    return any("a dark reading gets" in each for each in check_plan(plan).warnings)


def test_a_warm_up_before_the_first_dark_reading_gives_no_warning() -> None:
    assert not warns_of_old_dark_reading(planned(TWO + "gains_v_per_a = [1e8]\n[warm_up]\npercent_per_10min = 0.5\n"))


def test_a_drift_check_comes_after_its_dark_reading() -> None:
    plan = planned(
        "sigma_deg = [30, 60]\nbeta_deg = { start = 0, stop = 180, step = 30 }\nwavelength_nm = [450, 650]\n"
        "gains_v_per_a = [1e8, 1e10]\ndark_every_s = 20\nsignature = true\n" + DRIFT.format(30).replace("45", "30")
    )
    assert max(age for age in ages(plan).values() if age == age) <= 20.0
    assert not warns_of_old_dark_reading(plan)


def test_check_warns_of_a_dark_reading_that_gets_too_old() -> None:
    plan = planned(TWO + "gains_v_per_a = [1e8]\nreadings = 200\ndark_every_s = 5\n")
    assert max(age for age in ages(plan).values() if age == age) > 5.0
    assert warns_of_old_dark_reading(plan)
