"""The start of a resumed session: homing of unreferenced axes, drift check, skipped rows, warm-up."""

import sqlite3
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import clock_for, operator_for, resume_campaign, run_campaign
from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.row import Row, RowData
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.running.resume import remaining_work
from goniotwin.app.campaign.running.rig_executor import RigExecutor
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.errors import UserError
from goniotwin.app.rig import OpenRig, open_rig, read_rig
from goniotwin.drivers import NoAnswer, wait
from tests.app.campaign.campaign_bench import QUIET, planned_values, run_until
from tests.app.test_referencing import HOMES
from tests.conftest import SMALL, Writer

FOUR_SHIFTS = SMALL.replace("shift_deg = [0, 1]", "shift_deg = [0, 1, 2, 3]")
CHECKED = FOUR_SHIFTS + "\n[drift]\nevery_s = 600\nsigma_deg = 30\nbeta_deg = 180\nwavelength_nm = 550\n"
FADED = 0.9
PAPER = """Source\tMeasured
Symmetry\tPlaneSymmetrical
SpectralContent\tMonochrome
ScatterType\tBRDF
SampleRotation\t1
0
AngleOfIncidence\t3
0\t30\t60
ScatterAzimuth\t3
0\t90\t180
ScatterRadial\t3
0\t90\t180

Monochrome
DataBegin
"""


def resume_with(path: Path, change: Callable[[OpenRig], None]) -> tuple[State, list[tuple[str, str]]]:
    """As `resume_campaign`, after a `change` of the rig; return the final state and the events."""
    with Journal.reopen(path) as journal:
        rest = remaining_work(journal, None)
        with open_rig(rest.plan.rig, clock_for(rest.plan.rig.file, rest.start_s)) as opened:
            opened.connect()
            change(opened)
            operator = operator_for(opened, rest.plan.rig.file, None)
            state = Engine(opened.rig, rest.plan, journal, operator, work=rest.work).run()
    return state, events(path)


def events(path: Path) -> list[tuple[str, str]]:
    connection = sqlite3.connect(path)
    try:
        return connection.execute("SELECT kind, text FROM event ORDER BY rowid").fetchall()
    finally:
        connection.close()


def dim_light(opened: OpenRig) -> None:
    """Reduce the light behind the beam splitter, where the monitor does not measure it."""
    assert opened.virtual is not None
    for photodiode in range(36):
        opened.virtual.plant.fade(photodiode, FADED)


def no_change(_: OpenRig) -> None:
    """Leave the rig as it is."""


def run_half(plan: Plan, path: Path) -> None:
    """Run a plan and stop it in the middle of the last mounted sample."""
    seconds = np.cumsum([row.seconds for row in plan.rows])
    last = [k for k, row in enumerate(plan.rows) if row.kind == "measure"][-2]
    run_until(plan, path, float(seconds[last - 1]) + 0.5 * plan.rows[last].seconds)


@pytest.fixture(params=[FOUR_SHIFTS, CHECKED], ids=["without drift checks", "with drift checks"])
def plan(request: pytest.FixtureRequest, write_rig: Writer, write_schedule: Writer) -> Plan:
    return make_plan(read_schedule(write_schedule(text=request.param)), read_rig(write_rig(*QUIET)))


