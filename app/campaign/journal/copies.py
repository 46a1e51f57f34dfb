"""Copies of a journal, and the unfinished file that a new one is until it is complete and gets its name."""

import contextlib
import errno
import os
import sqlite3
import tempfile
from collections.abc import Callable
from pathlib import Path

from goniotwin.app.campaign.journal.block_sizes import BlockSizes
from goniotwin.app.campaign.journal.chain import Chain, check_chain
from goniotwin.app.campaign.journal.reading import bound_steps, open_read_only, report_damage
from goniotwin.app.campaign.journal.schema import APPLICATION_ID, SCHEMA_VERSION, check_lengths, check_schema
from goniotwin.app.errors import UserError, room_on_disk
from goniotwin.app.formats.file import name_new_file, sync_folder
from goniotwin.app.rig.lock import RigInUse, lock_journal

PROBE_BYTES = 1 << 16
"""SQLite makes its files longer by half of this at once."""
UNFINISHED = ".goniotwin-new"
"""End of the name of a journal until it is complete."""
Progress = Callable[[int, int, int], object]
"""Takes a status of SQLite, and the numbers of pages that remain and of all."""


def remove(path: Path) -> None:
    """Delete a database and the files that SQLite keeps beside it, the database last. Raises OSError."""
    for suffix in ("-wal", "-shm", "-journal", ""):
        Path(f"{path}{suffix}").unlink(missing_ok=True)


def discard(spare: Path) -> None:
    """Delete an unfinished journal, where the disk permits it."""
    with contextlib.suppress(OSError):
        remove(spare)


def sweep(spare: Path) -> None:
    """Delete the unfinished journal `spare`, whose lock is held, and those that killed programs left in its folder.

    Raises OSError for the first.
    """
    remove(spare)
    for left in spare.parent.glob(f".*{UNFINISHED}"):
        with contextlib.suppress(UserError):  # a program makes it now
            lock = lock_journal(left.with_name(left.name[1:].removesuffix(UNFINISHED)), "removing what a killed program left")
            discard(left)
            lock.release(remove=True)


def check_leftovers(path: Path) -> None:
    """Raise UserError where the name of a new journal has files that SQLite would apply to it."""
    for leftover in (Path(f"{path}-wal"), Path(f"{path}-journal")):
        if leftover.exists():
            raise UserError(
                f"{leftover}: belongs to another journal of that name; move it to that journal, or choose another name"
            )


def unwritable(path: Path, error: Exception) -> UserError:
    """The error of a journal that cannot be written, with the remedy."""
    remedy = remedy_on_disk(path, error) or "check the folder and the disk"
    return UserError(f"{path}: cannot be written: {error}; {remedy}")


def remedy_on_disk(path: Path, error: Exception) -> str:
    """The remedy where a journal cannot be written because the disk is full; else empty.

    SQLite may report a full disk as any error of input and output, and such an error as one: another file shows it.
    """
    if isinstance(error, OSError):
        return room_on_disk(error)
    try:
        with tempfile.TemporaryFile(dir=path.parent) as file:
            file.write(bytes(PROBE_BYTES))
    except OSError as found:
        return room_on_disk(found)
    return room_on_disk(OSError(errno.ENOSPC, "")) if getattr(error, "sqlite_errorcode", 0) == sqlite3.SQLITE_FULL else ""


def check_file(path: Path) -> None:
    """Raise UserError where there is no file of that name."""
    if not path.is_file():
        what = "is a folder or a device, not a journal" if path.exists() else "there is no such journal"
        raise UserError(f"{path}: {what}; check the name")


