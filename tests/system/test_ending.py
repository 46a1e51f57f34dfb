"""Repeated signals to end: the first stops the run in good order, and further ones do not interrupt that."""

import signal
import sqlite3
import subprocess
from pathlib import Path

import pytest

from tests.conftest import Writer
from tests.system.conftest import MAIN, Serve, control_client, until

QUIET = (("noise = true", "noise = false"), ("drift_per_hour = 0.02", "drift_per_hour = 0.0"))


@pytest.mark.parametrize("second", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.long)])
def test_a_second_signal_does_not_interrupt_the_stop(
    write_rig: Writer, write_schedule: Writer, serve: Serve, tmp_path: Path, second: int
) -> None:
    there = tmp_path / "served.toml"
    _, lines = serve(write_rig(*QUIET), "--write-rig", there)
    control = control_client(lines)
    journal = tmp_path / "c.journal"
    run = subprocess.Popen(
        [*MAIN, "run", str(write_schedule()), "--rig", str(there), "--out", str(journal), "--transcript", tmp_path / "wires"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    until(lambda: run.poll() is not None or control.do("state")["angles_deg"]["beta"] >= 20.0)
    assert run.poll() is None
    for number in (signal.SIGINT, second, second, signal.SIGINT):
        run.send_signal(number)
    errors = run.communicate(timeout=60.0)[1]
    assert run.returncode == 130
    assert "Traceback" not in errors
    wire = (tmp_path / "wires" / "axes.txt").read_text(encoding="utf-8").splitlines()
    assert sum(" > " in line and "MST" in line for line in wire) >= 4
    resting = control.do("state")["angles_deg"]
    while control.do("state")["angles_deg"] != resting:  # until the end of its ramp
        resting = control.do("state")["angles_deg"]
    assert resting["beta"] < 179.0
    database = sqlite3.connect(journal)
    assert database.execute("SELECT outcome FROM session").fetchall() == [("stopped",)]
    database.close()
    control.close()
