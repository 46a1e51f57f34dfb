"""Another user's program at the port of a server that was killed: it gets no secret, and nothing that it sends is believed."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from goniotwin.app.campaign.running.operator import ServedOperator
from goniotwin.app.desktop.model.connection import StationProcesses
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from goniotwin.app.rig.lock import LockFile
from goniotwin.app.station.client import Refused
from goniotwin.app.station.connection_file import attach, lock_of, read_connection
from goniotwin.own_files import state_folder
from tests.conftest import Writer
from tests.system.command import invoke
from tests.system.command_process import FORKED, CommandProcess
from tests.system.conftest import Serve, at, until
from tests.system.station_bench import station_process

OTHER_USER = 65534
IMPOSTOR = f"""
import json, os, socket, sys, threading
os.setgroups([])
os.setgid({OTHER_USER})
os.setuid({OTHER_USER})
listener = socket.create_server(("127.0.0.1", int(sys.argv[1])))
print("listening", flush=True)

def answer(connection):
    print("connected", flush=True)
    with connection, connection.makefile("rwb", buffering=0) as end:
        for line in end:
            print(line, flush=True)
            try:
                line_read = json.loads(line)
            except ValueError:
                line_read = {{}}
            reply = {{**line_read, "protocol": 2, "ok": True, "answer": line_read.get("id")}}
            reply.update(nonce="0c" * 32, proof="0c" * 32)
            end.write(json.dumps(reply).encode() + b"\\n")
            end.write(b'{{"event": 1, "type": "Positions", "degrees": {{"sigma": -99.0}}}}\\n')
            end.write(b'{{"event": 2, "type": "ActivityChanged", "activity": "", "error": ""}}\\n')

while True:
    threading.Thread(target=answer, args=(listener.accept()[0],), daemon=True).start()
"""
pytestmark = [*FORKED, pytest.mark.endpoint]
AS_ROOT = pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can act as another user")
TIMES = [2, pytest.param(20, marks=pytest.mark.long)]


@contextlib.contextmanager
def impostor(port: int, folder: Path) -> Iterator[Callable[[], str]]:
    """A program of another user at a port that takes any first line and answers everything with ok; gives its log."""
    log = folder / "impostor.log"
    with log.open("w") as out:
        process = subprocess.Popen([sys.executable, "-I", "-S", "-c", IMPOSTOR, str(port)], stdout=out, stderr=out)
        try:
            while "listening" not in log.read_text():
                assert process.poll() is None, log.read_text()
            yield lambda: log.read_text().removeprefix("listening\n")
        finally:
            process.kill()
            process.wait()


def keys_of(log: str) -> list[set[str]]:
    """The keys of each line that the impostor has received."""
    return [set(json.loads(line[2:-3])) for line in log.splitlines() if line.startswith("b'")]


@AS_ROOT
@pytest.mark.parametrize("times", TIMES)
def test_a_program_at_the_port_of_a_dead_station_is_believed_by_no_window_and_no_command(
    times: int, tmp_path: Path, write_rig: Writer
) -> None:
    """With its connection file still there; and also where the lock is held as if the station lived."""
    rig = write_rig()
    process, path = station_process(tmp_path, rig)
    connection, content = read_connection(path), path.read_text(encoding="utf-8")
    process.kill()
    assert connection is not None
    window = StationProcesses()
    with impostor(connection.port, tmp_path) as log:
        for _ in range(times):
            path.write_text(content, encoding="utf-8")
            moved = invoke("move", "--rig", rig, "sigma", "20")  # alone: no station has the rig
            assert (moved.returncode, moved.stdout) == (0, "sigma: moved to 20 deg, at 20.000 deg\n")
            path.write_text(content, encoding="utf-8")
            assert window.attach(rig, "window", lambda _: None, lambda: None) is None
            assert not path.exists()
        assert log() == ""
        path.write_text(content, encoding="utf-8")
        held = LockFile(lock_of(path), str(rig), "a station", 0o600)
        try:
            for _ in range(times):
                with pytest.raises(Refused, match="does not have the token"):
                    window.attach(rig, "window", lambda _: None, lambda: None)
                moved = invoke("move", "--rig", rig, "sigma", "20")
                assert (moved.returncode, moved.stdout, "does not have the token" in moved.stderr) == (2, "", True)
        finally:
            held.release(remove=True)
        assert keys_of(log()) == [{"protocol", "nonce"}] * (2 * times)
        assert connection.token not in log()
    assert attach(path, "cleaner") is None


@AS_ROOT
@pytest.mark.parametrize("times", TIMES)
def test_a_program_at_the_ports_of_a_dead_served_rig_is_believed_by_no_command(
    times: int, tmp_path: Path, write_rig: Writer, write_schedule: Writer, serve: Serve
) -> None:
    path, schedule = tmp_path / "served.toml", write_schedule()
    process, lines = serve(write_rig(), "--write-rig", path)
    port = at(lines, "control", "port")
    process.kill()
    process.wait()
    simulated = read_rig(path).file.simulated
    assert simulated is not None
    assert (simulated.control_port, simulated.control_token) == (port["port"], port["token"])
    with impostor(port["port"], tmp_path) as log:
        for number in range(times):
            run = invoke("run", schedule, "--rig", path, "--out", tmp_path / f"{number}.journal")
            assert (run.returncode, "goniotwin serve that served this rig has ended" in run.stderr) == (2, True)
            move = invoke("move", "--rig", path, "sigma", "20")
            assert (move.returncode, "goniotwin serve that served this rig has ended" in move.stderr) == (2, True)
            with pytest.raises(UserError, match="has ended"):
                ServedOperator(port["port"], port["token"], simulated.server).mount("etalon")
        assert log() == ""
        for _ in range(times):  # of a rig file that does not name its server
            with pytest.raises(UserError, match="does not have the token"):
                ServedOperator(port["port"], port["token"], None).mount("etalon")
        assert keys_of(log()) == [{"protocol", "nonce"}] * times
        assert port["token"] not in log()


@pytest.mark.long
def test_a_served_rig_is_used_as_long_as_its_server_lives(tmp_path: Path, write_rig: Writer) -> None:
    path, locks = tmp_path / "served.toml", state_folder() / "locks"
    before = {*locks.glob("served-*")}
    process = CommandProcess(tmp_path, "serve", "--rig", write_rig(), "--ptys", tmp_path / "ptys", "--write-rig", path)
    until(lambda: not process.alive or '"control"' in process.output)
    assert "sigma: moved to 20 deg" in invoke("move", "--rig", path, "sigma", "20").stdout
    os.kill(process.pid, signal.SIGTERM)
    process.wait()
    ended = invoke("move", "--rig", path, "sigma", "30")
    assert (ended.returncode, "goniotwin serve that served this rig has ended" in ended.stderr) == (2, True)
    assert {*locks.glob("served-*")} == before
