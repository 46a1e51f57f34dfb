"""The journal's own code on a SQLite of which every write, sync and removal is known.

The connection is apsw's, whose VFS may be written in Python; to the journal it looks like one of the standard library's, with
the same statements, pragmas and transactions. Two things differ, neither of which changes what is written and synced, and
when: the library is apsw's own SQLite, and the lock is exclusive, since a VFS in Python has no shared memory.

As the VFS of SQLite for Unix does it, the folder is synced with the first sync of each journal and each -wal file that is
opened (os_unix.c, UNIXFILE_DIRSYNC), and with a removal that asks for it.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

import apsw

from tests.app.campaign.journal.simulated_disk import Doing, FolderSynced, Named, Renamed, Resized, Synced, Written

CHANGING = ("INSERT", "UPDATE", "DELETE", "REPLACE")
DIRECTORY_SYNCED = apsw.SQLITE_OPEN_WAL | apsw.SQLITE_OPEN_MAIN_JOURNAL
_vfs_numbers = itertools.count()


class WatchedDisk(apsw.VFS):
    """Does everything on the real disk too, and writes down what."""

    def __init__(self) -> None:
        self.name = f"watched-{next(_vfs_numbers)}"
        self.doings: list[Doing] = []
        self._files: dict[str, int] = {}
        self._numbers = itertools.count()
        super().__init__(self.name, base="")

    def xOpen(self, name: Any, flags: list[int]) -> "WatchedFile":
        path = name.filename() if isinstance(name, apsw.URIFilename) else name
        there = Path(path).exists()
        opened = WatchedFile(self, name, flags)
        if not there:
            self._files[path] = next(self._numbers)
            self.doings.append(Named(Path(path).name, self._files[path]))
        opened.number = self._files[path]
        opened.syncs_folder = bool(flags[0] & DIRECTORY_SYNCED)
        return opened

    def xDelete(self, filename: str, syncdir: bool) -> None:
        super().xDelete(filename, syncdir)
        self.removed(Path(filename))
        if syncdir:
            self.doings.append(FolderSynced())

    def removed(self, path: Path) -> None:
        """A name is gone."""
        if self._files.pop(str(path), None) is not None:
            self.doings.append(Named(path.name, None))

    def renamed(self, path: Path, to: Path) -> None:
        """A name is another."""
        self._files[str(to)] = self._files.pop(str(path))
        self.doings.append(Renamed(path.name, to.name))


class WatchedFile(apsw.VFSFile):
    """One that is open."""

    number = -1
    syncs_folder = False

    def __init__(self, disk: WatchedDisk, name: Any, flags: list[int]) -> None:
        self._disk = disk
        super().__init__("", name, flags)

    def xWrite(self, data: bytes, offset: int) -> None:
        super().xWrite(data, offset)
        self._disk.doings.append(Written(self.number, offset, bytes(data)))

    def xTruncate(self, newsize: int) -> None:
        super().xTruncate(newsize)
        self._disk.doings.append(Resized(self.number, newsize))

    def xSync(self, flags: int) -> None:
        super().xSync(flags)
        self._disk.doings.append(Synced(self.number))
        if self.syncs_folder:
            self.syncs_folder = False
            self._disk.doings.append(FolderSynced())


class Found:
    """What a statement has found, as the standard library's cursor says it."""

    def __init__(self, rows: Iterable[tuple[Any, ...]], lastrowid: int) -> None:
        self._rows = iter(rows)
        self.lastrowid = lastrowid

    def fetchone(self) -> tuple[Any, ...] | None:
        return next(self._rows, None)

    def fetchall(self) -> list[tuple[Any, ...]]:
        return list(self._rows)

    def __iter__(self) -> Iterator[tuple[Any, ...]]:
        return self._rows


class Connection:
    """As `sqlite3.Connection`: a transaction begins with the first statement that changes something, and ends with `with`."""

    def __init__(self, disk: WatchedDisk, path: Path, translate: Callable[[str], str], checkpoint_pages: int) -> None:
        self._translate = translate
        self._db = apsw.Connection(str(path), vfs=disk.name)
        self._db.execute("PRAGMA locking_mode = EXCLUSIVE")
        self._db.execute(f"PRAGMA wal_autocheckpoint = {checkpoint_pages}")

    def execute(self, statement: str, bindings: Iterable[Any] = ()) -> Found:
        self._begin_where_needed(statement)
        rows = self._db.execute(self._translate(statement), tuple(bindings)).fetchall()
        return Found(rows, self._db.last_insert_rowid())

    def executemany(self, statement: str, bindings: Iterable[Iterable[Any]]) -> None:
        self._begin_where_needed(statement)
        self._db.executemany(statement, [tuple(each) for each in bindings])

    def close(self) -> None:
        self._db.close()

    def __enter__(self) -> "Connection":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._db.in_transaction:
            self._db.execute("COMMIT" if kind is None else "ROLLBACK")

    def _begin_where_needed(self, statement: str) -> None:
        if statement.lstrip().upper().startswith(CHANGING) and not self._db.in_transaction:
            self._db.execute("BEGIN")
