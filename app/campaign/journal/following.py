"""A journal that another program writes, read in short queries. Each opens and closes it: a reader that stays would keep the
writer from making the journal one file at its end.
"""

import contextlib
import sqlite3
from collections.abc import Iterator
from pathlib import Path

from goniotwin.app.campaign.journal.chain import Chain
from goniotwin.app.campaign.journal.reading import JournalReader, open_read_only, report_damage
from goniotwin.app.campaign.row import CommittedRow

MOST_ROWS = 200
"""Rows of one query."""


class JournalFollower:
    """The rows of a journal as they are committed. Its chain of hashes is not checked: its writer is this user's station."""

    def __init__(self, path: Path, most_rows: int = MOST_ROWS) -> None:
        self.path, self._most_rows = path, most_rows
        self._last = 0

    @contextlib.contextmanager
    def reading(self) -> Iterator[JournalReader]:
        """The journal, for one short query. Raises UserError, OSError."""
        with report_damage(self.path), contextlib.closing(open_read_only(self.path)) as db:
            yield JournalReader(db, self.path, Chain())

    def new_rows(self) -> Iterator[CommittedRow]:
        """The rows that were committed since the last call, in that order. Raises UserError, OSError."""
        while rows := self._next_rows():
            yield from rows

    def _next_rows(self) -> list[CommittedRow]:
        with report_damage(self.path), contextlib.closing(open_read_only(self.path)) as db:
            newest = self._newest(db)
            if newest is None:
                return []
            first, self._last = self._last, newest
            reader = JournalReader(db, self.path, Chain())
            return list(reader.rows_between(first, newest))

    def _newest(self, db: sqlite3.Connection) -> int | None:
        """The last entry of the next rows; None if there are no more."""
        found = db.execute(
            "SELECT MAX(entry), COUNT(*) FROM (SELECT rowid AS entry FROM attempt WHERE rowid > ? ORDER BY rowid LIMIT ?)",
            (self._last, self._most_rows),
        ).fetchone()
        return int(found[0]) if found[1] else None
