"""The channel: what opens it, and what ends it."""

import contextlib
import json
import re
import socket
import socketserver
import threading
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.protocols.channel import (
    HELLO_S,
    LONGEST_LINE,
    MOST_UNPROVED,
    PROTOCOL,
    Channel,
    ChannelServer,
    NotProved,
    connect,
    parse_object,
    proof,
)
from goniotwin.protocols.loopback import LOOPBACK
from tests.system.conftest import until

TOKEN = "the token of these tests"
OWN = "0c" * 32
HELLO = json.dumps({"protocol": PROTOCOL, "nonce": OWN}).encode() + b"\n"
POST = b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: text/plain\r\n\r\n" + HELLO + b'{"do": "it"}\n'
REPOSITORY = Path(__file__).parents[2]
pytestmark = pytest.mark.endpoint


@pytest.fixture(scope="module")
def server() -> Iterator[ChannelServer]:
    """Echoes every object."""
    with echoing() as server:
        yield server


@contextlib.contextmanager
def echoing(hello_s: float = HELLO_S) -> Iterator[ChannelServer]:
    """A server that echoes every object of a client that has its hello in time."""

    def echo(end: Channel) -> None:
        while (message := end.receive()) is not None:
            end.send(message)

    server = ChannelServer("echo", TOKEN, echo, hello_s=hello_s)
    server.start()
    try:
        yield server
    finally:
        server.stop()


def answer(server: ChannelServer, sent: bytes, token: str | None = None) -> bytes:
    """Everything that a client receives for its bytes, until the server hangs up; with a token it proves that first."""
    received = b""
    with (
        socket.create_connection((LOOPBACK, server.port), timeout=20.0) as client,
        contextlib.suppress(ConnectionError),  # the server may hang up before it has read everything
    ):
        if token is not None:
            client.sendall(HELLO)
            nonce = line_of(client)["nonce"]
            client.sendall(json_line({"proof": proof(token, "client", server.port, OWN, nonce)}))
        client.sendall(sent)
        while data := client.recv(4096):
            received += data
    return received


def json_line(content: object) -> bytes:
    return json.dumps(content).encode() + b"\n"


def line_of(connection: socket.socket) -> dict[str, Any]:
    """The next line, read byte by byte so that no more is taken."""
    line = b""
    while not line.endswith(b"\n") and (byte := connection.recv(1)):
        line += byte
    content = json.loads(line)
    assert isinstance(content, dict)
    return content


def test_a_client_with_the_token_is_served(server: ChannelServer) -> None:
    end = connect(server.port, TOKEN, 20.0)
    for message in ({"a": 1}, {"b": "ü" * 10_000}):
        end.send(message)
        assert end.receive() == message
    end.close()


@pytest.mark.parametrize(
    "first",
    [
        POST,
        b"\n",
        b"[]\n",
        b"null\n",
        b"\xff\n",
        b"{}\n",
        b'{"protocol": 2}\n',
        b'{"protocol": 2, "nonce": ""}\n',
        b'{"protocol": 2, "nonce": null}\n',
        b'{"protocol": 2, "nonce": "\\ud800"}\n',
        HELLO.replace(b"2", b"1"),
        HELLO.replace(b"2", b"2.0"),
        HELLO.replace(b"2", b'"2"'),
        HELLO.replace(b"2", b"true"),
        HELLO.replace(b"0c", b"0C"),
        HELLO.replace(b"0c", b"0", 1),
        json_line({"protocol": 1, "token": TOKEN}),
        b"[" * 60_000 + b"\n",
        b" " * LONGEST_LINE + HELLO,
        b'{"protocol": ' + b"9" * 5000 + b"}\n",
    ],
    ids=lambda line: repr(line[:40]),
)
def test_any_other_first_line_is_hung_up_on_without_an_answer(server: ChannelServer, first: bytes) -> None:
    assert answer(server, first + HELLO + b'{"do": "it"}\n') == b""


@pytest.mark.parametrize("given", ["token", "server", "port", "nonce", "none", "number", "surrogate"])
def test_a_client_without_the_right_proof_is_hung_up_on(server: ChannelServer, given: str) -> None:
    """Neither the server's own proof, nor one of another connection or port, opens it; the token itself does not either."""
    with socket.create_connection((LOOPBACK, server.port), timeout=20.0) as client:
        client.sendall(HELLO)
        first = line_of(client)
        nonce = first["nonce"]
        proofs: dict[str, object] = {
            "token": TOKEN,
            "server": first["proof"],
            "port": proof(TOKEN, "client", server.port + 1, OWN, nonce),
            "nonce": proof(TOKEN, "client", server.port, OWN, OWN),
            "none": None,
            "number": 3,
            "surrogate": "\ud800" * 64,
        }
        client.sendall(json_line({"proof": proofs[given]}) + b'{"do": "it"}\n')
        with contextlib.suppress(ConnectionError):
            assert client.recv(100) == b""