def known_version(path: Path) -> int:
    """The schema version of a journal.

    Raises UserError for a file that is not a journal, or too new, and DamagedJournal for one that may have been a journal: half
    of a file, or a copy that was made while rows were written.
    """
    check_file(path)
    try:
        with contextlib.closing(open_read_only(path)) as db:
            found = db.execute("PRAGMA application_id").fetchone()[0]
            version = int(db.execute("PRAGMA user_version").fetchone()[0])
            if found == APPLICATION_ID and 1 <= version <= SCHEMA_VERSION:
                with bound_steps(db, path):
                    check_schema(db, version)
    except ValueError as error:
        raise UserError(f"{path}: {error}; use the journal as goniotwin wrote it, or a copy of that") from None
    except (sqlite3.Error, OSError) as error:
        if getattr(error, "sqlite_errorname", "").startswith("SQLITE_CORRUPT"):
            with report_damage(path):
                raise
        raise UserError(f"{path}: is not a journal: {' '.join(str(error).split())}; is it the right file?") from None
    if found != APPLICATION_ID or version < 1:
        what = "is an SQLite file, but not a journal of goniotwin" if path.stat().st_size > 1 else "is empty"
        raise UserError(f"{path}: {what}; is it the right file?")
    if version > SCHEMA_VERSION:
        raise UserError(f"{path}: has schema {version}, newer than {SCHEMA_VERSION}; use a newer goniotwin")
    return version


def copy_journal(path: Path, copy: Path, progress: Progress | None = None) -> Chain:
    """Copy a journal as it is now to one file, also while its campaign runs, and check the copy; return its chain.

    The copy has its name when it is whole. `progress` is called as that of `sqlite3.Connection.backup` is. Raises UserError
    where the copy cannot be made, and DamagedJournal for a journal of which more than rows, plan or sessions is damaged.
    """
    known_version(path)
    try:
        with contextlib.closing(open_read_only(path)) as db:
            return new_copy(db, copy, path, progress)
    except (sqlite3.Error, OSError) as error:
        raise unwritable(copy, error) from None


def new_copy(db: sqlite3.Connection, copy: Path, path: Path, progress: Progress | None = None) -> Chain:
    """Copy the journal `path`, open as `db`, to a new file, and check it. Raises UserError; nothing is overwritten."""
    exists = UserError(f"{copy}: exists, and nothing is overwritten; choose another name")
    if os.path.lexists(copy):
        raise exists
    if not copy.parent.is_dir():
        raise UserError(f"{copy}: cannot be written: there is no folder {copy.parent}; create it first")
    try:
        lock = lock_journal(copy, f"copied from {path}")
    except RigInUse as used:
        raise UserError(f"{copy}: is being written by {used.holder}; nothing is overwritten: choose another name") from None
    spare = unfinished_path(copy)
    try:
        check_leftovers(copy)
        sweep(spare)
        copy_database(db, spare, progress)
        with contextlib.closing(open_read_only(spare)) as made:
            chain = checked_chain(made, path)
        name_new_file(spare, copy)
        sync_folder(copy.parent)
        return chain
    except FileExistsError:
        raise exists from None
    except (sqlite3.Error, OSError) as error:
        raise unwritable(copy, error) from None
    finally:
        discard(spare)
        lock.release(remove=True)


def copy_database(db: sqlite3.Connection, to: Path, progress: Progress | None = None) -> None:
    """Copy a snapshot of a database to a new file, which is then on the disk. Raises sqlite3.Error."""
    with contextlib.closing(sqlite3.connect(to)) as copy:
        db.backup(copy, progress=progress)
        copy.execute("PRAGMA journal_mode = DELETE")


def unfinished_path(path: Path) -> Path:
    """The name of a journal until it is complete; the holder of the journal's lock may make and delete it."""
    return path.with_name(f".{path.name}{UNFINISHED}")


def checked_chain(db: sqlite3.Connection, path: Path, at_once: int = BlockSizes.checked) -> Chain:
    """The chain of a journal, compared with all of it in one snapshot.

    Raises UserError, and closes `db`, where more than rows, plan or sessions is damaged.
    """
    try:
        with report_damage(path), bound_steps(db, path):
            db.execute("BEGIN")
            (found,) = db.execute("PRAGMA integrity_check(1)").fetchone()
            if found != "ok":
                raise ValueError(found)
            check_lengths(db)
            chain = check_chain(db, at_once)
            db.execute("COMMIT")
            return chain
    except UserError:
        db.close()
        raise
