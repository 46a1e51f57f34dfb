"""Copies of a journal's one file, plain ones and exact ones, while its campaign runs and when it has ended."""

import contextlib
import itertools
import os
import shutil
import sqlite3
import stat
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from goniotwin.app.campaign.campaign import resume_campaign, run_campaign
from goniotwin.app.campaign.journal import copies
from goniotwin.app.campaign.journal.copies import copy_journal
from goniotwin.app.campaign.journal.reading import DamagedJournal
from goniotwin.app.campaign.journal.writing import CHECKPOINT_ROWS, CHECKPOINT_S, Journal
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.running.events import Event, RowCommitted, State
from goniotwin.app.cli.main import app
from goniotwin.app.errors import UserError
from goniotwin.app.rig.lock import lock_journal
from tests.system.command_process import row_digest

PAGE = 4096
Digests = dict[int, str]


@dataclass
class Copier:
    """A listener that copies the journal after each row: its one file as it is, and with `copy_journal`."""

    path: Path
    exact: Path
    committed: Digests = field(default_factory=dict)
    ended_s: list[float] = field(default_factory=list)
    plain: list[bytes] = field(default_factory=list)

    def __call__(self, event: Event) -> None:
        """Take a row."""
        if not isinstance(event, RowCommitted):
            return
        if not self.plain:  # never closed while SQLite has its locks on the file
            self._file = os.open(self.path, os.O_RDONLY)
        self.committed[event.row.number] = row_digest(event.data)
        self.ended_s.append(event.data.ended_s)
        self.plain.append(os.pread(self._file, 1 << 30, 0))
        copy = self.exact / f"{event.done}.journal"
        copy_journal(self.path, copy)
        assert digests(copy) == self.committed

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)


def digests(path: Path) -> Digests:
    """The rows of a sound journal, by number."""
    with Journal.open(path) as journal:
        assert not journal.chain.damage
        return {each.row.number: row_digest(each.data) for each in journal.rows()}


@pytest.mark.skipif(os.name == "nt", reason="no read at an offset")
def test_copies_during_a_run_have_its_rows_or_are_named_as_torn(plan: Plan, tmp_path: Path) -> None:
    """Plain copies lack at most the rows of a minute, or ten; exact ones none. Of a plain copy whose pages are of two moments,
    each row is true, or it is refused.
    """
    path, copied = tmp_path / "a.journal", tmp_path / "copied.journal"
    (tmp_path / "exact").mkdir()
    copier = Copier(path, tmp_path / "exact")
    assert run_campaign(plan, path, listeners=[copier]).state is State.DONE
    copier.close()
    assert digests(path) == copier.committed
    rows = list(copier.committed.items())
    for done, content in enumerate(copier.plain, 1):
        copied.write_bytes(content)
        last = copier.ended_s[done - 1] - CHECKPOINT_S
        certain = [row for row, t in zip(rows[:done], copier.ended_s, strict=False) if t <= last][: done + 1 - CHECKPOINT_ROWS]
        found = digests(copied)
        assert dict(certain).items() <= found.items() <= dict(rows[:done]).items()
    assert len(found) > 1
    kinds = list(dict.fromkeys([*copier.plain, path.read_bytes()]))
    torn = 0
    for first, second in itertools.combinations(kinds, 2):
        for cut in range(PAGE, len(first), PAGE):
            copied.write_bytes(first[:cut] + second[cut:])
            try:
                with Journal.open(copied) as journal:
                    true = {
                        each.row.number: row_digest(each.data) for each in journal.rows()
                    }.items() <= copier.committed.items()
                    assert true or journal.chain.damage
                    torn += bool(journal.chain.damage)
            except DamagedJournal:
                torn += 1
    assert torn > 5


