"""Stations as processes: found, attached to, left, killed; the run outlives what has started it."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from goniotwin.app.campaign.campaign import resume_campaign, run_campaign
from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.rig import read_rig
from goniotwin.app.station.client import Refused
from goniotwin.app.station.connection_file import attach, connection_folder, known_stations, read_connection
from goniotwin.app.station.messages import RowSaved
from goniotwin.protocols.channel import PROTOCOL
from tests.app.campaign.campaign_bench import QUIET, planned_values
from tests.conftest import REPOSITORY, Writer
from tests.system.command_process import FORKED, CommandProcess
from tests.system.conftest import until
from tests.system.station_bench import Attached, connection_of, runs, station_process

pytestmark = [*FORKED, pytest.mark.endpoint, pytest.mark.usefixtures("heard_hangup")]
ROWS = 10
Start = Callable[..., tuple[CommandProcess, Path]]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Starts `goniotwin station`."""
    processes: list[CommandProcess] = []

    def started(rig: Path, *options: object) -> tuple[CommandProcess, Path]:
        process, path = station_process(tmp_path, rig, *options)
        processes.append(process)
        return process, path

    yield started
    for each in processes:
        with contextlib.suppress(ValueError):  # it has ended
            each.kill()
    for path in known_stations():  # that of a killed process
        attach(path, "cleaner")


def rig_opened(path: Path, name: str = "test") -> Attached:
    """A client of a station that has connected its devices."""
    client = Attached(path, name)
    client.wait_for(lambda: client.snapshot.rig is not None)
    return client


def begin(client: Attached, schedule: Path, folder: Path, rows: int = 3) -> Path:
    """Start a run, and wait until some rows are in its journal; return the journal."""
    client.client.do("start", schedule=str(schedule), folder=str(folder))
    client.wait_for(lambda: client.snapshot.done >= rows and client.snapshot.journal is not None)
    journal = client.snapshot.journal
    assert journal is not None
    return journal


def test_a_station_is_found_by_its_file_and_ends_with_disconnect(start: Start, write_rig: Writer) -> None:
    rig = write_rig()
    process, path = start(rig)
    connection = read_connection(path)
    assert connection is not None
    assert (connection.pid, connection.rig, connection.host) == (process.pid, str(rig), socket.gethostname())
    assert path.stat().st_mode & 0o777 == 0o600
    client = rig_opened(path)
    assert all(each.connected for each in client.snapshot.rig.devices.values())  # type: ignore[union-attr]
    client.client.do("disconnect")
    assert client.ended.wait(30.0)
    assert process.wait() == 0
    assert not path.exists()
    client.client.close()


def test_a_rig_has_one_station(start: Start, write_rig: Writer, tmp_path: Path) -> None:
    rig = write_rig()
    first, path = start(rig)
    second = CommandProcess(tmp_path, "station", "--rig", rig)
    pid = first.pid
    assert second.wait() == 2
    assert f"is in use by process {pid}" in second.errors
    rig_opened(path).client.close()


def test_a_station_without_clients_and_run_gives_the_rig_back(start: Start, write_rig: Writer) -> None:
    process, path = start(write_rig(), "--unattended", 0.2)
    assert process.wait() == 0
    assert not path.exists()