def test_a_change_of_the_light_is_in_the_journal_and_later_rows_are_flagged(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "a.journal"
    run_half(plan, path)
    state, recorded = resume_with(path, dim_light)
    assert state is State.DONE
    texts = [text for kind, text in recorded if kind == "drift" and text.startswith("resumed 2/")]
    assert len(texts) == 1
    assert "beyond the limit: the light has changed by -" in texts[0]
    change = float(texts[0].split("changed by ")[1].split(" %")[0])
    assert change == pytest.approx(100.0 * (FADED - 1.0), abs=0.1)
    with Journal.open(path) as journal:
        resumed_at = journal.sessions()[1].started_s
        points = reduce_journal(journal).samples["gaussian-5"]
        late = {each.row.pose for each in journal.rows() if each.row.kind == "measure" and each.data.started_s > resumed_at}
    assert 0 < len(late) < 4
    assert points.flag("drift").any()
    assert not points.good[points.flag("drift")].any()


def test_constant_light_is_in_the_journal_and_no_row_is_flagged(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "a.journal"
    run_half(plan, path)
    state, recorded = resume_with(path, no_change)
    assert state is State.DONE
    (texts,) = [text for kind, text in recorded if kind == "drift" and text.startswith("resumed 2/")]
    assert ": the light has changed by +0.0" in texts or ": the light has changed by -0.0" in texts
    with Journal.open(path) as journal:
        assert not reduce_journal(journal).samples["gaussian-5"].flag("drift").any()


def test_an_unreferenced_axis_is_homed_on_resume(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    needs_homing = (
        "settling_s = 0.2\npower_up_at_reference = true\n\n" + HOMES[0][1],
        "settling_s = 0.2\nhoming_required = true\n\n" + HOMES[0][1],
    )
    plan = make_plan(read_schedule(write_schedule(text=FOUR_SHIFTS)), read_rig(write_rig(*QUIET, *HOMES, needs_homing)))
    path = tmp_path / "a.journal"
    with pytest.raises(UserError, match="sigma"):
        run_campaign(plan, path)  # a new campaign does not home by itself
    with open_rig(plan.rig, clock_for(plan.rig.file)) as opened, Journal.create(path, plan, {}) as journal:
        opened.connect()
        wait(opened.rig.clock, [opened.rig.axes["sigma"].start_homing()])
        engine = Engine(opened.rig, plan, journal, operator_for(opened, plan.rig.file, None))
        opened.rig.clock.at(opened.rig.clock.now() + 0.8 * plan.seconds, engine.stop)
        assert engine.run() is State.IDLE
    assert resume_campaign(path).state is State.DONE
    assert [text.split(":")[0] for kind, text in events(path) if kind == "home"] == ["sigma"]
    with Journal.open(path) as journal:
        sigmas = {each.data.positions["sigma"] for each in journal.rows() if each.data.positions}
    assert all(sigma == pytest.approx(30.0, abs=0.01) or sigma == pytest.approx(0.0, abs=0.01) for sigma in sigmas)


def test_skipped_rows_are_measured_on_resume(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows of the etalon and of the sample: each is mounted again for its rows."""
    policy = FOUR_SHIFTS + '\n[faults]\nwire = "skip"\nattempts = 1\n'
    plan = make_plan(read_schedule(write_schedule(text=policy)), read_rig(write_rig(*QUIET)))
    run_campaign(plan, tmp_path / "whole.journal")
    failing = [row.number for row in plan.rows if row.kind == "measure" and row.pose is not None and row.pose[3] in (1.0, 3.0)]
    execute = RigExecutor.execute

    def fail(executor: RigExecutor, row: Row) -> RowData:
        if row.number in failing:
            raise NoAnswer("photodiodes", "read", "no answer")
        return execute(executor, row)

    path = tmp_path / "a.journal"
    monkeypatch.setattr(RigExecutor, "execute", fail)
    outcome = run_campaign(plan, path)
    assert (outcome.state, outcome.rows, outcome.skipped) == (State.DONE, len(plan.rows) - 4, 4)
    found = campaign_summary(path)
    assert (found.state, found.rows, found.skipped, found.seconds_left > 0.0) == ("done", len(plan.rows) - 4, 4, True)
    with Journal.open(path) as journal:
        notes = reduce_journal(journal).notes
    assert any(
        note.startswith("rows skipped after faults, without values: 2 of etalon, 2 of gaussian-5; goniotwin run")
        for note in notes
    )
    monkeypatch.setattr(RigExecutor, "execute", execute)
    outcome = resume_campaign(path)
    assert (outcome.state, outcome.rows, outcome.skipped) == (State.DONE, len(plan.rows), 0)
    with Journal.open(path) as journal:
        assert not [note for note in reduce_journal(journal).notes if "skipped" in note or "etalon was not" in note]
    assert planned_values(path) == planned_values(tmp_path / "whole.journal")
    with Journal.open(path) as journal:
        mounted = [each.row.sample for each in journal.rows() if each.row.kind == "mount" and each.row.unplanned]
    assert mounted == ["etalon", "gaussian-5"]
    with pytest.raises(UserError, match="there is nothing to resume"):
        resume_campaign(path)


@pytest.mark.parametrize("shift", [1.0, 1.0140625])
def test_values_without_an_etalon_row_are_in_the_notes(
    shift: float, write_rig: Writer, write_schedule: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = make_plan(
        read_schedule(
            write_schedule(("1, 2, 3]", f"{shift}, 2, 3]"), text=FOUR_SHIFTS + '\n[faults]\nwire = "skip"\nattempts = 1\n')
        ),
        read_rig(write_rig(*QUIET)),
    )
    execute = RigExecutor.execute

    def fail(executor: RigExecutor, row: Row) -> RowData:
        if row.sample == "etalon" and row.pose is not None and row.pose[3] == shift:
            raise NoAnswer("photodiodes", "read", "no answer")
        return execute(executor, row)

    monkeypatch.setattr(RigExecutor, "execute", fail)
    run_campaign(plan, tmp_path / "a.journal")
    with Journal.open(tmp_path / "a.journal") as journal:
        found = reduce_journal(journal)
    assert "gaussian-5: rows without all values, because the etalon was not measured at their poses: 1" in found.notes
    assert sorted(np.unique(found.samples["gaussian-5"].shift_deg)) == [0.0, 2.0, 3.0]


def test_the_warm_up_is_repeated_on_resume(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    text = FOUR_SHIFTS + "\n[warm_up]\npercent_per_10min = 50\nlongest_s = 600\n"
    plan = make_plan(read_schedule(write_schedule(text=text)), read_rig(write_rig(*QUIET)))
    run_half(plan, tmp_path / "a.journal")
    assert resume_campaign(tmp_path / "a.journal").state is State.DONE
    with Journal.open(tmp_path / "a.journal") as journal:
        unplanned = [each.row.identity for each in journal.rows() if each.row.unplanned]
    assert unplanned[0] == "resumed 2/nothing/warm-up"
    assert [identity.split("/")[-1] for identity in unplanned[1:]] == ["mount", "dark", "drift"]


def test_a_virtual_rig_with_a_changed_sample_is_refused(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    table = tmp_path / "paper.bsdf"
    block = "TIS\t0.628\n" + 3 * "0.2\t0.2\t0.2\n"
    table.write_text(PAPER + 3 * block + "DataEnd\n", encoding="utf-8")
    sample = '[twin.samples.paper]\nmodel = "zemax"\nfile = "paper.bsdf"\n\n[twin.samples.etalon]'
    rig = write_rig(*QUIET, ("[twin.samples.etalon]", sample))
    plan = make_plan(read_schedule(write_schedule(("gaussian-5", "paper"), text=FOUR_SHIFTS)), read_rig(rig))
    run_half(plan, tmp_path / "a.journal")
    table.write_text(table.read_text(encoding="utf-8").replace("0.2", "0.1"), encoding="utf-8")
    with pytest.raises(UserError, match="the model's hash differs"):
        resume_campaign(tmp_path / "a.journal")
