"""The place of a journal that is written: its name, its lock, and the one file that has all rows at the end."""

import contextlib
import itertools
import os
import shutil
import sqlite3
import tempfile
from pathlib import Path

from goniotwin.app.campaign.journal.copies import copy_database, discard, new_copy, remedy_on_disk, remove, unfinished_path
from goniotwin.app.errors import UserError
from goniotwin.app.formats.file import sync_folder
from goniotwin.app.rig.lock import JournalLock, identity_of
from goniotwin.protocols.clock import RealClock

QUERY_S = 0.5
"""Longest time that is waited for the end of other programs' short queries, at the end of a journal."""


class JournalError(Exception):
    """The journal cannot be written any more. All rows committed before are safe."""


class JournalPlace:
    """Where a journal is written: under its name, as long as that leads to it. One without a lock is only read.

    After `end`, `kept_at` is the file with all rows, and `note` states why it is not the journal's one file, if it is not.
    """

    def __init__(self, path: Path, lock: JournalLock | None) -> None:
        self.path = path
        self.note = ""
        self.kept_at = path
        self._lock = lock

    def end(self, db: sqlite3.Connection, *, written: bool) -> None:
        """Close the database of the journal, and release its name. One that is `written` is then whole in its one file.

        Where that cannot be, `note` has the reason. A journal that has lost its name is kept as a copy under another one.
        """
        moved = self._moved
        if moved:
            self._rescue(db)
        remains = ""
        try:
            if self._lock is not None:
                self._make_one_file(db)
        except sqlite3.Error:  # another program has it open
            if written and not moved:
                remains = self._finish(db)
        db.close()
        if remains and _size(wal := Path(f"{os.path.realpath(self.path)}-wal")):
            self.note = f"{self.path}: rows remain in {wal}, because {remains}; use goniotwin copy to have all in one file"
        if self._lock is not None:
            self._lock.release(remove=True)

    @staticmethod
    def _make_one_file(db: sqlite3.Connection) -> None:
        """End the write-ahead log, after the short queries of others, for which SQLite does not wait. Raises sqlite3.Error."""
        clock = RealClock()
        while True:
            try:
                db.execute("PRAGMA journal_mode = DELETE")
                return
            except sqlite3.OperationalError as error:
                if error.sqlite_errorcode != sqlite3.SQLITE_BUSY or clock.now() > QUERY_S:
                    raise
            clock.sleep_until(clock.now() + 0.01)

    def _finish(self, db: sqlite3.Connection) -> str:
        """Bring all rows into the file of a journal that other programs have open; return why that cannot be, if so.

        SQLite waits some seconds for their reading to end. If it does not end, the journal is replaced by a copy; they keep
        the file that they have open. Windows does not permit that, and a hard link would still lead to that file.
        """
        with contextlib.suppress(sqlite3.Error):
            if not db.execute("PRAGMA wal_checkpoint(FULL)").fetchone()[0]:
                return ""
        remains = "another program reads it"
        if os.name == "nt":
            return remains
        file = Path(os.path.realpath(self.path))
        spare = unfinished_path(file)
        try:
            if (status := file.stat()).st_nlink > 1:
                return f"{remains}, and it has another name too (a hard link)"
            remove(spare)
            copy_database(db, spare)
            made = spare.stat()
            if (made.st_uid, made.st_gid) != (status.st_uid, status.st_gid):
                os.chown(spare, status.st_uid, status.st_gid)
            shutil.copymode(file, spare)
            db.close()
            spare.replace(file)
            sync_folder(file.parent)
            for suffix in ("-wal", "-shm"):
                Path(f"{file}{suffix}").unlink(missing_ok=True)
            return ""
        except (sqlite3.Error, OSError) as error:
            reason = remedy_on_disk(file, error)
            return f"{remains}, and a copy cannot take its place: {error}{f' ({reason})' if reason else ''}"
        finally:
            discard(spare)

    @property
    def _moved(self) -> bool:
        """Whether the name of a journal that is written leads to another file, or to none."""
        if self._lock is None or self._lock.identity is None:
            return False
        try:
            return identity_of(self.path) != self._lock.identity
        except (FileNotFoundError, NotADirectoryError):
            return True
        except OSError:  # a network disk that does not answer
            return False

    def check(self) -> None:
        """Raise JournalError where the rows go into a file that is not found by the journal's name any more."""
        if self._moved:
            now = "another file" if os.path.lexists(self.path) else "no file"
            raise JournalError(
                f"{self.path}: was moved, renamed or removed during the run, and {now} has its name now; "
                "a copy with all rows is made, which can be resumed"
            )

    def _rescue(self, db: sqlite3.Connection) -> None:
        """Copy a journal that has lost its name to a free name beside the old one, or in the nearest folder that permits it."""
        folders = [self.path.parent]
        with contextlib.suppress(OSError):  # the program's own folder was removed
            folders += self.path.absolute().parent.parents
        lost, failed = f"{self.path}: was moved, renamed or removed while it was written", ""
        for folder in filter(Path.is_dir, [*folders, Path(tempfile.gettempdir())]):
            names = (f"{self.path.stem}-rescued{f'-{k}' if k else ''}{self.path.suffix}" for k in itertools.count())
            copy = next(each for each in map(folder.joinpath, names) if not os.path.lexists(each))
            try:
                new_copy(db, copy, self.path)
            except UserError as error:
                failed = failed or str(error)
            else:
                self.kept_at = copy
                self.note = f"{lost}; {copy} has all its rows: use that"
                return
        self.note = f"{lost}, and a copy cannot be made: {failed}; the rows are where the file is now"


def _size(path: Path) -> int:
    """The size of a file; 0 where there is none."""
    with contextlib.suppress(OSError):
        return path.stat().st_size
    return 0
