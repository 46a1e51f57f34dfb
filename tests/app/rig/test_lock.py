"""One controlling program per rig and per journal."""

import os
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock

from goniotwin.app.errors import UserError
from goniotwin.app.rig.lock import LockFile, RigInUse, RigLock, journal_holder, lock_journal
from goniotwin.protocols.loopback import LOOPBACK

HOLD = """
import sys
from pathlib import Path
from goniotwin.app.rig.lock import RigLock
lock = RigLock(["/dev/axes"], "measuring paint", Path(sys.argv[1]))
print("held", flush=True)
sys.stdin.read()
"""
linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="Linux alone has this guard")
posix = pytest.mark.skipif(os.name == "nt", reason="Windows has no owners and no links for everybody")


def test_a_second_program_is_refused_with_the_holder_until_the_lock_is_released(tmp_path: Path) -> None:
    first = RigLock(["/dev/axes", "/dev/adcs"], "measuring paint", tmp_path)
    with pytest.raises(UserError, match=rf"/dev/adcs: is in use by process {os.getpid()} of .*, since 2.*: measuring paint"):
        RigLock(["/dev/adcs"], "something else", tmp_path)
    RigLock(["/dev/other"], "another rig", tmp_path).release()
    first.release()
    RigLock(["/dev/axes"], "something else", tmp_path).release()


def test_if_one_address_is_in_use_no_other_is_locked(tmp_path: Path) -> None:
    first = RigLock(["COM8"], "one", tmp_path)
    with pytest.raises(UserError, match="COM8: is in use"):
        RigLock(["COM7", "COM8"], "two", tmp_path)
    RigLock(["COM7"], "three", tmp_path).release()
    first.release()


def test_the_lock_ends_with_its_process(tmp_path: Path) -> None:
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert holder.stdin is not None
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    with pytest.raises(UserError, match=rf"process {holder.pid} "):
        RigLock(["/dev/axes"], "mine", tmp_path)
    holder.kill()
    holder.wait()
    holder.stdin.close()
    holder.stdout.close()
    RigLock(["/dev/axes"], "mine", tmp_path).release()


def test_a_check_of_the_lock_does_not_keep_another_program_out(tmp_path: Path) -> None:
    RigLock(["COM4"], "makes the file", tmp_path).release()
    (file,) = tmp_path.glob("*.lock")
    probe = FileLock(file, thread_local=False)
    probe.acquire()
    threading.Timer(0.02, probe.release).start()
    RigLock(["COM4"], "first", tmp_path, 60.0).release()


@pytest.mark.parametrize(("one", "other"), [("1313:8078", "1313:8078:P1"), ("1313:8078:P1", "1313:8078")])
def test_an_instrument_with_and_without_its_serial_number_is_one(tmp_path: Path, one: str, other: str) -> None:
    first = RigLock([one], "the first", tmp_path)
    with pytest.raises(RigInUse, match="the first"):
        RigLock([other], "the second", tmp_path)
    RigLock(["1313:807a"], "another model", tmp_path).release()
    first.release()
    RigLock([other], "the second", tmp_path).release()


def test_two_instruments_of_one_model_are_two(tmp_path: Path) -> None:
    first = RigLock(["1313:8078:P1"], "the first", tmp_path)
    RigLock(["1313:8078:P2"], "the second", tmp_path).release()
    first.release()


@linux
def test_a_tcp_address_is_taken_for_all_users_whatever_their_folders(tmp_path: Path) -> None:
    with socket.create_server((LOOPBACK, 0)) as server:
        port = server.getsockname()[1]
        first = RigLock([f"localhost:{port}"], "the first", tmp_path / "one")
        for spelling in (f"socket://[::1]:{port}", f"{LOOPBACK}:{port}", f"rtu:SOCKET://127.0.0.1:{port}/?unit=3"):
            with pytest.raises(RigInUse, match=rf"in use by process {os.getpid()} of the user with the number {os.getuid()}"):
                RigLock([spelling], "the second", tmp_path / "other")
        first.release()
        RigLock([f"{LOOPBACK}:{port}"], "the second", tmp_path / "other").release()


@linux
def test_a_serial_port_that_is_open_elsewhere_is_refused_before_it_is_opened(tmp_path: Path) -> None:
    """Any program that uses pyserial's `exclusive`; its folder of locks is unknown here."""
    import fcntl

    server, port = os.openpty()
    fcntl.flock(port, fcntl.LOCK_EX)
    try:
        with pytest.raises(RigInUse, match=rf"in use by process {os.getpid()};"):
            RigLock([os.ttyname(port)], "the second", tmp_path)
    finally:
        os.close(port)
        os.close(server)


def link_to_foreign(folder: Path, foreign: Path) -> None:
    folder.symlink_to(foreign, target_is_directory=True)


def open_to_all(folder: Path, foreign: Path) -> None:
    folder.mkdir()
    folder.chmod(0o777)


def file_in_its_place(folder: Path, foreign: Path) -> None:
    folder.write_text("mine", encoding="utf-8")


