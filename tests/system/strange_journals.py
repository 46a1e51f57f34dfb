"""A journal of an older version, and changes of it that no version makes."""

import shutil
import sqlite3
from pathlib import Path

from tests.conftest import REPOSITORY

OLD_JOURNAL = REPOSITORY / "tests" / "golden" / "data" / "finished.journal"


ANOTHER_TEXT = (
    "PRAGMA writable_schema = ON; UPDATE sqlite_schema SET sql = replace(sql, 'gamma_deg REAL', 'gamma_deg REAL CHECK (1)');"
)


STRANGE_SCHEMAS = {
    "trigger": "CREATE TRIGGER strange AFTER UPDATE ON session BEGIN DELETE FROM reading; END;",
    "view": "CREATE VIEW strange AS SELECT * FROM plan;",
    "view in place of a table": "DROP TABLE event; CREATE VIEW event AS SELECT 1 AS id, 'x' AS text, 'fault' AS kind;",
    "table": "CREATE TABLE strange (x);",
    "index": "CREATE INDEX strange ON plan (abs(seconds));",
    "virtual table": "CREATE VIRTUAL TABLE strange USING fts5(x);",
    "column": "ALTER TABLE plan ADD COLUMN strange TEXT;",
    "generated column": "ALTER TABLE plan ADD COLUMN strange TEXT AS (identity || kind) VIRTUAL;",
    "other text": ANOTHER_TEXT,
    "no table": "DROP TABLE reading;",
    "statistics": "ANALYZE;",
}


def changed_journal(path: Path, statements: str) -> Path:
    """A copy of an old journal, changed as a stranger can."""
    shutil.copyfile(OLD_JOURNAL, path)
    database = sqlite3.connect(path)
    database.executescript(statements)
    database.close()
    return path
