"""The design of an alignment's campaign: it fits into the time, has more information than its schedule, and is right."""

from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.rehearsal.alignment_design import SearchLimits, design_alignment
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.sample_alignment import align_sample
from goniotwin.app.errors import UserError
from tests.app.campaign.studies.alignment_bench import SAMPLE, SCHEDULE, alignment_rig, drawn_plan, model_of, run
from tests.app.campaign.studies.test_alignment import SMALL

LITTLE = (
    SMALL.replace('side = "both"', 'side = "front"')
    .replace("sigma_deg = [5, 30, 60]", "sigma_deg = [5, 30]")
    .replace("shift_deg = [0, 2.5]", "shift_deg = [0]")
)
"""Of 22 rows, 8 of them with the sample."""
FEW = {"sigma_deg": (45.0,), "gamma_deg": (90.0,), "beta_deg": (172.0,), "shift_deg": (2.0,)}


def test_a_design_fits_into_the_time_and_has_more_information() -> None:
    schedule, rig = parse_schedule(LITTLE, "little"), alignment_rig()
    minutes = make_plan(schedule, rig).seconds / 60.0
    design = design_alignment(schedule, rig, minutes, limits=SearchLimits(FEW))
    assert design.plan.seconds <= 60.0 * minutes
    assert {**design.levels} != {"sigma_deg": (5, 30), "gamma_deg": (0, 180), "beta_deg": (165, 188), "shift_deg": (0,)}
    assert design.gain > 0.0
    again = make_plan(parse_schedule(design.text, "design"), rig)
    assert [each.identity for each in again.rows] == [each.identity for each in design.plan.rows]
    assert all(0.0 < each.u < 0.5 * each.prior_u for each in design.forecast.combinations)
    assert len(design.as_dict()["combinations"]) == len(design.forecast.u_before) > 0


def test_too_short_a_time_is_refused_with_the_shortest_one() -> None:
    limits = SearchLimits(dict.fromkeys(FEW, ()))
    with pytest.raises(UserError, match=r"^little: 0.1 min are too few; the shortest design takes \d+ min$"):
        design_alignment(parse_schedule(LITTLE, "little"), alignment_rig(), 0.1, limits=limits)


def test_times_in_which_no_design_is_computed_are_refused() -> None:
    """The design's own time, and that of the schedule that it begins with."""
    schedule = parse_schedule(LITTLE, "little")
    with pytest.raises(UserError, match=r"^--minutes 1e\+06: an alignment is planned for at most 180 min; give fewer$"):
        design_alignment(schedule, alignment_rig(), 1e6)
    with pytest.raises(UserError, match=r"^little: takes \d min, and a design begins with at most 1; "):
        design_alignment(schedule, alignment_rig(), 0.5, limits=SearchLimits(most_minutes=1.0))


def test_a_search_ends_with_what_it_has_after_so_many_planned_rows() -> None:
    limits = SearchLimits(FEW, most_planned_rows=1)
    design = design_alignment(parse_schedule(LITTLE, "little"), alignment_rig(), 10.0, limits=limits)
    assert design.ended_early
    assert list(design.levels["sigma_deg"]) == [5, 30]
    assert design.forecast.combinations


@pytest.mark.long
def test_a_shorter_design_knows_no_combination_less_well_than_the_schedule_at_equal_time() -> None:
    """45 min in place of 65. With the shift at one place, its position would be taken for a turn of the arc."""
    design = design_alignment(parse_schedule(SCHEDULE.read_text(encoding="utf-8"), "alignment"), alignment_rig(), 45.0)
    found = np.array([each.u for each in design.forecast.combinations]) / design.forecast.u_before
    print("\n  u over that of the schedule at equal time:", *(f"{each:.2f}" for each in found))
    assert design.gain > 0.2
    assert len(design.levels["shift_deg"]) > 1
    assert np.max(found) < 1.05


@pytest.mark.long
def test_expected_uncertainties_are_those_of_random_rigs(tmp_path: Path) -> None:
    """The example's time: what an alignment states after the campaign is as expected, and its errors are as stated.

    The mean square of the errors over u is 1. Where more than a fifth of the hole is dark they are larger
    (docs/analyse/alignment.md).
    """
    design = design_alignment(parse_schedule(SCHEDULE.read_text(encoding="utf-8"), "alignment"), alignment_rig(), 64.9)
    assert design.gain > 0.1
    assert len(design.forecast.combinations) == 10
    schedule = parse_schedule(design.text, "design")
    scores, ratios = [], []
    for seed in range(1, 25):
        plan = drawn_plan(schedule, alignment_rig(), seed)
        with Journal.open(run(plan, tmp_path / f"{seed}.journal")) as journal:
            evaluation = evaluate_journal(journal)
            result = align_sample(evaluation.reduction, evaluation.closure, SAMPLE)
        _, drawn = model_of(plan)
        assert result.light is not None
        for each in result.combinations if result.light.dark < 0.2 else ():
            truth = sum(c * drawn[name] for name, c in each.coefficients.items())
            scores.append((each.value - truth) / each.u)
        found, expected = (np.sort([each.u for each in some]) for some in (result.combinations, design.forecast.combinations))
        ratios.append(found[: len(expected)] / expected)  # beyond those of the forecast: the place of the slit's image
    assert len(scores) > 50
    assert 0.6 < np.mean(np.square(scores)) < 1.5
    assert np.median(ratios, axis=0) == pytest.approx(1.0, abs=0.15)
