"""The channel: what opens it, and what ends it."""

import contextlib
import json
import socket
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.protocols import channel
from goniotwin.protocols.channel import LONGEST_LINE, PROTOCOL, Channel, ChannelServer, connect, parse_object
from goniotwin.protocols.loopback import LOOPBACK

TOKEN = "the token of these tests"
HELLO = json.dumps({"protocol": PROTOCOL, "token": TOKEN}).encode() + b"\n"
POST = b"POST / HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: text/plain\r\n\r\n" + HELLO + b'{"do": "it"}\n'
pytestmark = pytest.mark.endpoint


@pytest.fixture(scope="module")
def server() -> Iterator[ChannelServer]:
    """Echoes every object."""

    def echo(end: Channel) -> None:
        while (message := end.receive()) is not None:
            end.send(message)

    server = ChannelServer("echo", TOKEN, echo)
    server.start()
    yield server
    server.stop()


def answer(server: ChannelServer, sent: bytes, before: bytes = b"") -> bytes:
    """Everything that a client receives for its bytes, until the server hangs up; `before` is answered first."""
    received = b""
    with (
        socket.create_connection((LOOPBACK, server.port), timeout=20.0) as client,
        contextlib.suppress(ConnectionError),  # the server may hang up before it has read everything
    ):
        client.sendall(before)
        while before and not received.endswith(b"\n"):
            received += client.recv(4096)
        client.sendall(sent)
        while data := client.recv(4096):
            received += data
    return received


def test_a_client_with_the_token_is_served(server: ChannelServer) -> None:
    end = connect(server.port, TOKEN, 20.0)
    for message in ({"a": 1}, {"b": "ü" * 10_000}):
        end.send(message)
        assert end.receive() == message
    end.close()


@pytest.mark.parametrize("first", [
    POST, b"\n", b"[]\n", b"null\n", b"\xff\n", b"{}\n", b'{"protocol": 1}\n', b'{"protocol": 1, "token": ""}\n',
    b'{"protocol": 1, "token": null}\n', b'{"protocol": 1, "token": "\\ud800"}\n', HELLO.replace(b"1", b"2"),
    HELLO.replace(b"token of", b"Token of"), b"[" * 60_000 + b"\n", b" " * LONGEST_LINE + HELLO,
    b'{"protocol": ' + b"9" * 5000 + b"}\n",
], ids=lambda line: repr(line[:40]))  # fmt: skip
def test_any_other_first_line_is_hung_up_on_without_an_answer(server: ChannelServer, first: bytes) -> None:
    assert answer(server, first + HELLO + b'{"do": "it"}\n') == b""


@pytest.mark.parametrize("line", [
    b"x\n", b"[]\n", b"3\n", b"GET / HTTP/1.1\r\n", b"{" * 60_000 + b"\n", b'{"a": "' + b"b" * 200_000 + b'"}\n',
], ids=lambda line: repr(line[:40]))  # fmt: skip
def test_the_first_line_that_is_not_an_object_ends_the_connection(server: ChannelServer, line: bytes) -> None:
    assert answer(server, line + b'{"b": 2}\n', before=HELLO + b'{"a": 1}\n') == b'{"a": 1}\n'


@pytest.mark.parametrize("part", [b"", HELLO[:-1]], ids=["silent", "no line end"])
def test_a_client_without_a_whole_first_line_is_hung_up_on(
    server: ChannelServer, monkeypatch: pytest.MonkeyPatch, part: bytes
) -> None:
    monkeypatch.setattr(channel, "HELLO_S", 0.05)
    assert answer(server, part) == b""


@given(st.binary(max_size=100) | st.text(max_size=100).map(str.encode))
def test_a_line_of_any_content_is_an_object_or_none(line: bytes) -> None:
    message = parse_object(line)
    assert message is None or isinstance(message, dict)
