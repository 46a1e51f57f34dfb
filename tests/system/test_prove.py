"""A proof on several processes: Ctrl-C ends it in good order, nothing is left behind, and the same command continues."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import Writer
from tests.system.conftest import MAIN, until

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(sys.platform == "win32", reason="this system has no signal for one process alone"),
]


def test_an_interrupted_proof_continues(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    folder = tmp_path / "proof"
    options = ["--rigs", "12", "--without-wires", "--processes", "2", "--out", str(folder), "--json"]
    command = [*MAIN, "prove", str(write_schedule()), "--rig", str(write_rig()), *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
    until(lambda: process.poll() is not None or any(folder.glob("chunk-*.npz")))
    process.send_signal(signal.SIGINT)
    out, errors = process.communicate(timeout=120)
    assert process.returncode == 130, errors
    assert out == ""
    assert f"to continue: the same command; finished rigs are in {folder}" in " ".join(errors.split())
    assert "Traceback" not in errors
    assert [each for each in folder.iterdir() if each.is_dir()] == []
    finished = {path: path.read_bytes() for path in folder.glob("chunk-*.npz")}
    assert 1 <= len(finished) < 12
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["rigs"] == 12
    assert result["failed"] == {}
    assert all(path.read_bytes() == content for path, content in finished.items())
