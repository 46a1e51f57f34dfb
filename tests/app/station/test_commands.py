"""`goniotwin move`, `read`, `home` and `here`, alone and through a station; the questions of `run` with a station's channel."""

import contextlib
import io
import json
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from goniotwin.app.campaign.running.events import Positions, State, StateChanged
from goniotwin.app.campaign.running.question import Answer, PositionGiven, Question, SampleGiven, UnreferencedAxis
from goniotwin.app.campaign.schedule.metadata import SampleMetadataTable
from goniotwin.app.cli.work.terminal import TerminalAsk
from goniotwin.app.errors import UserError
from goniotwin.app.rig import open_rig, parse_rig, read_rig
from goniotwin.app.rig.lock import LockFile
from goniotwin.app.station import connection_file, hosting, starting
from goniotwin.app.station.client import Refused, StationClient
from goniotwin.app.station.connection_file import (
    Connection,
    attach,
    connection_folder,
    known_stations,
    lock_of,
    read_connection,
    write_connection,
)
from goniotwin.app.station.hosting import HostedRun, connection_path, serving, station_of
from goniotwin.app.station.messages import QuestionAsked, RunBegun
from goniotwin.app.station.process import run_station
from goniotwin.app.station.station import Station
from goniotwin.protocols.channel import PROTOCOL
from goniotwin.protocols.clock import RealClock
from tests.app.test_referencing import HOMES
from tests.conftest import Writer
from tests.system.command import invoke, json_result

pytestmark = pytest.mark.endpoint
MOUNT = Question("Mount x", "Mount x.", (Answer.MOUNTED, Answer.WAIT, Answer.STOP), Answer.WAIT)
WHERE = Question(
    "Position of beta unknown",
    "jammed",
    (Answer.SET_POSITION, Answer.RETRY, Answer.SKIP, Answer.STOP),
    axis=UnreferencedAxis("beta", -5.0, 360.0, False),
)


@pytest.fixture
def station(write_rig: Writer) -> Iterator[tuple[Station, Path]]:
    """A station of a rig file, at a high simulation speed."""
    rig = write_rig(*HOMES)
    station = Station(200.0)
    station.open(read_rig(rig))
    with serving(station, read_rig(rig)):
        engine = threading.Thread(target=station.serve)
        station.do(station.connect_all)
        engine.start()
        clock = RealClock()
        while station.snapshot.rig is None:
            clock.sleep_until(clock.now() + 0.01)
        yield station, rig
        station.end()
        engine.join()


def test_a_move_and_a_reading_without_a_station(write_rig: Writer) -> None:
    rig = write_rig()
    assert "sigma: moved to 20 deg, at 20.000 deg" in invoke("move", "--rig", rig, "sigma", "20").stdout
    found = json_result(invoke("read", "--rig", rig, "--readings", "4", "--gain", "1e10", "--dark", "--json"))
    assert (len(found["counts"]), found["gain_v_per_a"], found["readings"], found["dark"]) == (36, 1e10, 4, True)


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (("move", "sigma", "2000"), "outside its soft limits"),
        (("move", "tau", "2"), "is no axis"),
        (("read", "--gain", "3"), "is no gain of this rig"),
    ],
)
def test_what_is_refused_is_one_line(write_rig: Writer, arguments: tuple[str, ...], error: str) -> None:
    name, *rest = arguments
    result = invoke(name, "--rig", write_rig(), *rest)
    assert result.returncode == 2
    assert error in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1


def test_a_move_through_the_station_that_has_the_rig(station: tuple[Station, Path]) -> None:
    held, rig = station
    assert station_of(rig) == connection_path(read_rig(rig))
    assert "at 12.000 deg" in invoke("move", "--rig", rig, "beta", "12").stdout
    assert held.snapshot.positions["beta"] == pytest.approx(12.0, abs=0.01)
    found = json_result(invoke("read", "--rig", rig, "--json"))
    assert len(found["volts"]) == 36
    assert invoke("move", "--rig", rig, "beta", "5000").returncode == 2


