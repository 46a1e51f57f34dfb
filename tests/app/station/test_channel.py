"""The channel of a station over loopback: attach, commands, one operator, clients that are silent or never read, a flood."""

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator

import pytest

from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.running.events import EventLogged, Positions, RowStarted, SafetyOrder
from goniotwin.app.station import server as station_server
from goniotwin.app.station.client import NoStation, Refused, StationClient
from goniotwin.app.station.messages import (
    ActivityChanged,
    Message,
    OperatorChanged,
    SpeedChanged,
    advance,
)
from goniotwin.app.station.server import ClientLimits, StationServer
from goniotwin.app.station.station import Station
from goniotwin.protocols.channel import LONGEST_LINE, Channel, connect
from goniotwin.protocols.clock import RealClock
from goniotwin.protocols.loopback import LOOPBACK

pytestmark = pytest.mark.endpoint
LONGEST_S = 20.0


def with_limits(limits: ClientLimits) -> pytest.MarkDecorator:
    """Gives the server of a test its limits."""
    return pytest.mark.parametrize("server", [limits], indirect=True, ids=["limits"])


@pytest.fixture
def station() -> Station:
    """A station without a rig."""
    return Station()


@pytest.fixture
def server(station: Station, request: pytest.FixtureRequest) -> Iterator[StationServer]:
    """Its server, with the limits of a test."""
    server = StationServer(station, limits=getattr(request, "param", ClientLimits()))
    server.start()
    yield server
    server.stop()


def note_stops(station: Station, stopped: list[int]) -> None:
    """Note the stops of a station, which then do nothing."""

    def stop() -> list[str]:
        stopped.append(1)
        return []

    station.stop = stop  # type: ignore[method-assign]


class Watcher:
    """A client and what it has received."""

    def __init__(self, server: StationServer, name: str) -> None:
        self.events: list[Message] = []
        self._changed = threading.Condition()
        self.ended = threading.Event()
        self.client = StationClient(server.port, server.token, name, self._note, self.ended.set)
        self.client.start()

    def _note(self, message: Message) -> None:
        with self._changed:
            self.events.append(message)
            self._changed.notify_all()

    def wait_for(self, condition: Callable[[], bool]) -> None:
        with self._changed:
            assert self._changed.wait_for(condition, LONGEST_S), self.events


@pytest.fixture
def attach(server: StationServer) -> Iterator[Callable[[str], Watcher]]:
    watchers: list[Watcher] = []

    def attached(name: str) -> Watcher:
        watchers.append(Watcher(server, name))
        return watchers[-1]

    yield attached
    for each in watchers:
        each.client.close()


def until(condition: Callable[[], bool]) -> None:
    clock = RealClock()
    while not condition():
        assert clock.now() < LONGEST_S
        clock.sleep_until(clock.now() + 0.005)


def test_a_client_gets_the_state_and_then_the_events(station: Station, attach: Callable[[str], Watcher]) -> None:
    station.board.publish(SpeedChanged(60.0))
    one = attach("one")
    assert one.client.snapshot.speed == 60.0
    station.board.publish(Positions({"sigma": 3.0}))
    two = attach("two")
    assert two.client.snapshot.positions == {"sigma": 3.0}
    station.board.publish(ActivityChanged("waiting"))
    for each in (one, two):
        each.wait_for(lambda each=each: ActivityChanged("waiting") in each.events)  # type: ignore[misc]
    assert one.client.snapshot == two.client.snapshot == station.snapshot


def test_an_event_of_another_version_does_not_end_the_connection(
    station: Station, attach: Callable[[str], Watcher], monkeypatch: pytest.MonkeyPatch
) -> None:
    one = attach("one")
    with monkeypatch.context() as patch:
        patch.setattr(station_server, "encode", lambda _message: {"type": "Positions", "degrees": "all"})
        station.board.publish(Positions({"sigma": 3.0}))
        one.client.do("stop")  # its answer follows the event
    station.board.publish(ActivityChanged("waiting"))
    one.wait_for(lambda: ActivityChanged("waiting") in one.events)


