"""`goniotwin move` and `read`, alone and through a station; the questions of `goniotwin run` with a station's channel."""

import io
import json
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from goniotwin.app.campaign.running.question import Answer, Question
from goniotwin.app.cli.campaign import TerminalAsk
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from goniotwin.app.station.connection_file import attach, station_of
from goniotwin.app.station.hosting import HostedRun, connection_path, serving
from goniotwin.app.station.messages import QuestionAsked
from goniotwin.app.station.station import Station
from goniotwin.protocols.clock import RealClock
from tests.conftest import Writer
from tests.system.command import invoke, json_result

pytestmark = pytest.mark.endpoint
MOUNT = Question("Mount x", "Mount x.", (Answer.MOUNTED, Answer.WAIT, Answer.STOP), Answer.WAIT)


@pytest.fixture
def station(write_rig: Writer) -> Iterator[tuple[Station, Path]]:
    """A station of a rig file, at a high simulation speed."""
    rig = write_rig()
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


@pytest.mark.parametrize(("arguments", "error"), [
    (("move", "sigma", "2000"), "outside its soft limits"), (("move", "tau", "2"), "is no axis"),
    (("read", "--gain", "3"), "is no gain of this rig"),
])  # fmt: skip
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
    import contextlib

    return HostedRun(1.0, contextlib.ExitStack())


def test_the_terminal_answers(host: HostedRun, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("\nwhat\nmounted\n"))
    assert TerminalAsk(host)(MOUNT) is Answer.MOUNTED
    assert host.snapshot.question is None


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
            threading.Thread(target=host.answer, args=(message.number, Answer.MOUNTED)).start()

    host.board.subscribe(answer)
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