def test_axes_are_referenced_through_the_station_that_has_the_rig(station: tuple[Station, Path]) -> None:
    held, rig = station
    assert invoke("here", "--rig", rig, "shift", "2.5").stdout == "shift: position set to 2.500 deg\n"
    assert held.snapshot.positions["shift"] == pytest.approx(2.5)
    for angle in ("60", "nan"):
        refused = invoke("here", "--rig", rig, "shift", angle)
        assert (refused.returncode, "soft limits" in refused.stderr) == (2, True)
    assert invoke("home", "--rig", rig).stdout.startswith("sigma: homed, at ")
    held.board.publish(StateChanged(State.RUNNING))
    assert "a run is" in invoke("home", "--rig", rig).stderr
    held.board.publish(StateChanged(State.IDLE))


def test_a_rig_is_found_by_its_devices(write_rig: Writer, tmp_path: Path) -> None:
    """A run that is resumed has the rig of its journal, whose file is not known."""
    rig = write_rig(("twin://virtual/adc", "127.0.0.1?unit="), ("?unit=-", "?unit="), ("twin://virtual", f"{tmp_path}"))
    recorded = parse_rig(rig.read_text(encoding="utf-8"), tmp_path, "x.journal (rig)")
    assert station_of(rig) is None
    with serving(Station(), recorded):
        assert station_of(rig) == connection_path(recorded)
    assert station_of(rig) is None