@pytest.mark.long
def test_a_run_goes_on_without_clients_and_the_station_ends_after_it(
    start: Start, write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    process, path = start(write_rig(*QUIET), "--speed", 20, "--unattended", 0.5)
    client = rig_opened(path)
    journal = begin(client, write_schedule(), tmp_path / "journals", rows=1)
    client.client.close()
    assert process.wait() == 0
    assert not path.exists()
    summary = campaign_summary(journal)
    assert (summary.state, summary.rows) == ("done", ROWS)


def test_a_killed_station_leaves_a_journal_that_the_next_one_resumes(
    start: Start, write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    """Its connection file is stale: the first that finds it removes it. The values are those of an undisturbed run."""
    rig, schedule = write_rig(*QUIET), write_schedule()
    process, path = start(rig, "--speed", 20)
    client = rig_opened(path)
    journal = begin(client, schedule, tmp_path / "journals")
    process.kill()
    assert client.ended.wait(10.0)
    assert path.exists()
    assert attach(path, "late") is None
    assert not path.exists()
    kept = campaign_summary(journal)
    assert kept.state == "killed"
    assert client.snapshot.done <= kept.rows < ROWS
    _, path = start(rig, "--speed", 60)
    again = rig_opened(path)
    again.client.do("continue", journal=str(journal))
    again.wait_for(lambda: again.snapshot.state is State.DONE and not again.snapshot.activity)
    run_campaign(make_plan(read_schedule(schedule), read_rig(rig)), tmp_path / "undisturbed.journal")
    until(lambda: campaign_summary(journal).state == "done")
    assert planned_values(journal) == planned_values(tmp_path / "undisturbed.journal")
    for each in (client, again):
        each.client.close()


@pytest.mark.parametrize(
    "number",
    [
        signal.SIGTERM,
        pytest.param(signal.SIGINT, marks=pytest.mark.long),
        pytest.param(signal.SIGHUP, marks=pytest.mark.long),
    ],
)
def test_a_signal_to_the_station_stops_the_run_in_order(
    start: Start, write_rig: Writer, write_schedule: Writer, tmp_path: Path, number: int
) -> None:
    process, path = start(write_rig(*QUIET), "--speed", 20)
    client = rig_opened(path)
    journal = begin(client, write_schedule(), tmp_path / "journals")
    os.kill(process.pid, number)
    assert client.ended.wait(30.0)
    assert process.wait() == 130
    assert client.snapshot.state is State.IDLE
    summary = campaign_summary(journal)
    assert (summary.state, summary.orders, summary.faults) == ("stopped", [], [])
    assert not Path(f"{journal}-wal").exists()
    assert not path.exists()
    assert resume_campaign(journal).state is State.DONE
    client.client.close()


def test_goniotwin_run_can_be_watched_paused_and_stopped(
    start: Start, write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    journal = tmp_path / "run.journal"
    process = CommandProcess(tmp_path, "run", write_schedule(), "--rig", write_rig(*QUIET), "--out", journal, "--speed", 20)
    client = Attached(connection_of(process))
    client.wait_for(lambda: client.snapshot.done >= 3)
    with pytest.raises(Refused, match="a run is"):
        client.client.do("move", axis="sigma", target_deg=1.0)
    with pytest.raises(Refused, match="stop it first"):
        client.client.do("disconnect")
    client.client.do("pause")
    client.wait_for(lambda: client.snapshot.state is State.PAUSED)
    client.client.do("resume")
    client.wait_for(lambda: client.snapshot.state is State.RUNNING)
    client.client.do("stop")
    assert client.ended.wait(30.0)
    assert client.snapshot.state is State.IDLE
    assert process.wait() == 130
    assert campaign_summary(journal).state == "stopped"
    assert len([each for each in client.events if isinstance(each, RowSaved)]) <= ROWS
    client.client.close()


def test_run_speed_is_of_virtual_rigs(tmp_path: Path, write_rig: Writer, write_schedule: Writer) -> None:
    rig = write_rig(('port = "twin://virtual/axes"', f'port = "{tmp_path / "none"}"'))
    process = CommandProcess(tmp_path, "run", write_schedule(), "--rig", rig, "--out", tmp_path / "a.journal", "--speed", 2)
    assert process.wait() == 2
    assert "--speed: the rig is not virtual" in process.errors


def test_two_clients_and_a_stale_file_of_another_host(start: Start, write_rig: Writer) -> None:
    _, path = start(write_rig(), "--speed", 20)
    one, two = rig_opened(path, "one"), rig_opened(path, "two")
    one.client.do("live", on=True)
    two.wait_for(lambda: two.snapshot.operator == "one" and two.snapshot.reading is not None)
    with pytest.raises(Refused, match="one operates this rig"):
        two.client.do("live", on=False)
    two.client.do("stop")
    foreign = connection_folder() / "foreign.json"
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        content = {**json.loads(path.read_text(encoding="utf-8")), "port": taken.getsockname()[1]}
        foreign.write_text(json.dumps({**content, "host": "elsewhere"}), encoding="utf-8")
        assert attach(foreign, "x") is None
        assert foreign.exists()
        assert foreign not in known_stations()
        foreign.write_text(json.dumps({**content, "protocol": PROTOCOL + 1}), encoding="utf-8")
        assert attach(foreign, "x") is None
        assert foreign.exists()  # of another version
        foreign.write_text(json.dumps(content), encoding="utf-8")
        assert attach(foreign, "x") is None
        assert not foreign.exists()
    for each in (one, two):
        each.client.close()


STARTER = """
import sys
from pathlib import Path
from goniotwin.app.station.starting import start_station
client = start_station(Path(sys.argv[1]), 20.0, "parent")
client.start()
while client.snapshot.rig is None:
    pass
client.do("start", schedule=sys.argv[2], folder=sys.argv[3])
print(client.snapshot.rig.name, flush=True)
sys.stdin.read()
"""


@pytest.mark.long
def test_a_killed_parent_leaves_the_run_on(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    """With its whole process group, and its ends of all pipes: as a terminal that is closed, or a log-out."""
    parent = subprocess.Popen(
        [sys.executable, "-c", STARTER, str(write_rig(*QUIET)), str(write_schedule()), str(tmp_path / "journals")],
        cwd=REPOSITORY,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    assert parent.stdout is not None
    assert parent.stdin is not None
    try:
        assert b"virtual goniophotometer" in parent.stdout.readline()
        ((path, connection),) = known_stations().items()  # it has answered its parent
        os.killpg(parent.pid, signal.SIGHUP)
        os.killpg(parent.pid, signal.SIGKILL)
        parent.wait()
        client = Attached(path)
        before = client.snapshot.done
        client.wait_for(lambda: client.snapshot.done > before)
        assert runs(connection.pid)
        client.client.do("stop")
        client.wait_for(lambda: client.snapshot.state is State.IDLE and client.snapshot.total > 0)
        journal = client.snapshot.journal
        assert journal is not None
        until(lambda: campaign_summary(journal).state == "stopped")
        client.client.do("disconnect")
        assert client.ended.wait(30.0)
        until(lambda: not runs(connection.pid))
        client.client.close()
    finally:
        for pipe in (parent.stdin, parent.stdout):
            pipe.close()
        parent.kill()
        parent.wait()
        for each in known_stations().values():
            os.kill(each.pid, signal.SIGKILL)