def test_a_wrong_token_is_no_station(server: StationServer) -> None:
    with pytest.raises(NoStation, match="does not have the token"):
        StationClient(server.port, "another", "x")
    server.stop()
    with pytest.raises(NoStation, match="no station answers"):
        StationClient(server.port, server.token, "x")


@pytest.mark.parametrize(
    "first",
    [
        b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
        b"{}\n",
        b'{"protocol": true, "nonce": "NONCE"}\n',
        b'{"protocol": 1, "token": "TOKEN"}\n',
        b" " * (LONGEST_LINE + 2) + b"\n",
        b'{"do": "stop"}\n',
    ],
    ids=["POST", "no nonce", "protocol", "token", "long", "stop"],
)
def test_what_is_no_hello_learns_nothing(server: StationServer, first: bytes, station: Station) -> None:
    stopped: list[int] = []
    note_stops(station, stopped)
    with socket.create_connection((LOOPBACK, server.port), timeout=LONGEST_S) as end:
        first = first.replace(b"TOKEN", server.token.encode()).replace(b"NONCE", b"0c" * 32)
        end.sendall(first + b'{"do": "stop", "id": 1}\n')
        with contextlib.suppress(ConnectionError):
            assert end.recv(100) == b""
    assert server.clients == []
    assert not stopped


@with_limits(ClientLimits(hello_s=0.2))
def test_a_silent_client_keeps_no_other_out(server: StationServer, attach: Callable[[str], Watcher]) -> None:
    with socket.create_connection((LOOPBACK, server.port), timeout=LONGEST_S) as silent:
        attach("one")
        assert silent.recv(1) == b""


def test_a_later_line_that_is_too_long_ends_the_connection(server: StationServer) -> None:
    end = connect(server.port, server.token, LONGEST_S, client="long")
    assert end.receive() is not None
    end.send({"do": "x" * (LONGEST_LINE + 10), "id": 1})
    assert end.receive(LONGEST_S) is None
    end.close()
    until(lambda: server.clients == [])


def test_an_answer_is_json_whatever_the_number_of_the_command(server: StationServer) -> None:
    end = connect(server.port, server.token, LONGEST_S, client="odd")
    assert end.receive() is not None
    for number, answer in ((float("nan"), None), ({"a": 1}, None), ("x", "x"), (3, 3)):
        end.send({"do": "pause", "id": number})
        while "answer" not in (line := end.receive(LONGEST_S) or {"answer": "none"}):  # events
            pass
        assert line["answer"] == answer
    end.hang_up()
    end.close()


@pytest.mark.parametrize(
    ("command", "arguments", "error"),
    [
        ("pause", {}, "no run is in progress"),
        ("move", {"axis": "sigma", "target_deg": 3.0}, "opening the rig"),
        ("move", {"axis": "sigma"}, "target_deg"),
        ("move", {"axis": "sigma", "target_deg": "far"}, "target_deg"),
        ("move", {"axis": "sigma", "target_deg": 1.0, "quickly": True}, "quickly"),
        ("move", {"axis": "\ud800", "target_deg": 1.0}, "axis: has characters"),
        ("start", {"schedule": "a\0b", "folder": "."}, "schedule: has characters"),
        ("close_rig", {}, "there is no command"),
        ("__init__", {}, "there is no command"),
        ("answer", {"question": 1, "choice": "Perhaps"}, "choice"),
    ],
    ids=str,
)
def test_a_command_is_refused_in_one_line(
    attach: Callable[[str], Watcher], command: str, arguments: dict[str, object], error: str
) -> None:
    one = attach("one")
    with pytest.raises(Refused, match=error):
        one.client.do(command, **arguments)
    assert one.client.do("stop")["failures"] == []


def test_one_operates_the_others_watch_and_stop_is_everybodys(
    station: Station, server: StationServer, attach: Callable[[str], Watcher]
) -> None:
    stopped: list[int] = []
    note_stops(station, stopped)
    one, two = attach("one"), attach("two")
    with pytest.raises(Refused, match="no run"):
        one.client.do("pause")  # takes the free place
    two.wait_for(lambda: two.client.snapshot.operator == "one")
    with pytest.raises(Refused, match="one operates this rig"):
        two.client.do("pause")
    two.client.do("stop")
    assert stopped == [1]
    two.client.do("operate")
    with pytest.raises(Refused, match="two operates this rig"):
        one.client.do("pause")
    two.client.close()
    one.wait_for(lambda: one.client.snapshot.operator == "")
    assert OperatorChanged("two") in one.events
    until(lambda: server.clients == ["one"])


