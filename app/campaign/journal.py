"""The journal: one SQLite file a campaign, one transaction a row. Crash journal, resume pointer and archive.

It holds the schedule and the rig as they were, and raw counts; everything else can be derived from it again. The schema
is described in docs/journal.md.
"""

import contextlib
import json
import sqlite3
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

import numpy as np
import numpy.typing as npt

from app.campaign.plan import Plan
from app.campaign.row import Row
from app.errors import UserError
from protocols.clock import calendar_stamp

SCHEMA_VERSION = 1
APPLICATION_ID = 0x474F4E49  # "GONI"
SCHEMA = """
CREATE TABLE campaign (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;
CREATE TABLE plan (
    number INTEGER PRIMARY KEY, identity TEXT NOT NULL UNIQUE, kind TEXT NOT NULL, sample TEXT NOT NULL,
    wavelength_nm REAL, gamma_deg REAL, sigma_deg REAL, beta_deg REAL, shift_deg REAL, seconds REAL NOT NULL
) STRICT;
CREATE TABLE attempt (
    number INTEGER NOT NULL REFERENCES plan, attempt INTEGER NOT NULL, started_s REAL NOT NULL, ended_s REAL NOT NULL,
    positions TEXT, flags TEXT NOT NULL, PRIMARY KEY (number, attempt)
) STRICT;
CREATE TABLE reading (
    number INTEGER NOT NULL, attempt INTEGER NOT NULL, gain_v_per_a REAL NOT NULL, first_s REAL NOT NULL,
    period_s REAL NOT NULL, monitor_a REAL NOT NULL, readings INTEGER NOT NULL, channels INTEGER NOT NULL,
    counts BLOB NOT NULL, PRIMARY KEY (number, attempt, gain_v_per_a),
    FOREIGN KEY (number, attempt) REFERENCES attempt
) STRICT;
CREATE TABLE event (id INTEGER PRIMARY KEY, t_s REAL NOT NULL, kind TEXT NOT NULL, text TEXT NOT NULL) STRICT;
CREATE TABLE session (
    id INTEGER PRIMARY KEY, started_s REAL NOT NULL, ended_s REAL, outcome TEXT, wall_started TEXT NOT NULL, wall_ended TEXT
) STRICT;
"""

Counts = npt.NDArray[np.uint16]


class JournalError(Exception):
    """The journal cannot be written any more; what it acknowledged before is safe."""


@dataclass(frozen=True)
class Reading:
    """All photodiodes at one gain: raw `counts` (readings, photodiodes), the monitor's mean current meanwhile."""

    gain_v_per_a: float
    first_s: float
    period_s: float
    monitor_a: float
    counts: Counts


@dataclass(frozen=True)
class RowData:
    """What a row came to: times on the rig's clock, read-back positions and encoders in degrees, readings by gain."""

    started_s: float
    ended_s: float
    positions: dict[str, float | None] | None
    readings: tuple[Reading, ...]
    flags: tuple[str, ...] = ()


@dataclass(frozen=True)
class Committed:
    """A row of a journal with what it came to."""

    row: Row
    data: RowData


