"""One schedule in this process on the virtual clock, and over ports of another process in real time."""

import json
import sqlite3
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import Change, Writer
from tests.drivers.photodiode_bench import SERIAL
from tests.system.command import invoke, json_result
from tests.system.command_process import FORKED, CommandProcess
from tests.system.conftest import ForkedServe

pytestmark = FORKED
STEADY = (("noise = true", "noise = false"), ("drift_per_hour = 0.02", "drift_per_hour = 0.0"))
ROWS = """
SELECT plan.identity, plan.kind, attempt.positions, attempt.flags, gain_v_per_a, monitor_a, readings, channels, counts
FROM plan JOIN attempt USING (number) JOIN reading USING (number, attempt) ORDER BY plan.number, gain_v_per_a
"""


def rows(journal: Path) -> list[tuple[Any, ...]]:
    connection = sqlite3.connect(journal)
    try:
        return connection.execute(ROWS).fetchall()
    finally:
        connection.close()


@pytest.mark.parametrize(
    ("converters", "gains"),
    [
        pytest.param((), "[1e8, 1e10]", id="modbus tcp", marks=pytest.mark.long),
        pytest.param(SERIAL, "[1e11]", id="modbus rtu", marks=pytest.mark.long),
    ],
)
def test_rows_have_the_same_values_in_process_and_over_served_ports(
    write_rig: Writer,
    write_schedule: Writer,
    forked_serve: ForkedServe,
    tmp_path: Path,
    converters: tuple[Change, ...],
    gains: str,
) -> None:
    """Noise and drift off: raw counts, gains, flags, encoders and the monitor of every row, to the last bit."""
    rig, schedule = write_rig(*STEADY, *converters), write_schedule(("[1e8, 1e10]", gains))
    served = tmp_path / "served.toml"
    forked_serve(rig, "--speed", 5, "--write-rig", served)
    assert json_result(invoke("run", schedule, "--rig", rig, "--out", tmp_path / "twin.journal", "--json"))["simulated"] is True
    run = CommandProcess(tmp_path, "run", schedule, "--rig", served, "--out", tmp_path / "served.journal", "--json")
    assert run.wait() == 0, run.errors
    assert json.loads(run.output)["simulated"] is True
    in_process = rows(tmp_path / "twin.journal")
    assert len(in_process) == 8 * len(json.loads(gains))
    assert rows(tmp_path / "served.journal") == in_process
