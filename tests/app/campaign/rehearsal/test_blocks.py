"""A rehearsal in blocks has the rows and, without noise and drift, the values of one in one process; it states what differs."""

from functools import partial
from pathlib import Path

import pytest

from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.rehearsal.blocks import divide, run_blocks, why_in_one_process
from goniotwin.app.campaign.rehearsal.rehearsal import run_in_processes, run_on_twin
from goniotwin.app.campaign.rehearsal.row_statistics import RowStatistics
from goniotwin.app.campaign.rehearsal.warnings import relevant_photodiodes
from goniotwin.app.campaign.running.events import RowCommitted, State
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from goniotwin.app.sweeps.runners import Here
from tests.app.campaign.campaign_bench import QUIET, planned_values
from tests.conftest import Writer

DRIFT = (
    "dark_readings = 4",
    "dark_readings = 4\ndrift = { every_s = 60, sigma_deg = 30, beta_deg = 180, shift_deg = 0, wavelength_nm = 550 }",
)


@pytest.fixture
def quiet(write_rig: Writer, write_schedule: Writer) -> Plan:
    return make_plan(read_schedule(write_schedule()), read_rig(write_rig(*QUIET)))


def statistics(plan: Plan) -> RowStatistics:
    return RowStatistics(plan.rig.file.photodiodes, partial(relevant_photodiodes, plan))


def test_the_rows_of_blocks_have_the_values_of_one_process(quiet: Plan, tmp_path: Path) -> None:
    whole, parts = tmp_path / "whole.journal", tmp_path / "parts.journal"
    run_on_twin(quiet, whole, statistics(quiet), [])
    committed: list[int] = []

    def note(event: object) -> None:
        if isinstance(event, RowCommitted):
            committed.append(event.row.number)

    blocks = divide(quiet, 2)
    assert len(blocks) == 2
    run_blocks(quiet, blocks, parts, Here(), [note])
    assert committed == [row.number for row in quiet.rows]
    assert planned_values(parts) == planned_values(whole)


@pytest.mark.parametrize("count", [1, 2, 3, 50])
def test_blocks_cover_the_plan_and_begin_with_a_mounting_in_the_order_of_time(quiet: Plan, count: int) -> None:
    blocks = divide(quiet, count)
    assert 1 <= len(blocks) <= count
    assert [row for block in blocks for row in quiet.rows[block.first : block.last]] == list(quiet.rows)
    assert all(quiet.rows[block.first].kind == "mount" for block in blocks[1:])
    assert [block.start_s for block in blocks] == sorted({block.start_s for block in blocks})


@pytest.mark.long
def test_two_processes_state_that_their_rows_are_of_other_times(quiet: Plan, tmp_path: Path) -> None:
    run = run_in_processes(quiet, tmp_path / "two.journal", statistics(quiet), [], 2)
    assert run.state is State.DONE
    assert "of the times that the plan expects" in run.assumed[-1]


def test_a_schedule_whose_rows_are_compared_with_earlier_ones_stays_in_one_process(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    plan = make_plan(read_schedule(write_schedule(DRIFT)), read_rig(write_rig(*QUIET)))
    assert "drift checks" in why_in_one_process(plan)
    run = run_in_processes(plan, tmp_path / "one.journal", statistics(plan), [], 2)
    assert run.state is State.DONE
    assert run.assumed == (f"rehearsed in one process, because {why_in_one_process(plan)}",)


def test_blocks_that_would_overlap_are_refused(quiet: Plan, tmp_path: Path) -> None:
    first, second = divide(quiet, 2)
    early = type(second)(second.first, second.last, 0.5 * second.start_s)
    with pytest.raises(UserError, match="overlap"):
        run_blocks(quiet, [first, early], tmp_path / "overlapping.journal", Here(), [])
