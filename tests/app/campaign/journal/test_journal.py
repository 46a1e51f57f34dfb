"""The journal: refusals, its entries about the campaign, and damaged files."""

import contextlib
import errno
import os
import sqlite3
import sys
import tempfile
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.journal.copies import copy_journal
from goniotwin.app.campaign.journal.place import JournalError
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.row import Reading, RowData
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.errors import UserError
from tests.app.campaign.campaign_bench import recorded_events


def test_a_journal_is_not_overwritten(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "a.journal"
    path.write_bytes(b"precious")
    with pytest.raises(UserError, match="exists already"):
        run_campaign(plan, path)
    assert path.read_bytes() == b"precious"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere every name of a file is text")
def test_a_journal_may_have_a_name_that_is_no_text(plan: Plan, tmp_path: Path) -> None:
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff.journal"))
    plan = replace(plan, rig=replace(plan.rig, folder=path.parent / "\udcff"))
    assert run_campaign(plan, path).journal == path
    assert [*tmp_path.glob("*journal*")] == [path]
    with Journal.open(path) as journal:
        assert journal.row_counts() == (len(plan.rows), len(plan.rows))


@pytest.mark.skipif(os.name == "nt", reason="links to files")
def test_a_journal_behind_a_link_to_nowhere_is_refused_and_no_folder_is_made(plan: Plan, tmp_path: Path) -> None:
    (tmp_path / "a.journal").symlink_to("nowhere/b.journal")
    Journal.create(tmp_path / "c.journal", plan, {}).close()
    for make in (lambda path: Journal.create(path, plan, {}), lambda path: copy_journal(tmp_path / "c.journal", path)):
        with pytest.raises(UserError, match=r"a\.journal: "):
            make(tmp_path / "a.journal")
    assert not (tmp_path / "nowhere").exists()


@pytest.mark.parametrize("content", [b"", b"not a database at all", b"SQLite format 3\0"])
def test_a_file_that_is_not_a_journal_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.journal"
    path.write_bytes(content)
    with pytest.raises(UserError, match=r"a\.journal"):
        Journal.open(path)


def test_a_journal_has_schedule_rig_and_model(plan: Plan, tmp_path: Path) -> None:
    run_campaign(plan, tmp_path / "a.journal")
    with Journal.open(tmp_path / "a.journal") as journal:
        assert journal.simulated
        assert journal.value("rig") == plan.rig.text
        assert journal.value("schedule") == plan.schedule.text
        assert journal.value("model") == f'"{plan.rig.model_hash()}"'
        with pytest.raises(UserError, match="has no entry 'nonsense'"):
            journal.value("nonsense")


def test_a_journal_that_cannot_be_created_leaves_no_file(plan: Plan, tmp_path: Path) -> None:
    twice = Plan(plan.schedule, plan.rig, (plan.rows[0], plan.rows[0]))
    with pytest.raises(UserError, match="cannot be written"):
        Journal.create(tmp_path / "a.journal", twice, {})
    assert list(tmp_path.glob("a.journal*")) == []


def test_an_event_of_any_length_leaves_a_journal_that_can_be_opened(plan: Plan, tmp_path: Path) -> None:
    """The text of an exception has no bound; a journal with longer texts than are written is refused."""
    with Journal.create(tmp_path / "a.journal", plan, {}) as journal:
        journal.begin_session(0.0, plan.rig.text, {})
        journal.event(1.0, "fault", "\N{GRINNING FACE}" * 200_000)
    with Journal.open(tmp_path / "a.journal") as opened:
        (text,) = opened.faults()
    assert text.startswith("\N{GRINNING FACE}")


def test_a_journal_with_any_number_of_orders_lists_some(plan: Plan, tmp_path: Path) -> None:
    with Journal.create(tmp_path / "a.journal", plan, {}) as journal:
        journal.begin_session(0.0, plan.rig.text, {})
        for k in range(23):
            journal.event(1.0, "order", f"order {k}")
        journal.event(2.0, "acknowledged", "order 0")
        assert journal.open_orders() == [*(f"order {k}" for k in range(1, 21)), "and 2 more orders"]


def test_the_events_of_a_guardian_are_taken_over_into_the_session_that_died(plan: Plan, tmp_path: Path) -> None:
    """They are in a file beside the journal, one JSON object a line; what is none is ignored."""
    path, beside = tmp_path / "a.journal", tmp_path / "a.journal.guardian"
    with Journal.create(path, plan, {}) as journal:
        journal.begin_session(0.0, plan.rig.text, {})
    beside.write_text('{"at": "now", "text": "the shutter\\nis closed"}\n[1]\n{"at": "la', encoding="utf-8")
    with Journal.reopen(path) as journal:
        assert journal.event_texts("guardian") == ["the shutter is closed"]
    assert not beside.exists()


def test_a_journal_is_not_closed_in_the_middle_of_another_threads_event(plan: Plan, tmp_path: Path) -> None:
    """Stop records a safety order in its own thread while the run ends: Python's SQLite then ended in a segmentation fault."""
    path = tmp_path / "a.journal"
    journal = Journal.create(path, plan, {})
    journal.begin_session(0.0, plan.rig.text, {})
    writer = threading.Thread(target=journal.event, args=(1.0, "order", "Cut the motors' power"))
    closer = threading.Thread(target=journal.close)
    with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")  # the event waits for it, in its transaction
        for thread in (writer, closer):
            thread.start()
            thread.join(0.1)  # without a lock the second one closes the connection meanwhile
        assert writer.is_alive()
        other.execute("COMMIT")
    writer.join()
    closer.join()
    assert recorded_events(path) == [("order", "Cut the motors' power")]
    with pytest.raises(JournalError, match="closed"):
        journal.event(2.0, "order", "Cut the motors' power")


DAMAGES = [
    "DROP TABLE reading",
    "UPDATE reading SET counts = substr(counts, 1, 7)",
    "UPDATE reading SET readings = channels, channels = readings + 1",
    "UPDATE attempt SET positions = '{'",
    "UPDATE reading SET gain_v_per_a = 12345.0 WHERE gain_v_per_a = 1e8",
    "DELETE FROM campaign",
    "DROP TABLE campaign",
]


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_journal_gives_one_line(plan: Plan, tmp_path: Path, damage: str) -> None:
    path = tmp_path / "a.journal"
    run_campaign(plan, path)
    database = sqlite3.connect(path)
    database.execute(damage)
    database.commit()
    database.close()
    with pytest.raises(UserError, match=r"a\.journal") as caught, Journal.open(path) as journal:
        reduce_journal(journal)
    assert "\n" not in str(caught.value)


def test_an_event_of_another_thread_is_no_part_of_a_transaction_that_fails(plan: Plan, tmp_path: Path) -> None:
    with Journal.create(tmp_path / "a.journal", plan, {}) as journal:
        other = threading.Thread(target=lambda: journal.event(2.0, "acknowledged", "done"))
        journal.begin_session(0.0, plan.rig.text, {})

        class Counts(np.ndarray):
            """While they are written the other thread has its event."""

            def astype(self, *_: Any, **__: Any) -> Any:
                if other.ident is None:
                    other.start()
                other.join(timeout=0.1)
                return np.asarray(self)

        reading = Reading(1e8, 0.0, 0.1, 1e-7, np.zeros((1, 36), dtype="<u2").view(Counts))
        with pytest.raises(JournalError, match="UNIQUE"):
            journal.commit(plan.rows[0], RowData(0.0, 1.0, None, (reading, reading)))  # of one gain there is one reading
        other.join()
        assert journal.event_texts("acknowledged") == ["done"]
        assert journal.row_counts()[0] == 0


def test_free_space_is_asked_for_only_where_the_disk_is_full(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another program that holds the journal, and a disk that fails, are other faults."""
    path = tmp_path / "a.journal"
    with Journal.create(path, plan, {}, readers_end_s=0.0) as journal, Journal.open(path) as read_journal:
        other = sqlite3.connect(path)
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(JournalError, match="database is locked") as locked:
            journal.event(0.0, "fault", "x")
        other.close()
        journal = read_journal
        with pytest.raises(JournalError, match="readonly") as read_only:
            journal.event(0.0, "fault", "x")
        assert "free space" not in f"{locked.value}{read_only.value}"
        assert str(locked.value).endswith("database is locked; close the other program that writes to it")
        monkeypatch.setattr(tempfile, "TemporaryFile", full)
        with pytest.raises(JournalError, match=r"; free space on the disk$"):
            journal.event(0.0, "fault", "x")


def full(**_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")
