"""The journal of a campaign: one SQLite file, one transaction per row.

It is crash journal, resume pointer and archive. It contains the text of the schedule and of the rig file, the planned rows,
and the raw counts; everything else can be derived from these again. docs/exchange/journal.md describes the tables.
"""

import contextlib
import json
import math
import os
import platform
import sqlite3
import threading
from collections.abc import Iterator, Sequence
from importlib import metadata
from pathlib import Path
from types import TracebackType

from goniotwin.app.campaign.journal.block_sizes import DEFAULT_SIZES, BlockSizes
from goniotwin.app.campaign.journal.chain import Chain, add_links, begin_chain, campaign_hash, seal_session
from goniotwin.app.campaign.journal.copies import (
    check_file,
    check_leftovers,
    checked_chain,
    discard,
    known_version,
    remedy_on_disk,
    remove,
    sweep,
    unfinished_path,
    unwritable,
)
from goniotwin.app.campaign.journal.place import JournalError, JournalPlace
from goniotwin.app.campaign.journal.reading import (
    DETAIL_KEYS,
    JournalReader,
    distrust,
    open_read_only,
    report_damage,
)
from goniotwin.app.campaign.journal.schema import (
    LONGEST_TEXT,
    create_tables,
    migrate,
)
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.row import Row, RowData
from goniotwin.app.errors import UserError
from goniotwin.app.formats.file import name_new_file
from goniotwin.app.guardian.guard import read_events
from goniotwin.app.guardian.record import EVENTS_SUFFIX
from goniotwin.app.rig.lock import JournalLock, lock_journal
from goniotwin.protocols.clock import calendar_stamp

CHECKPOINT_ROWS, CHECKPOINT_S = 10, 60.0
"""After so many rows, or so many seconds after the first of them, they are brought from the -wal file into the journal."""
ROWS_TOGETHER = 50
"""Rows in a transaction of a journal that is not durable."""
READERS_END_S = 5.0
"""Longest time that is waited for other programs' reading."""
OLDEST_READABLE = 2
"""Older schemas lack columns that are read: a copy of them is migrated."""
PACKAGES = ("goniotwin", "numpy", "numba", "pyserial", "pymodbus", "pyusb")


def software_versions() -> dict[str, str]:
    """Versions of Python and of the packages that the measured values depend on."""
    return {"python": platform.python_version(), **{name: metadata.version(name) for name in PACKAGES}}