@pytest.mark.parametrize("reading", [False, True])
def test_a_finished_journal_is_whole_in_its_one_file_while_it_is_read(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reading: bool
) -> None:
    """The reader has the journal open, or reads an earlier state of it all the time."""
    path = tmp_path / "a.journal"
    readers: list[sqlite3.Connection] = []

    def attach(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.done == 5:
            readers.append(sqlite3.connect(path, isolation_level=None))
            readers[0].execute("BEGIN")
            assert readers[0].execute("SELECT COUNT(*) FROM attempt").fetchone() == (5,)
            if not reading:
                readers[0].execute("COMMIT")

    assert run_campaign(plan, path, listeners=[attach], readers_end_s=0.05).state is State.DONE
    copied = Path(shutil.copyfile(path, tmp_path / "copied.journal"))
    assert len(digests(copied)) == len(plan.rows)
    with Journal.open(copied) as journal:
        assert journal.sessions()[-1].outcome == "done"
    if reading:
        assert readers[0].execute("SELECT COUNT(*) FROM attempt").fetchone() == (5,)
    readers[0].close()
    assert len(digests(path)) == len(plan.rows)


def test_a_copy_is_not_made_over_a_file_nor_of_a_file_that_is_no_journal(
    plan: Plan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    journal, copy = tmp_path / "a.journal", tmp_path / "b.journal"
    run_campaign(plan, journal)
    copy.write_bytes(b"precious")
    with pytest.raises(UserError, match=r"b\.journal: exists, and nothing is overwritten"):
        copy_journal(journal, copy)
    with pytest.raises(UserError, match=r"b\.journal: is not a journal"):
        copy_journal(copy, tmp_path / "c.journal")
    with pytest.raises(UserError, match=r"c\.journal: cannot be written"):
        copy_journal(journal, tmp_path / "none" / "c.journal")
    assert copy.read_bytes() == b"precious"
    app(["copy", str(journal), str(tmp_path / "c.journal")], standalone_mode=False)
    with Journal.open(journal) as opened:
        assert capsys.readouterr().out.splitlines() == [str(tmp_path / "c.journal"), opened.chain.statement]
    assert digests(tmp_path / "c.journal") == digests(journal)
    with contextlib.closing(sqlite3.connect(journal)) as db, db:
        db.execute("UPDATE reading SET monitor_a = 2.0 * monitor_a WHERE number = 3")
    assert app(["copy", str(journal), str(tmp_path / "d.journal")], standalone_mode=False) == 1
    assert "d.journal: differs from what was measured, as " in capsys.readouterr().err
    assert sorted(each.name for each in tmp_path.iterdir() if "journal" in each.name) == [
        "a.journal",
        "b.journal",
        "c.journal",
        "d.journal",
    ]


def test_of_two_copies_to_one_name_one_is_made_and_nothing_is_overwritten(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second begins while the first is made; then another file gets the name of the first."""
    journal, copy, other = tmp_path / "a.journal", tmp_path / "b.journal", tmp_path / "c.journal"
    run_campaign(plan, journal)
    seen: list[Path] = []

    def interrupt(*_: int) -> None:
        if not seen:
            seen.extend(each for each in tmp_path.iterdir() if each.name.startswith("."))
            with pytest.raises(UserError, match=rf"b\.journal: is being written by process {os.getpid()} .*copied from .*a\.j"):
                copy_journal(journal, copy)
            with pytest.raises(UserError, match=r"b\.journal: is in use by process"):
                Journal.create(copy, plan, {})
            copy_journal(journal, other)

    copy_journal(journal, copy, interrupt)
    assert seen
    assert digests(copy) == digests(other) == digests(journal)

    def appear(*_: int) -> None:
        copy.write_bytes(b"precious")

    copy.unlink()
    with pytest.raises(UserError, match=r"b\.journal: exists, and nothing is overwritten"):
        copy_journal(journal, copy, appear)
    assert copy.read_bytes() == b"precious"
    assert {*tmp_path.glob("*journal*"), *tmp_path.glob(".*")} == {journal, copy, other}


def test_what_killed_programs_left_is_removed_and_what_is_being_made_is_not(plan: Plan, tmp_path: Path) -> None:
    journal = tmp_path / "a.journal"
    run_campaign(plan, journal)
    left, made = (tmp_path / f".{name}.journal{copies.UNFINISHED}" for name in ("killed", "made"))
    for each in (left, Path(f"{left}-wal"), made):
        each.write_bytes(b"part")
    lock = lock_journal(tmp_path / "made.journal", "measuring")
    copy_journal(journal, tmp_path / "b.journal")
    assert [*tmp_path.glob(".*")] == [made]
    lock.release(remove=True)
    copy_journal(journal, tmp_path / "c.journal")
    assert [*tmp_path.glob(".*")] == []


@pytest.mark.skipif(os.name == "nt", reason="no hard links of open files")
def test_rows_that_remain_outside_of_a_finished_journal_are_reported(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, link = tmp_path / "a.journal", tmp_path / "link.journal"
    readers: list[sqlite3.Connection] = []

    def attach(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.done == 5:
            os.link(path, link)
            readers.append(sqlite3.connect(path, isolation_level=None))
            readers[0].execute("BEGIN")
            readers[0].execute("SELECT COUNT(*) FROM attempt").fetchone()

    outcome = run_campaign(plan, path, listeners=[attach], readers_end_s=0.05)
    assert (outcome.state, outcome.journal) == (State.DONE, path)
    assert outcome.journal_note == (
        f"{path}: rows remain in {path}-wal, because another program reads it, and it has another name too (a hard link); "
        "use goniotwin copy to have all in one file"
    )
    copy_journal(path, tmp_path / "whole.journal")
    assert len(digests(tmp_path / "whole.journal")) == len(plan.rows)
    readers[0].close()


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such modes")
def test_a_journal_that_is_replaced_at_its_end_keeps_its_mode(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.journal"
    owner = (1234, 2345) if os.geteuid() == 0 else (os.geteuid(), os.getegid())
    readers: list[sqlite3.Connection] = []

    def attach(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.done == 5:
            path.chmod(0o640)
            os.chown(path, *owner)
            readers.append(sqlite3.connect(path, isolation_level=None))
            readers[0].execute("BEGIN")
            readers[0].execute("SELECT COUNT(*) FROM attempt").fetchone()

    assert run_campaign(plan, path, listeners=[attach], readers_end_s=0.05).journal_note == ""
    status = path.stat()
    assert (stat.S_IMODE(status.st_mode), status.st_uid, status.st_gid) == (0o640, *owner)
    readers[0].close()


@pytest.mark.skipif(os.name == "nt", reason="no hard links of open files")
def test_reading_and_a_refused_resume_leave_no_files(plan: Plan, tmp_path: Path) -> None:
    """Of a plain copy during the run, which is in WAL mode without its -wal file, under two names."""
    copier = Copier(tmp_path / "a.journal", tmp_path)
    run_campaign(plan, copier.path, listeners=[copier])
    copier.close()
    folder = tmp_path / "folder"
    folder.mkdir()
    path, link = folder / "a.journal", folder / "link.journal"
    path.write_bytes(copier.plain[-1])
    os.link(path, link)
    before = {each: (each.stat().st_mtime_ns, each.read_bytes()) for each in (path, link)}
    assert len(digests(path)) > 1
    with pytest.raises(UserError, match="has another name too"):
        resume_campaign(link, plan.rig)
    assert {each: (each.stat().st_mtime_ns, each.read_bytes()) for each in folder.iterdir()} == before
