"""A journal is followed row by row while another connection writes it, and no reader stays in its way."""

import contextlib
import threading
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.journal.following import JournalFollower
from goniotwin.app.campaign.journal.reading import open_read_only
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.row import CommittedRow
from goniotwin.app.campaign.running.events import Event, RowCommitted
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from tests.app.campaign.campaign_bench import run_plan
from tests.conftest import RIG, Writer


@pytest.mark.parametrize("rows_at_once", [2, 200])
def test_each_row_is_read_once_as_soon_as_it_is_committed(write_schedule: Writer, tmp_path: Path, rows_at_once: int) -> None:
    """Also many at once, in queries of a few; and the journal then is one file."""
    path = tmp_path / "a.journal"
    follower = JournalFollower(path, rows_at_once)
    committed: list[int] = []
    read: list[CommittedRow] = []

    def listen(event: Event) -> None:
        if isinstance(event, RowCommitted):
            committed.append(event.row.number)
            if len(committed) in (1, 2, 9):
                read.extend(follower.new_rows())
                assert [each.row.number for each in read] == committed
                assert list(follower.new_rows()) == []

    run_plan(make_plan(read_schedule(write_schedule()), read_rig(RIG)), path, listeners=[listen])
    read += follower.new_rows()
    assert [each.row.number for each in read] == committed
    assert not Path(f"{path}-wal").exists()
    with Journal.open(path) as journal:
        for one, other in zip(read, journal.rows(), strict=True):
            assert one.row == other.row
            for mine, theirs in zip(one.data.readings, other.data.readings, strict=True):
                assert np.array_equal(mine.counts, theirs.counts)
    with follower.reading() as reader:
        assert reader.value("name") == "small"


def test_a_query_at_the_end_of_a_journal_leaves_no_files_beside_it(write_schedule: Writer, tmp_path: Path) -> None:
    """A window reads the last rows when the station closes the journal."""
    path = tmp_path / "a.journal"
    with contextlib.ExitStack() as stack:

        def listen(event: Event) -> None:
            if isinstance(event, RowCommitted) and event.done == event.total:
                query = stack.enter_context(contextlib.closing(open_read_only(path)))
                query.execute("SELECT COUNT(*) FROM attempt").fetchone()
                threading.Timer(0.1, query.close).start()

        run_plan(make_plan(read_schedule(write_schedule()), read_rig(RIG)), path, listeners=[listen])
    assert [*tmp_path.glob("a.journal*")] == [path]


def test_what_is_no_journal_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "x.journal"
    path.write_bytes(b"SQLite format 3\0" + bytes(4096))
    with pytest.raises(UserError):
        list(JournalFollower(path).new_rows())
