"""Read access to a journal: the campaign's properties, its sessions, and its rows."""

import contextlib
import itertools
import json
import math
import os
import shutil
import sqlite3
import stat
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from goniotwin.app.campaign.journal.block_sizes import DEFAULT_SIZES
from goniotwin.app.campaign.journal.chain import Chain
from goniotwin.app.campaign.journal.mounting import MOUNTED, read_mounting
from goniotwin.app.campaign.row import (
    CONTRADICTION,
    MIRRORED_MARK,
    SKIPPED,
    CommittedRow,
    Reading,
    RecordedRows,
    Row,
    RowData,
    RowKind,
    table_of_columns,
)
from goniotwin.app.campaign.schedule.metadata import SampleMetadataTable
from goniotwin.app.errors import UserError
from goniotwin.arrays import Counts, Floats, Ints

ROW_INDEX = np.dtype(
    [
        ("number", np.int64),
        ("sample", np.int32),
        ("mirrored", np.bool_),
        ("contradiction", np.bool_),
        ("wavelength_nm", np.float64),
        ("gamma_deg", np.float64),
        ("sigma_deg", np.float64),
        ("beta_deg", np.float64),
        ("shift_deg", np.float64),
    ]
)
"""Index entry of a measured row: a few bytes a row, so that long campaigns fit in memory. `sample` is an index into a list of
sample names that comes with the index.
"""
USE_A_COPY = "use a copy of it, if there is one; goniotwin copy makes copies that are whole, also during a run"
LIMITS = {
    sqlite3.SQLITE_LIMIT_LENGTH: 1 << 26,
    sqlite3.SQLITE_LIMIT_SQL_LENGTH: 100_000,
    sqlite3.SQLITE_LIMIT_COLUMN: 100,
    sqlite3.SQLITE_LIMIT_EXPR_DEPTH: 100,
    sqlite3.SQLITE_LIMIT_COMPOUND_SELECT: 10,
    sqlite3.SQLITE_LIMIT_TRIGGER_DEPTH: 1,
    sqlite3.SQLITE_LIMIT_LIKE_PATTERN_LENGTH: 100,
    sqlite3.SQLITE_LIMIT_ATTACHED: 0,
}
"""Bounds for all journals, far above what one needs: bytes of a value and of a statement, and what a schema could have."""
LEAST_STEPS, STEPS_PER_BYTE, STEPS_TOGETHER = 10_000_000, 100, 100_000
"""Steps of SQLite's machine that a check of a journal may take, and after how many these are counted."""
SUPER_JOURNAL = bytes.fromhex("d9d505f920a163d7")
"""Last bytes of a rollback journal that names another file, which SQLite deletes after it; this program makes none."""
MOST_BESIDE = 1 << 30
"""Bytes of the files beside a journal that are copied with it."""
LAST_ATTEMPT = "WHERE attempt = (SELECT MAX(attempt) FROM attempt b WHERE b.number = p.number)"
READINGS_OF = """
SELECT p.number, p.started_s, r.gain_v_per_a, r.first_s, r.period_s, r.monitor_a, r.readings, r.channels, r.counts
FROM attempt p LEFT JOIN reading r ON r.number = p.number AND r.attempt = p.attempt
WHERE {} AND p.attempt = (SELECT MAX(attempt) FROM attempt b WHERE b.number = p.number)
ORDER BY p.number, r.gain_v_per_a
"""
"""The readings of rows, of their last attempts."""
ASKED_AT_ONCE = 256
"""Rows that are asked for in one statement."""
NO_ROW = -1
PLAN_FIRST = "CROSS JOIN"
"""A join in which SQLite begins with the plan: it looks for no attempts of rows of other kinds."""
NUMBER_AND_START = np.dtype([("number", np.int64), ("started_s", np.float64)])
ATTEMPTED = "EXISTS (SELECT 1 FROM attempt a WHERE a.number = p.number)"
MOST_ORDERS = 20
"""Safety orders of a session that are listed: a run gives two."""
MOST_EVENTS = 1000
"""Events of a session that are listed, the last ones."""
OUTCOMES = ("done", "stopped", "failed", None)
DETAIL_KEYS = ("gains", "readings", "automatic", "target", "longest_s")
"""Fields of a row that the column `detail` holds as JSON."""


