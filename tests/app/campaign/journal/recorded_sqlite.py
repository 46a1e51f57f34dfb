"""SQLite with a record of every write, sync and removal, for the code of the journal.

The connection is apsw's, because its VFS can be written in Python; for the journal it acts as a connection of the standard
library, with the same statements, pragmas and transactions. Two things differ, and neither changes what is written and synced,
and when: the library is apsw's own SQLite, and the lock is exclusive, because a VFS in Python has no shared memory.

As in SQLite's VFS for Unix, the folder is synced with the first sync of each journal and each -wal file that is opened
(os_unix.c, UNIXFILE_DIRSYNC), and with a removal that requests it.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

import apsw

from tests.app.campaign.journal.simulated_disk import FolderSynced, Named, Operation, Resized, Synced, Written

CHANGING = ("INSERT", "UPDATE", "DELETE", "REPLACE")
DIRECTORY_SYNCED = apsw.SQLITE_OPEN_WAL | apsw.SQLITE_OPEN_MAIN_JOURNAL
_vfs_numbers = itertools.count()


class RecordingVfs(apsw.VFS):
    """VFS that does everything on the real disk and records it in `operations`."""

    def __init__(self) -> None:
        self.name = f"recorded-{next(_vfs_numbers)}"
        self.operations: list[Operation] = []
        self._files: dict[str, int] = {}
        self._numbers = itertools.count()
        super().__init__(self.name, base="")

    def xOpen(self, name: Any, flags: list[int]) -> "RecordingFile":
        path = name.filename() if isinstance(name, apsw.URIFilename) else name
        existed = Path(path).exists()
        opened = RecordingFile(self, name, flags)
        if not existed:
            self._files[path] = next(self._numbers)
            self.operations.append(Named(Path(path).name, self._files[path]))
        opened.number = self._files[path]
        opened.syncs_folder = bool(flags[0] & DIRECTORY_SYNCED)
        return opened

    def xDelete(self, filename: str, syncdir: bool) -> None:
        super().xDelete(filename, syncdir)
        self.record_removal(Path(filename))
        if syncdir:
            self.operations.append(FolderSynced())

    def record_removal(self, path: Path) -> None:
        """Record the removal of a name."""
        if self._files.pop(str(path), None) is not None:
            self.operations.append(Named(path.name, None))

    def record_link(self, path: Path, target: Path) -> None:
        """Record another name of a file."""
        self._files[str(path)] = self._files[str(target)]
        self.operations.append(Named(path.name, self._files[str(path)]))


class RecordingFile(apsw.VFSFile):
    """An open file of a RecordingVfs."""

    number = -1
    syncs_folder = False

    def __init__(self, disk: RecordingVfs, name: Any, flags: list[int]) -> None:
        self._disk = disk
        super().__init__("", name, flags)

    def xWrite(self, data: bytes, offset: int) -> None:
        super().xWrite(data, offset)
        self._disk.operations.append(Written(self.number, offset, bytes(data)))

    def xTruncate(self, newsize: int) -> None:
        super().xTruncate(newsize)
        self._disk.operations.append(Resized(self.number, newsize))

    def xSync(self, flags: int) -> None:
        super().xSync(flags)
        self._disk.operations.append(Synced(self.number))
        if self.syncs_folder:
            self.syncs_folder = False
            self._disk.operations.append(FolderSynced())


class Cursor:
    """Result of a statement, with the interface of the standard library's cursor."""

    def __init__(self, rows: Iterable[tuple[Any, ...]], lastrowid: int) -> None:
        self._rows = iter(rows)
        self.lastrowid = lastrowid

    def fetchone(self) -> tuple[Any, ...] | None:
        return next(self._rows, None)

    def fetchmany(self, size: int) -> list[tuple[Any, ...]]:
        return list(itertools.islice(self._rows, size))

    def fetchall(self) -> list[tuple[Any, ...]]:
        return list(self._rows)

    def __iter__(self) -> Iterator[tuple[Any, ...]]:
        return self._rows


class Connection:
    """As `sqlite3.Connection`: a transaction starts with the first statement that changes data, and ends with `with`."""

    text_factory: Any = str

    def __init__(self, disk: RecordingVfs, path: Path, translate: Callable[[str], str], checkpoint_pages: int) -> None:
        self._translate = translate
        self._db = apsw.Connection(str(path), vfs=disk.name)
        self._db.execute("PRAGMA locking_mode = EXCLUSIVE")
        self._db.execute(f"PRAGMA wal_autocheckpoint = {checkpoint_pages}")

    def execute(self, statement: str, bindings: Iterable[Any] = ()) -> Cursor:
        self._begin_if_needed(statement)
        rows = self._db.execute(self._translate(statement), tuple(bindings)).fetchall()
        return Cursor(rows, self._db.last_insert_rowid())

    def executemany(self, statement: str, bindings: Iterable[Iterable[Any]]) -> None:
        self._begin_if_needed(statement)
        self._db.executemany(statement, [tuple(each) for each in bindings])

    def setlimit(self, category: int, limit: int) -> int:
        return self._db.limit(category, limit)

    def set_progress_handler(self, handler: Callable[[], bool] | None, steps: int) -> None:
        self._db.set_progress_handler(handler, steps or 1)

    def close(self) -> None:
        self._db.close()

    def __enter__(self) -> "Connection":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._db.in_transaction:
            self._db.execute("COMMIT" if kind is None else "ROLLBACK")

    def _begin_if_needed(self, statement: str) -> None:
        if statement.lstrip().upper().startswith(CHANGING) and not self._db.in_transaction:
            self._db.execute("BEGIN")
