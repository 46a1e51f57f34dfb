"""Schedules whose arc could collide with the beam: an order without collision, omitted cross-checks, or the key at fault."""

import numpy as np
import pytest

from goniotwin.app.campaign.geometry.collision import crosses_beam
from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.plan import NewPlan, first_collision, make_plan
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import arc_clearance, read_rig
from tests.conftest import RIG

VIRTUAL = read_rig(RIG)
CLEARANCE = arc_clearance(VIRTUAL.file)
HEAD = 'name = "x"\nsamples = ["gaussian-5"]\netalon = "etalon"\ngains_v_per_a = [1e8]\nwavelength_nm = [450]\n'
PLANE = (
    'symmetry = "plane-symmetric"\nsigma_deg = [20, 60]\ngamma_deg = { start = 0, stop = 270, step = 90 }\n'
    "beta_deg = [0, 60, 120, 180, 240, 300]\nrepeats = 3\n"
)
DRIFT = "[drift]\nevery_s = {}\nsigma_deg = 60\nbeta_deg = {}\nwavelength_nm = 450\n"


def planned(text: str) -> NewPlan:
    return make_plan(parse_schedule(HEAD + text, "x.toml"), VIRTUAL)


def refused(text: str) -> str:
    with pytest.raises(UserError) as caught:
        planned(text)
    return str(caught.value)


@pytest.mark.parametrize("every_s", [5, 40, 600])
@pytest.mark.parametrize("checks", ["[overlap]\npoints = 2\n", "[overlap]\npoints = 1\n[symmetry_check]\npoints = 3\n"])
def test_a_plan_with_cross_checks_and_drift_checks_has_no_collision(every_s: float, checks: str) -> None:
    plan = planned(PLANE + checks + DRIFT.format(every_s, 180))
    assert first_collision(plan.rows, CLEARANCE) is None
    assert plan.omitted == ()
    assert any(row.pose is not None and row.pose[3] == 5.0 for row in plan.rows)
    assert ("symmetry_check" in checks) == any(row.identity.endswith("/mirrored") for row in plan.rows)


def test_unreachable_cross_checks_are_omitted_with_a_warning() -> None:
    """At beta 270 the shift must be low: an overlap at shift 5 would put the arc into the beam."""
    plan = planned("sigma_deg = [30]\nbeta_deg = [270]\n[overlap]\npoints = 1\n")
    assert plan.omitted == ("overlap",)
    assert {row.pose[3] for row in plan.rows if row.pose is not None} == {0.0}
    assert any(
        "[overlap] points = 1 is omitted: in any order the arc would collide" in each for each in check_plan(plan).warnings
    )


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("sigma_deg = [30]\nbeta_deg = [0, 270]\nshift_deg = [3, 4]\n", "change beta_deg or shift_deg"),
        ("sigma_deg = [30]\nbeta_deg = [0, 180]\n" + DRIFT.format(60, 180) + "shift_deg = 4\ngamma_deg = 0\n", None),
        (
            "sigma_deg = [30]\nbeta_deg = [280, 300]\nshift_deg = [3, 4]\n" + DRIFT.format(60, 180),
            "drift.beta_deg or drift.shift",
        ),
        (
            "sigma_deg = [60]\nbeta_deg = [180, 270]\n[near_specular]\nwithin_deg = 90\nshift_deg = [0, 5]\n",
            "change near_specular.shift_deg",
        ),
        (
            "sigma_deg = [30]\nbeta_deg = [250, 290]\nshift_deg = [0, 4]\nback_and_forth = false\n"
            'order = ["shift", "beta", "gamma", "sigma", "wavelength"]\n',
            'set order = "fastest" and back_and_forth = true',
        ),
    ],
)
def test_a_collision_is_refused_with_the_key_at_fault(text: str, key: str | None) -> None:
    if key is None:
        planned(text)
        return
    message = refused(text)
    assert message.startswith("x.toml: on the way to ")
    assert key in message


def test_an_impossible_symmetry_check_is_refused_with_the_reason() -> None:
    grids = 'symmetry = "plane-symmetric"\nsigma_deg = [30]\n[symmetry_check]\npoints = 1\n'
    assert refused("beta_deg = [0, 180]\n" + grids) == (
        "x.toml: symmetry_check.points: 1, but the rig reaches the mirror images of 0 of 2 poses (2 equal their mirror image); "
        "remove [symmetry_check], or take gammas and betas whose mirror images the rig reaches"
    )


def test_there_is_no_collision_between_passes() -> None:
    plan = planned(PLANE + "signature = true\nopen_beam = true\n[overlap]\npoints = 2\n")
    poses = [(*row.pose, 0.0) for row in plan.rows if row.pose is not None]
    assert not crosses_beam(CLEARANCE, np.array(poses)).any()