class PlanEntry(NamedTuple):
    """A row of the table `plan`, by its columns."""

    number: int
    identity: str
    kind: RowKind
    sample: str
    wavelength_nm: float | None
    gamma_deg: float
    sigma_deg: float | None
    beta_deg: float
    shift_deg: float
    seconds: float
    detail: str


ROW_COLUMNS = ", ".join(f"p.{name}" for name in PlanEntry._fields)


class ExecutedRow(NamedTuple):
    """A row that was executed: its last attempt. `pose` has the angles gamma, sigma, beta, shift in degrees."""

    number: int
    kind: str
    sample: str
    session: int
    pose: tuple[float, float, float, float] | None


class DamagedJournal(UserError):
    """A journal that differs from what was written."""

    status = 1


@dataclass(frozen=True)
class Session:
    """One run of a program on a campaign. Times in s on the rig's clock; wall times are ISO 8601.

    A program that was killed recorded no end: then `outcome` is None, and `ended_s` is the end of its last committed row.
    """

    number: int
    started_s: float
    ended_s: float
    outcome: str | None
    wall_started: str
    wall_ended: str | None
    versions: dict[str, str]


class JournalReader:
    """The contents of a journal. All methods raise UserError for a damaged file.

    `chain` is its chain of hashes as it was when the journal was opened. Rows that differ from what was committed count as not
    measured. `sizes` are those of the blocks in which it is read.
    """

    def __init__(self, connection: sqlite3.Connection, path: Path, chain: Chain) -> None:
        self._db = connection
        self.path = path
        self.chain = chain
        self.sizes = DEFAULT_SIZES
        self._sound = ""
        if chain.without_values:
            self._db.execute("CREATE TEMP TABLE damaged (number INTEGER PRIMARY KEY)")
            self._db.executemany("INSERT INTO temp.damaged VALUES (?)", [(number,) for number in chain.without_values])
            self._db.commit()
            self._sound = " AND p.number NOT IN temp.damaged"

    def value(self, key: str) -> str:
        """A value of the table `campaign`: schedule, rig, name, simulated, seed, model or versions.

        Raises UserError where it is missing.
        """
        found = self.optional_value(key)
        if found is None:
            raise DamagedJournal(f"{self.path}: has no entry {key!r}: the file is incomplete; {USE_A_COPY}")
        return found

    def optional_value(self, key: str) -> str | None:
        """A value that not every campaign has, such as the alignment of its rig; None where it is missing."""
        with self._reading():
            found = self._db.execute("SELECT value FROM campaign WHERE key = ?", (key,)).fetchone()
        return None if found is None else str(found[0])

    @property
    def simulated(self) -> bool:
        """Whether the campaign ran on a virtual rig."""
        return self.value("simulated") == "true"

    @property
    def seconds(self) -> float:
        """Duration of all sessions together, on the rig's clock."""
        return self._finite(sum(session.ended_s - session.started_s for session in self.sessions()))

    def sessions(self) -> list[Session]:
        """The sessions in order of time."""
        with self._reading():
            found = self._db.execute(
                "SELECT id, started_s, COALESCE(ended_s, (SELECT MAX(ended_s) FROM attempt WHERE session = s.id), started_s),"
                " outcome, wall_started, wall_ended, versions FROM session s ORDER BY id"
            )
            return [_session(*entries) for entries in found]

    def row_counts(self) -> tuple[int, int]:
        """Number of the planned rows that are measured, and number of all planned rows."""
        with self._reading():
            ((begun, planned),) = self._db.execute(
                f"SELECT SUM({ATTEMPTED}{self._sound}), COUNT(*) FROM plan p WHERE session IS NULL"
            )
        return (begun or 0) - sum(self.skipped_by_sample().values()), planned

    def seconds_left(self) -> float:
        """Estimated duration of the planned rows that are not measured, skipped ones included."""
        with self._reading():
            ((seconds,),) = self._db.execute(
                f"SELECT TOTAL(seconds) FROM plan p WHERE session IS NULL AND NOT ({ATTEMPTED}{self._sound})"
            )
        return self._finite(float(seconds) + sum(seconds for _, seconds in self._skipped_rows()))

    def _finite(self, seconds: float) -> float:
        if not math.isfinite(seconds):
            raise DamagedJournal(f"{self.path}: is damaged: it has a duration of {seconds} s; {USE_A_COPY}")
        return seconds

    def skipped_by_sample(self) -> dict[str, int]:
        """Number of the planned rows of each sample that were skipped because of a fault and not measured since."""
        return dict(Counter(sample for sample, _ in self._skipped_rows()))

    def planned_rows(self) -> tuple[Row, ...]:
        """The rows of the plan, in order; without the unplanned rows of resumed sessions."""
        with self._reading():
            return tuple(
                _row(*entries)
                for entries in self._db.execute(f"SELECT {ROW_COLUMNS} FROM plan p WHERE session IS NULL ORDER BY number")
            )

    def committed_numbers(self) -> set[int]:
        """Numbers of the rows that are measured, unplanned ones included, skipped and damaged ones excluded."""
        with self._reading():
            attempted = {number for (number,) in self._db.execute("SELECT DISTINCT number FROM attempt")}
        return attempted - self._last_skipped() - self.chain.without_values.keys()

    def _last_skipped(self) -> set[int]:
        """Numbers of the rows with the flag SKIPPED in their last attempt."""
        with self._reading():
            found = self._db.execute(
                "SELECT number, flags FROM attempt a WHERE flags LIKE ?"
                " AND attempt = (SELECT MAX(attempt) FROM attempt b WHERE b.number = a.number)",
                (f"%{SKIPPED}%",),
            )
            return {
                number for number, flags in found if number not in self.chain.without_values and SKIPPED in json.loads(flags)
            }

    def _skipped_rows(self) -> list[tuple[str, float]]:
        """Sample and estimated duration of the planned rows that were skipped and not measured since, in their order."""
        rows = (
            self._db.execute("SELECT sample, seconds FROM plan WHERE session IS NULL AND number = ?", (number,)).fetchall()
            for number in sorted(self._last_skipped())
        )
        with self._reading():
            return [(sample, seconds) for found in rows for sample, seconds in found]

    def event_texts(self, kind: str) -> list[str]:
        """Texts of the events of one kind, in order of time, without duplicates."""
        with self._reading():
            found = self._db.execute("SELECT text FROM event WHERE kind = ? ORDER BY id", (kind,))
            return list(dict.fromkeys(str(text) for (text,) in found))

    def sample_records(self) -> dict[str, SampleMetadataTable]:
        """What operators have stated of samples as they mounted them, by sample; of each key what was stated last.

        Who has mounted a sample belongs to the last mounting alone.
        """
        found: dict[str, SampleMetadataTable] = {}
        with self._reading():
            for (text,) in self._db.execute("SELECT text FROM event WHERE kind = ? ORDER BY id", (MOUNTED,)):
                sample, record = read_mounting(text, str(self.path))
                before = found[sample].given if sample in found else {}
                before.pop("mounted_by", None)
                found[sample] = SampleMetadataTable(**before).updated(record)
        return found

    def events(self) -> list[tuple[float, str, str]]:
        """Time on the rig's clock, kind and text of the events of the last session, in order of time."""
        with self._reading():
            found = self._db.execute(
                "SELECT t_s, kind, text FROM event WHERE session = (SELECT MAX(id) FROM session) ORDER BY id DESC LIMIT ?",
                (MOST_EVENTS,),
            )
            return [(float(t), str(kind), str(text)) for t, kind, text in found][::-1]

    def last_of(self, kind: RowKind) -> tuple[str, float] | None:
        """Identity of the last row of a kind that was executed, and its end on the rig's clock; None where there is none."""
        with self._reading():
            found = self._db.execute(
                "SELECT identity, ended_s FROM plan JOIN attempt USING (number) WHERE kind = ? ORDER BY ended_s DESC LIMIT 1",
                (kind,),
            ).fetchone()
            return None if found is None else (str(found[0]), float(found[1]))

    def open_orders(self) -> list[str]:
        """Texts of the safety orders of the last session that are not acknowledged, in order of time.

        Beyond MOST_ORDERS it is their number: a journal of unknown origin may have a million, which would hide those of others.
        """
        with self._reading():
            found = self._db.execute(
                "SELECT kind, text, session = (SELECT MAX(id) FROM session) FROM event"
                " WHERE kind IN ('order', 'acknowledged') ORDER BY id"
            )
            orders: dict[str, None] = {}
            for kind, text, last in found:
                if kind == "acknowledged":
                    orders.pop(str(text), None)
                elif last:
                    orders[str(text)] = None
            more = len(orders) - MOST_ORDERS
            return [*itertools.islice(orders, MOST_ORDERS), *([f"and {more} more orders"] if more > 0 else [])]

    def last_number(self) -> int:
        """Highest row number, unplanned rows included."""
        with self._reading():
            return int(self._db.execute("SELECT MAX(number) FROM plan").fetchone()[0])

    def rows(self, *kinds: RowKind) -> Iterator[CommittedRow]:
        """Committed rows, of all kinds or of some, in order of their start; each with its last attempt."""
        with self._reading():
            chosen = f"AND kind IN ({', '.join('?' * len(kinds))})" if kinds else ""
            yield from self._rows(f"{LAST_ATTEMPT}{self._sound} {chosen} ORDER BY started_s, p.number", kinds, PLAN_FIRST)

    def rows_of(self, numbers: Iterable[int]) -> Iterator[CommittedRow]:
        """Committed rows by their numbers, in that order; each with its last attempt."""
        with self._reading():
            for number in numbers:
                yield from self._rows(f"{LAST_ATTEMPT}{self._sound} AND p.number = ?", (number,))

    def recorded(self, numbers: Iterable[int], at_once: int = ASKED_AT_ONCE) -> Iterator[RecordedRows]:
        """The readings of committed rows by their numbers, in that order, of the last attempts; so many rows at once."""
        left = iter(numbers)
        statement = READINGS_OF.format(f"p.number IN ({', '.join('?' * at_once)}){self._sound}")
        while asked := list(itertools.islice(left, at_once)):
            with self._reading():
                # One statement for any number of rows is prepared once.
                found = self._db.execute(statement, asked + [NO_ROW] * (at_once - len(asked))).fetchall()
                rows = _recorded_rows([columns_of_readings(found)] if found else [])
            yield rows.of(np.array(asked, dtype=np.int64))

    def all_recorded(self, most_bytes: int, *kinds: RowKind) -> RecordedRows | None:
        """The readings of all committed rows of some kinds, in the order of their numbers; None where they take more memory."""
        left, parts = most_bytes, []
        of_kinds = f"(SELECT kind FROM plan q WHERE q.number = p.number) IN ({', '.join('?' * len(kinds))})"
        with self._reading():
            found = self._db.execute(READINGS_OF.format(f"{of_kinds}{self._sound}"), kinds)
            while block := found.fetchmany(self.sizes.recorded):
                parts.append(columns_of_readings(block))
                left -= sum(each.nbytes for each in parts[-1])
                if left < 0:
                    return None
            return _recorded_rows(parts)

    def row_numbers(self, *kinds: RowKind) -> Ints:
        """The numbers (n,) of the committed rows of some kinds, in order of their start."""
        with self._reading():
            chosen = f"AND kind IN ({', '.join('?' * len(kinds))})"
            found = self._db.execute(
                f"SELECT p.number, started_s FROM plan p {PLAN_FIRST} attempt a USING (number) {LAST_ATTEMPT}{self._sound}"
                f" {chosen}",
                kinds,
            )
            rows = np.fromiter(found, dtype=NUMBER_AND_START)
        return np.ascontiguousarray(rows["number"][np.lexsort([rows["number"], rows["started_s"]])])

    def drift_row_numbers(self) -> list[int]:
        """Numbers of the mountings, of the drift checks, and of the measured row before each of these, in order of their start.

        Empty without a drift check.
        """
        read = "EXISTS (SELECT 1 FROM reading r WHERE r.number = p.number AND r.attempt = a.attempt)"
        numbers: list[int] = []
        last: int | None = None
        some = False
        with self._reading():
            if self._db.execute("SELECT 1 FROM plan WHERE kind = 'drift' LIMIT 1").fetchone() is None:
                return []  # without a look at every row
            for number, kind in self._db.execute(
                f"SELECT p.number, kind FROM plan p JOIN attempt a USING (number) {LAST_ATTEMPT}{self._sound}"
                f" AND (kind = 'mount' OR kind IN ('measure', 'drift') AND {read}) ORDER BY started_s, p.number"
            ):
                if kind == "measure":
                    last = number
                else:
                    numbers += [number] if last is None else [last, number]
                    last, some = None, some or kind == "drift"
        return numbers if some else []

    def rows_between(self, after: int, last: int) -> Iterator[CommittedRow]:
        """The rows of the entries of `attempt` after one and up to another, by their internal numbers, in that order."""
        with self._reading():
            yield from self._rows("WHERE a.rowid > ? AND a.rowid <= ? ORDER BY a.rowid", (after, last))

    def row_index(self) -> tuple[npt.NDArray[np.void], list[str]]:
        """Index (ROW_INDEX) of the measured rows that have readings, in order of their start, and the names of the samples."""
        names: dict[str, int] = {}
        parts, starts = [np.zeros(0, dtype=ROW_INDEX)], [np.zeros(0)]
        with self._reading():
            found = self._db.execute(
                "SELECT p.number, sample, instr(identity, ?) > 0, instr(a.flags, ?) > 0, wavelength_nm, gamma_deg, sigma_deg,"
                f" beta_deg, shift_deg, started_s FROM plan p {PLAN_FIRST} attempt a USING (number) {LAST_ATTEMPT}"
                " AND kind = 'measure'"
                f" AND EXISTS (SELECT 1 FROM reading r WHERE r.number = p.number AND r.attempt = a.attempt){self._sound}",
                (MIRRORED_MARK, CONTRADICTION),
            )
            while block := found.fetchmany(self.sizes.recorded):
                number, sample, *columns, started = zip(*block, strict=True)
                part = np.empty(len(block), dtype=ROW_INDEX)
                codes = [names.setdefault(each, len(names)) for each in sample]
                for name, column in zip(ROW_INDEX.names or (), (number, codes, *columns), strict=True):
                    part[name] = column
                parts.append(part)
                starts.append(np.array(started, dtype=np.float64))
        index = np.concatenate(parts)
        order = np.lexsort([index["number"], np.concatenate(starts)])
        return index[order], list(names)

    def executed_rows(self) -> Iterator[ExecutedRow]:
        """All rows that were executed, damaged ones too, in order of their start."""
        with self._reading():
            for number, kind, sample, session, *pose in self._db.execute(
                "SELECT p.number, kind, sample, a.session, gamma_deg, sigma_deg, beta_deg, shift_deg"
                f" FROM plan p JOIN attempt a USING (number) {LAST_ATTEMPT} ORDER BY started_s, p.number"
            ):
                yield ExecutedRow(number, kind, sample, session, None if None in pose else tuple(pose))

    @contextlib.contextmanager
    def _reading(self) -> Iterator[None]:
        with report_damage(self.path):
            yield

    def _rows(self, which: str, values: Sequence[Any], join: str = "JOIN") -> Iterator[CommittedRow]:
        found = self._db.execute(
            f"SELECT {ROW_COLUMNS}, attempt, started_s, ended_s, positions, flags"
            f" FROM plan p {join} attempt a USING (number) {which}",
            values,
        )
        for columns in found:
            row = _row(*columns[: len(PlanEntry._fields)])
            attempt, started, ended, positions, flags = columns[len(PlanEntry._fields) :]
            readings = tuple(self._readings(row.number, attempt))
            degrees = None if positions is None else json.loads(positions)
            yield CommittedRow(row, RowData(started, ended, degrees, readings, tuple(json.loads(flags))))

    def _readings(self, number: int, attempt: int) -> Iterator[Reading]:
        for *about, readings, channels, counts in self._db.execute(
            "SELECT gain_v_per_a, first_s, period_s, monitor_a, readings, channels, counts FROM reading"
            " WHERE number = ? AND attempt = ? ORDER BY gain_v_per_a",
            (number, attempt),
        ):
            gain, first, period, monitor = about
            yield Reading(gain, first, period, monitor, np.frombuffer(counts, dtype="<u2").reshape(readings, channels))


