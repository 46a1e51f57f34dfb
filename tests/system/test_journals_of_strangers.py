"""A journal of unknown origin is data and not a program: what cannot be is refused before it is used."""

import contextlib
import os
import sqlite3
import struct
from pathlib import Path

import pytest

from goniotwin.app.campaign.journal.writing import Journal
from tests.system.command import invoke
from tests.system.strange_journals import OLD_JOURNAL, STRANGE_SCHEMAS, changed_journal


@pytest.mark.parametrize("strange", STRANGE_SCHEMAS)
def test_a_journal_with_another_schema_is_refused(tmp_path: Path, strange: str) -> None:
    path = changed_journal(tmp_path / "a.journal", STRANGE_SCHEMAS[strange])
    before = path.read_bytes()
    out = tmp_path / "a.csv"
    for arguments in (("export", path, "--format", "csv", "--out", out), ("run", "--resume", path)):
        done = invoke(*arguments)
        assert (done.returncode, done.stdout) == (2, "")
        (line,) = done.stderr.splitlines()
        assert "a.journal: has " in line
        assert "as no version of goniotwin makes" in line
    assert path.read_bytes() == before
    assert not out.exists()


@pytest.mark.parametrize("place", ["attempt.flags", "attempt.positions", "plan.detail", "session.versions", "event.text"])
def test_a_journal_with_a_text_of_a_length_that_nothing_has_is_refused_before_it_is_parsed(tmp_path: Path, place: str) -> None:
    """16 million lists of 48 MB are 1.4 GB as objects. A stranger can compute checksums, and an old journal has none."""
    table, column = place.split(".")
    lists = "'[' || substr(replace(hex(zeroblob(100000)), '00', '[],'), 1, 299999) || ']'"
    path = changed_journal(tmp_path / "a.journal", f"UPDATE {table} SET {column} = {lists};")
    if table == "event":
        with contextlib.closing(sqlite3.connect(path)) as database, database:
            database.execute(f"INSERT INTO event (t_s, kind, text) VALUES (0, 'fault', {lists})")
    for arguments in (("export", path, "--format", "csv", "--out", tmp_path / "a.csv"), ("runs", tmp_path)):
        done = invoke(*arguments)
        assert done.returncode == (1 if arguments[0] == "export" else 0)
        assert f"has more than 100000 bytes in {column} of the table {table}" in done.stderr
    assert not (tmp_path / "a.csv").exists()


@pytest.mark.parametrize("where", ["kind = 'dark'", "kind = 'measure'", "1"])
@pytest.mark.parametrize("shape", ["readings = readings * 2, channels = channels / 2", "readings = 0, counts = x''"])
def test_counts_of_other_photodiodes_than_the_rigs_are_refused(tmp_path: Path, shape: str, where: str) -> None:
    changed = f"UPDATE reading SET {shape} WHERE number IN (SELECT number FROM plan WHERE {where});"
    path = changed_journal(tmp_path / "a.journal", changed)
    done = invoke("export", path, "--format", "csv", "--out", tmp_path / "a.csv")
    assert done.returncode == 2
    assert "a.journal: a row has counts of " in done.stderr
    assert "the rig has 36 of these: use a copy of the journal" in done.stderr


@pytest.mark.parametrize("time", ["9e999", "1e308"])
def test_a_reading_at_no_possible_time_is_refused(tmp_path: Path, time: str) -> None:
    path = changed_journal(tmp_path / "a.journal", f"UPDATE reading SET first_s = {time} WHERE number = 1;")
    done = invoke("export", path, "--format", "csv", "--out", tmp_path / "a.csv")
    assert done.returncode == 2
    assert "a.journal: a row has readings at the time " in done.stderr


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        ("UPDATE reading SET monitor_a = 9e999 WHERE number = 3;", "a row has a monitor current of inf A"),
        ("UPDATE attempt SET started_s = 1e308 WHERE number = 3;", "row 3 began at the time 1e+308 s"),
    ],
)
def test_a_row_of_no_possible_light_or_time_is_refused(tmp_path: Path, change: str, wrong: str) -> None:
    path = changed_journal(tmp_path / "a.journal", change)
    done = invoke("export", path, "--format", "csv", "--out", tmp_path / "a.csv")
    assert done.returncode == 2
    assert (len(done.stderr.splitlines()), wrong in done.stderr) == (1, True), done.stderr


@pytest.mark.skipif(os.name == "nt", reason="pipes and links as files")
def test_what_is_no_file_is_no_journal(tmp_path: Path) -> None:
    pipe, loop = tmp_path / "pipe.journal", tmp_path / "loop.journal"
    os.mkfifo(pipe)
    loop.symlink_to(loop)
    for path, what in (
        (pipe, "is a folder or a device, not a journal"),
        (Path("/dev/zero"), "is a folder or a device, not a journal"),
        (loop, "there is no such journal"),
    ):
        done = invoke("export", path, "--format", "csv", "--out", tmp_path / "a.csv")
        assert (done.returncode, done.stderr) == (2, f"goniotwin: {path}: {what}; check the name\n")


def rollback_journal(naming: Path) -> bytes:
    """A rollback journal without pages that names a super-journal (https://sqlite.org/fileformat.html, section 3, and the
    comment of `readSuperJournal` in SQLite's pager.c): once it is rolled back, SQLite deletes the file of that name.
    """
    magic, name = bytes.fromhex("d9d505f920a163d7"), str(naming).encode()
    head = magic + struct.pack(">5I", 0, 1, OLD_JOURNAL.stat().st_size // 4096, 512, 4096)
    locked_page = (1 << 30) // 4096 + 1
    return head.ljust(512, b"\0") + struct.pack(">I", locked_page) + name + struct.pack(">2I", len(name), sum(name)) + magic


@pytest.mark.skipif(os.name == "nt", reason="pipes and links as files")
@pytest.mark.parametrize("strange", ["super-journal", "long", "link", "pipe"])
def test_a_strange_file_beside_a_journal_is_named_and_nothing_else_is_touched(tmp_path: Path, strange: str) -> None:
    path, precious = changed_journal(tmp_path / "a.journal", ""), tmp_path / "precious"
    precious.write_text("x", encoding="utf-8")
    beside = Path(f"{path}-wal" if strange == "link" else f"{path}-journal")
    if strange == "super-journal":
        beside.write_bytes(rollback_journal(precious))
    elif strange == "long":
        beside.write_bytes(rollback_journal(precious))
        os.truncate(beside, 10**11)  # takes no room
    elif strange == "link":
        beside.symlink_to(precious)
    else:
        os.mkfifo(beside)
    export = ("export", path, "--format", "csv", "--out", tmp_path / "a.csv")
    for arguments in (("runs", tmp_path), export, ("copy", path, tmp_path / "b.journal"), ("run", "--resume", path)):
        done = invoke(*arguments)
        assert done.returncode == (0 if arguments[0] == "runs" else 2)
        assert f"{beside}: " in done.stderr
        assert "remove it, and beware of its origin" in done.stderr
    assert precious.read_text(encoding="utf-8") == "x"
    assert {each.name for each in tmp_path.iterdir()} == {path.name, beside.name, "precious"}


def test_a_journal_of_any_own_version_is_opened(tmp_path: Path) -> None:
    """The schema text of one that was migrated is another than that of one that was made so."""
    path = changed_journal(tmp_path / "old.journal", "")
    with Journal.open(path) as journal:
        planned = journal.row_counts()
    with Journal.reopen(path):  # migrates it
        pass
    with Journal.open(path) as journal:
        assert journal.row_counts() == planned
