"""Tables of the journal, and the migration of journals with an older schema. docs/exchange/journal.md describes the tables."""

import contextlib
import json
import sqlite3
import tomllib
from collections.abc import Callable
from functools import cache

from goniotwin.app.campaign.journal.chain import begin_chain

SCHEMA_VERSION = 3
APPLICATION_ID = 0x474F4E49  # "GONI"
MOST_ENTRIES = 100
CAMPAIGN = "CREATE TABLE campaign (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT"
SESSION = """CREATE TABLE session (
    id INTEGER PRIMARY KEY, started_s REAL NOT NULL, ended_s REAL, outcome TEXT, wall_started TEXT NOT NULL, wall_ended TEXT,
    rig TEXT NOT NULL, versions TEXT NOT NULL, first_link INTEGER, last_link INTEGER, tip TEXT, sha256 TEXT
) STRICT"""
PLAN = """CREATE TABLE plan (
    number INTEGER PRIMARY KEY, identity TEXT NOT NULL UNIQUE, kind TEXT NOT NULL, sample TEXT NOT NULL,
    wavelength_nm REAL, gamma_deg REAL, sigma_deg REAL, beta_deg REAL, shift_deg REAL, seconds REAL NOT NULL,
    detail TEXT NOT NULL, session INTEGER REFERENCES session
) STRICT"""
ATTEMPT = """CREATE TABLE attempt (
    number INTEGER NOT NULL REFERENCES plan, attempt INTEGER NOT NULL, session INTEGER NOT NULL REFERENCES session,
    started_s REAL NOT NULL, ended_s REAL NOT NULL, positions TEXT, flags TEXT NOT NULL, PRIMARY KEY (number, attempt)
) STRICT"""
READING = """CREATE TABLE reading (
    number INTEGER NOT NULL, attempt INTEGER NOT NULL, gain_v_per_a REAL NOT NULL, first_s REAL NOT NULL,
    period_s REAL NOT NULL, monitor_a REAL NOT NULL, readings INTEGER NOT NULL, channels INTEGER NOT NULL,
    counts BLOB NOT NULL, PRIMARY KEY (number, attempt, gain_v_per_a),
    FOREIGN KEY (number, attempt) REFERENCES attempt
) STRICT"""
EVENT = """CREATE TABLE event (
    id INTEGER PRIMARY KEY, session INTEGER REFERENCES session, t_s REAL NOT NULL, kind TEXT NOT NULL, text TEXT NOT NULL
) STRICT"""
CHAIN = """CREATE TABLE chain (
    link INTEGER PRIMARY KEY, number INTEGER NOT NULL, attempt INTEGER NOT NULL, sha256 TEXT NOT NULL
) STRICT"""
SESSION_2 = """CREATE TABLE session (
    id INTEGER PRIMARY KEY, started_s REAL NOT NULL, ended_s REAL, outcome TEXT, wall_started TEXT NOT NULL, wall_ended TEXT,
    rig TEXT NOT NULL, versions TEXT NOT NULL
) STRICT"""
SESSION_1 = """CREATE TABLE session (
    id INTEGER PRIMARY KEY, started_s REAL NOT NULL, ended_s REAL, outcome TEXT, wall_started TEXT NOT NULL, wall_ended TEXT
) STRICT"""
PLAN_1 = """CREATE TABLE plan (
    number INTEGER PRIMARY KEY, identity TEXT NOT NULL UNIQUE, kind TEXT NOT NULL, sample TEXT NOT NULL,
    wavelength_nm REAL, gamma_deg REAL, sigma_deg REAL, beta_deg REAL, shift_deg REAL, seconds REAL NOT NULL
) STRICT"""
ATTEMPT_1 = """CREATE TABLE attempt (
    number INTEGER NOT NULL REFERENCES plan, attempt INTEGER NOT NULL, started_s REAL NOT NULL, ended_s REAL NOT NULL,
    positions TEXT, flags TEXT NOT NULL, PRIMARY KEY (number, attempt)
) STRICT"""
EVENT_1 = "CREATE TABLE event (id INTEGER PRIMARY KEY, t_s REAL NOT NULL, kind TEXT NOT NULL, text TEXT NOT NULL) STRICT"
CREATED = {
    1: (CAMPAIGN, PLAN_1, ATTEMPT_1, READING, EVENT_1, SESSION_1),
    2: (CAMPAIGN, SESSION_2, PLAN, ATTEMPT, READING, EVENT),
    3: (CAMPAIGN, SESSION, PLAN, ATTEMPT, READING, EVENT, CHAIN),
}
"""By schema version, the statements that make an empty journal. Those of older versions stay, to compare journals with."""
ALTERED = {
    1: (
        "ALTER TABLE session ADD COLUMN rig TEXT NOT NULL DEFAULT ''",
        "ALTER TABLE session ADD COLUMN versions TEXT NOT NULL DEFAULT ''",
        "ALTER TABLE plan ADD COLUMN detail TEXT NOT NULL DEFAULT ''",
        "ALTER TABLE plan ADD COLUMN session INTEGER REFERENCES session",
        "ALTER TABLE attempt ADD COLUMN session INTEGER NOT NULL DEFAULT 1 REFERENCES session",
        "ALTER TABLE event ADD COLUMN session INTEGER REFERENCES session",
    ),
    2: (
        *(f"ALTER TABLE session ADD COLUMN {each}" for each in ("first_link INTEGER", "last_link INTEGER", "tip TEXT")),
        "ALTER TABLE session ADD COLUMN sha256 TEXT",
        CHAIN,
    ),
}
"""By schema version, the statements that change its tables to those of the next one."""
LONGEST_TEXT = 100_000
LONGEST_FILE = 5_000_000
FILES = (("campaign", "value"), ("session", "rig"))
"""Columns that hold whole files. Their bound is above that of the largest file a schedule names, the certificate."""
Schema = frozenset[tuple[str, ...]]