def open_read_only(path: Path) -> sqlite3.Connection:
    """Open a database without changing the file. Raises sqlite3.Error, OSError, and UserError for what is strange beside it.

    After a killed program or a power failure SQLite may have to recover the database before it can be read; in a read-only
    folder it may be unable to make its auxiliary files. Then a recovered copy in memory is opened.
    """
    # A connection that may not write leaves the auxiliary files that it makes. One that may takes them away, and writes nothing
    # into a database that is whole in its one file.
    file = Path(os.path.realpath(path))
    _check_beside(file)
    whole = not any(Path(f"{file}{suffix}").exists() for suffix in ("-wal", "-journal"))
    db = sqlite3.connect(f"{file.as_uri()}?mode={'rw' if whole else 'ro'}", uri=True, check_same_thread=False)
    try:
        distrust(db)
        db.execute("PRAGMA user_version")
    except sqlite3.OperationalError as error:
        db.close()
        if error.sqlite_errorcode & 0xFF not in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN):
            raise
        return _recovered_copy(file)
    return db


def _check_beside(file: Path) -> None:
    """Raise UserError for a file beside a journal for which SQLite would wait, or which makes it delete another file.

    A journal of unknown origin may come with such files. A rollback journal has each page of the database at most once.
    """
    for suffix in ("-wal", "-shm", "-journal"):
        beside = Path(f"{file}{suffix}")
        try:
            status = beside.lstat()
        except OSError:  # there is none
            continue
        if not stat.S_ISREG(status.st_mode):
            wrong = "is a link, a folder or a device"
        elif suffix == "-journal" and status.st_size > 2 * file.stat().st_size + MOST_BESIDE // 1000:
            wrong = f"has {status.st_size} bytes, more than the journal explains"
        elif suffix == "-journal" and _last_bytes(beside, len(SUPER_JOURNAL)) == SUPER_JOURNAL:
            wrong = "names another file, which would be deleted"
        else:
            continue
        raise UserError(f"{beside}: {wrong}; no version of goniotwin makes such a file: remove it, and beware of its origin")


