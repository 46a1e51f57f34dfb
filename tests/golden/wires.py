"""What a rehearsal puts on the wires and into its journal, as digests: each wire's bytes with their times, each table's rows.

The golden digests are those of the version before poses and readings were computed ahead. Numbers of the monitor, which
processors may round differently in the last digit, are compared to nine digits.
"""

import hashlib
import re
import sqlite3
from collections.abc import Callable
from pathlib import Path
from typing import Any

from goniotwin.app.campaign.journal.writing import Journal, software_versions
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.rehearsal.rehearsal import plan_rehearsal
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.operator import VirtualOperator
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.rig import OpenRig, open_rig, read_rig
from goniotwin.protocols.clock import VirtualClock
from tests.conftest import REPOSITORY, RIG

SPECTRAL = """
name = "spectral"
samples = ["gaussian-5"]
etalon = "etalon"
sigma_deg = [0, 45]
beta_deg = [0, 180]
shift_deg = { start = 0.0, stop = 4.0, step = 2.0 }
wavelength_nm = { start = 400.0, stop = 700.0, step = 100.0 }
gains_v_per_a = "automatic"
readings = 3
dark_readings = 4
dark_every_s = 60
drift = { every_s = 120, sigma_deg = 0, beta_deg = 180, shift_deg = 2.0, wavelength_nm = 500 }
"""
QUICK = (REPOSITORY / "examples" / "schedules" / "quick.toml").read_text(encoding="utf-8")
SCHEDULES = {"quick": QUICK, "spectral": SPECTRAL}
TABLES = {
    "plan": "SELECT number, identity, kind, sample, wavelength_nm, detail FROM plan ORDER BY number",
    "attempts": "SELECT number, attempt, started_s, ended_s, positions, flags FROM attempt ORDER BY number, attempt",
    "readings": "SELECT * FROM reading ORDER BY number, attempt, gain_v_per_a",
    "sessions": "SELECT id, started_s, ended_s, outcome, first_link, last_link FROM session ORDER BY id",
    "links": "SELECT number, attempt FROM chain ORDER BY link",
}
MONITOR_REPLY = re.compile(r"(?m)^( *[0-9.]+ <) .*$")
Json = dict[str, Any]


def plan_of(name: str) -> Plan:
    """The plan of one of the schedules on the example's rig."""
    plan, _ = plan_rehearsal(parse_schedule(SCHEDULES[name], f"{name}.toml"), read_rig(RIG), {})
    return plan


def record(name: str, folder: Path, prepare: Callable[[OpenRig, Plan], object] = lambda *_: None) -> Json:
    """Digests of the journal and of the transcripts of a rehearsal."""
    plan, path = plan_of(name), folder / f"{name}.journal"
    with (
        Journal.create(path, plan, software_versions(), durable=False) as journal,
        open_rig(plan.rig, VirtualClock(), transcript=folder / name) as opened,
    ):
        opened.connect()
        assert opened.virtual is not None
        prepare(opened, plan)
        state = Engine(opened.rig, plan, journal, VirtualOperator(opened.virtual)).run()
    wires = {each.stem: wire_digest(each) for each in sorted((folder / name).iterdir())}
    return {"state": str(state), "wires": wires, "journal": journal_digests(path)}


def journal_digests(path: Path) -> Json:
    """A digest of each table of a journal, without what differs between two runs of the same program."""
    with sqlite3.connect(path) as db:
        found = {
            table: digest(repr([tuple(map(rounded, row)) for row in db.execute(query)])) for table, query in TABLES.items()
        }
    db.close()
    return found


def wire_digest(path: Path) -> str:
    """The digest of a transcript."""
    text = path.read_text(encoding="utf-8")
    return digest(MONITOR_REPLY.sub(r"\1", text) if path.stem == "monitor" else text)


def rounded(value: object) -> object:
    """A number to nine digits, anything else as it is."""
    return f"{value:.9g}" if isinstance(value, float) else value


def digest(text: str) -> str:
    """Of a text."""
    return hashlib.sha256(text.encode()).hexdigest()[:32]
