"""`goniotwin verify-device` on a served rig: another process has the devices, and time is real."""

import json
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest

from goniotwin.app.rig import open_rig, read_rig
from goniotwin.protocols.clock import RealClock
from tests.conftest import RIG
from tests.system.command import invoke
from tests.system.command_process import FORKED
from tests.system.conftest import MAIN, ForkedServe, control_client, until

pytestmark = FORKED


@pytest.mark.long
def test_a_served_rig_is_verified_and_the_lock_of_another_program_is_respected(
    forked_serve: ForkedServe, tmp_path: Path
) -> None:
    rig = tmp_path / "served.toml"
    forked_serve(RIG, "--write-rig", rig)
    done = invoke("verify-device", "--rig", rig, "gamma", "monitor", "--yes", "--json")
    found: dict[str, Any] = json.loads(done.stdout)
    assert [each for each in found["records"] if each["verdict"] == "differs"] == []
    assert done.returncode == 0
    assert found["simulated"]
    assert {each["subject"] for each in found["records"] if each["moves"] and each["verdict"] == "ok"} == {"gamma"}
    with open_rig(read_rig(rig), RealClock()):
        refused = invoke("verify-device", "--rig", rig, "monitor")
    assert refused.returncode == 2
    assert "is in use by" in refused.stderr


def test_ctrl_c_during_a_move_stops_the_axis(forked_serve: ForkedServe, tmp_path: Path) -> None:
    rig, wires = tmp_path / "served.toml", tmp_path / "wires"
    control = control_client(forked_serve(RIG, "--write-rig", rig))
    verifying = subprocess.Popen(
        [*MAIN, "verify-device", "--rig", rig, "sigma", "--yes", "--transcript", wires],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    until(lambda: verifying.poll() is not None or control.do("state")["angles_deg"]["sigma"] > 0.3)
    verifying.send_signal(signal.SIGINT)
    _, errors = verifying.communicate(timeout=60.0)
    assert verifying.returncode == 130
    assert errors.split("goniotwin: ")[1:] == ["stopping\n", "stopped\n"]
    sent = [line for line in (wires / "axes.txt").read_text(encoding="utf-8").splitlines() if " > " in line]
    moved, stopped = ([k for k, line in enumerate(sent) if word in line] for word in ("MVP", "MST"))
    assert len(moved) == 1  # it does not move back
    assert len(stopped) >= 4
    resting = control.do("state")["angles_deg"]["sigma"]
    while control.do("state")["angles_deg"]["sigma"] != resting:  # until the end of its ramp
        resting = control.do("state")["angles_deg"]["sigma"]
    assert 0.3 < resting < 4.9
    control.close()
