"""What a journal says: of itself, of its sessions, of its rows.

Which rows of a journal were measured, and where: a few bytes a row, however many there are.
"""

import contextlib
import json
import shutil
import sqlite3
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from goniotwin.app.campaign.journal.record import CommittedRow, Reading, RowData
from goniotwin.app.campaign.row import MIRRORED_MARK, SKIPPED, Row, RowKind
from goniotwin.app.errors import UserError

ROW_INDEX = np.dtype(
    [
        ("number", np.int64),
        ("sample", np.int32),
        ("mirrored", np.bool_),
        ("wavelength_nm", np.float64),
        ("gamma_deg", np.float64),
        ("sigma_deg", np.float64),
        ("beta_deg", np.float64),
        ("shift_deg", np.float64),
    ]
)
"""One row; `sample` is the place of its name in a list that stands beside."""


def measured_rows(db: sqlite3.Connection) -> tuple[npt.NDArray[np.void], list[str]]:
    """CommittedRow rows of measurements that have readings, by their last attempt, in order of time; and the samples' names.

    Raises sqlite3.Error and ValueError for a damaged journal.
    """
    names: dict[str, int] = {}
    found = db.execute(
        "SELECT p.number, sample, instr(identity, ?) > 0, wavelength_nm, gamma_deg, sigma_deg, beta_deg, shift_deg"
        " FROM plan p JOIN attempt a USING (number) WHERE kind = 'measure'"
        " AND attempt = (SELECT MAX(attempt) FROM attempt b WHERE b.number = p.number)"
        " AND EXISTS (SELECT 1 FROM reading r WHERE r.number = p.number AND r.attempt = a.attempt)"
        " ORDER BY started_s, p.number",
        (MIRRORED_MARK,),
    )
    rows = ((number, names.setdefault(sample, len(names)), *rest) for number, sample, *rest in found)
    return np.fromiter(rows, dtype=ROW_INDEX), list(names)


ROW_COLUMNS = "p.number, identity, kind, sample, wavelength_nm, gamma_deg, sigma_deg, beta_deg, shift_deg, seconds, detail"
LAST_ATTEMPT = "WHERE attempt = (SELECT MAX(attempt) FROM attempt b WHERE b.number = p.number)"
DETAIL_KEYS = ("gains", "readings", "automatic", "target", "longest_s")
"""What the column `detail` has of a row."""


@dataclass(frozen=True)
class Session:
    """A stretch of work on a campaign by one program. A program that was killed has left no end: `ended_s` is then that of
    the last row which it committed, and `outcome` is None.
    """

    number: int
    started_s: float
    ended_s: float
    outcome: str | None
    wall_started: str
    wall_ended: str | None
    versions: dict[str, str]


