"""The logs of a rig that is served, and of the programs that use it: none has a token, or the key of the served rig."""

import sys
from pathlib import Path

import pytest

from goniotwin.app.rig import read_rig
from goniotwin.app.station.connection_file import known_stations
from tests.conftest import RIG, Writer
from tests.system.command import goniotwin
from tests.system.command_process import CommandProcess
from tests.system.conftest import ForkedServe, until

pytestmark = pytest.mark.endpoint


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="a station is ended by a signal")
def test_no_log_has_a_secret(forked_serve: ForkedServe, write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    served, log = tmp_path / "served.toml", tmp_path / "log"
    log.mkdir()
    lines = forked_serve(write_rig(), "--speed", 60, "--write-rig", served, "--log-file", log / "serve.log", "-vv")
    token = next(line["token"] for line in lines if line["device"] == "control")
    simulated = read_rig(served).file.simulated
    assert simulated is not None
    assert simulated.server is not None
    schedule = write_schedule()
    run = goniotwin("run", schedule, "--rig", served, "--out", tmp_path / "a.journal", "--log-file", log / "run.log", "-vv")
    assert run.returncode == 0, run.stderr
    before = set(known_stations())
    station = CommandProcess(tmp_path, "station", "--rig", RIG, "--speed", 60, "--log-file", log / "station.log")
    until(lambda: not station.alive or bool(set(known_stations()) - before))
    (place,) = set(known_stations()) - before
    of_station = known_stations()[place].token
    until(lambda: not station.alive or "rig opened" in "".join(station.output_lines))
    station.kill()
    texts = {each.name: each.read_text(encoding="utf-8") for each in log.iterdir()} | {"screen": run.stderr}
    assert "monitor: connected" in texts["run.log"]
    assert "monitor: connected" in texts["station.log"]
    assert "row 1 of" in texts["run.log"]
    for name, text in texts.items():
        for secret in (token, simulated.server, of_station):
            assert len(secret) >= 16
            assert secret not in text, name
