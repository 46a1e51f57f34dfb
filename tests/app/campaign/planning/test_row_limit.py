"""A campaign has a million rows at most, all kinds of them counted; more are refused before they are built."""

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
GREAT = (
    "sigma_deg = [15, 30, 45, 60, 70]\ngamma_deg = [0, 30]\nbeta_deg = { start = 0, stop = 180, step = 1 }\n"
    'shift_deg = [0, 1, 2, 3, 4]\nwavelength_nm = { start = 400, stop = 700, step = 6.25 }\nsymmetry = "anisotropic"\n'
)
DRIFT = "[drift]\nevery_s = {}\nsigma_deg = 30\nbeta_deg = 180\nwavelength_nm = 550\n"


def refused(text: str) -> str:
    clock = RealClock()
    begun = clock.now()
    with pytest.raises(UserError) as caught:
        make_plan(parse_schedule(HEAD + text, "x.toml"), VIRTUAL)
    assert clock.now() - begun < 5.0, "before anything is built"
    return str(caught.value)


@pytest.mark.parametrize("points", [4, 300_000_000, 10_000_000_000_000])
def test_no_more_overlaps_than_there_are_betas(points: int) -> None:
    message = refused(SMALL + f"[overlap]\npoints = {points}\n")
    assert message == f"x.toml: overlap.points: {points} betas at each sigma, but beta_deg has 3; take fewer"


def test_darks_and_drift_checks_count() -> None:
    message = refused(GREAT + "dark_every_s = 0.1\n" + DRIFT.format(0.1))
    found = re.fullmatch(
        r"x\.toml: 886900 measurements \+ at least (\d+) darks \(dark_every_s = 0\.1\) \+ "
        r"at least (\d+) drift checks \(drift\.every_s = 0\.1\) = (\d+) rows, more than 1000000; "
        "take them less often, or coarser grids",
        message,
    )
    assert found is not None, message
    darks, checks, rows = (int(each) for each in found.groups())
    assert 886_900 + darks + checks == rows


@pytest.mark.parametrize("text", ["", "dark_every_s = 0.1\n", "dark_every_s = 20\nreadings = 100\n" + DRIFT.format(30)])
def test_the_fewest_rows_are_no_more_than_there_are(text: str) -> None:
    plan = make_plan(parse_schedule(HEAD + SMALL + text, "x.toml"), VIRTUAL)
    assert plan.details is not None
    for kind, count in min_rows(plan.details.mountings, plan.details.templates, Timing(VIRTUAL.file)).items():
        assert count <= sum(row.kind == kind for row in plan.rows), kind