def test_a_station_of_another_rig_file_is_not_used(
    station: tuple[Station, Path], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Its soft limits are others. A link to the file is the same one. A station that is silent is named."""
    _, rig = station
    link = tmp_path / "link.toml"
    link.symlink_to(rig)
    assert station_of(link) == station_of(rig)
    with monkeypatch.context() as patch:
        patch.setattr(StationClient, "do", raise_timeout)
        silent = invoke("move", "--rig", link, "beta", "12")
    assert (silent.returncode, "station is not responding" in silent.stderr) == (1, True)
    rig.write_text(rig.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    other = invoke("move", "--rig", rig, "beta", "12")
    assert (other.returncode, "another rig file" in other.stderr) == (2, True)


def full_disk(*_: object) -> None:
    raise OSError("No space left on device")


def raise_timeout(*_: object, **_more: object) -> None:
    raise TimeoutError


@pytest.mark.parametrize(
    "content",
    ["", "{{{", "[]", "x" * 100_000, *(f'{{"protocol": {each}}}' for each in ("true", f"{PROTOCOL}.0", f'"{PROTOCOL}"'))],
    ids=["empty", "braces", "list", "long", "true", "float", "text"],
)
def test_a_connection_file_that_is_none_is_removed(tmp_path: Path, content: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection_file, "connection_folder", lambda: tmp_path)
    path = tmp_path / "x.json"
    for find in (lambda: attach(path, "client"), known_stations):
        path.write_text(content, encoding="utf-8")
        assert not find()
        assert not path.exists()
    path.write_text(f'{{"protocol": {PROTOCOL + 1}}}', encoding="utf-8")
    assert not known_stations()
    assert attach(path, "client") is None
    assert path.exists()  # of another version


def test_without_a_place_for_its_file_a_station_is_refused_and_a_run_measures(
    write_rig: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig, path = read_rig(write_rig()), tmp_path / "x.json"
    monkeypatch.setattr("goniotwin.app.station.hosting.connection_path", lambda _: path)
    path.mkdir()
    warnings: list[str] = []
    for place, reason in ((path, "x.json: .*Is a directory"), (tmp_path / "x.json" / "y" / "z.json", "is not a folder")):
        if place != path:
            path.rmdir()
            path.touch()
            path = place
        with pytest.raises(UserError, match=reason), serving(Station(), rig):
            pass
        with pytest.raises(UserError, match=reason):
            run_station(Path(rig.name), 1.0, full_disk)
    with contextlib.ExitStack() as stack:
        run = HostedRun(1.0, stack, warnings.append)
        with open_rig(rig, run.clock_for(rig, 0.0)) as opened:
            run.adopt(opened, rig)
        assert (run.clients, len(warnings), "no client can attach" in warnings[0]) == ([], 1, True)


def test_the_second_starter_waits_for_the_file_of_the_first(write_rig: Writer, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first one has the lock before its file is there."""
    rig, path = write_rig(), Path("first.json")
    looks = iter([None, None, path])
    monkeypatch.setattr(starting, "_start", lambda *_: subprocess.Popen([sys.executable, "-S", "-c", ""]))
    monkeypatch.setattr(starting, "station_of", lambda _: next(looks))
    monkeypatch.setattr(starting, "attach", lambda path, *_: path)
    assert starting.start_station(rig, 1.0, "second") is path  # type: ignore[comparison-overlap]


def test_a_station_that_does_not_serve_leaves_nothing(write_rig: Writer, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = read_rig(write_rig())
    before = set(connection_folder().glob("*"))
    with monkeypatch.context() as patch:
        patch.setattr("goniotwin.app.station.hosting.write_connection", full_disk)
        with pytest.raises(UserError, match="No space"), serving(Station(), rig):
            pass
    assert set(connection_folder().glob("*")) == before
    station = Station()
    with serving(station, rig), monkeypatch.context() as patch:  # its lock and port are free
        patch.setattr("goniotwin.app.station.hosting.write_connection", full_disk)
        station.board.publish(RunBegun(Path("x.journal"), "x", 0, 1, 1.0))  # the run begins, and the file stays
        assert known_stations()[connection_path(rig)].journal == ""


def test_a_station_that_does_not_come_up_is_ended(write_rig: Writer, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    processes: list[subprocess.Popen[bytes]] = []

    def start(_command: list[str], _log: Path) -> "subprocess.Popen[bytes]":
        processes.append(subprocess.Popen([sys.executable, "-S", "-c", "input()"], stdin=subprocess.PIPE))
        return processes[-1]

    monkeypatch.setattr(starting, "_start", start)
    with pytest.raises(UserError, match="was ended"):
        starting.start_station(write_rig(), 1.0, "window", within_s=0.1)
    (process,) = processes
    assert process.wait(20.0) != 0
    assert process.stdin is not None
    process.stdin.close()


@pytest.fixture
def held(write_rig: Writer) -> Iterator[Callable[[int], tuple[Path, Path]]]:
    """Function that makes the connection file of a station that lives, at any port; returns it and its rig file."""
    with contextlib.ExitStack() as stack:

        def hold(port: int) -> tuple[Path, Path]:
            rig = write_rig()
            path = connection_path(read_rig(rig))
            path.parent.mkdir(parents=True, exist_ok=True)
            stack.callback(LockFile(lock_of(path), str(rig), "station", 0o600).release, remove=True)
            about = Connection(PROTOCOL, os.getpid(), socket.gethostname(), port, "a token", str(rig), "", "")
            write_connection(path, about)
            stack.callback(path.unlink, missing_ok=True)
            return path, rig

        yield hold


Held = Callable[[int], tuple[Path, Path]]


def test_a_station_that_hangs_is_named(held: Held, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("goniotwin.app.station.client.ATTACH_S", 0.1)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        path, rig = held(silent.getsockname()[1])
        hung = invoke("here", "--rig", rig, "sigma", "0")
        assert (hung.returncode, "its station is not responding" in hung.stderr) == (2, True)
        assert path.exists()


def test_nothing_connects_to_the_port_of_a_station_that_has_died(held: Held) -> None:
    """Another program may have it by now. The file is removed, whichever process has the station's number."""
    with socket.create_server(("127.0.0.1", 0)) as other:
        other.settimeout(0.0)
        path, _ = held(other.getsockname()[1])
        about = path.read_text(encoding="utf-8")
        dead = path.with_name("dead.json")
        dead.write_text(about, encoding="utf-8")
        assert attach(dead, "client") is None
        assert not dead.exists()
        with pytest.raises(BlockingIOError):
            other.accept()


@pytest.mark.parametrize("number", [float(PROTOCOL), str(PROTOCOL), True], ids=repr)
def test_the_protocol_of_a_connection_file_is_an_integer(held: Held, number: object) -> None:
    path, _ = held(1)
    assert read_connection(path) is not None
    path.write_text(json.dumps({**json.loads(path.read_text(encoding="utf-8")), "protocol": number}), encoding="utf-8")
    assert read_connection(path) is None
    assert path not in known_stations()


def test_a_station_that_lives_keeps_its_file_where_another_program_answers_at_its_port(held: Held) -> None:
    """It gets no more than a nonce: neither the token nor a command."""
    received: list[bytes] = []

    def answer() -> None:
        for _ in range(2):
            connection, _address = other.accept()
            with connection, connection.makefile("rwb", buffering=0) as end:
                received.append(end.readline())
                end.write(b'{"protocol": 2, "ok": true, "client": "x", "snapshot": {"type": "Snapshot"}}\n')
                received.append(end.readline())

    with socket.create_server(("127.0.0.1", 0)) as other:
        path, rig = held(other.getsockname()[1])
        thread = threading.Thread(target=answer)
        thread.start()
        with pytest.raises(Refused, match=rf"does not have the token.*in use by process {os.getpid()} .*station: wait for it"):
            attach(path, "client")
        moved = invoke("move", "--rig", rig, "beta", "12")
        assert (moved.returncode, moved.stdout, "does not have the token" in moved.stderr) == (2, "", True)
        thread.join()
    assert path.exists()
    assert [set(json.loads(each)) for each in received[::2]] == [{"protocol", "nonce"}] * 2
    assert received[1::2] == [b"", b""]


def test_a_station_removes_the_file_of_one_that_has_died_before_it_seems_to_live(
    write_rig: Writer, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = read_rig(write_rig())
    path = connection_path(rig)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_connection(path, Connection(PROTOCOL, 1, socket.gethostname(), 9, "old", rig.name, "", ""))
    seen: list[bool] = []

    def write(at: Path, about: Connection) -> None:
        seen.append(at.exists())
        write_connection(at, about)

    monkeypatch.setattr(hosting, "write_connection", write)
    with serving(Station(), rig):
        assert seen == [False]
        assert known_stations()[path].pid == os.getpid()


def test_a_second_station_of_a_virtual_rig_is_refused(station: tuple[Station, Path]) -> None:
    _, rig = station
    with pytest.raises(UserError, match="is in use by process"), serving(Station(), read_rig(rig)):
        pass
    client = attach(connection_path(read_rig(rig)), "still there")
    assert client is not None
    client.close()


@pytest.fixture
def host() -> HostedRun:
    """A run's station without a rig."""
    return HostedRun(1.0, contextlib.ExitStack())


def test_the_end_of_a_hosted_run_is_the_rig_given_back(monkeypatch: pytest.MonkeyPatch, write_rig: Writer) -> None:
    """To its clients a program that just ends would be a station that has died."""
    monkeypatch.setattr(hosting, "serving", lambda *_: contextlib.nullcontext())
    rig = read_rig(write_rig())
    with hosting.hosted_run(1.0) as host, open_rig(rig, host.clock_for(rig, 0.0)) as opened:
        host.adopt(opened, rig)
    assert host.station.snapshot.given_back
    assert host.station.snapshot.closed == "the run's program has ended"


def test_the_terminal_answers(host: HostedRun, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("\nwhat\nmounted\n"))
    assert TerminalAsk(host)(MOUNT) is Answer.MOUNTED
    assert host.station.snapshot.question is None


def test_the_terminal_takes_the_record_of_a_sample(
    host: HostedRun, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = 'stop { note = "x" }\nm { note = \nm { thickness_mm = "x" }\nMounted { thickness_mm = 1.2, note = "A Scratch" }\n'
    monkeypatch.setattr(sys, "stdin", io.StringIO(lines))
    question = replace(MOUNT, sample="x")
    assert TerminalAsk(host)(question) == SampleGiven(SampleMetadataTable(thickness_mm=1.2, note="A Scratch"))
    shown = capsys.readouterr().err
    assert "sample record: thickness_mm: " in shown
    assert "sample record: is not TOML: " in shown
    assert 'Type Mounted or Mounted { thickness_mm = 1.2, note = "..." } or Stop' in " ".join(shown.split())
    monkeypatch.setattr(sys, "stdin", io.StringIO('mounted { note = "x" }\n'))
    with pytest.raises(UserError, match="standard input is closed"):  # of an etalon there is none
        TerminalAsk(host)(MOUNT)


def test_the_terminal_states_where_an_axis_is(host: HostedRun, monkeypatch: pytest.MonkeyPatch) -> None:
    """A position without an angle is no answer, and one outside the soft limits is refused; then the encoder's is taken."""
    host.station.board.publish(Positions({"beta": 180.0}, {"beta": 150.0004}))
    monkeypatch.setattr(sys, "stdin", io.StringIO("s\nset\nset position\nset 400\nset there\nset 1_0\nset ١٠\nset encoder\n"))
    assert TerminalAsk(host)(WHERE) == PositionGiven(150.0004)
    assert host.station.snapshot.question is None


def test_the_terminal_does_not_take_an_encoder_that_a_reset_has_zeroed(
    host: HostedRun, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    host.station.board.publish(Positions({"beta": 0.0}, {"beta": None}))
    monkeypatch.setattr(sys, "stdin", io.StringIO("set encoder\nset 30\n"))
    assert TerminalAsk(host)(WHERE) == PositionGiven(30.0)
    shown = capsys.readouterr().err
    assert "encoder lost in the reset" in shown
    assert "or encoder" not in shown


@pytest.mark.parametrize(("line", "angle_deg"), [("set 12.5", 12.5), ("Set position −3,25", -3.25), ("set p 0", 0.0)])
def test_the_terminal_takes_an_angle(host: HostedRun, monkeypatch: pytest.MonkeyPatch, line: str, angle_deg: float) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(f"{line}\n"))
    assert TerminalAsk(host)(WHERE) == PositionGiven(angle_deg)


def test_another_client_answers_before_the_terminal(host: HostedRun, monkeypatch: pytest.MonkeyPatch) -> None:
    read, write = threading.Event(), threading.Event()

    class Silent(io.StringIO):
        def readline(self, *_: object) -> str:  # type: ignore[override]
            read.set()
            write.wait(20.0)
            return ""

    monkeypatch.setattr(sys, "stdin", Silent())

    def answer(_number: int, message: object) -> None:
        if isinstance(message, QuestionAsked):
            threading.Thread(target=host.station.answer, args=(message.number, Answer.MOUNTED)).start()

    host.station.board.subscribe(answer)
    assert TerminalAsk(host)(MOUNT) is Answer.MOUNTED
    write.set()


def test_without_terminal_and_clients_no_answer_can_come(host: HostedRun, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    with pytest.raises(UserError, match="standard input is closed"):
        TerminalAsk(host)(MOUNT)


def test_the_connection_file_has_the_journal_of_the_run(
    station: tuple[Station, Path], write_schedule: Writer, tmp_path: Path
) -> None:
    held, rig = station
    ended = threading.Event()
    held.board.subscribe(lambda _number, message: ended.set() if type(message).__name__ == "RunEnded" else None)
    held.start(write_schedule(), tmp_path / "journals")
    assert ended.wait(60.0)
    content = json.loads(connection_path(read_rig(rig)).read_text(encoding="utf-8"))
    assert content["journal"] == str(tmp_path / "journals" / "small-001.journal")
