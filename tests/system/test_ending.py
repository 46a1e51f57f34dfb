"""Ends of a run from outside: the first signal stops it in good order, and further ones do not interrupt that.

The axes come to rest, then the shutter closes; also where the terminal is gone, to which nothing can be written any more.
"""

import contextlib
import os
import select
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from goniotwin.mocks.control import ControlClient
from tests.conftest import Writer
from tests.system.command_process import FORKED
from tests.system.conftest import MAIN, ForkedServe, control_client, until

pytestmark = [*FORKED, pytest.mark.usefixtures("heard_hangup")]
TURNS = ("beta_deg = [180]", "beta_deg = [0, 180]")
QUIET = (("noise = true", "noise = false"), ("drift_per_hour = 0.02", "drift_per_hour = 0.0"))


@pytest.mark.long
@pytest.mark.parametrize(
    ("first", "second"), [(signal.SIGINT, signal.SIGTERM), (signal.SIGINT, signal.SIGINT), (signal.SIGTERM, signal.SIGINT)]
)
def test_a_second_signal_does_not_interrupt_the_stop(
    write_rig: Writer, write_schedule: Writer, forked_serve: ForkedServe, tmp_path: Path, first: int, second: int
) -> None:
    there = tmp_path / "served.toml"
    lines = forked_serve(write_rig(*QUIET), "--speed", 3, "--write-rig", there)
    control = control_client(lines)
    journal = tmp_path / "c.journal"
    run = subprocess.Popen(
        [*MAIN, "run", write_schedule(TURNS), "--rig", there, "--out", journal, "--transcript", tmp_path / "wires"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    until(lambda: run.poll() is not None or turns_in_light(control.do("state")))
    assert run.poll() is None
    for number in (first, second, second, signal.SIGINT):
        run.send_signal(number)
    errors = run.communicate(timeout=60.0)[1]
    assert run.returncode == 130
    assert "Traceback" not in errors
    wire = (tmp_path / "wires" / "axes.txt").read_text(encoding="utf-8").splitlines()
    assert sum(" > " in line and "MST" in line for line in wire) >= 4
    resting = control.do("state")["angles_deg"]
    while control.do("state")["angles_deg"] != resting:  # until the end of its ramp
        resting = control.do("state")["angles_deg"]
    assert 1.0 < resting["beta"] < 179.0
    check_stopped_dark(control, journal)
    control.close()


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="this system has no terminals of this kind")
@pytest.mark.parametrize("way", ["SIGHUP", "the terminal is closed"])
def test_the_shutter_closes_after_the_end_of_the_terminal(
    write_rig: Writer, write_schedule: Writer, forked_serve: ForkedServe, tmp_path: Path, way: str
) -> None:
    import fcntl
    import termios

    there = tmp_path / "served.toml"
    lines = forked_serve(write_rig(*QUIET), "--speed", 3, "--write-rig", there)
    control = control_client(lines)
    journal = tmp_path / "c.journal"
    terminal, end = os.openpty()
    run = subprocess.Popen(
        [*MAIN, "run", str(write_schedule(TURNS)), "--rig", str(there), "--out", str(journal)],
        stdin=end,
        stdout=end,
        stderr=end,
        start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
    )
    os.close(end)

    def turns() -> bool:
        while select.select([terminal], [], [], 0.0)[0]:  # a terminal that is not read blocks the command
            os.read(terminal, 4096)
        return run.poll() is not None or turns_in_light(control.do("state"))

    until(turns)
    assert run.poll() is None
    if way == "SIGHUP":
        run.send_signal(signal.SIGHUP)
        shown = b""
        while run.poll() is None:
            with contextlib.suppress(OSError):  # at its end
                if select.select([terminal], [], [], 0.1)[0]:
                    shown += os.read(terminal, 4096)
        assert b"goniotwin: stopping" in shown
    os.close(terminal)
    assert run.wait(timeout=60.0) == 130
    check_stopped_dark(control, journal)
    control.close()


def turns_in_light(state: dict[str, Any]) -> bool:
    """Whether the arc turns with the shutter open."""
    return bool(state["shutter_open"] and 20.0 <= state["angles_deg"]["beta"] <= 160.0)


def check_stopped_dark(control: ControlClient, journal: Path) -> None:
    """Check that the shutter is closed, and that the journal has the stop and the closing."""
    assert not control.do("state")["shutter_open"]
    database = sqlite3.connect(journal)
    assert database.execute("SELECT outcome FROM session").fetchall() == [("stopped",)]
    events = database.execute("SELECT kind, text FROM event WHERE kind <> 'sleep'").fetchall()
    # On a busy computer an answer is late; no other fault is met, and this one is repeated.
    events = [each for each in events if not (each[0] == "fault" and "reconnect the devices and retry" in each[1])]
    assert events == [("shutter", "closed after the stop")]
    database.close()