def create_tables(db: sqlite3.Connection) -> None:
    """Create the tables in an empty database."""
    with db:
        db.execute("BEGIN")  # otherwise each statement is a transaction of its own and waits for the disk
        db.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        db.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
        for statement in CREATED[SCHEMA_VERSION]:
            db.execute(statement)


def check_schema(db: sqlite3.Connection, version: int) -> None:
    """Raise ValueError where a database has other tables than a journal of this version, made so or migrated, or anything else.

    A journal may come of unknown origin, and SQLite executes what a schema has: triggers, views, expressions of a table.
    """
    known, found = known_schemas()[version], _schema_of(db)
    if found in known:
        return
    strange = sorted(found.difference(*known))
    what = f"the {strange[0][0]} {strange[0][1][:40]!a}" if strange else "fewer tables, or other ones,"
    raise ValueError(f"has {what} as no version of goniotwin makes")


def check_lengths(db: sqlite3.Connection) -> None:
    """Raise ValueError where a text is longer than any that is written: it could take a hundred times its size to parse.

    The length is in bytes: of characters, SQLite counts those before the first NUL.
    """
    for (table,) in db.execute("SELECT name FROM sqlite_schema WHERE type = 'table'").fetchall():
        for _, column, kind, *_ in db.execute(f"PRAGMA table_info({table})").fetchall():
            most = LONGEST_FILE if (table, column) in FILES else LONGEST_TEXT
            if (
                kind == "TEXT"
                and db.execute(f"SELECT 1 FROM {table} WHERE length(CAST({column} AS BLOB)) > {most} LIMIT 1").fetchone()
            ):
                raise ValueError(f"has more than {most} bytes in {column} of the table {table}")


@cache
def known_schemas() -> dict[int, frozenset[Schema]]:
    """All schemas that a version of this program has ever made, by the schema version: ALTER TABLE leaves other text."""
    known: dict[int, set[Schema]] = {version: set() for version in CREATED}
    for version, statements in CREATED.items():
        with contextlib.closing(sqlite3.connect(":memory:")) as db:
            for step, altering in enumerate([statements, *(ALTERED[each] for each in range(version, SCHEMA_VERSION))]):
                for statement in altering:
                    db.execute(statement)
                known[version + step].add(_schema_of(db))
    return {version: frozenset(schemas) for version, schemas in known.items()}


def _schema_of(db: sqlite3.Connection) -> Schema:
    """Type, name, table and text of each entry, with blanks for all white space; of a strange database not all of them."""
    factory, db.text_factory = db.text_factory, lambda raw: raw.decode(errors="replace")  # a damaged text may not be UTF-8
    try:
        found = db.execute(f"SELECT type, name, tbl_name, sql FROM sqlite_schema LIMIT {MOST_ENTRIES}").fetchall()
    finally:
        db.text_factory = factory
    return frozenset(tuple(" ".join(str(each).split()) for each in entry) for entry in found)


def migrate(db: sqlite3.Connection) -> None:
    """Migrate a journal to SCHEMA_VERSION in one transaction.

    Raises sqlite3.Error, ValueError and KeyError for a damaged journal.
    """
    version = db.execute("PRAGMA user_version").fetchone()[0]
    if version == SCHEMA_VERSION:
        return
    db.execute("PRAGMA foreign_keys = OFF")
    db.execute("BEGIN IMMEDIATE")
    try:
        for step in range(version, SCHEMA_VERSION):
            for statement in ALTERED[step]:
                db.execute(statement)
            FILL[step](db)
        db.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
    except BaseException:
        db.execute("ROLLBACK")
        raise
    db.execute("COMMIT")
    db.execute("PRAGMA foreign_keys = ON")


def _fill_from_1(db: sqlite3.Connection) -> None:
    """Fill the new columns from schema 1, which has one session, and gains and readings of a row only in the schedule."""
    about = dict(db.execute("SELECT key, value FROM campaign"))
    schedule, rig = tomllib.loads(about["schedule"]), tomllib.loads(about["rig"])
    known = rig["photodiodes"]["gains_v_per_a"]
    gains = sorted(known.index(gain) for gain in schedule["gains_v_per_a"])

    def detail(kind: str) -> str:
        if kind == "mount":
            return json.dumps({"gains": [], "readings": 0})
        default, key = (16, "dark_readings") if kind == "dark" else (4, "readings")
        return json.dumps({"gains": gains, "readings": schedule.get(key, default)})

    db.execute("INSERT INTO campaign VALUES ('rig_folder', '.')")
    db.execute("UPDATE session SET rig = ?, versions = ?", (about["rig"], about["versions"]))
    db.execute("UPDATE event SET session = 1 WHERE EXISTS (SELECT 1 FROM session)")
    for (kind,) in db.execute("SELECT DISTINCT kind FROM plan").fetchall():
        db.execute("UPDATE plan SET detail = ? WHERE kind = ?", (detail(kind), kind))


FILL: dict[int, Callable[[sqlite3.Connection], None]] = {1: _fill_from_1, 2: begin_chain}
"""By schema version, what fills the new tables and columns; a chain of hashes begins after the rows that are there."""