@posix
@pytest.mark.parametrize("prepare", [link_to_foreign, open_to_all, file_in_its_place])
def test_a_folder_that_another_user_can_have_prepared_is_refused(tmp_path: Path, prepare: Callable[[Path, Path], None]) -> None:
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    prepare(tmp_path / "locks", foreign)
    with pytest.raises(UserError, match=r"COM4 cannot be made: .*locks: .*; choose another"):
        RigLock(["COM4"], "mine", tmp_path / "locks")
    assert [*foreign.iterdir()] == []


@posix
@pytest.mark.parametrize("kind", ["symbolic link", "hard link"])
def test_no_byte_of_a_file_changes_that_is_linked_to_as_lock_or_note(tmp_path: Path, kind: str) -> None:
    journal, foreign = tmp_path / "a.journal", tmp_path / "foreign"
    foreign.write_text("not yours", encoding="utf-8")
    for name in ("a.journal.lock", "a.journal.holder"):
        link = tmp_path / name
        if kind == "symbolic link":
            link.symlink_to(foreign)
        else:
            os.link(foreign, link)
    if kind == "symbolic link":
        with pytest.raises(UserError, match="its lock file cannot be made"):
            lock_journal(journal, "measuring")
    else:
        lock_journal(journal, "measuring").release(remove=True)
    assert foreign.read_text(encoding="utf-8") == "not yours"


def test_a_journal_is_locked_by_a_file_beside_it_which_goes_with_the_lock(tmp_path: Path) -> None:
    journal = tmp_path / "a.journal"
    assert journal_holder(journal) is None
    lock = lock_journal(journal, "measuring paint")
    with pytest.raises(RigInUse, match=r"a\.journal: is in use by process \d+ .*: measuring paint"):
        lock_journal(tmp_path / "." / "a.journal", "measuring wood")
    assert "measuring paint" in (journal_holder(journal) or "")
    lock.release(remove=True)
    assert journal_holder(journal) is None
    assert [*tmp_path.iterdir()] == []


@pytest.mark.skipif(sys.platform == "win32", reason="Windows removes no open file")
def test_a_file_that_another_program_has_made_in_place_of_a_removed_one_stays(tmp_path: Path) -> None:
    lock, note = tmp_path / "a.lock", tmp_path / "a.holder"
    first = LockFile(lock, "a", "a test", 0o600)
    lock.unlink()  # by a person
    second = LockFile(lock, "a", "another test", 0o600)
    first.release(remove=True)
    assert lock.exists()
    assert "another test" in note.read_text(encoding="utf-8")
    second.release(remove=True)
    assert list(tmp_path.iterdir()) == []


def test_looking_at_a_lock_leaves_no_file_that_its_holder_removes_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal, acquire = tmp_path / "a.journal", FileLock.acquire
    held = lock_journal(journal, "measuring")

    def release_before(lock: FileLock, *arguments: Any, **named: Any) -> Any:
        held.release(remove=True)
        return acquire(lock, *arguments, **named)

    monkeypatch.setattr(FileLock, "acquire", release_before)
    assert journal_holder(journal) is None
    assert [*tmp_path.iterdir()] == []


@posix
def test_a_journal_that_is_renamed_while_it_is_written_is_locked_under_any_name(tmp_path: Path) -> None:
    """Also where the second program has another folder of locks, as another user has: on Linux by a name of the system."""
    journal, moved = tmp_path / "a.journal", tmp_path / "b" / "b.journal"
    journal.write_bytes(b"rows")
    lock = lock_journal(journal, "measuring paint")
    lock.hold_file(journal)
    moved.parent.mkdir()
    journal.rename(moved)
    assert f"measuring paint, as {journal}" in (journal_holder(moved) or "")
    second = lock_journal(moved, "resumed")
    with pytest.raises(RigInUse, match=rf"b\.journal: is in use by process {os.getpid()} .*: measuring paint, as .*a\.journal"):
        second.hold_file(moved)
    for state in (tmp_path / "other", journal.parent / "no-folder") if sys.platform.startswith("linux") else ():
        (tmp_path / "no-folder").write_text("so that this user has no state folder")
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("XDG_STATE_HOME", str(state))
            with pytest.raises(RigInUse, match=rf"b\.journal: is in use by process {os.getpid()} of the user"):
                second.hold_file(moved)
    second.release(remove=True)
    lock.release(remove=True)
    assert journal_holder(moved) is None
    again = lock_journal(moved, "resumed")
    again.hold_file(moved)
    again.release(remove=True)
    assert [*moved.parent.iterdir()] == [moved]


@posix
def test_a_note_is_one_printable_line_whatever_lies_there(tmp_path: Path) -> None:
    lock = lock_journal(tmp_path / "a.journal", "measuring")
    note = tmp_path / "a.journal.holder"
    for content in (b"\x1b[2Jhello\nthere", b""):
        note.write_bytes(content)
        assert journal_holder(tmp_path / "a.journal") == ("?[2Jhello there" if content else "another program")
    note.unlink()
    os.mkfifo(note)
    assert journal_holder(tmp_path / "a.journal") == "another program"
    lock.release(remove=True)
