"""The watch: a misalignment that begins in the middle of a run is found and named; without one it is silent."""

from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.journal.writing import Journal, software_versions
from goniotwin.app.campaign.planning.plan import NewPlan
from goniotwin.app.campaign.rehearsal import without_wires
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.journals import watch_journal
from goniotwin.app.campaign.studies.watch import FALSE_ALARMS, LOOKS, PATTERNS, PLACES, alarm_limit
from goniotwin.app.campaign.wording import concise
from goniotwin.app.errors import UserError
from goniotwin.app.json_document import json_value
from goniotwin.twin.plant import Plant, TwinModel
from tests.app.campaign.studies.alignment_bench import SAMPLE, SCHEDULE, alignment_rig, drawn_plan
from tests.app.campaign.studies.test_alignment import SMALL

TILT_DEG = 0.03
NEVER = -1
"""In place of the row from which the sample is tilted."""


def tilted(plan: NewPlan, path: Path, row: int, tilt_deg: float, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The journal of a plan's campaign, in which the sample is tilted before a row."""
    model = plan.rig.model()
    assert model is not None
    plants: list[Plant] = []

    class KnownPlant(Plant):
        def __init__(self, of: TwinModel) -> None:
            super().__init__(of)
            plants.append(self)

    monkeypatch.setattr(without_wires, "Plant", KnownPlant)
    with Journal.create(path, plan, software_versions(), durable=False) as journal:
        session = journal.begin_session(0.0, plan.rig.text, software_versions())
        now = 0.0
        rows = without_wires.rows_without_wires(plan, model)
        for planned in plan.rows:
            if planned.number == row:
                plants[0].tilt_sample(tilt_deg, now)
            each = next(rows)
            journal.commit(each.row, each.data)
            now = each.data.ended_s
        journal.end_session(session, now, "done")
    return path


def rows_of_sample(plan: NewPlan) -> list[int]:
    return [row.number for row in plan.rows if row.kind == "measure" and row.sample == SAMPLE]


def small_plan(seed: int) -> NewPlan:
    return drawn_plan(parse_schedule(SMALL, "small"), alignment_rig(), seed)


@pytest.mark.long
def test_a_tilt_in_the_middle_of_a_run_is_found_and_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sample tilted by t in the plane of incidence turns the specular direction against the arc by 2 t.

    Beside the lobe it changes the cosine of incidence, by less than 0.002 deg of the lobe's slope.
    """
    plan = small_plan(207)
    row = rows_of_sample(plan)[7]
    path = tilted(plan, tmp_path / "tilted.journal", row, TILT_DEG, monkeypatch)
    found = watch_journal(path)
    assert found.simulated
    (misalignment,) = found.misalignments
    assert misalignment.pattern.words == "light against arc in the plane of incidence"
    assert misalignment.earliest <= row <= misalignment.latest
    assert abs(abs(misalignment.size) - 2.0 * TILT_DEG) < 3.0 * misalignment.u + 0.002
    assert misalignment.text.startswith("light against arc in the plane of incidence: off by 0.0")
    assert f"since row {misalignment.row}" in misalignment.text
    assert "sigma's zero, a mirror or the arc: the open beam distinguishes them" in misalignment.text
    assert json_value(found)["misalignments"][0]["row"] == misalignment.row
    with pytest.raises(UserError, match="has no sample 'paper'"):
        watch_journal(path, "paper")


def test_the_limit_is_that_of_the_stated_share_of_false_alarms() -> None:
    """Bonferroni's inequality; the normal law's quantile by an approximation of its tail (Abramowitz and Stegun 26.2.23)."""
    t = np.sqrt(-2.0 * np.log(0.5 * FALSE_ALARMS / (len(PATTERNS) * PLACES * LOOKS)))
    tail = t - (2.515517 + 0.802853 * t + 0.010328 * t**2) / (1.0 + 1.432788 * t + 0.189269 * t**2 + 0.001308 * t**3)
    assert alarm_limit(1) == pytest.approx(tail, abs=5e-4)
    assert alarm_limit(2) > alarm_limit(1)


@pytest.mark.parametrize(
    ("value", "u", "text"),
    [(0.0412, 0.0103, "0.04(1)"), (0.0412, 0.0014, "0.041(1)"), (0.0412, 0.0098, "0.04(1)"), (12.3, 2.0, "12(2)")],
)
def test_a_value_has_one_digit_of_its_uncertainty(value: float, u: float, text: str) -> None:
    assert concise(value, u) == text


@pytest.mark.long
def test_no_misalignment_is_named_on_rigs_that_are_off_as_stated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One campaign in a hundred at most: two alarms of 40 have a probability of 0.06."""
    alarms = 0
    for seed in range(101, 141):
        found = watch_journal(tilted(small_plan(seed), tmp_path / f"{seed}.journal", NEVER, 0.0, monkeypatch))
        assert found.clear or found.misalignments
        alarms += len(found.misalignments)
    assert alarms < 2


@pytest.mark.long
@pytest.mark.parametrize("gammas", ["[0, 45, 180]", "[0, 90, 180]"])
@pytest.mark.parametrize("place", [96, 150])
def test_a_tilt_is_found_in_the_example_campaign(
    place: int, gammas: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """0.01 deg from where gamma changes, or between: the row is found, and 0.02 deg of light against arc."""
    text = SCHEDULE.read_text(encoding="utf-8").replace("gamma_deg = [0, 45, 180]", f"gamma_deg = {gammas}")
    plan = drawn_plan(parse_schedule(text, "alignment"), alignment_rig(), 5)
    row = rows_of_sample(plan)[place]
    (found,) = watch_journal(tilted(plan, tmp_path / "tilted.journal", row, 0.01, monkeypatch)).misalignments
    assert found.earliest <= row <= found.latest
    assert abs(abs(found.size) - 0.02) < 3.0 * found.u + 0.001
    assert found.pattern.words == "light against arc in the plane of incidence"