def test_clients_of_one_name_are_several_also_at_the_same_moment(
    station: Station, server: StationServer, attach: Callable[[str], Watcher]
) -> None:
    taken = [attach("window (1)").client.name]
    ends = [connect(server.port, server.token, LONGEST_S, client="window") for _ in range(3)]
    with station.board.deciding():
        ends += [connect(server.port, server.token, LONGEST_S, client="window") for _ in range(3)]
        until(lambda: sum(each.name.endswith("(process_request_thread)") for each in threading.enumerate()) == 7)
    names = [str((each.receive(LONGEST_S) or {})["client"]) for each in ends]
    assert len(set(names + taken)) == 7
    assert sorted(server.clients) == sorted(names + taken)
    for each in ends:
        each.close()
    until(lambda: server.clients == taken)


def test_a_client_that_has_left_operates_no_more(station: Station, attach: Callable[[str], Watcher]) -> None:
    """A script gives one command after the other, each a client with another name."""
    here = attach("here").client
    here.do("operate")
    leaving = threading.Thread(target=here.close)
    with station.board.deciding() as snapshot:  # the station has other work
        leaving.start()
        leaving.join(0.2)
        assert (leaving.is_alive(), snapshot.operator) == (True, "here")
    leaving.join()
    assert station.snapshot.operator == ""


def test_a_client_leaves_a_station_that_hangs(station: Station, attach: Callable[[str], Watcher]) -> None:
    here = attach("here")
    with station.board.deciding():
        here.client.close(leave_s=0.05)
        assert here.ended.is_set()


@with_limits(ClientLimits(clients=2))
def test_a_client_too_many_is_refused_and_the_others_stay(attach: Callable[[str], Watcher]) -> None:
    one, _two = attach("one"), attach("two")
    with pytest.raises(Refused, match="2 clients are attached to the station; close one"):
        attach("three")
    assert one.client.do("stop")["ok"]