def _last_bytes(file: Path, count: int) -> bytes:
    with file.open("rb") as content:
        content.seek(max(0, content.seek(0, os.SEEK_END) - count))
        return content.read(count)


def _recovered_copy(path: Path) -> sqlite3.Connection:
    beside = [Path(f"{path}{suffix}") for suffix in ("-wal", "-journal")]
    if sum(each.stat().st_size for each in beside if each.exists()) > MOST_BESIDE:
        raise UserError(f"{path}: {beside[0].name} is too large to be read here; copy all its files to a folder of your own")
    with tempfile.TemporaryDirectory() as folder:
        spare = Path(folder) / path.name
        for suffix in ("", "-wal", "-journal"):
            with contextlib.suppress(FileNotFoundError):
                shutil.copyfile(f"{path}{suffix}", f"{spare}{suffix}")
        with contextlib.closing(sqlite3.connect(spare)) as source:
            distrust(source)
            copy = sqlite3.connect(":memory:", check_same_thread=False)
            try:
                source.backup(copy)
                distrust(copy)
            except sqlite3.Error:
                copy.close()
                raise
    return copy


def distrust(db: sqlite3.Connection) -> None:
    """Set what a database that may come of unknown origin must not do. Raises sqlite3.Error."""
    db.execute("PRAGMA trusted_schema = OFF")
    db.execute("PRAGMA cell_size_check = ON")
    for limit, most in LIMITS.items():
        db.setlimit(limit, most)