@contextlib.contextmanager
def impostor(answers: Callable[[dict[str, Any]], bytes]) -> Iterator[tuple[int, list[bytes]]]:
    """A server at a port that answers every line, without the token; its port, and all that it has received."""
    received: list[bytes] = []

    class Handler(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            with contextlib.suppress(OSError):
                for line in self.rfile:
                    received.append(line)
                    self.wfile.write(answers(json.loads(line)))

    with socketserver.ThreadingTCPServer((LOOPBACK, 0), Handler) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield server.server_address[1], received
        finally:
            server.shutdown()
            thread.join()


def own_proof(nonce: str, role: str = "client") -> Callable[[dict[str, Any]], bytes]:
    """Answers with a proof made with a wrong guess of the token."""
    return lambda line: json_line(
        {
            "protocol": PROTOCOL,
            "nonce": nonce,
            "proof": proof("a guess", "server", 1, line["nonce"], nonce),
            "ok": True,
        }
    )


@pytest.mark.parametrize(
    "answers",
    [
        lambda _: b'{"ok": true}\n',
        lambda line: json_line({**line, "ok": True}),
        own_proof("0c" * 32),
        lambda line: json_line({**line, "proof": line["nonce"], "token": "x", "ok": True}),
        lambda _: b"\n",
        lambda line: json_line({"protocol": PROTOCOL, "nonce": 3, "proof": 3}),
        lambda _: b"x" * 200_000,
    ],
    ids=["ok", "echo", "guess", "nonce", "empty", "numbers", "endless"],
)
def test_a_program_without_the_token_gets_no_more_than_a_nonce(answers: Callable[[dict[str, Any]], bytes]) -> None:
    with impostor(answers) as (port, received):
        for _ in range(3):
            with pytest.raises(NotProved, match=f"at port {port} does not have the token"):
                connect(port, TOKEN, 20.0, client="a name")
    assert len(received) == 3
    lines = [json.loads(line) for line in received]
    assert all(line.keys() == {"protocol", "nonce"} for line in lines)
    assert len({line["nonce"] for line in lines}) == 3


@pytest.mark.parametrize("number", [True, 2.0, "2", 1, 3, None], ids=repr)
def test_a_server_of_another_protocol_is_refused(number: object) -> None:
    """Also one that has the token."""

    def answers(line: dict[str, Any]) -> bytes:
        right = proof(TOKEN, "server", ports[0], line["nonce"], OWN)
        return json_line({"protocol": number, "nonce": OWN, "proof": right})

    ports: list[int] = []
    with impostor(answers) as (port, _):
        ports.append(port)
        with pytest.raises(NotProved):
            connect(port, TOKEN, 20.0)


def test_a_program_that_passes_the_proofs_on_to_the_living_server_is_refused(server: ChannelServer) -> None:
    """It has the port of a server that died, and the same token opens another one, at another port."""

    def pass_on(line: dict[str, Any]) -> bytes:
        with socket.create_connection((LOOPBACK, server.port), timeout=20.0) as far:
            far.sendall(json_line(line))
            return json_line(line_of(far))

    with impostor(pass_on) as (port, received), pytest.raises(NotProved):
        connect(port, TOKEN, 20.0)
    assert len(received) == 1


def test_a_silent_server_is_not_waited_for() -> None:
    with socket.create_server((LOOPBACK, 0)) as silent, pytest.raises(TimeoutError):
        connect(silent.getsockname()[1], TOKEN, 0.05)


@pytest.mark.parametrize(
    "line",
    [
        b"x\n",
        b"[]\n",
        b"3\n",
        b"GET / HTTP/1.1\r\n",
        b"{" * 60_000 + b"\n",
        b'{"a": "' + b"b" * 200_000 + b'"}\n',
    ],
    ids=lambda line: repr(line[:40]),
)
def test_the_first_line_that_is_not_an_object_ends_the_connection(server: ChannelServer, line: bytes) -> None:
    assert answer(server, b'{"a": 1}\n' + line + b'{"b": 2}\n', TOKEN) == b'{"a": 1}\n'


@pytest.mark.parametrize("part", [b"", HELLO[:-1], HELLO, HELLO + b'{"proof": '], ids=["silent", "part", "hello", "no proof"])
def test_a_client_without_both_lines_in_time_is_hung_up_on(part: bytes) -> None:
    with echoing(0.05) as server:
        assert answer(server, part).count(b"\n") == part.count(b"\n")


def test_a_flood_of_silent_connections_is_bounded_and_keeps_no_client_out() -> None:
    """The oldest are ended: nothing has to wait for the time of a hello."""
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(echoing(60.0))
        threads = threading.active_count()
        flood = [stack.enter_context(socket.create_connection((LOOPBACK, server.port), timeout=20.0)) for _ in range(100)]
        for each in flood[: 100 - MOST_UNPROVED]:
            with contextlib.suppress(ConnectionError):
                assert each.recv(1) == b""
        end = stack.enter_context(contextlib.closing(connect(server.port, TOKEN, 20.0)))
        end.send({"a": 1})
        assert end.receive() == {"a": 1}
        until(lambda: threading.active_count() <= threads + MOST_UNPROVED + 1)  # those of ended connections are ending


def test_the_worked_example_of_the_page_is_right() -> None:
    """By RFC 2104's own formula, so that a client in another language can be held against the page."""
    page = (REPOSITORY / "docs" / "operate" / "station.md").read_text(encoding="utf-8")
    examples = dict(
        re.findall(r"^    (token|port|client's nonce|server's nonce|server's proof|client's proof) +(\S+)$", page, re.M)
    )
    assert len(examples) == 6
    for role in ("server", "client"):
        numbers = (examples["port"], examples["client's nonce"], examples["server's nonce"])
        message = f"goniotwin {PROTOCOL} {role} {' '.join(numbers)}"
        assert f"`{message.partition(' ')[0]} {PROTOCOL} {role} PORT CLIENT-NONCE SERVER-NONCE`" in page
        key = examples["token"].encode().ljust(64, b"\0")
        inner, outer = (bytes(byte ^ pad for byte in key) for pad in (0x36, 0x5C))
        expected = sha256(outer + sha256(inner + message.encode()).digest()).hexdigest()
        assert examples[f"{role}'s proof"] == expected
        assert proof(examples["token"], role, int(numbers[0]), *numbers[1:]) == expected


@given(st.binary(max_size=100) | st.text(max_size=100).map(str.encode))
def test_a_line_of_any_content_is_an_object_or_none(line: bytes) -> None:
    message = parse_object(line)
    assert message is None or isinstance(message, dict)
