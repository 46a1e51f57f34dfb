"""The power goes at any moment of a campaign: what was told to be on the disk is there when it comes back."""

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
from tests.app.campaign.disk import Doing, Told, after_the_power_came_back
from tests.app.campaign.test_resume import MORE, STEADY, values
from tests.app.campaign.watched_sqlite import Connection, WatchedDisk
from tests.conftest import Writer
from tests.system.killable import digest_of

NAME = "a.journal"
FEW_PAGES, USUAL_PAGES = 12, 1000
"""In the -wal file before they go into the journal: so few that it happens every third row, and SQLite's own number."""
GONE_ON_WITH = 5
"""Each fifth of the journals is gone on with, which takes a while."""
Watch = Callable[..., list[Doing]]


@pytest.fixture
def steady(write_rig: Writer, write_schedule: Writer) -> Plan:
    return make_plan(read_schedule(write_schedule(MORE)), read_rig(write_rig(*STEADY)))


def as_it_is(statement: str) -> str:
    """The statement."""
    return statement


@pytest.fixture
def watch(steady: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Watch:
    """Begins a campaign, stops it in the middle, goes on with it; returns all that was done to the disk."""

    def watched(pages: int, translate: Callable[[str], str] = as_it_is) -> list[Doing]:
        disk = WatchedDisk()
        connect, rename, unlink = sqlite3.connect, Path.rename, Path.unlink

        def connected(database: Any, **options: Any) -> Any:
            only_read = "uri" in options
            return connect(database, **options) if only_read else Connection(disk, database, translate, pages)

        def renamed(path: Path, to: Path) -> Path:
            moved = rename(path, to)
            disk.renamed(path, to)
            return moved

        def unlinked(path: Path, missing_ok: bool = False) -> None:
            unlink(path, missing_ok)
            disk.removed(path)

        def told(stop_after: int, event: Event) -> None:
            if isinstance(event, RowCommitted):
                disk.doings.append(Told(event.row.number, digest_of(event.data)))
                if event.done == stop_after:
                    raise KeyboardInterrupt

        path = tmp_path / f"{disk.name}.journal"
        with monkeypatch.context() as patch:
            patch.setattr(sqlite3, "connect", connected)
            patch.setattr(Path, "rename", renamed)
            patch.setattr(Path, "unlink", unlinked)
            assert run_campaign(steady, path, listeners=[partial(told, 6)]).state is State.IDLE
            assert resume_campaign(path, listeners=[partial(told, 0)]).state is State.DONE
        return disk.doings

    return watched


def the_disk_after(doings: list[Doing], lots: np.random.Generator | None, folder: Path) -> Path:
    """In a folder of its own; the journal, if there is one."""
    folder.mkdir()
    for name, content in after_the_power_came_back(doings, lots).items():
        (folder / name).write_bytes(content)
    found = [path for path in folder.glob("*.journal") if not path.name.startswith(".")]
    return found[0] if found else folder / "none"


def told_by(doings: list[Doing]) -> dict[int, str]:
    """The rows that were said to be on the disk."""
    return {each.number: each.digest for each in doings if isinstance(each, Told)}


def there(path: Path) -> dict[int, str]:
    """The rows that are."""
    if not path.exists():
        return {}
    with Journal.open(path) as journal:
        return {each.row.number: digest_of(each.data) for each in journal.rows()}


def check_whole(path: Path, plan: Plan) -> None:
    """The journal is one, and says rightly what is left of the plan."""
    with Journal.open(path) as journal:
        done = journal.committed_numbers()
        left = [row for row in plan.rows if row.number not in done]
        if left:
            rest = remaining_work(journal, None)
            assert rest.plan.rows == plan.rows
            assert [row for row in rest.work if row not in rest.unplanned] == left
        else:
            with pytest.raises(UserError, match="nothing to resume"):
                remaining_work(journal, None)
    database = sqlite3.connect(path)
    assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    database.close()


@pytest.mark.parametrize("pages", [FEW_PAGES, USUAL_PAGES])
@pytest.mark.parametrize("cuts", [pytest.param(20, id="20"), pytest.param(100, id="100", marks=pytest.mark.long)])
def test_when_the_power_goes_nothing_that_was_told_is_lost(
    watch: Watch, steady: Plan, tmp_path: Path, pages: int, cuts: int
) -> None:
    """From the first doing to the last, one moment by lot of each stretch; every other time a part of what was not synced is
    there, torn in pieces."""
    run_campaign(steady, tmp_path / "undisturbed.journal")
    doings = watch(pages)
    (journal,) = tmp_path.glob("watched-*.journal")
    assert the_disk_after(doings, None, tmp_path / "end").read_bytes() == journal.read_bytes()  # nothing escapes the watch
    lots = np.random.default_rng(cuts)
    gone_on_with = 0
    for k, part in enumerate(lots.uniform(size=cuts)):
        before = doings[: round((k + part) / cuts * len(doings))]
        path = the_disk_after(before, lots if k % 2 else None, tmp_path / f"{k}")
        assert told_by(before).items() <= there(path).items()
        if not path.exists():
            continue
        check_whole(path, steady)
        if k % GONE_ON_WITH == 0 and len(there(path)) < len(steady.rows):
            assert resume_campaign(path).state is State.DONE
            assert values(path) == values(tmp_path / "undisturbed.journal")
            gone_on_with += 1
    assert gone_on_with > cuts // 10


@pytest.mark.parametrize("lazy", ["NORMAL", "OFF"])
def test_a_journal_that_waits_for_the_disk_less_often_would_lose_rows(watch: Watch, tmp_path: Path, lazy: str) -> None:
    """So the test above can fail, and `synchronous = FULL` is needed."""
    doings = watch(USUAL_PAGES, lambda statement: statement.replace("synchronous = FULL", f"synchronous = {lazy}"))
    lots = np.random.default_rng(1)
    lost = 0
    for k, end in enumerate(lots.integers(len(doings), size=40)):
        try:
            found = there(the_disk_after(doings[:end], None, tmp_path / f"{k}"))
        except UserError:  # damaged
            found = {}
        lost += not told_by(doings[:end]).items() <= found.items()
    assert lost > 10