@contextlib.contextmanager
def bound_steps(db: sqlite3.Connection, path: Path) -> Iterator[None]:
    """Interrupt what takes more steps than the size of a journal explains. Raises sqlite3.OperationalError."""
    size = sum(each.stat().st_size for each in (path, Path(f"{path}-wal")) if each.exists())
    left = itertools.count((LEAST_STEPS + STEPS_PER_BYTE * size) // STEPS_TOGETHER, -1)
    db.set_progress_handler(lambda: next(left) < 0, STEPS_TOGETHER)
    try:
        yield
    finally:
        db.set_progress_handler(None, 0)


@contextlib.contextmanager
def report_damage(path: Path) -> Iterator[None]:
    """Convert errors of the database and of the stored values into DamagedJournal."""
    try:
        yield
    except (sqlite3.Error, ValueError, TypeError, LookupError, AttributeError, RecursionError, OverflowError) as error:
        line, *more = str(error).splitlines() or [type(error).__name__]
        raise DamagedJournal(f"{path}: is damaged: {line}{' ...' if more else ''}; {USE_A_COPY}") from None


def columns_of_readings(found: Sequence[tuple[Any, ...]]) -> tuple[Ints, Floats, Ints, Counts]:
    """Entries of READINGS_OF, in columns: numbers (n,), times and currents (n, 5), shapes (n, 2), and all counts.

    A row without a reading has an entry with the shape 0, 0. Raises ValueError for counts that have not the stated shape.
    """
    number, *numbers, readings, channels, counts = zip(*found, strict=True)
    if None in counts:
        readings, channels = (tuple(each or 0 for each in column) for column in (readings, channels))
        counts = tuple(each or b"" for each in counts)
    shapes = np.array((readings, channels), dtype=np.int64)
    sizes = np.fromiter(map(len, counts), dtype=np.int64, count=len(counts))
    wrong = (2.0 * shapes[0] * shapes[1] != sizes) | (shapes < 0).any(axis=0)  # of floats, which do not overflow
    for k in np.flatnonzero(wrong)[:1].tolist():
        raise ValueError(
            f"row {number[k]} has {sizes[k]} bytes of counts, for {readings[k]} readings of {channels[k]} photodiodes"
        )
    raw = np.frombuffer(b"".join(counts), dtype="<u2")
    return np.array(number, dtype=np.int64), np.array(numbers, dtype=np.float64).T, shapes.T, raw


def _recorded_rows(parts: Sequence[tuple[Ints, Floats, Ints, Counts]]) -> RecordedRows:
    """Rows with their readings, of the columns of all of them, which are in the order of the rows' numbers."""
    if not parts:
        parts = [
            (np.zeros(0, dtype=np.int64), np.zeros((0, 5)), np.zeros((0, 2), dtype=np.int64), np.zeros(0, dtype=np.uint16))
        ]
    number, numbers, shapes, counts = (np.concatenate(each) for each in zip(*parts, strict=True))
    first = np.flatnonzero(np.diff(number, prepend=NO_ROW - 1))
    row = np.repeat(np.arange(first.size), np.diff(first, append=number.size))
    read = ~np.isnan(numbers[:, 1])  # of a row without readings the gain is NULL
    table = table_of_columns(first.size, row[read], numbers[read, 1:].T, shapes[read], counts)
    return RecordedRows(number[first], numbers[first, 0], table)


def _session(number: int, started: float, ended: float, outcome: str | None, *about: Any) -> Session:
    if outcome not in OUTCOMES:
        raise ValueError(f"session {number} has the outcome {ascii(outcome)[:40]}")
    wall_started, wall_ended, versions = about
    return Session(number, started, ended, outcome, wall_started, wall_ended, json.loads(versions))


def _row(*columns: Any) -> Row:
    entry = PlanEntry(*columns)
    details = {key: value for key, value in json.loads(entry.detail).items() if key in DETAIL_KEYS}
    details["gains"] = tuple(details["gains"])
    pose = None if entry.sigma_deg is None else (entry.gamma_deg, entry.sigma_deg, entry.beta_deg, entry.shift_deg)
    return Row(entry.number, entry.identity, entry.kind, entry.sample, entry.seconds, entry.wavelength_nm, pose, **details)