class JournalReader:
    """The contents of a journal. Everything raises UserError where it is damaged."""

    def __init__(self, connection: sqlite3.Connection, path: Path) -> None:
        self._db = connection
        self.path = path

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
        return sum(session.ended_s - session.started_s for session in self.sessions())

    def sessions(self) -> list[Session]:
        """In order."""
        with self._reading():
            found = self._db.execute(
                "SELECT id, started_s, COALESCE(ended_s, (SELECT MAX(ended_s) FROM attempt WHERE session = s.id), started_s),"
                " outcome, wall_started, wall_ended, versions FROM session s ORDER BY id"
            )
            return [
                Session(number, begun, ended, outcome, wall_begun, wall_ended, json.loads(versions))
                for number, begun, ended, outcome, wall_begun, wall_ended, versions in found
            ]

    def counted(self) -> tuple[int, int]:
        """How many of the planned rows are done, and how many there are."""
        planned = self._planned_numbers()
        return len(self.committed() & planned), len(planned)

    def planned(self) -> tuple[Row, ...]:
        """The planned rows, without those that sessions have added."""
        with self._reading():
            return tuple(
                _row(*entries)
                for entries in self._db.execute(f"SELECT {ROW_COLUMNS} FROM plan p WHERE session IS NULL ORDER BY number")
            )

    def committed(self) -> set[int]:
        """Numbers of the rows that are done."""
        with self._reading():
            begun = {number for (number,) in self._db.execute("SELECT DISTINCT number FROM attempt")}
        return begun - self._skipped()

    def skipped(self) -> set[int]:
        """Numbers of the planned rows that were left out for a fault, and not done since."""
        return self._skipped() & self._planned_numbers()

    def _skipped(self) -> set[int]:
        with self._reading():
            found = self._db.execute(
                "SELECT number, flags FROM attempt a WHERE flags LIKE ?"
                " AND attempt = (SELECT MAX(attempt) FROM attempt b WHERE b.number = a.number)",
                (f"%{SKIPPED}%",),
            )
            return {number for number, flags in found if SKIPPED in json.loads(flags)}

    def _planned_numbers(self) -> set[int]:
        with self._reading():
            return {number for (number,) in self._db.execute("SELECT number FROM plan WHERE session IS NULL")}

    def told(self, kind: str) -> list[str]:
        """What events of a kind say, in order, each once."""
        with self._reading():
            found = self._db.execute("SELECT text FROM event WHERE kind = ? ORDER BY id", (kind,))
            return list(dict.fromkeys(str(text) for (text,) in found))

    def last_number(self) -> int:
        """Of all rows, added ones too."""
        with self._reading():
            return int(self._db.execute("SELECT MAX(number) FROM plan").fetchone()[0])

    def rows(self, *kinds: RowKind) -> Iterator[CommittedRow]:
        """The committed rows, or those of some kinds, in the order in which they were begun, each by its last attempt."""
        with self._reading():
            chosen = f"AND kind IN ({', '.join('?' * len(kinds))})" if kinds else ""
            yield from self._rows(f"{LAST_ATTEMPT} {chosen} ORDER BY started_s, p.number", kinds)

    def rows_of(self, numbers: Iterable[int]) -> Iterator[CommittedRow]:
        """CommittedRow rows by their numbers, in that order, each by its last attempt."""
        with self._reading():
            for number in numbers:
                yield from self._rows(f"{LAST_ATTEMPT} AND p.number = ?", (number,))

    def measured_rows(self) -> tuple[npt.NDArray[np.void], list[str]]:
        """Which measurements have readings, and where they were made: see `LISTED`; and the names of the samples."""
        with self._reading():
            return measured_rows(self._db)

    @contextlib.contextmanager
    def _reading(self) -> Iterator[None]:
        with report_damage(self.path):
            yield

    def _rows(self, which: str, values: Sequence[Any]) -> Iterator[CommittedRow]:
        found = self._db.execute(
            f"SELECT {ROW_COLUMNS}, attempt, started_s, ended_s, positions, flags"
            f" FROM plan p JOIN attempt a USING (number) {which}",
            values,
        )
        for *planned, attempt, started, ended, positions, flags in found:
            row = _row(*planned)
            readings = tuple(self._readings(row.number, attempt))
            where = None if positions is None else json.loads(positions)
            yield CommittedRow(row, RowData(started, ended, where, readings, tuple(json.loads(flags))))

    def _readings(self, number: int, attempt: int) -> Iterator[Reading]:
        for gain, first, period, monitor, readings, channels, counts in self._db.execute(
            "SELECT gain_v_per_a, first_s, period_s, monitor_a, readings, channels, counts FROM reading"
            " WHERE number = ? AND attempt = ? ORDER BY gain_v_per_a",
            (number, attempt),
        ):
            raw = np.frombuffer(counts, dtype="<u2").reshape(readings, channels)
            yield Reading(gain, first, period, monitor, raw)


def open_read_only(path: Path) -> sqlite3.Connection:
    """A database that stays as it is. Raises sqlite3.Error, OSError.

    Where its program was killed or the power went, SQLite may have to put it in order before it can be read, or needs a file
    beside it where none may be made: then it is done with a copy, in memory.
    """
    db = sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, check_same_thread=False)
    try:
        db.execute("PRAGMA user_version")
    except sqlite3.OperationalError as error:
        db.close()
        if error.sqlite_errorcode & 0xFF not in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN):
            raise
        return _copy_in_order(path)
    return db


def _copy_in_order(path: Path) -> sqlite3.Connection:
    with tempfile.TemporaryDirectory() as folder:
        spare = Path(folder) / path.name
        for suffix in ("", "-wal", "-journal"):
            with contextlib.suppress(FileNotFoundError):
                shutil.copyfile(f"{path}{suffix}", f"{spare}{suffix}")
        with contextlib.closing(sqlite3.connect(spare)) as source:
            copy = sqlite3.connect(":memory:", check_same_thread=False)
            try:
                source.backup(copy)
            except sqlite3.Error:
                copy.close()
                raise
    return copy


@contextlib.contextmanager
def report_damage(path: Path) -> Iterator[None]:
    """Says of what goes wrong inside that the journal is damaged. Raises UserError."""
    try:
        yield
    except (sqlite3.Error, ValueError, TypeError, KeyError) as error:
        told, *more = str(error).splitlines() or [type(error).__name__]
        raise UserError(f"{path}: is damaged: {told}{' ...' if more else ''}; use a copy of it, if there is one") from None


def _row(*columns: Any) -> Row:
    number, identity, kind, sample, wavelength, gamma, sigma, beta, shift, seconds, detail = columns
    told = {key: value for key, value in json.loads(detail).items() if key in DETAIL_KEYS}
    told["gains"] = tuple(told["gains"])
    pose = None if sigma is None else (gamma, sigma, beta, shift)
    return Row(number, identity, kind, sample, seconds, wavelength, pose, **told)
