"""A campaign has at most a million rows of all kinds; more are refused before they are built."""

import re

import pytest

from goniotwin.app.campaign.planning.durations import Timing
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.planning.validation import min_rows
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from goniotwin.protocols.clock import RealClock
from tests.conftest import RIG

VIRTUAL = read_rig(RIG)
HEAD = 'name = "x"\nsamples = ["gaussian-5"]\netalon = "etalon"\ngains_v_per_a = [1e8]\n'
SMALL = "sigma_deg = [30]\nbeta_deg = [0, 90, 180]\nwavelength_nm = [550]\n"
LARGE = (
    "sigma_deg = [15, 30, 45, 60, 70]\ngamma_deg = [0, 30]\nbeta_deg = { start = 0, stop = 180, step = 1 }\n"
    'shift_deg = [0, 1, 2, 3, 4]\nwavelength_nm = { start = 400, stop = 700, step = 6.25 }\nsymmetry = "anisotropic"\n'
)
DRIFT = "[drift]\nevery_s = {}\nsigma_deg = 30\nbeta_deg = 180\nwavelength_nm = 550\n"


def refused(text: str) -> str:
    clock = RealClock()
    start = clock.now()
    with pytest.raises(UserError) as caught:
        make_plan(parse_schedule(HEAD + text, "x.toml"), VIRTUAL)
    assert clock.now() - start < 5.0, "before anything is built"
    return str(caught.value)


@pytest.mark.parametrize("points", [4, 300_000_000, 10_000_000_000_000])
def test_more_overlaps_than_betas_are_refused(points: int) -> None:
    message = refused(SMALL + f"[overlap]\npoints = {points}\n")
    assert message == f"x.toml: overlap.points: {points} betas at each sigma, but beta_deg has 3; take fewer"


def test_dark_readings_and_drift_checks_count_for_the_row_limit() -> None:
    message = refused(LARGE + "dark_every_s = 0.1\n" + DRIFT.format(0.1))
    match = re.fullmatch(
        r"x\.toml: 886900 measurements \+ at least (\d+) dark readings \(dark_every_s = 0\.1\) \+ "
        r"at least (\d+) drift checks \(drift\.every_s = 0\.1\) = (\d+) rows, more than 1000000; "
        "take longer intervals or coarser grids",
        message,
    )
    assert match is not None, message
    dark_readings, checks, rows = (int(each) for each in match.groups())
    assert 886_900 + dark_readings + checks == rows


@pytest.mark.parametrize("text", ["", "dark_every_s = 0.1\n", "dark_every_s = 20\nreadings = 100\n" + DRIFT.format(30)])
def test_the_least_number_of_rows_is_not_above_the_number_of_rows(text: str) -> None:
    plan = make_plan(parse_schedule(HEAD + SMALL + text, "x.toml"), VIRTUAL)
    for kind, count in min_rows(plan.mountings, plan.templates, Timing(VIRTUAL.file)).items():
        assert count <= sum(row.kind == kind for row in plan.rows), kind