class Journal(JournalReader):
    """An open journal. A row is on the disk when `commit` returns. After `close`, `place` has the file with all rows."""

    def __init__(
        self,
        connection: sqlite3.Connection,
        path: Path,
        chain: Chain,
        lock: JournalLock | None = None,
        *,
        written: bool = False,
    ) -> None:
        super().__init__(connection, path, chain)
        self.place = JournalPlace(path, lock)
        self._session: int | None = None
        self._written = written
        self._fresh = 0  # committed since the last checkpoint
        self._due_s: float | None = None  # time of the next checkpoint; None if there is nothing to bring into the file
        self._writes = threading.RLock()
        self._together, self._safe_chain = 0, chain  # rows of the transaction, and the chain before them
        self._unlinked: list[tuple[int, int]] = []  # rows of the transaction that are not in the chain yet, and their attempts

    @classmethod
    def create(
        cls,
        path: Path,
        plan: Plan,
        versions: dict[str, str],
        *,
        durable: bool = True,
        readers_end_s: float = READERS_END_S,
    ) -> "Journal":
        """Create the journal of a plan. Raises UserError where the file exists already or cannot be written.

        The file gets its name when it is complete and on the disk, so that a program that is killed here leaves either no
        journal or one that can be resumed. The name is on the disk before the first commit returns: SQLite syncs the folder
        with each new -wal file. With `durable` False nothing waits for the disk: a rehearsal need not survive a power failure.
        `readers_end_s` is the longest wait for other programs' reading.
        """
        if not path.parent.is_dir():
            raise UserError(f"{path}: there is no folder {path.parent}; create it first")
        with contextlib.ExitStack() as failed:
            lock = lock_journal(path, plan.schedule.file.name)
            failed.callback(lock.release, remove=True)
            if os.path.lexists(path):
                raise _not_overwritten(path)
            check_leftovers(path)
            journal = cls._create(path, plan, versions, lock, durable=durable, readers_end_s=readers_end_s)
            failed.pop_all()
        return journal

    @classmethod
    def _create(
        cls,
        path: Path,
        plan: Plan,
        versions: dict[str, str],
        lock: JournalLock,
        *,
        durable: bool,
        readers_end_s: float,
    ) -> "Journal":
        spare = unfinished_path(path)
        try:
            sweep(spare)
            with contextlib.closing(_connect(spare, durable=durable)) as db:
                create_tables(db)
                _describe(db, plan, versions)
                db.execute("PRAGMA wal_checkpoint")  # closing does this too, but ignores errors
            if durable:
                lock.hold_file(spare)  # before another program can find it
            name_new_file(spare, path)
        except (sqlite3.Error, OSError, UserError) as error:
            discard(spare)
            if isinstance(error, UserError):
                raise
            raise _not_overwritten(path) if isinstance(error, FileExistsError) else unwritable(path, error) from None
        try:
            db = _connect(path, durable=durable, readers_end_s=readers_end_s)
            return cls(db, path, Chain(tip=campaign_hash(db)), lock, written=durable)
        except sqlite3.Error as error:
            remove(path)
            raise unwritable(path, error) from None

    @classmethod
    def open(cls, path: Path, sizes: BlockSizes = DEFAULT_SIZES) -> "Journal":
        """Open an existing journal for reading. The file is not changed; an older schema is migrated in memory.

        Raises UserError for a file that is not a journal.
        """
        version = known_version(path)
        db = open_read_only(path)
        if version < OLDEST_READABLE:
            copy = sqlite3.connect(":memory:", check_same_thread=False)
            with contextlib.closing(db), report_damage(path):
                db.backup(copy)
                migrate(copy)
            db = copy
        journal = cls(db, path, checked_chain(db, path, sizes.checked))
        journal.sizes = sizes
        db.execute("PRAGMA query_only = ON")
        return journal

    @classmethod
    def reopen(cls, path: Path) -> "Journal":
        """Open an existing journal for writing, to resume its campaign. An older schema is migrated in the file.

        Raises UserError for a file that is not a journal, or cannot be written.
        """
        check_file(path)
        with contextlib.ExitStack() as failed:
            lock = lock_journal(path, "resumed")
            failed.callback(lock.release, remove=True)
            lock.hold_file(path)
            discard(unfinished_path(Path(os.path.realpath(path))))  # the other name, if a program was killed while it named it
            if path.stat().st_nlink > 1:  # SQLite keeps the latest rows in a file that has the journal's name
                raise UserError(
                    f"{path}: has another name too (a hard link), and could lose rows; copy it, and resume the copy"
                )
            known_version(path)
            try:
                db = _connect(path)
            except sqlite3.Error as error:
                raise UserError(
                    f"{path}: cannot be written: {error}; check its permissions, and whether another program has it open"
                ) from None
            with report_damage(path):
                migrate(db)
            journal = cls(db, path, checked_chain(db, path), lock, written=True)
            failed.pop_all()
        journal._take_over_events()
        return journal

    def _take_over_events(self) -> None:
        """Take the events of a guardian over from the file beside the journal: they are of the last session."""
        sessions, beside = self.sessions(), Path(f"{os.path.realpath(self.path)}{EVENTS_SUFFIX}")
        if sessions:
            for text in read_events(beside):
                self.event(sessions[-1].ended_s, "guardian", text)
            with contextlib.suppress(OSError):
                beside.unlink()

    def close(self) -> None:
        """Close the journal. A written journal is then whole in its one file, also while other programs read it."""
        with self._writes:  # not in the middle of an event of another thread: Python's SQLite then crashes
            if self._together:
                with contextlib.suppress(sqlite3.Error):  # of a rehearsal
                    self._commit_all()
            self.place.end(self._db, written=self._written)

    def tend(self, t: float) -> None:
        """Bring the rows into the journal's one file if it is time; `t` is on the rig's clock. Raises JournalError."""
        if self._due_s is not None and t >= self._due_s:
            self.checkpoint()

    def checkpoint(self) -> None:
        """Bring the rows into the journal's one file as far as readers permit, so that a plain copy of it has them.

        Raises JournalError where the journal has lost its name.
        """
        self._checkpoint()
        self.place.check()

    def _checkpoint(self) -> None:
        with self._writes, contextlib.suppress(sqlite3.Error):  # the rows are on the disk, in the -wal file
            self._fresh, self._due_s = 0, None
            if self._written:
                _, written, copied = self._db.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
                if copied < written:  # a reader is in the way: again at the next poll
                    self._due_s = -math.inf

    def _expect_checkpoint(self, t: float, rows: int = 0) -> None:
        """Count what was committed at the time `t`, and make the checkpoint that is due."""
        with self._writes:
            self._fresh += rows
            if self._due_s is None:
                self._due_s = t + CHECKPOINT_S
            if self._fresh >= CHECKPOINT_ROWS or t >= self._due_s:
                self._checkpoint()

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def begin_session(self, t: float, rig: str, versions: dict[str, str]) -> int:
        """Record the start of a session and return its number. `t` is on the rig's clock, `rig` the text of the rig file.

        All rows and events from now on belong to this session.
        """
        about = (t, calendar_stamp(), rig, json.dumps(versions, sort_keys=True), self.chain.length + 1)
        with self._writing():
            cursor = self._db.execute(
                "INSERT INTO session (started_s, wall_started, rig, versions, first_link) VALUES (?, ?, ?, ?, ?)", about
            )
            session = int(cursor.lastrowid or 0)
            seal_session(self._db, session)
        self._session = session
        self._expect_checkpoint(t)
        return session

    def add_rows(self, rows: Sequence[Row]) -> None:
        """Record the unplanned rows of this session: those with which a resumed campaign starts."""
        with self._writing():
            self._db.executemany(INSERT_ROW, [(*_planned(row), self._session) for row in rows])

    def end_session(self, session: int, t: float, outcome: str) -> None:
        """Record the end of a session, with the tip and length of the chain; `outcome` is done, stopped or failed."""
        with self._writing():
            self._db.execute(
                "UPDATE session SET ended_s = ?, outcome = ?, wall_ended = ?, last_link = ?, tip = ? WHERE id = ?",
                (t, outcome, calendar_stamp(), self.chain.length, self.chain.tip, session),
            )
            seal_session(self._db, session)

    def event(self, t: float, kind: str, text: str) -> None:
        """Record an event of a kind (fault, stop, drift, order, ...) at time `t` on the rig's clock. From any thread.

        An event outside of a session belongs to the last one. A text that `check_lengths` would refuse is cut: an exception
        of any library may be one.
        """
        text = text[: LONGEST_TEXT // 4]  # a character has at most four bytes
        session = "COALESCE(?, (SELECT MAX(id) FROM session))"
        with self._writing():
            self._db.execute(
                f"INSERT INTO event (session, t_s, kind, text) VALUES ({session}, ?, ?, ?)", (self._session, t, kind, text)
            )
        self._expect_checkpoint(t)

    def faults(self) -> list[str]:
        """Texts of all fault events, in order of time."""
        return [str(text) for (text,) in self._db.execute("SELECT text FROM event WHERE kind = 'fault' ORDER BY id")]

    def commit(self, row: Row, data: RowData) -> None:
        """Write one row in one transaction; it is on the disk on return. Raises JournalError.

        A journal that is not durable has many rows in a transaction, and `chain` has them at its end.
        """
        positions = None if data.positions is None else json.dumps(data.positions)
        with self._writing(together=not self._written):
            (attempt,) = self._db.execute(NEXT_ATTEMPT, (row.number, row.number)).fetchone()
            self._db.execute(
                INSERT_ATTEMPT,
                (row.number, attempt, data.started_s, data.ended_s, positions, json.dumps(data.flags), self._session),
            )
            self._db.executemany(
                INSERT_READING,
                [
                    (
                        row.number,
                        attempt,
                        each.gain_v_per_a,
                        each.first_s,
                        each.period_s,
                        each.monitor_a,
                        *each.counts.shape,
                        each.counts.astype("<u2").tobytes(),
                    )
                    for each in data.readings
                ],
            )
            self._unlinked.append((row.number, attempt))
            if self._written:
                if row.number in self.chain.damaged:
                    self._db.execute("DELETE FROM temp.damaged WHERE number = ?", (row.number,))
                self._link()
        self._expect_checkpoint(data.ended_s, rows=1)
        self.place.check()

    def append_session(self, path: Path, rig: str, rows: Sequence[Row]) -> None:
        """Append the one session of another journal of this plan, made by this program just now: `rows`, and its events.

        `rig` is the text of the rig file. Raises UserError where it has other rows, or begins before the last one here ends.
        """
        with contextlib.closing(open_read_only(path)) as part:
            ((begin, end, versions),) = part.execute("SELECT started_s, ended_s, versions FROM session").fetchall()
            (last,) = self._db.execute("SELECT MAX(ended_s) FROM session").fetchone()
            if last is not None and begin < last:
                raise UserError("its blocks overlap in time")
            attempts = part.execute(f"SELECT {ATTEMPT} FROM attempt ORDER BY rowid").fetchall()
            if [number for number, *_ in attempts] != [row.number for row in rows]:
                raise UserError(f"{path}: does not have the rows of its block")
            session = self.begin_session(begin, rig, json.loads(versions))
            with self._writing():
                self._db.executemany(INSERT_ATTEMPT, [(*attempt, session) for attempt in attempts])
                self._db.executemany(INSERT_READING, part.execute("SELECT * FROM reading"))
                self._db.executemany(
                    "INSERT INTO event (session, t_s, kind, text) VALUES (?, ?, ?, ?)",
                    [(session, *event) for event in part.execute("SELECT t_s, kind, text FROM event ORDER BY id")],
                )
                for first in range(0, len(attempts), ROWS_TOGETHER):
                    self._unlinked = [(number, attempt) for number, attempt, *_ in attempts[first : first + ROWS_TOGETHER]]
                    self._link()
        self.end_session(session, end, "done")

    def _link(self) -> None:
        """Add the links of the rows that have none yet. Raises sqlite3.Error."""
        if self._unlinked:
            self.chain = add_links(self._db, self.chain, self._unlinked)
            self._unlinked = []

    def _commit_all(self) -> None:
        """End the transaction. Raises sqlite3.Error."""
        self._link()
        self._db.commit()
        self._safe_chain, self._together = self.chain, 0

    @contextlib.contextmanager
    def _writing(self, *, together: bool = False) -> Iterator[None]:
        """One transaction, of one thread at a time; with `together` one with those before it, if they are not too many.

        Raises JournalError where it cannot be written.
        """
        try:
            with self._writes:
                try:
                    if together:
                        yield
                        self._together += 1
                        if self._together >= ROWS_TOGETHER:
                            self._commit_all()
                    else:
                        with self._db:
                            self._link()
                            yield
                        self._safe_chain, self._together = self.chain, 0
                except BaseException:
                    if together:
                        self._db.rollback()
                    self.chain, self._together, self._unlinked = self._safe_chain, 0, []
                    raise
        except sqlite3.Error as error:
            remedy = remedy_on_disk(self.path, error) or "check the disk, its permissions and any limit of the size of files"
            if getattr(error, "sqlite_errorcode", 0) & 0xFF == sqlite3.SQLITE_BUSY:
                remedy = "close the other program that writes to it"
            raise JournalError(f"{self.path}: cannot be written: {error}; {remedy}") from None


def _describe(db: sqlite3.Connection, plan: Plan, versions: dict[str, str]) -> None:
    """Write what the campaign begins with. Raises sqlite3.Error."""
    about = {
        "name": plan.schedule.file.name,
        "schedule": plan.schedule.text,
        "rig": plan.rig.text,
        "rig_folder": str(plan.rig.folder.absolute()).encode(errors="backslashreplace").decode(),  # a name need not be text
        "simulated": json.dumps(plan.rig.simulated),
        "seed": json.dumps(plan.rig.seed),
        "model": json.dumps(plan.rig.model_hash()),
        "versions": json.dumps(versions, sort_keys=True),
    }
    if plan.schedule.certificate is not None:
        about["certificate"] = plan.schedule.certificate
    if plan.rig.alignment is not None:
        about["alignment"] = plan.rig.alignment
    with db:
        db.executemany("INSERT INTO campaign VALUES (?, ?)", about.items())
        db.executemany(INSERT_ROW, [(*_planned(row), None) for row in plan.rows])
        begin_chain(db)


def _connect(path: Path, *, durable: bool = True, readers_end_s: float = READERS_END_S) -> sqlite3.Connection:
    db = sqlite3.connect(path, timeout=readers_end_s, check_same_thread=False)
    try:
        distrust(db)
        db.execute("PRAGMA journal_mode = WAL")
        db.execute(f"PRAGMA synchronous = {'FULL' if durable else 'OFF'}")
        db.execute("PRAGMA fullfsync = ON")  # macOS only: there a plain sync leaves the data in the cache of the disk
        db.execute("PRAGMA checkpoint_fullfsync = ON")
        db.execute("PRAGMA foreign_keys = ON")
    except sqlite3.Error:
        db.close()
        raise
    return db


def _not_overwritten(path: Path) -> UserError:
    return UserError(f"{path}: exists already, and a journal is never overwritten; choose another name")


NEXT_ATTEMPT = """
SELECT 1 + MAX(
    COALESCE((SELECT MAX(attempt) FROM attempt WHERE number = ?), 0),
    COALESCE((SELECT MAX(attempt) FROM reading WHERE number = ?), 0)
)
"""
"""A damaged journal may have readings without their attempt."""
ATTEMPT = "number, attempt, started_s, ended_s, positions, flags"
INSERT_ATTEMPT = f"INSERT INTO attempt ({ATTEMPT}, session) VALUES (?, ?, ?, ?, ?, ?, ?)"
INSERT_READING = "INSERT INTO reading VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)"
INSERT_ROW = (
    "INSERT INTO plan (number, identity, kind, sample, wavelength_nm, gamma_deg, sigma_deg, beta_deg, shift_deg, seconds,"
    " detail, session) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"
)


def _planned(row: Row) -> tuple[object, ...]:
    pose = row.pose if row.pose is not None else (None, None, None, None)
    detail = json.dumps({key: getattr(row, key) for key in DETAIL_KEYS})
    return (
        row.number,
        row.identity,
        row.kind,
        row.sample,
        row.wavelength_nm,
        *pose,
        row.seconds,
        detail,
    )
