"""Power loss at any moment of a campaign: each row that was reported as committed is on the disk afterwards."""

import sqlite3
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import resume_campaign, run_campaign
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.running.events import Event, RowCommitted, State
from goniotwin.app.campaign.running.resume import remaining_work
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from tests.app.campaign.campaign_bench import QUIET, THREE_SHIFTS, planned_values
from tests.app.campaign.journal.recorded_sqlite import Connection, RecordingVfs
from tests.app.campaign.journal.simulated_disk import Acknowledged, Operation, files_after_power_loss
from tests.conftest import Writer
from tests.system.command_process import row_digest

NAME = "a.journal"
FEW_PAGES, USUAL_PAGES = 12, 1000
"""Pages in the -wal file before a checkpoint: so few that one occurs every third row, and SQLite's default."""
RESUMED_EVERY = 5
"""Every fifth journal is resumed; that takes a while."""
Record = Callable[..., list[Operation]]


@pytest.fixture
def steady(write_rig: Writer, write_schedule: Writer) -> Plan:
    return make_plan(read_schedule(write_schedule(THREE_SHIFTS)), read_rig(write_rig(*QUIET)))


def unchanged(statement: str) -> str:
    """The statement itself."""
    return statement


@pytest.fixture
def record(steady: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Record:
    """Start a campaign, stop it in the middle, resume it; return all operations on the disk."""

    def record_campaign(pages: int, translate: Callable[[str], str] = unchanged) -> list[Operation]:
        disk = RecordingVfs()
        connect, link, unlink = sqlite3.connect, Path.hardlink_to, Path.unlink

        def connect_recorded(database: Any, **options: Any) -> Any:
            read_only = "uri" in options
            return connect(database, **options) if read_only else Connection(disk, database, translate, pages)

        def link_recorded(path: Path, target: Path) -> None:
            link(path, target)
            disk.record_link(path, target)

        def unlink_recorded(path: Path, missing_ok: bool = False) -> None:
            unlink(path, missing_ok)
            disk.record_removal(path)

        def acknowledge(stop_after: int, event: Event) -> None:
            if isinstance(event, RowCommitted):
                disk.operations.append(Acknowledged(event.row.number, row_digest(event.data)))
                if event.done == stop_after:
                    raise KeyboardInterrupt

        path = tmp_path / f"{disk.name}.journal"
        with monkeypatch.context() as patch:
            patch.setattr(sqlite3, "connect", connect_recorded)
            patch.setattr(Path, "hardlink_to", link_recorded)
            patch.setattr(Path, "unlink", unlink_recorded)
            assert run_campaign(steady, path, listeners=[partial(acknowledge, 6)]).state is State.IDLE
            assert resume_campaign(path, listeners=[partial(acknowledge, 0)]).state is State.DONE
        return disk.operations

    return record_campaign


def write_files_after_power_loss(operations: list[Operation], rng: np.random.Generator | None, folder: Path) -> Path:
    """Write the files that remain after a power loss to a new folder; return the path of the journal, which may not exist."""
    folder.mkdir()
    for name, content in files_after_power_loss(operations, rng).items():
        (folder / name).write_bytes(content)
    found = [path for path in folder.glob("*.journal") if not path.name.startswith(".")]
    return found[0] if found else folder / "none"


def acknowledged_rows(operations: list[Operation]) -> dict[int, str]:
    """The rows that were reported as committed, with the digests of their data."""
    return {each.number: each.digest for each in operations if isinstance(each, Acknowledged)}


def rows_of(path: Path) -> dict[int, str]:
    """The rows of a journal, with the digests of their data."""
    if not path.exists():
        return {}
    with Journal.open(path) as journal:
        return {each.row.number: row_digest(each.data) for each in journal.rows()}


def check_journal(path: Path, plan: Plan) -> None:
    """Check the integrity of a journal, and that its remaining work is the rest of the plan."""
    with Journal.open(path) as journal:
        done = journal.committed_numbers()
        left = [row for row in plan.rows if row.number not in done]
        if left:
            rest = remaining_work(journal, None)
            assert rest.plan.rows == plan.rows
            assert [row for row in rest.work if row not in rest.unplanned] == left
        elif journal.sessions()[-1].outcome == "done":
            with pytest.raises(UserError, match="nothing to resume"):
                remaining_work(journal, None)
        else:
            assert remaining_work(journal, None).work == ()
    database = sqlite3.connect(path)
    assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    database.close()


@pytest.mark.parametrize("pages", [FEW_PAGES, pytest.param(USUAL_PAGES, marks=pytest.mark.long)])
@pytest.mark.parametrize("cuts", [pytest.param(20, id="20"), pytest.param(100, id="100", marks=pytest.mark.long)])
def test_a_power_loss_loses_no_acknowledged_row(record: Record, steady: Plan, tmp_path: Path, pages: int, cuts: int) -> None:
    """One random moment in each of `cuts` intervals, from the first operation to the last.

    Every other time a random part of the operations that were not synced is on the disk, block by block.
    """
    run_campaign(steady, tmp_path / "undisturbed.journal")
    operations = record(pages)
    (journal,) = tmp_path.glob("recorded-*.journal")
    complete = write_files_after_power_loss(operations, None, tmp_path / "end")
    assert complete.read_bytes() == journal.read_bytes()  # no operation is missing in the record
    rng = np.random.default_rng(cuts)
    resumed = 0
    for k, part in enumerate(rng.uniform(size=cuts)):
        before = operations[: round((k + part) / cuts * len(operations))]
        path = write_files_after_power_loss(before, rng if k % 2 else None, tmp_path / f"{k}")
        assert acknowledged_rows(before).items() <= rows_of(path).items()
        if not path.exists():
            continue
        check_journal(path, steady)
        if k % RESUMED_EVERY == 0 and len(rows_of(path)) < len(steady.rows):
            assert resume_campaign(path).state is State.DONE
            assert planned_values(path) == planned_values(tmp_path / "undisturbed.journal")
            resumed += 1
    assert resumed > cuts // 10


@pytest.mark.parametrize("lazy", ["NORMAL", "OFF"])
def test_a_journal_with_fewer_syncs_loses_rows(record: Record, tmp_path: Path, lazy: str) -> None:
    """The test above can fail, and `synchronous = FULL` is necessary."""
    operations = record(USUAL_PAGES, lambda statement: statement.replace("synchronous = FULL", f"synchronous = {lazy}"))
    rng = np.random.default_rng(1)
    lost = 0
    for k, end in enumerate(rng.integers(len(operations), size=40)):
        try:
            found = rows_of(write_files_after_power_loss(operations[:end], None, tmp_path / f"{k}"))
        except UserError:  # damaged
            found = {}
        lost += not acknowledged_rows(operations[:end]).items() <= found.items()
    assert lost > 10