def test_a_station_of_another_version_is_not_taken_for_none(server: StationServer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its connection file would be removed, and nothing could stop its run."""
    monkeypatch.setattr(station_server, "encode", lambda _snapshot: {"type": "Snapshot", "number": "many"})
    with pytest.raises(Refused, match="of another version"):
        StationClient(server.port, server.token, "x")


def test_a_stop_is_carried_out_by_the_thread_that_reads_it(station: Station, attach: Callable[[str], Watcher]) -> None:
    """It is received before its answer, which may take long; another client's stop does not wait for it."""
    one, two = attach("one"), attach("two")
    go, threads = threading.Event(), []

    def stop() -> list[str]:
        threads.append(threading.get_ident())
        if len(threads) == 1:
            go.wait(LONGEST_S)
        return ["sigma: not confirmed"]

    station.stop = stop  # type: ignore[method-assign]
    received = threading.Event()
    first = one.client.send("stop", received=received.set)
    assert received.wait(LONGEST_S)
    assert not first.done()
    assert two.client.do("stop")["failures"] == ["sigma: not confirmed"]
    go.set()
    assert first.result(LONGEST_S)["ok"]
    assert len(set(threads)) == 2
    assert threading.get_ident() not in threads


@with_limits(ClientLimits(waiting=50))
def test_a_client_that_never_reads_is_dropped_and_learns_why_when_it_comes_back(
    station: Station, server: StationServer, attach: Callable[[str], Watcher]
) -> None:
    good = attach("good")
    bad = connect(server.port, server.token, LONGEST_S, client="bad")
    until(lambda: sorted(server.clients) == ["bad", "good"])
    sent = 0
    while "bad" in server.clients:
        station.board.publish(EventLogged("x", "y" * 1900, str(sent)))
        sent += 1
        good.wait_for(lambda sent=sent: len([each for each in good.events if isinstance(each, EventLogged)]) == sent)  # type: ignore[misc]
        assert sent < 100_000
    bad.close()
    again = attach("bad")
    assert again.client.dropped == "it did not read what was sent"
    assert attach("bad").client.dropped == ""


def test_of_positions_a_slow_client_gets_the_newest(station: Station, server: StationServer) -> None:
    slow = connect(server.port, server.token, LONGEST_S, client="slow")
    first = slow.receive(LONGEST_S)
    assert first is not None
    for k in range(20_000):
        station.board.publish(Positions({"sigma": float(k)}))
    station.board.publish(ActivityChanged("end"))
    assert server.clients == ["slow"]
    last = {}
    while (line := slow.receive(LONGEST_S)) is not None and line["type"] != "ActivityChanged":
        last = line
    assert last["degrees"] == {"sigma": 19_999.0}
    slow.close()


def test_the_end_of_a_station_ends_its_clients(server: StationServer, attach: Callable[[str], Watcher]) -> None:
    one = attach("one")
    waiting = one.client.send("stop")
    waiting.result(LONGEST_S)
    server.stop()
    assert one.ended.wait(LONGEST_S)
    with pytest.raises(NoStation):
        one.client.do("stop")


def test_a_command_that_fails_while_the_station_ends_fails_once(
    server: StationServer, attach: Callable[[str], Watcher], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The thread that reads and the one that sends notice the end at the same moment."""
    one, send, asks = attach("one"), Channel.send, threading.current_thread()

    def fail(channel: Channel, message: dict[str, object]) -> None:
        if threading.current_thread() is not asks:  # of the server
            send(channel, message)
            return
        server.stop()
        assert one.ended.wait(LONGEST_S)
        raise OSError("broken")

    monkeypatch.setattr(Channel, "send", fail)
    with pytest.raises(NoStation):
        one.client.do("stop")


def test_a_client_that_fails_is_attached_no_more(
    server: StationServer, station: Station, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What it shows would be the past, without a word about it."""
    faults: list[object] = []
    monkeypatch.setattr(threading, "excepthook", faults.append)

    def fail(_message: Message) -> None:
        raise RuntimeError

    ended = threading.Event()
    client = StationClient(server.port, server.token, "failing", fail, ended.set)
    client.start()
    station.board.publish(ActivityChanged("waiting"))
    assert ended.wait(LONGEST_S)
    with pytest.raises(NoStation):
        client.do("stop")
    client.close()
    assert len(faults) == 1


def test_without_clients_the_time_is_counted(server: StationServer, attach: Callable[[str], Watcher]) -> None:
    until(lambda: server.unattended_s > 0.0)
    one = attach("one")
    assert server.unattended_s == 0.0
    one.client.close()
    until(lambda: server.unattended_s > 0.0)


def test_no_event_is_longer_than_a_line(station: Station, attach: Callable[[str], Watcher]) -> None:
    one = attach("one")
    names = tuple(f"{k}" * 900 for k in range(100))
    station.board.publish(RowStarted(Row(1, "x" * 70_000, "dark", "s", gains=(1, 2))))
    station.board.publish(Positions(dict.fromkeys(names, 1.0)))
    station.board.publish(SafetyOrder("a", "b"))
    one.wait_for(lambda: SafetyOrder("a", "b") in one.events)


def test_events_and_snapshot_of_the_server_are_those_of_one_function(
    station: Station, server: StationServer, attach: Callable[[str], Watcher]
) -> None:
    """Attached in the middle of many events from two threads, no client misses one or has one twice."""
    done = threading.Event()

    def publish() -> None:
        for k in range(500):
            station.board.publish(EventLogged("k", str(k)))
        done.set()

    threads = [threading.Thread(target=publish) for _ in range(2)]
    for each in threads:
        each.start()
    watchers = [attach(f"w{k}") for k in range(5)]
    for each in threads:
        each.join()
    for watcher in watchers:
        watcher.wait_for(lambda watcher=watcher: watcher.client.snapshot.number == 1000)  # type: ignore[misc]
    assert done.is_set()
    assert advance(station.snapshot, EventLogged("a", "b")).number == 1001
