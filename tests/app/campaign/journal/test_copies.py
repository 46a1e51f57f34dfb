"""Copies of a journal's one file, plain ones and exact ones, while its campaign runs and when it has ended."""

import contextlib
import itertools
import os
import shutil
import sqlite3
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.journal import writing
from goniotwin.app.campaign.journal.reading import DamagedJournal
from goniotwin.app.campaign.journal.writing import CHECKPOINT_ROWS, CHECKPOINT_S, Journal, copy_journal
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.running.events import Event, RowCommitted, State
from goniotwin.app.cli.main import app as command
from goniotwin.app.errors import UserError
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
    monkeypatch.setattr(writing, "READERS_END_S", 0.05)
    path = tmp_path / "a.journal"
    readers: list[sqlite3.Connection] = []

    def attach(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.done == 5:
            readers.append(sqlite3.connect(path, isolation_level=None))
            readers[0].execute("BEGIN")
            assert readers[0].execute("SELECT COUNT(*) FROM attempt").fetchone() == (5,)
            if not reading:
                readers[0].execute("COMMIT")

    assert run_campaign(plan, path, listeners=[attach]).state is State.DONE
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
    command(["copy", str(journal), str(tmp_path / "c.journal")], standalone_mode=False)
    with Journal.open(journal) as opened:
        assert capsys.readouterr().out.splitlines() == [str(tmp_path / "c.journal"), opened.chain.statement]
    assert digests(tmp_path / "c.journal") == digests(journal)
    with contextlib.closing(sqlite3.connect(journal)) as db, db:
        db.execute("UPDATE reading SET monitor_a = 2.0 * monitor_a WHERE number = 3")
    assert command(["copy", str(journal), str(tmp_path / "d.journal")], standalone_mode=False) == 1
    assert "d.journal: differs from what was measured, as " in capsys.readouterr().err
    assert sorted(each.name for each in tmp_path.iterdir() if "journal" in each.name) == [
        "a.journal", "b.journal", "c.journal", "d.journal",
    ]  # fmt: skip
