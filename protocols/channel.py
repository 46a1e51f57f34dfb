"""The channel between programs of one computer: JSON objects, one a line, over TCP on loopback, opened by a token.

The first line of a client is `{"protocol": 1, "token": ...}`, within `HELLO_S`. Any other first line, any later line that is
not a JSON object and any line longer than `LONGEST_LINE` end the connection without an answer: everything on this computer
can connect to the port, a web page's POST included, and none of it may be obeyed or learn what it is talking to.
"""

import contextlib
import hmac
import json
import secrets
import socket
import socketserver
from collections.abc import Callable
from typing import Any

from goniotwin.protocols.clock import RealClock
from goniotwin.protocols.loopback import LOOPBACK, LoopbackServer

PROTOCOL = 1
LONGEST_LINE = 65_536
HELLO_S = 2.0
"""Real time in which the first line has to come, whole."""
CHUNK = 65_536
Message = dict[str, Any]


def new_token() -> str:
    """A token that cannot be guessed, for one server."""
    return secrets.token_urlsafe(24)


class Channel:
    """One end of a connection."""

    def __init__(self, connection: socket.socket) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # a line is sent at once
        self._connection = connection
        self._received = b""
        self.hello: Message = {}
        """The first line of a client, on its server's side."""
        self._clock = RealClock()

    def send(self, message: Message) -> None:
        """Send an object. Raises OSError."""
        self._connection.sendall(json.dumps(message).encode() + b"\n")

    def receive(self, within_s: float | None = None) -> Message | None:
        """The next object; None at the end of the connection, and for a line that is none.

        `within_s` is the longest time for the whole line. Raises TimeoutError after it, other OSErrors of a broken connection.
        """
        deadline = None if within_s is None else self._clock.now() + within_s
        while b"\n" not in self._received:
            if len(self._received) > LONGEST_LINE:
                return None
            if deadline is not None:
                if (left := deadline - self._clock.now()) <= 0.0:
                    raise TimeoutError("no whole line in time")
                self._connection.settimeout(left)
            data = self._connection.recv(CHUNK)
            if not data:
                return None
            self._received += data
        line, _, self._received = self._received.partition(b"\n")
        return parse_object(line) if len(line) <= LONGEST_LINE else None

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()

    def hang_up(self) -> None:
        """End the connection, for a thread that waits in `receive` or `send` too. From any thread."""
        with contextlib.suppress(OSError):
            self._connection.shutdown(socket.SHUT_RDWR)

    def wait_without_limit(self) -> None:
        """From now on `send` and `receive` wait as long as it takes."""
        self._connection.settimeout(None)


def parse_object(line: bytes) -> Message | None:
    """The JSON object in a line of any content; None if it is none."""
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):  # of JSON, of UTF-8, of a number with thousands of digits; nested too deeply
        return None
    return message if isinstance(message, dict) else None


class ChannelServer(LoopbackServer):
    """A server of channels, one thread for each client: `serve` has its channel from the right hello until it returns."""

    def __init__(self, name: str, token: str, serve: Callable[[Channel], None], port: int = 0) -> None:
        class Handler(socketserver.BaseRequestHandler):
            def handle(self) -> None:
                with contextlib.suppress(OSError):
                    channel = Channel(self.request)
                    hello = channel.receive(HELLO_S)
                    if hello is not None and _is_hello(hello, token):
                        channel.hello = hello
                        channel.wait_without_limit()
                        serve(channel)

        super().__init__(name, Handler, port)
        self.token = token


def connect(port: int, token: str, timeout_s: float, **about: object) -> Channel:
    """A client's end, its hello sent, with what else it states. Its waits last at most `timeout_s`. Raises OSError."""
    channel = Channel(socket.create_connection((LOOPBACK, port), timeout=timeout_s))
    try:
        channel.send({"protocol": PROTOCOL, "token": token, **about})
    except OSError:
        channel.close()
        raise
    return channel


def _is_hello(message: Message, token: str) -> bool:
    if message.get("protocol") is True or message.get("protocol") != PROTOCOL:
        return False
    given = message.get("token")
    return isinstance(given, str) and hmac.compare_digest(given.encode(errors="replace"), token.encode())
