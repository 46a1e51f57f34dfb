"""The program as the golden tests call it: the only module of them that has names of its packages, classes and functions.

What can be asked of the command is asked of the command, in this process: its options, its JSON and the columns of its files
stay. Journals are read with SQL, for their schema stays too.
"""

import contextlib
import io
import json
import multiprocessing
import os
import signal
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.running.events import Event, RowCommitted
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.cli.main import app
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from goniotwin.app.simulation.paper.explanation import WIDTHS_DEG, rms_table
from goniotwin.arrays import Flags
from goniotwin.twin.optics import Instrument

COLUMNS = {
    "wavelength_nm": "wavelength_nm",
    "sigma_deg": "sigma_deg",
    "gamma_deg": "gamma_deg",
    "beta_deg": "beta_deg",
    "shift_deg": "shift_deg",
    "photodiode": "photodiode",
    "zenith_deg": "zenith_deg",
    "azimuth_deg": "azimuth_deg",
    "theta_deg": "theta_deg",
    "phi_deg": "phi_deg",
    "bsdf": "bsdf",
    "u_bsdf": "u_bsdf",
    "signature": "signature",
    "u_field": "u_field",
}
"""Columns of a sample's points: the name in the golden files, and the attribute."""
MARKS = {"back": "back", "transmitted": "transmitted", "mirrored": "mirrored"}
"""What else is true or false of a point."""
ROWS = """
SELECT plan.identity, plan.kind, plan.sample, plan.session, attempt.started_s, attempt.ended_s, attempt.positions,
    attempt.flags, gain_v_per_a, first_s, period_s, monitor_a, readings, channels, counts
FROM plan JOIN attempt USING (number) LEFT JOIN reading USING (number, attempt)
WHERE attempt.attempt = (SELECT MAX(attempt) FROM attempt latest WHERE latest.number = plan.number)
ORDER BY attempt.started_s, plan.number, gain_v_per_a
"""

Row = dict[str, Any]


def answer(*arguments: object) -> dict[str, Any]:
    """What `goniotwin ARGUMENTS --json` answers."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(io.StringIO()):
        status = app([*map(str, arguments), "--json"], standalone_mode=False)
    assert not status, f"goniotwin {' '.join(map(str, arguments))}: status {status}: {out.getvalue()}"
    result: dict[str, Any] = json.loads(out.getvalue())
    return result


def refusal(*arguments: object) -> str:
    """Why `goniotwin ARGUMENTS` is refused."""
    with pytest.raises(UserError) as caught, contextlib.redirect_stderr(io.StringIO()):
        app([*map(str, arguments)], standalone_mode=False)
    return str(caught.value)


def plan_rows(schedule: Path, rig: Path) -> dict[str, list[Any]]:
    """The rows of a plan in columns; `seconds` is how long each is expected to take."""
    rows = make_plan(read_schedule(schedule), read_rig(rig)).rows
    poses = [row.pose or (None,) * 4 for row in rows]
    return {
        "identity": [row.identity for row in rows],
        "kind": [str(row.kind) for row in rows],
        "sample": [row.sample for row in rows],
        **{axis: [pose[k] for pose in poses] for k, axis in enumerate(("gamma", "sigma", "beta", "shift"))},
        "wavelength": [row.wavelength_nm for row in rows],
        "gains": [row.gains for row in rows],
        "readings": [row.readings for row in rows],
        "automatic gains": [row.automatic for row in rows],
        "target": [row.target for row in rows],
        "longest": [row.longest_s for row in rows],
        "seconds": [row.seconds for row in rows],
    }


def points(journal: Path) -> dict[str, tuple[dict[str, npt.NDArray[Any]], dict[str, Flags]]]:
    """By sample, the columns of the points that a journal reduces to, and what is true or false of each point."""
    with Journal.open(journal) as opened:
        reduced = reduce_journal(opened)
    return {
        sample: (
            {name: getattr(each, attribute) for name, attribute in COLUMNS.items()},
            {**{name: getattr(each, attribute) for name, attribute in MARKS.items()}, **each.flags},
        )
        for sample, each in reduced.samples.items()
    }


def table3_noise_free() -> dict[str, list[float]]:
    """The noise-free cells of the paper's Table 3, percent: a column a width, a row a sigma."""
    cells = rms_table(Instrument(obstruction=False))
    return {f"{width:g} deg": cells[:, k].tolist() for k, width in enumerate(WIDTHS_DEG)}


def run_and_kill(schedule: Path, rig: Path, journal: Path, rows: int) -> None:
    """Runs a campaign in a process of its own, which is killed when so many rows are on the disk."""
    process = multiprocessing.get_context("spawn").Process(target=_run_and_die, args=(schedule, rig, journal, rows))
    process.start()
    process.join()
    assert process.exitcode == -signal.SIGKILL


def _run_and_die(schedule: Path, rig: Path, journal: Path, rows: int) -> None:
    def listen(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.done == rows:
            os.kill(os.getpid(), signal.SIGKILL)

    run_campaign(make_plan(read_schedule(schedule), read_rig(rig)), journal, listeners=[listen])


def measured_rows(journal: Path) -> list[Row]:
    """The rows of a journal in the order in which they were begun, added ones too, each by its last attempt."""
    connection = sqlite3.connect(journal)
    try:
        found = connection.execute(ROWS).fetchall()
    finally:
        connection.close()
    rows: list[Row] = []
    for identity, kind, sample, session, started, ended, positions, flags, gain, first, period, monitor, *counted in found:
        if not rows or rows[-1]["identity"] != identity:
            about = {"identity": identity, "kind": kind, "sample": sample, "planned": session is None}
            when = {"started_s": started, "ended_s": ended}
            where = {"positions": None if positions is None else json.loads(positions), "flags": json.loads(flags)}
            rows.append({**about, **when, **where, "readings": []})
        if gain is not None:
            readings, channels, counts = counted
            table = np.frombuffer(counts, dtype="<u2").reshape(readings, channels).tolist()
            reading = {"gain_v_per_a": gain, "first_s": first, "period_s": period, "monitor_a": monitor, "counts": table}
            rows[-1]["readings"].append(reading)
    return rows


def change_campaign(journal: Path, key: str, value: str) -> None:
    """Writes an entry of a journal's table `campaign`."""
    with contextlib.closing(sqlite3.connect(journal)) as connection, connection:
        connection.execute("UPDATE campaign SET value = ? WHERE key = ?", (value, key))


def campaign_entry(journal: Path, key: str) -> str:
    """Reads one."""
    with contextlib.closing(sqlite3.connect(journal)) as connection:
        return str(connection.execute("SELECT value FROM campaign WHERE key = ?", (key,)).fetchone()[0])


def put_in_order(journal: Path) -> None:
    """Brings what a killed program has left beside a journal into it: one file is left. The campaign stays broken off."""
    with contextlib.closing(sqlite3.connect(journal)) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