class Journal:
    """An open journal. What `commit` has returned from is on the disk."""

    def __init__(self, connection: sqlite3.Connection, path: Path) -> None:
        self._db = connection
        self.path = path

    @classmethod
    def create(cls, path: Path, plan: Plan, versions: dict[str, str]) -> "Journal":
        """A new journal for a plan. Raises UserError where there is a file already, or none can be written."""
        if path.exists():
            raise UserError(f"{path}: is there already, and no journal is ever overwritten; choose another name")
        if not path.parent.is_dir():
            raise UserError(f"{path}: there is no folder {path.parent}; make it first")
        db: sqlite3.Connection | None = None
        try:
            db = _connect(path)
            db.execute(f"PRAGMA application_id = {APPLICATION_ID}")
            db.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
            with db:
                for statement in SCHEMA.split(";"):
                    db.execute(statement)
            journal = cls(db, path)
            journal._describe(plan, versions)
        except sqlite3.Error as error:
            if db is not None:
                db.close()
            for leftover in (path, Path(f"{path}-wal"), Path(f"{path}-shm")):
                leftover.unlink(missing_ok=True)
            raise UserError(f"{path}: cannot be written: {error}; check folder and disk") from None
        return journal

    @classmethod
    def open(cls, path: Path) -> "Journal":
        """A journal that is there already, for reading. Raises UserError for a file that is none."""
        if not path.is_file():
            raise UserError(f"{path}: there is no such journal; check the name")
        try:
            db = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, check_same_thread=False)
            found = db.execute("PRAGMA application_id").fetchone()[0]
            version = db.execute("PRAGMA user_version").fetchone()[0]
        except sqlite3.Error as error:
            raise UserError(f"{path}: is not a journal: {error}; is it the right file?") from None
        if found != APPLICATION_ID:
            db.close()
            raise UserError(f"{path}: is an SQLite file, but not a journal of goniotwin; is it the right file?")
        if version > SCHEMA_VERSION:
            db.close()
            raise UserError(f"{path}: has schema {version}, newer than {SCHEMA_VERSION}; use a newer goniotwin")
        return cls(db, path)

    def close(self) -> None:
        """Ends it; a journal that was written is then one file, to be read from any medium."""
        with contextlib.suppress(sqlite3.Error):
            self._db.execute("PRAGMA journal_mode = DELETE")
        self._db.close()

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def begin_session(self, t: float) -> int:
        """A program begins to work on the campaign; returns the session's number."""
        with self._writing():
            cursor = self._db.execute("INSERT INTO session (started_s, wall_started) VALUES (?, ?)", (t, calendar_stamp()))
        return int(cursor.lastrowid or 0)

    def end_session(self, session: int, t: float, outcome: str) -> None:
        """It ends, with `outcome`: done, stopped or failed."""
        with self._writing():
            self._db.execute(
                "UPDATE session SET ended_s = ?, outcome = ?, wall_ended = ? WHERE id = ?",
                (t, outcome, calendar_stamp(), session),
            )

    def event(self, t: float, kind: str, text: str) -> None:
        """Something that is to be known later."""
        with self._writing():
            self._db.execute("INSERT INTO event (t_s, kind, text) VALUES (?, ?, ?)", (t, kind, text))

    def faults(self) -> list[str]:
        """The faults that were met, in order."""
        return [str(text) for (text,) in self._db.execute("SELECT text FROM event WHERE kind = 'fault' ORDER BY id")]

    def commit(self, row: Row, data: RowData) -> None:
        """One row, whole or not at all; on the disk when this returns. Raises JournalError."""
        positions = None if data.positions is None else json.dumps(data.positions)
        with self._writing():
            (attempt,) = self._db.execute(
                "SELECT COALESCE(MAX(attempt), 0) + 1 FROM attempt WHERE number = ?", (row.number,)
            ).fetchone()
            self._db.execute(
                "INSERT INTO attempt VALUES (?, ?, ?, ?, ?, ?)",
                (row.number, attempt, data.started_s, data.ended_s, positions, json.dumps(data.flags)),
            )
            self._db.executemany(
                "INSERT INTO reading VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
                [
                    (row.number, attempt, each.gain_v_per_a, each.first_s, each.period_s, each.monitor_a,
                     *each.counts.shape, each.counts.astype("<u2").tobytes())
                    for each in data.readings
                ],
            )  # fmt: skip

    @contextlib.contextmanager
    def _writing(self) -> Iterator[None]:
        """One transaction."""
        try:
            with self._db:
                yield
        except sqlite3.Error as error:
            raise JournalError(f"{self.path}: cannot be written: {error}; make room on the disk") from None

    def value(self, key: str) -> str:
        """An entry of the campaign's table: schedule, rig, name, simulated, seed, model, versions. Raises UserError."""
        with self._reading():
            found = self._db.execute("SELECT value FROM campaign WHERE key = ?", (key,)).fetchone()
        if found is None:
            raise UserError(f"{self.path}: says nothing of its {key}; it was cut off when it was made")
        return str(found[0])

    @property
    def simulated(self) -> bool:
        """Whether nothing in it is real."""
        return self.value("simulated") == "true"

    @property
    def seconds(self) -> float:
        """How long the campaign took on the rig's clock, all sessions together."""
        found = self._db.execute("SELECT COALESCE(SUM(ended_s - started_s), 0.0) FROM session").fetchone()
        return float(found[0])

    def counted(self) -> tuple[int, int]:
        """How many rows are committed, and how many are planned."""
        done = self._db.execute("SELECT COUNT(DISTINCT number) FROM attempt").fetchone()[0]
        return int(done), int(self._db.execute("SELECT COUNT(*) FROM plan").fetchone()[0])

    def rows(self) -> Iterator[Committed]:
        """The committed rows in the plan's order, each by its last attempt. Raises UserError where it is damaged."""
        with self._reading():
            yield from self._rows()

    @contextlib.contextmanager
    def _reading(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.Error, ValueError, TypeError) as error:
            raise UserError(f"{self.path}: is damaged: {error}; use a copy of it, if there is one") from None

    def _rows(self) -> Iterator[Committed]:
        found = self._db.execute(
            "SELECT p.number, identity, kind, sample, wavelength_nm, gamma_deg, sigma_deg, beta_deg, shift_deg,"
            " seconds, attempt, started_s, ended_s, positions, flags FROM plan p JOIN attempt a USING (number)"
            " WHERE attempt = (SELECT MAX(attempt) FROM attempt b WHERE b.number = p.number) ORDER BY p.number"
        )
        for number, identity, kind, sample, wavelength, *rest in found:
            gamma, sigma, beta, shift, seconds, attempt, started, ended, positions, flags = rest
            pose = None if sigma is None else (gamma, sigma, beta, shift)
            row = Row(number, identity, kind, sample, seconds, wavelength, pose)
            readings = tuple(self._readings(number, attempt))
            where = None if positions is None else json.loads(positions)
            yield Committed(row, RowData(started, ended, where, readings, tuple(json.loads(flags))))

    def _readings(self, number: int, attempt: int) -> Iterator[Reading]:
        for gain, first, period, monitor, readings, channels, counts in self._db.execute(
            "SELECT gain_v_per_a, first_s, period_s, monitor_a, readings, channels, counts FROM reading"
            " WHERE number = ? AND attempt = ? ORDER BY gain_v_per_a",
            (number, attempt),
        ):
            raw = np.frombuffer(counts, dtype="<u2").reshape(readings, channels)
            yield Reading(gain, first, period, monitor, raw)

    def _describe(self, plan: Plan, versions: dict[str, str]) -> None:
        about = {
            "name": plan.schedule.file.name,
            "schedule": plan.schedule.text,
            "rig": plan.rig.text,
            "simulated": json.dumps(plan.rig.simulated),
            "seed": json.dumps(plan.rig.seed),
            "model": json.dumps(plan.rig.model_hash()),
            "versions": json.dumps(versions, sort_keys=True),
        }
        with self._db:
            self._db.executemany("INSERT INTO campaign VALUES (?, ?)", about.items())
            self._db.executemany("INSERT INTO plan VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", map(_planned, plan.rows))


def _connect(path: Path) -> sqlite3.Connection:
    db = sqlite3.connect(path, check_same_thread=False)
    db.execute("PRAGMA journal_mode = WAL")
    db.execute("PRAGMA synchronous = FULL")
    db.execute("PRAGMA foreign_keys = ON")
    return db


def _planned(row: Row) -> Sequence[object]:
    pose = row.pose if row.pose is not None else (None, None, None, None)
    return (row.number, row.identity, row.kind, row.sample, row.wavelength_nm, *pose, row.seconds)
