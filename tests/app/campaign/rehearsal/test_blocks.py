"""A rehearsal in blocks has the rows and, without noise and drift, the values of one in one process; it states what differs."""

from functools import partial
from pathlib import Path

import pytest

from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.rehearsal.blocks import divide, run_blocks, statistics_of, why_in_one_process
from goniotwin.app.campaign.rehearsal.rehearsal import run_in_processes, run_on_twin
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


@pytest.mark.parametrize("count", [2, 50])
def test_the_rows_of_blocks_have_the_values_and_the_statistics_of_one_process(quiet: Plan, tmp_path: Path, count: int) -> None:
    whole, parts = tmp_path / "whole.journal", tmp_path / "parts.journal"
    of_whole, of_parts = statistics_of(quiet), statistics_of(quiet)
    run_on_twin(quiet, whole, of_whole, [])
    committed: list[int] = []

    def note(event: object) -> None:
        if isinstance(event, RowCommitted):
            committed.append(event.row.number)

    blocks = divide(quiet, count, 0)
    assert len(blocks) > 1
    run_blocks(quiet, blocks, parts, Here(), of_parts, [note])
    assert committed == [row.number for row in quiet.rows]
    found, wanted = of_parts.as_data(), of_whole.as_data()
    for each in (*found["blocks"], *wanted["blocks"]):
        del each["duration_s"]
    assert {key: found[key] for key in ("blocks", "flagged", "largest", "saturated", "steps")} == {
        key: wanted[key] for key in ("blocks", "flagged", "largest", "saturated", "steps")
    }
    assert planned_values(parts) == planned_values(whole)


@pytest.mark.parametrize("count", [1, 2, 3, 50])
def test_blocks_cover_the_plan_and_begin_with_a_dark_reading_in_the_order_of_time(quiet: Plan, count: int) -> None:
    blocks = divide(quiet, count, 0)
    assert 1 <= len(blocks) <= count
    assert [row for block in blocks for row in quiet.rows[block.first : block.last]] == list(quiet.rows)
    for first in [block.first for block in blocks[1:]]:
        assert quiet.rows[first + (quiet.rows[first].kind == "mount")].kind == "dark"
    assert [block.start_s for block in blocks] == sorted({block.start_s for block in blocks})


@pytest.mark.long
def test_two_processes_state_that_their_rows_are_of_other_times(
    quiet: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("goniotwin.app.campaign.rehearsal.rehearsal.divide", partial(divide, starting_rows=0))
    run = run_in_processes(quiet, tmp_path / "two.journal", statistics_of(quiet), [], 2)
    assert run.state is State.DONE
    assert "of the times that the plan expects" in run.assumed[-1]


def test_a_schedule_whose_rows_are_compared_with_earlier_ones_stays_in_one_process(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    plan = make_plan(read_schedule(write_schedule(DRIFT)), read_rig(write_rig(*QUIET)))
    assert "drift checks" in why_in_one_process(plan)
    run = run_in_processes(plan, tmp_path / "one.journal", statistics_of(plan), [], 2)
    assert run.state is State.DONE
    assert run.assumed == (f"rehearsed in one process, because {why_in_one_process(plan)}",)


def test_blocks_that_would_overlap_are_refused(quiet: Plan, tmp_path: Path) -> None:
    first, second = divide(quiet, 2, 0)
    early = type(second)(second.first, second.last, 0.1 * second.start_s)
    with pytest.raises(UserError, match="overlap"):
        run_blocks(quiet, [first, early], tmp_path / "overlapping.journal", Here(), statistics_of(quiet), [])


def test_a_short_schedule_stays_in_one_process(quiet: Plan, tmp_path: Path) -> None:
    assert len(divide(quiet, 2)) == 1
    run = run_in_processes(quiet, tmp_path / "one.journal", statistics_of(quiet), [], 2)
    assert run.assumed == ("rehearsed in one process, because its rows take less time than the start of a process",)
