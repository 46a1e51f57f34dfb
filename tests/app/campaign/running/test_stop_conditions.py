"""Sessions ended by a stop condition: message, exit status, and rehearsals that resume as an operator would."""

import os
import sqlite3
from pathlib import Path

import pytest

from goniotwin.app.campaign.campaign import resume_campaign
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.rehearsal.rehearsal import Rehearsal, plan_rehearsal, rehearse
from goniotwin.app.campaign.rehearsal.report import report_text
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from tests.app.campaign.campaign_bench import QUIET, run_until
from tests.conftest import SMALL, Writer
from tests.system.command import CALLS, Call, json_result

SHORT = SMALL + "\n[stop]\nlongest_s = 10\n"
DIM = SMALL + "\n[stop]\nlamp_below = 0.75\n"


def run_rehearsal(schedule: Path, rig: Path, out: Path) -> Rehearsal:
    return rehearse(*plan_rehearsal(read_schedule(schedule), read_rig(rig), {}), out=out)


@pytest.mark.parametrize("call", CALLS)
def test_a_session_ended_by_the_schedule_has_a_reason_and_its_own_exit_status(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, call: Call
) -> None:
    journal = tmp_path / "a.journal"
    done = call("run", write_schedule(text=SHORT), "--rig", write_rig(*QUIET), "--out", journal)
    assert done.returncode == 3
    assert "ended by the schedule: the session has lasted" in " ".join(done.stderr.split())
    assert "to continue: goniotwin run --resume" in done.stderr
    again = call("run", "--resume", journal, "--json")
    assert again.returncode in (0, 3)
    assert json_result(call("runs", tmp_path, "--json"))["campaigns"][0]["sessions"] == 2


def test_a_rehearsal_resumes_session_after_session(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    found = run_rehearsal(write_schedule(text=SHORT), write_rig(*QUIET), tmp_path / "a.journal")
    assert found.done
    assert found.result.rows == found.result.planned
    assert found.result.sessions >= 3
    assert any("[stop] ends the run" in each and "--resume" in each for each in found.result.warnings)
    assert found.result.relative_uncertainty["gaussian-5"].trusted > 0


def test_a_rehearsal_without_progress_ends_with_a_warning(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    """The lamp loses a thirtieth of its light per second, and is not replaced."""
    rig = write_rig(QUIET[0], ("drift_per_hour = 0.02", "drift_per_hour = -120.0"))
    found = run_rehearsal(write_schedule(text=DIM), rig, tmp_path / "a.journal")
    assert (found.done, found.result.state) == (False, "stopped")
    assert found.result.rows < found.result.planned
    assert any("ends before all rows are measured" in each and "the lamp is at" in each for each in found.result.warnings)
    assert f"{found.result.rows} of {found.result.planned} rows" in report_text(found)


@pytest.mark.skipif(not hasattr(os, "link"), reason="this system has no hard links")
def test_a_journal_with_two_names_is_not_resumed(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    """SQLite keeps the latest rows beside the name that was used; under the other name they would be lost."""
    plan = make_plan(read_schedule(write_schedule()), read_rig(write_rig(*QUIET)))
    first, second = tmp_path / "a.journal", tmp_path / "b.journal"
    run_until(plan, first, 0.5 * plan.seconds)
    os.link(first, second)
    for each in (first, second):
        with pytest.raises(UserError, match=r"[ab]\.journal: has another name too .*; copy it, and resume the copy"):
            resume_campaign(each)
    first.unlink()
    assert resume_campaign(second).rows == len(plan.rows)


def test_a_journal_with_a_damaged_plan_is_not_resumed_and_not_changed(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    plan = make_plan(read_schedule(write_schedule()), read_rig(write_rig(*QUIET)))
    path = tmp_path / "a.journal"
    run_until(plan, path, 0.5 * plan.seconds)
    database = sqlite3.connect(path)
    with database:
        database.execute("UPDATE plan SET beta_deg = 0.0 WHERE number = 9")
    database.close()
    with pytest.raises(UserError, match=r"a\.journal: is damaged: the plan; use a copy of it"):
        resume_campaign(path)
    with Journal.open(path) as journal:
        assert len(journal.sessions()) == 1


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"", "is empty"), (b"not a database at all, but some text", "is not a journal"), (None, "is a folder")],
)
def test_a_file_that_is_not_a_journal_is_named_as_what_it_is(tmp_path: Path, content: bytes | None, message: str) -> None:
    path = tmp_path / "a.journal"
    if content is None:
        path.mkdir()
    else:
        path.write_bytes(content)
    with pytest.raises(UserError, match=f"a.journal: {message}"):
        Journal.open(path)
