"""Short campaigns on virtual rigs, with changed rows, stopped at a time, or with a journal of an older schema."""

import contextlib
import sqlite3
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from goniotwin.app.campaign.campaign import clock_for, operator_for
from goniotwin.app.campaign.journal.chain import ENTRY, begin_chain
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.row import CommittedRow, Row
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import Listener, State
from goniotwin.app.campaign.running.operator import Operator
from goniotwin.app.campaign.running.sleep import SleepWatch
from goniotwin.app.rig import OpenRig, open_rig
from goniotwin.protocols.clock import VirtualClock

QUIET = (("noise = true", "noise = false"), ("drift_per_hour = 0.02", "drift_per_hour = 0.0"))
"""Changes of the rig file: no noise, no drift of the lamp."""
THREE_SHIFTS = ("shift_deg = [0, 1]", "shift_deg = [0, 1, 2]")
"""Change of the schedule: three arc shifts instead of two."""
VALUES = """
SELECT plan.identity, plan.kind, attempt.positions, attempt.flags, gain_v_per_a, monitor_a, readings, channels, counts
FROM plan JOIN attempt USING (number) LEFT JOIN reading USING (number, attempt)
WHERE plan.session IS NULL AND attempt.attempt = (SELECT MAX(attempt) FROM attempt latest WHERE latest.number = plan.number)
ORDER BY plan.number, gain_v_per_a
"""
"""Values of the planned rows, each of its last attempt, without times."""
SCHEMA_1 = """
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


def change_rows(plan: Plan, change: Callable[[Row], Row | list[Row]]) -> Plan:
    """The plan with each row replaced by one or several rows, numbered again."""
    rows: list[Row] = []
    for row in plan.rows:
        changed = change(row)
        rows += changed if isinstance(changed, list) else [changed]
    return Plan(plan.schedule, plan.rig, tuple(replace(row, number=k) for k, row in enumerate(rows)))


@dataclass
class RunResult:
    """Result of a run: final state, committed rows, events (kind, text), faults, duration in s."""

    state: State
    rows: list[CommittedRow]
    events: list[tuple[str, str]]
    faults: list[str]
    seconds: float

    def of(self, kind: str, sample: str = "") -> list[CommittedRow]:
        """The rows of a kind, of all samples or of one."""
        return [each for each in self.rows if each.row.kind == kind and sample in ("", each.row.sample)]


def run_plan(
    plan: Plan,
    path: Path,
    prepare: Callable[[OpenRig], Any] = lambda _: None,
    operator: Operator | None = None,
    listeners: list[Listener] | None = None,
    use_engine: Callable[[Engine], Any] = lambda _: None,
    watch_sleep: Callable[[OpenRig], SleepWatch | None] = lambda _: None,
) -> RunResult:
    """Run a plan on its virtual rig. `prepare` gets the connected rig, `use_engine` the engine before it runs.

    `watch_sleep` gives the engine's watch for a sleep of the computer, if there is to be another one than usual.
    """
    with contextlib.ExitStack() as stack:
        opened = stack.enter_context(open_rig(plan.rig, VirtualClock()))
        opened.connect()
        prepare(opened)
        journal = stack.enter_context(Journal.create(path, plan, {}))
        chosen = operator or operator_for(opened, plan.rig.file, None)
        engine = Engine(opened.rig, plan, journal, chosen, listeners, sleep_watch=watch_sleep(opened))
        use_engine(engine)
        state = engine.run()
        events = recorded_events(path)
        return RunResult(state, list(journal.rows()), events, engine.faults, journal.seconds)


def recorded_events(journal: Path) -> list[tuple[str, str]]:
    """Kind and text of each event of a journal, which may still be open."""
    with contextlib.closing(sqlite3.connect(journal)) as connection:
        return [(str(kind), str(text)) for kind, text in connection.execute("SELECT kind, text FROM event ORDER BY id")]


def planned_values(journal: Path) -> list[tuple[Any, ...]]:
    """Values of the planned rows of a journal, without times: equal for an interrupted and an undisturbed campaign."""
    connection = sqlite3.connect(journal)
    try:
        return connection.execute(VALUES).fetchall()
    finally:
        connection.close()


def run_until(plan: Plan, path: Path, t: float) -> None:
    """Run a plan and stop it at a time of the rig's clock."""
    with open_rig(plan.rig, clock_for(plan.rig.file)) as opened:
        opened.connect()
        with Journal.create(path, plan, {}) as journal:
            engine = Engine(opened.rig, plan, journal, operator_for(opened, plan.rig.file, None))
            opened.rig.clock.at(t, engine.stop)
            assert engine.run() is State.IDLE


def convert_to_schema_1(path: Path) -> None:
    """Convert a journal to schema 1, as an older version of the program wrote it."""
    now = path.rename(path.with_suffix(".now"))
    database = sqlite3.connect(path)
    database.executescript(SCHEMA_1)
    database.execute("ATTACH ? AS now", (str(now),))
    for table in ("campaign", "plan", "attempt", "reading", "event", "session"):
        columns = ", ".join(name for _, name, *_ in database.execute(f"PRAGMA main.table_info({table})"))
        database.execute(f"INSERT INTO main.{table} SELECT {columns} FROM now.{table}")
    database.execute("DELETE FROM campaign WHERE key IN ('rig_folder', 'chain')")
    database.commit()
    database.execute("PRAGMA application_id = 0x474F4E49")
    database.execute("PRAGMA user_version = 1")
    database.close()


def remove_checksums(db: sqlite3.Connection) -> None:
    """Make the rows of a journal that a test has changed rows without checksums, as those of earlier versions."""
    db.execute("DELETE FROM chain")
    db.execute("DELETE FROM campaign WHERE key = ?", (ENTRY,))
    begin_chain(db)
