"""Plans: the rows that follow from a schedule, their order and durations, and refusals."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.campaign.planning.durations import UNKNOWN_STATE, Timing
from goniotwin.app.campaign.planning.plan import NewPlan, Plan, make_plan
from goniotwin.app.campaign.row import NO_SAMPLE, Row
from goniotwin.app.campaign.schedule.file import parse_schedule, read_schedule
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.app.errors import UserError
from goniotwin.app.rig import AXES, axis_settings, parse_rig, read_rig
from goniotwin.drivers.motion import limit_violation
from goniotwin.twin.optics import arc_direction, specular_direction
from tests.app.campaign.planning.planner_bench import EXAMPLES, NAMED, with_paper_order
from tests.conftest import RIG

VIRTUAL = read_rig(RIG)
HEAD = """
name = "small"
samples = ["gaussian-5"]
etalon = "etalon"
gains_v_per_a = [1e8, 1e10]
"""
GRIDS = "sigma_deg = [0, 30]\nbeta_deg = [0, 90, 180]\nshift_deg = [0, 2]\nwavelength_nm = [500, 600]\n"


def planned(text: str = "", grids: str = GRIDS) -> NewPlan:
    return make_plan(parse_schedule(HEAD + grids + text, "small.toml"), VIRTUAL)


def measured(plan: Plan, sample: str = "gaussian-5") -> list[Row]:
    return [row for row in plan.rows if row.kind == "measure" and row.sample == sample]


def poses(plan: Plan, sample: str = "gaussian-5") -> set[tuple[float, ...]]:
    return {row.pose for row in measured(plan, sample) if row.pose is not None}


def refused(text: str, grids: str = GRIDS) -> str:
    with pytest.raises(UserError) as caught:
        planned(text, grids)
    message = str(caught.value)
    assert message.startswith("small.toml: ")
    assert "\n" not in message
    return message


def test_each_sample_is_measured_at_every_pose_and_wavelength_once() -> None:
    plan = planned()
    for sample in ("etalon", "gaussian-5"):
        rows = measured(plan, sample)
        assert len(rows) == len({(row.pose, row.wavelength_nm) for row in rows}) == 2 * 3 * 2 * 2
    assert "gaussian-5/sigma 30/gamma 0/beta 90/shift 2/600 nm" in {row.identity for row in plan.rows}
    assert [row.number for row in plan.rows] == list(range(len(plan.rows)))


orders = st.one_of(
    st.just("fastest"), st.permutations(["gamma", "sigma", "beta", "shift", "wavelength"]).map(lambda names: list(names))
)


@settings(deadline=None)
@given(order=orders, both=st.booleans(), extra=st.sampled_from(["", "repeats = 2\n", "signature = true\nopen_beam = true\n"]))
def test_the_rows_do_not_depend_on_the_order(order: str | list[str], both: bool, extra: str) -> None:
    keys = f"order = {order!r}\nback_and_forth = {str(both).lower()}\n".replace("'", '"')
    plan, usual = planned(keys + extra), planned(extra)
    names = {row.identity for row in plan.rows if row.kind == "measure"}
    assert names == {row.identity for row in usual.rows if row.kind == "measure"}
    assert len(names) == plan.rows.kinds["measure"]
    assert plan.lower_bound_s <= min(plan.seconds, usual.seconds) <= plan.seconds


@pytest.mark.parametrize(
    "text",
    [
        "",
        "repeats = 2\nsignature = true\nopen_beam = true\n",
        "dark_every_s = 10\n",
        'side = "both"\nlight = "both"\n',
        "[drift]\nevery_s = 20\nsigma_deg = 45\nbeta_deg = 90\nwavelength_nm = 550\n[warm_up]\npercent_per_10min = 1\n",
        "[averaging]\nrelative_uncertainty = 0.01\n",
    ],
)
def test_the_duration_of_each_row_is_that_of_the_timing(text: str) -> None:
    plan, state = planned(text), UNKNOWN_STATE
    timing = Timing(VIRTUAL.file, plan.expected_reading_s)
    for row in plan.rows:
        seconds, after = timing.row(state, row)
        again = Timing(VIRTUAL.file, plan.expected_reading_s).row(state, row)[0]
        assert timing.row(state, row)[0] == seconds == again, "asking for a duration changes nothing"
        assert row.seconds == pytest.approx(seconds, abs=1e-9), row.identity
        state = after
    assert plan.seconds == pytest.approx(sum(row.seconds for row in plan.rows))


@pytest.mark.parametrize("name", NAMED)
def test_the_named_schedules_are_within_five_percent_of_the_bound_and_never_slower_than_the_paper(name: str) -> None:
    schedule = read_schedule(EXAMPLES / "schedules" / f"{name}.toml")
    plan = make_plan(schedule, VIRTUAL)
    least = plan.lower_bound_s
    assert least <= plan.seconds <= 1.05 * least
    for both in (False, True):
        paper = make_plan(with_paper_order(schedule, back_and_forth=both), VIRTUAL)
        assert least <= plan.seconds <= paper.seconds + 1e-6


def test_the_order_of_paper_order_toml_is_kept() -> None:
    plan = make_plan(read_schedule(EXAMPLES / "schedules" / "paper-order.toml"), VIRTUAL)
    rows = [(row.wavelength_nm, *row.pose) for row in measured(plan) if row.pose is not None]
    assert rows == sorted(rows, key=lambda row: (row[0], row[2], row[1], row[3], row[4]))


# ---- sides, light, symmetry ----


def test_for_light_on_the_back_sigma_is_beyond_90_degrees() -> None:
    assert {pose[1] for pose in poses(planned('side = "back"\n'))} == {180.0, 150.0}
    assert {pose[1] for pose in poses(planned('side = "both"\n'))} == {0.0, 30.0, 180.0, 150.0}


def test_for_transmitted_light_the_etalon_is_lit_from_the_other_side() -> None:
    plan = planned('light = "transmitted"\n')
    assert {pose[1] for pose in poses(plan)} == {0.0, 30.0}
    assert {pose[1] for pose in poses(plan, "etalon")} == {180.0, 150.0}
    assert {pose[1] for pose in poses(planned('light = "both"\n'), "etalon")} == {0.0, 30.0, 180.0, 150.0}


ROUND = "sigma_deg = [30]\ngamma_deg = [0, 90, 180, 270]\nbeta_deg = [0, 90, 180, 225, 315]\nwavelength_nm = [550]\n"


def test_an_isotropic_sample_needs_one_gamma_and_half_the_betas() -> None:
    plan = planned(grids=ROUND)
    assert {pose[::2] for pose in poses(plan)} == {(0.0, 0.0), (0.0, 90.0), (0.0, 180.0), (0.0, 225.0), (0.0, 315.0)}
    twice = planned(grids=ROUND.replace("[0, 90, 180, 225, 315]", "[0, 135, 225, 180]"))
    assert {pose[2] for pose in poses(twice)} == {0.0, 135.0, 180.0}
    assert twice.mountings[1][0].poses.left_out == 4 * 4 - 3


def test_a_plane_symmetric_sample_needs_one_of_each_pair_of_mirror_images() -> None:
    found = {pose[::2] for pose in poses(planned('symmetry = "plane-symmetric"\n', ROUND))}
    for gamma, beta in ((gamma, beta) for gamma in (0.0, 90.0, 180.0, 270.0) for beta in (0.0, 90.0, 180.0, 225.0, 315.0)):
        image = (-gamma % 360.0, -beta % 360.0)
        assert ((gamma, beta) in found) != (image in found) or (gamma, beta) == image


def test_an_anisotropic_sample_needs_all_poses() -> None:
    assert len(poses(planned('symmetry = "anisotropic"\n', ROUND))) == 20


def test_a_symmetry_check_measures_mirror_images_as_rows_of_their_own() -> None:
    plan = planned("[symmetry_check]\npoints = 2\n")
    mirrored = [row for row in measured(plan) if row.identity.endswith("/mirrored")]
    assert len(mirrored) == 2 * 2
    usual = poses(planned())
    for row in mirrored:
        assert row.pose is not None
        gamma, sigma, beta, shift = row.pose
        assert gamma == 90.0
        assert (0.0, sigma, -beta % 360.0, shift) in usual
    assert {row.pose for row in mirrored} <= poses(plan, "etalon")


# ---- near the specular direction, overlaps, the open beam ----

NEAR = "[near_specular]\nwithin_deg = 6\nshift_deg = { start = 0, stop = 4, step = 1 }\nbeta_step_deg = 2\n"
COARSE = "sigma_deg = [30]\nbeta_deg = { start = 0, stop = 180, step = 20 }\nwavelength_nm = [550]\n"


@pytest.mark.parametrize(("text", "arc"), [("", "upper"), ('light = "transmitted"\n', "lower")])
def test_finer_poses_are_where_a_photodiode_looks_near_the_specular_direction(text: str, arc: str) -> None:
    base = poses(planned(text, COARSE))
    found = poses(planned(text + NEAR, COARSE))
    assert base < found
    polar = np.array(VIRTUAL.file.photodiodes.upper_deg)
    peak = specular_direction(30.0) if arc == "upper" else specular_direction(30.0) * [1, 1, -1]

    def closest(beta: float, shift: float) -> float:
        looking = arc_direction(polar + shift, beta, lower=arc == "lower")
        return float(np.degrees(np.arccos(np.max(looking @ peak))))

    assert all(closest(*pose[2:]) <= 6.0 + 1e-6 for pose in found - base)
    every = {(beta, shift) for beta in np.arange(0.0, 181.0, 2.0) for shift in range(5) if closest(beta, shift) <= 6.0}
    assert {pose[2:] for pose in found} == every | {pose[2:] for pose in base}


def test_overlapping_poses_put_photodiodes_where_their_neighbours_look() -> None:
    plan = planned("[overlap]\npoints = 2\n", COARSE)
    assert {pose[2:] for pose in poses(plan)} - {pose[2:] for pose in poses(planned(grids=COARSE))} == {
        (0.0, 5.0),
        (180.0, 5.0),
    }


def test_added_poses_leave_room_for_the_approach_against_backlash() -> None:
    """At sigma 4.7 the beam is at shift -0.3 or 4.7 deg; the shift ends at -0.5 and then approaches -0.3 from -0.7."""
    text = RIG.read_text(encoding="utf-8")
    assert text.count("lower_deg = -0.5\n") == 1
    backlash = parse_rig(text.replace("lower_deg = -0.5\n", "lower_deg = -0.5\nbacklash_deg = 0.2\n"), RIG.parent, "backlash")
    schedule = parse_schedule(
        HEAD + "open_beam = true\nsigma_deg = [4.7]\nbeta_deg = [0]\nwavelength_nm = [500]\n", "small.toml"
    )
    for rig, shift in ((VIRTUAL, -0.3), (backlash, 4.7)):
        rows = make_plan(schedule, rig).rows
        assert [row.pose[3] for row in rows if row.pose is not None and "/open beam/" in row.identity] == [shift]
        for row in rows:
            for name, angle in zip(AXES, row.pose or (), strict=row.pose is not None):
                assert limit_violation(axis_settings(rig.file)[name], angle) is None


def test_the_open_beam_meets_a_photodiode_of_the_far_arc() -> None:
    plan = planned('open_beam = true\nside = "both"\n', "sigma_deg = [0, 32]\nbeta_deg = [0]\nwavelength_nm = [500, 600]\n")
    rows = [row for row in plan.rows if row.kind == "measure" and row.sample == NO_SAMPLE]
    assert all(row.identity.startswith("nothing/open beam/") for row in rows)
    assert Counter(row.pose for row in rows) == {
        (0.0, 0.0, 180.0, 0.0): 2, (0.0, 32.0, 180.0, 2.0): 2, (0.0, 180.0, 180.0, 0.0): 2, (0.0, 148.0, 180.0, 2.0): 2,
    }  # fmt: skip
    assert [row.sample for row in plan.rows if row.kind == "mount"] == ["etalon", "gaussian-5", NO_SAMPLE]


@pytest.mark.parametrize("light", ["reflected", "transmitted", "both"])
def test_the_signature_has_all_poses_of_the_etalon(light: str) -> None:
    plan = planned(f'signature = true\nlight = "{light}"\n')
    assert poses(plan, NO_SAMPLE) == poses(plan, "etalon")
    if light != "transmitted":
        assert poses(plan, NO_SAMPLE) >= poses(plan)


def test_the_signature_has_every_pose_without_a_sample_and_repeats_are_whole_passes() -> None:
    plan = planned("signature = true\nrepeats = 2\n")
    assert poses(plan, NO_SAMPLE) == poses(plan)
    rows = measured(plan, NO_SAMPLE)
    again = [row for row in rows if row.identity.endswith("/repeat 2")]
    assert len(again) == len(rows) / 2
    assert rows[len(again) :] == again


# ---- between the measurements ----


def test_dark_readings_are_no_older_than_the_schedule_allows() -> None:
    plan = planned("dark_every_s = 15\n")
    age = oldest = 0.0
    for row in plan.rows:
        age = 0.0 if row.kind in ("dark", "mount") else age + row.seconds
        oldest = max(oldest, age)
    assert 10.0 < oldest <= 15.0
    kinds = [row.kind for row in plan.rows]
    assert kinds[:2] == ["mount", "dark"]
    assert kinds[-1] == "dark"


def test_drift_checks_come_at_intervals_and_at_both_ends_of_each_mounting() -> None:
    text = "signature = true\n[drift]\nevery_s = 20\nsigma_deg = 45\nbeta_deg = 90\nwavelength_nm = 550\n"
    plan = planned(text)
    since = 0.0
    for row in plan.rows:
        since = 0.0 if row.kind in ("drift", "mount") else since + row.seconds
        assert since <= 20.0 + 4.0 * (row.kind == "dark") or row.sample == NO_SAMPLE
    for sample in ("etalon", "gaussian-5"):
        kinds = [row.kind for row in plan.rows if row.sample == sample]
        assert kinds[:3] == ["mount", "dark", "drift"]
        assert kinds[-2:] == ["drift", "dark"]
    drifts = [row for row in plan.rows if row.kind == "drift"]
    assert {row.pose for row in drifts} == {(0.0, 45.0, 90.0, 0.0)}
    assert NO_SAMPLE not in {row.sample for row in drifts}


def test_the_warm_up_is_the_first_row() -> None:
    first = planned("[warm_up]\npercent_per_10min = 0.5\nlongest_s = 900\n").rows[0]
    assert (first.kind, first.sample, first.target, first.longest_s) == ("warm-up", NO_SAMPLE, 0.005, 900.0)


def test_auto_range_plans_all_gains_of_the_rig() -> None:
    plan = make_plan(parse_schedule(HEAD.replace("[1e8, 1e10]", '"automatic"') + GRIDS, "small.toml"), VIRTUAL)
    assert {(row.kind, row.automatic, row.gains) for row in plan.rows if row.kind != "mount"} == {
        ("dark", False, (0, 1, 2, 3)),
        ("measure", True, (0, 1, 2, 3)),
    }


def test_the_next_sample_starts_at_the_last_point_of_the_one_before() -> None:
    plan = planned()
    ends = [measured(plan, "etalon")[-1], measured(plan)[0]]
    assert (ends[0].pose, ends[0].wavelength_nm) == (ends[1].pose, ends[1].wavelength_nm)


# ---- refusals ----


def test_a_refusal_has_key_reason_and_remedy() -> None:
    assert "near_specular.shift_deg: 6 deg is outside" in refused("[near_specular]\nwithin_deg = 5\nshift_deg = [6]\n")
    assert "drift.beta_deg: 400 deg is outside" in refused(
        "[drift]\nevery_s = 60\nsigma_deg = 0\nbeta_deg = 400\nwavelength_nm = 550\n"
    )
    assert "symmetry_check.points: 99, but the rig reaches the mirror images of 6 of 6 poses" in refused(
        "[symmetry_check]\npoints = 99\n"
    )
    assert "change beta_deg or shift_deg" in refused("", GRIDS.replace("[0, 90, 180]", "[0, 270]").replace("[0, 2]", "[3, 4]"))
    assert "near_specular: " in refused(
        "[near_specular]\nwithin_deg = 60\nbeta_step_deg = 0.001\nshift_deg = { start = 0, stop = 5, step = 0.001 }\n"
    )


def test_poses_beside_the_grids_count_for_the_row_limit() -> None:
    message = refused(
        "[near_specular]\nwithin_deg = 60\nbeta_step_deg = 0.5\nshift_deg = { start = 0, stop = 5, step = 0.01 }\n"
    )
    assert "poses x 2 wavelengths x 1 passes" in message
    assert "more than 1000000" in message


def test_planned_rows_behave_like_a_tuple() -> None:
    plan = planned()
    assert plan.rows == tuple(plan.rows)
    assert plan.rows[-1].number == len(plan.rows) - 1
    assert plan.rows[:2] == tuple(plan.rows)[:2]
    assert grid_values(plan.schedule.file.sigma_deg) == (0.0, 30.0)
