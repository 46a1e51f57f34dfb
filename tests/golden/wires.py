"""What a rehearsal puts on the wires and into its journal: digests of some lines of every wire, of some rows of every table.

The bytes and times are those of the version before poses and readings were computed ahead. Numbers of the monitor, which
processors may round differently in the last digit, are compared to nine digits.
"""

import contextlib
import re
import sqlite3
from collections.abc import Callable, Mapping
from pathlib import Path

from goniotwin.app.campaign.journal.writing import Journal, software_versions
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.rehearsal.rehearsal import plan_rehearsal
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.running.operator import VirtualOperator
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.rig import OpenRig, open_rig, read_rig
from goniotwin.protocols.clock import VirtualClock
from tests.conftest import REPOSITORY, RIG
from tests.golden.files import Table, Tables, digest, table

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
LINES, ROWS = 400, 50
"""So many lines of a transcript, and rows of a journal, have a digest together."""


def plan_of(name: str) -> Plan:
    """The plan of one of the schedules on the example's rig."""
    plan, _ = plan_rehearsal(parse_schedule(SCHEDULES[name], f"{name}.toml"), read_rig(RIG), {})
    return plan


def record(name: str, folder: Path, prepare: Callable[[OpenRig, Plan], object] = lambda *_: None) -> Tables:
    """Digests of the journal and of the transcripts of a rehearsal."""
    plan, path = plan_of(name), folder / f"{name}.journal"
    with (
        Journal.create(path, plan, software_versions(), durable=False) as journal,
        open_rig(plan.rig, VirtualClock(), transcript=folder / name) as opened,
    ):
        opened.connect()
        assert opened.virtual is not None
        prepare(opened, plan)
        assert Engine(opened.rig, plan, journal, VirtualOperator(opened.virtual)).run() is State.DONE
    lines = {each.stem: transcript_lines(each) for each in sorted((folder / name).iterdir())}
    return {f"{name}-wires": digests(lines, LINES), f"{name}-journal": journal_digests(path)}


def journal_digests(path: Path) -> Table:
    """Digests of the rows of each table of a journal, without what differs between two runs of the same program."""
    with contextlib.closing(sqlite3.connect(path)) as db:
        rows = {name: [repr(tuple(map(rounded, row))) for row in db.execute(query)] for name, query in TABLES.items()}
    return digests(rows, ROWS)


def transcript_lines(path: Path) -> list[str]:
    """The lines of a transcript."""
    text = path.read_text(encoding="utf-8")
    return (MONITOR_REPLY.sub(r"\1", text) if path.stem == "monitor" else text).splitlines()


def rounded(value: object) -> object:
    """A number to nine digits, anything else as it is."""
    return f"{value:.9g}" if isinstance(value, float) else value


def digests(lines: Mapping[str, list[str]], together: int) -> Table:
    """Digests of so many lines each."""
    parts = [(name, k, each[k : k + together]) for name, each in lines.items() for k in range(0, len(each), together)]
    return table(
        {
            "of": [name for name, _, _ in parts],
            "lines": [f"{k + 1} to {k + len(part)}" for _, k, part in parts],
            "digest": [digest(part)[:32] for _, _, part in parts],
        }
    )
