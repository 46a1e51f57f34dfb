"""The channel between programs of one computer: JSON objects, one a line, over TCP on loopback, opened by a token.

Both sides prove that they know the token; neither sends it. The first line of a client is `{"protocol": 2, "nonce": ...}`,
the server answers `{"protocol": 2, "nonce": ..., "proof": ...}`, and only after that proof the client sends its own,
`{"proof": ...}`: see `proof`. Both lines of a client have to come within `HELLO_S`. Any other line in their places, any later
line that is not a JSON object and any line longer than `LONGEST_LINE` end the connection without an answer: everything on this
computer can connect to the port, a web page's POST included, and none of it may be obeyed. And the port of a server that has
died may be another program's, of another user too: a client sends it no secret and no command, and believes nothing of it.
"""

import contextlib
import hmac
import json
import re
import secrets
import socket
import socketserver
import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, Literal, TypeGuard

from goniotwin.protocols.clock import RealClock
from goniotwin.protocols.loopback import LOOPBACK, LoopbackServer

PROTOCOL = 2
LONGEST_LINE = 65_536
HELLO_S = 2.0
"""Real time in which a client has to prove the token."""
MOST_UNPROVED = 64
"""Connections that have not proved the token yet: one more ends the oldest of them."""
CHUNK = 65_536
NONCE_BYTES = 32
NONCE = re.compile(f"[0-9a-f]{{{2 * NONCE_BYTES}}}")
Message = dict[str, Any]
Role = Literal["client", "server"]


class NotProved(ConnectionError):
    """What answers at a port has not proved that it knows the token."""

    def __init__(self, port: int) -> None:
        super().__init__(f"what answers at port {port} does not have the token of the server that this program looks for")


def new_token() -> str:
    """A token that cannot be guessed, for one server."""
    return secrets.token_urlsafe(24)


def proof(token: str, role: Role, port: int, client_nonce: str, server_nonce: str) -> str:
    """The proof of a side that it knows the token: HMAC-SHA256 with the token as the key, 64 hexadecimal digits.

    The role in it keeps a side from sending back the other's proof, the nonces keep it to one connection. The port is the
    one that the client connects to and the server listens at: a program at another port cannot pass the proofs on.
    """
    line = f"goniotwin {PROTOCOL} {role} {port} {client_nonce} {server_nonce}"
    return hmac.new(token.encode(errors="replace"), line.encode(), "sha256").hexdigest()


def is_protocol(value: object) -> bool:
    """Whether a value of JSON is the number of this protocol: the integer, neither 2.0 nor "2" nor true."""
    return type(value) is int and value == PROTOCOL


class Channel:
    """One end of a connection."""

    def __init__(self, connection: socket.socket) -> None:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # a line is sent at once
        self._connection = connection
        self._received = b""
        self.hello: Message = {}
        """The line of a client with its proof, on its server's side: what it states of itself."""
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

    def end_sending(self) -> None:
        """Send no more; what the other end sends is received until it closes, too."""
        with contextlib.suppress(OSError):
            self._connection.shutdown(socket.SHUT_WR)

    def wait_at_most(self, timeout_s: float | None) -> None:
        """From now on `send` and each part of `receive` wait so long, or without a limit."""
        self._connection.settimeout(timeout_s)


def parse_object(line: bytes) -> Message | None:
    """The JSON object in a line of any content; None if it is none."""
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):  # of JSON, of UTF-8, of a number with thousands of digits; nested too deeply
        return None
    return message if isinstance(message, dict) else None


class ChannelServer(LoopbackServer):
    """A server of channels, one thread for each client: `serve` has its channel from the client's proof until it returns.

    Both lines of a client have to come within `hello_s`.
    """

    def __init__(
        self, name: str, token: str, serve: Callable[[Channel], None], port: int = 0, hello_s: float = HELLO_S
    ) -> None:
        def handle(connection: socket.socket) -> None:
            with contextlib.suppress(OSError):
                channel = Channel(connection)
                with self._waiting_for_proof(channel):
                    proved = self._prove(channel)
                if proved:
                    channel.wait_at_most(None)
                    serve(channel)

        class Handler(socketserver.BaseRequestHandler):
            def handle(self) -> None:
                handle(self.request)

        super().__init__(name, Handler, port)
        self.token, self._hello_s = token, hello_s
        self._unproved = deque[Channel]()
        self._lock = threading.Lock()

    @contextlib.contextmanager
    def _waiting_for_proof(self, channel: Channel) -> Iterator[None]:
        """Count a connection without a proof. The oldest of too many is ended: one that has the token needs no time."""
        with self._lock:
            self._unproved.append(channel)
            oldest = self._unproved.popleft() if len(self._unproved) > MOST_UNPROVED else None
        if oldest is not None:
            oldest.hang_up()
        try:
            yield
        finally:
            with self._lock, contextlib.suppress(ValueError):
                self._unproved.remove(channel)

    def _prove(self, channel: Channel) -> bool:
        """Prove the token to a client, then have it do so. Raises OSError, TimeoutError for a slow client included."""
        clock = RealClock()
        first = channel.receive(self._hello_s)
        if first is None or not is_protocol(first.get("protocol")) or not _is_nonce(nonce := first.get("nonce")):
            return False
        own = _new_nonce()
        answer = proof(self.token, "server", self.port, nonce, own)
        channel.send({"protocol": PROTOCOL, "nonce": own, "proof": answer})
        channel.hello = channel.receive(self._hello_s - clock.now()) or {}
        return _is_proof(channel.hello.get("proof"), proof(self.token, "client", self.port, nonce, own))


def connect(port: int, token: str, timeout_s: float, **about: object) -> Channel:
    """A client's end, after both proofs, with what else it states. Its waits last at most `timeout_s`.

    Raises NotProved where what answers does not prove the token, and other OSErrors.
    """
    channel = Channel(socket.create_connection((LOOPBACK, port), timeout=timeout_s))
    try:
        own = _new_nonce()
        channel.send({"protocol": PROTOCOL, "nonce": own})
        answer = channel.receive(timeout_s) or {}
        if not is_protocol(answer.get("protocol")) or not _is_nonce(nonce := answer.get("nonce")):
            raise NotProved(port)
        if not _is_proof(answer.get("proof"), proof(token, "server", port, own, nonce)):
            raise NotProved(port)
        channel.wait_at_most(timeout_s)
        channel.send({"proof": proof(token, "client", port, own, nonce), **about})
    except OSError:
        channel.close()
        raise
    return channel


def _new_nonce() -> str:
    return secrets.token_hex(NONCE_BYTES)


def _is_nonce(value: object) -> TypeGuard[str]:
    return isinstance(value, str) and NONCE.fullmatch(value) is not None


def _is_proof(given: object, right: str) -> bool:
    """Whether a value of JSON is a proof, compared in constant time."""
    return isinstance(given, str) and hmac.compare_digest(given.encode(errors="replace"), right.encode())
