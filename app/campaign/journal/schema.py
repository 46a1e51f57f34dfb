"""Tables of the journal, and the migration of journals with an older schema. docs/journal.md describes the tables."""

import json
import sqlite3
import tomllib
from collections.abc import Callable

from goniotwin.app.campaign.journal.chain import begin_chain

SCHEMA_VERSION = 3
APPLICATION_ID = 0x474F4E49  # "GONI"
CHAIN_TABLE = """CREATE TABLE chain (
    link INTEGER PRIMARY KEY, number INTEGER NOT NULL, attempt INTEGER NOT NULL, sha256 TEXT NOT NULL
) STRICT"""
SCHEMA = f"""
CREATE TABLE campaign (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;
CREATE TABLE session (
    id INTEGER PRIMARY KEY, started_s REAL NOT NULL, ended_s REAL, outcome TEXT, wall_started TEXT NOT NULL, wall_ended TEXT,
    rig TEXT NOT NULL, versions TEXT NOT NULL, first_link INTEGER, last_link INTEGER, tip TEXT, sha256 TEXT
) STRICT;
CREATE TABLE plan (
    number INTEGER PRIMARY KEY, identity TEXT NOT NULL UNIQUE, kind TEXT NOT NULL, sample TEXT NOT NULL,
    wavelength_nm REAL, gamma_deg REAL, sigma_deg REAL, beta_deg REAL, shift_deg REAL, seconds REAL NOT NULL,
    detail TEXT NOT NULL, session INTEGER REFERENCES session
) STRICT;
CREATE TABLE attempt (
    number INTEGER NOT NULL REFERENCES plan, attempt INTEGER NOT NULL, session INTEGER NOT NULL REFERENCES session,
    started_s REAL NOT NULL, ended_s REAL NOT NULL, positions TEXT, flags TEXT NOT NULL, PRIMARY KEY (number, attempt)
) STRICT;
CREATE TABLE reading (
    number INTEGER NOT NULL, attempt INTEGER NOT NULL, gain_v_per_a REAL NOT NULL, first_s REAL NOT NULL,
    period_s REAL NOT NULL, monitor_a REAL NOT NULL, readings INTEGER NOT NULL, channels INTEGER NOT NULL,
    counts BLOB NOT NULL, PRIMARY KEY (number, attempt, gain_v_per_a),
    FOREIGN KEY (number, attempt) REFERENCES attempt
) STRICT;
CREATE TABLE event (
    id INTEGER PRIMARY KEY, session INTEGER REFERENCES session, t_s REAL NOT NULL, kind TEXT NOT NULL, text TEXT NOT NULL
) STRICT;
{CHAIN_TABLE};
"""


def create_tables(db: sqlite3.Connection) -> None:
    """Create the tables in an empty database."""
    with db:
        db.execute("BEGIN")  # otherwise each statement is a transaction of its own and waits for the disk
        db.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        db.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
        for statement in SCHEMA.split(";"):
            db.execute(statement)


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
            STEPS[step](db)
        db.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
    except BaseException:
        db.execute("ROLLBACK")
        raise
    db.execute("COMMIT")
    db.execute("PRAGMA foreign_keys = ON")


def _from_1(db: sqlite3.Connection) -> None:
    """Migrate schema 1, which has one session, and gains and readings of a row only in the schedule."""
    about = dict(db.execute("SELECT key, value FROM campaign"))
    schedule, rig = tomllib.loads(about["schedule"]), tomllib.loads(about["rig"])
    known = rig["photodiodes"]["gains_v_per_a"]
    gains = sorted(known.index(gain) for gain in schedule["gains_v_per_a"])

    def detail(kind: str) -> str:
        if kind == "mount":
            return json.dumps({"gains": [], "readings": 0})
        default, key = (16, "dark_readings") if kind == "dark" else (4, "readings")
        return json.dumps({"gains": gains, "readings": schedule.get(key, default)})

    for statement in (
        "ALTER TABLE session ADD COLUMN rig TEXT NOT NULL DEFAULT ''",
        "ALTER TABLE session ADD COLUMN versions TEXT NOT NULL DEFAULT ''",
        "ALTER TABLE plan ADD COLUMN detail TEXT NOT NULL DEFAULT ''",
        "ALTER TABLE plan ADD COLUMN session INTEGER REFERENCES session",
        "ALTER TABLE attempt ADD COLUMN session INTEGER NOT NULL DEFAULT 1 REFERENCES session",
        "ALTER TABLE event ADD COLUMN session INTEGER REFERENCES session",
    ):
        db.execute(statement)
    db.execute("INSERT INTO campaign VALUES ('rig_folder', '.')")
    db.execute("UPDATE session SET rig = ?, versions = ?", (about["rig"], about["versions"]))
    db.execute("UPDATE event SET session = 1 WHERE EXISTS (SELECT 1 FROM session)")
    for (kind,) in db.execute("SELECT DISTINCT kind FROM plan").fetchall():
        db.execute("UPDATE plan SET detail = ? WHERE kind = ?", (detail(kind), kind))


def _from_2(db: sqlite3.Connection) -> None:
    """Migrate schema 2, which has no chain of hashes: it begins after the rows that are there."""
    for column in ("first_link INTEGER", "last_link INTEGER", "tip TEXT", "sha256 TEXT"):
        db.execute(f"ALTER TABLE session ADD COLUMN {column}")
    db.execute(CHAIN_TABLE)
    begin_chain(db)


STEPS: dict[int, Callable[[sqlite3.Connection], None]] = {1: _from_1, 2: _from_2}
"""Migration from each older schema version to the next."""
