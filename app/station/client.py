"""A client of a station: its snapshot, kept by the events, and the commands. Light: it loads no driver and no numerics."""

import contextlib
import itertools
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from goniotwin.app.errors import UserError
from goniotwin.app.station.messages import Message, Snapshot, advance, decode
from goniotwin.app.station.permissions import OF_BENCH
from goniotwin.protocols.channel import Channel, NotProved, connect

ATTACH_S = 5.0
"""Longest time of each answer until a client is attached."""
ANSWER_S = 10.0
"""The same for a command that is waited for."""
LEAVE_S = 1.0
"""Longest wait for the station to note that a client leaves: it has more to do than that, or hangs."""


class Refused(UserError):
    """A command, or a client, that the station has refused; the message is its reason."""


class NoStation(UserError):
    """There is no station at a port, or it has ended."""


class StationClient:
    """One attached client. `on_event` gets each event, `on_end` the end of the connection, in the thread that reads.

    `snapshot` is the state of the station as the events so far give it, `attached_s` the time of the rig's clock before them.
    `name` is this client's at the station; `dropped` is why an earlier connection of that name was ended by the station, or
    empty.
    """

    def __init__(
        self,
        port: int,
        token: str,
        name: str,
        on_event: Callable[[Message], None] = lambda _: None,
        on_end: Callable[[], None] = lambda: None,
    ) -> None:
        """Attach. Raises NoStation where nothing that proves the token answers, TimeoutError where it is silent.

        Raises Refused where the station takes no more clients, or is of another version.
        """
        try:
            self._channel: Channel = connect(port, token, ATTACH_S, client=name)
            with contextlib.ExitStack() as otherwise:
                otherwise.callback(self._channel.close)
                first = self._channel.receive(ATTACH_S) or {}
                self.snapshot = _snapshot_of(first, port)
                otherwise.pop_all()
        except TimeoutError:
            raise
        except NotProved as error:
            raise NoStation(str(error)) from None
        except OSError as error:
            raise NoStation(f"no station answers at port {port}: {error.strerror or error}") from None
        self._channel.wait_at_most(None)
        self.name = str(first.get("client", name))
        self.dropped = str(first.get("dropped", ""))
        self.attached_s = float(first.get("t_s", 0.0))
        self.ended = False
        self._on_event, self._on_end = on_event, on_end
        self._numbers = itertools.count(1)
        self._sending = threading.Lock()
        self._waiting: dict[int, tuple[Future[dict[str, Any]], Callable[[], None] | None]] = {}
        self._thread = threading.Thread(target=self._read, name="station client", daemon=True)

    def start(self) -> None:
        """Read what the station sends, from now on."""
        self._thread.start()

    def send(self, command: str, *, received: Callable[[], None] | None = None, **arguments: Any) -> "Future[dict[str, Any]]":
        """Send a command; the future has its answer, or raises Refused, or NoStation where the connection ends.

        The line is written before anything else is done. `received` is called when a stop has reached the station. What begins
        something is refused after a stop that is not in `snapshot` yet, or beyond the argument `stops`.
        """
        if command in OF_BENCH:
            arguments.setdefault("stops", self.snapshot.stops)
        number = next(self._numbers)
        future: Future[dict[str, Any]] = Future()
        self._waiting[number] = future, received
        try:
            with self._sending:
                self._channel.send({"do": command, "id": number, **arguments})
        except OSError as error:
            self._fail(number, f"{command}: the station does not answer: {error.strerror or error}")
        if self.ended:  # in between
            self._fail(number, f"{command}: the station has ended")
        return future

    def do(self, command: str, **arguments: Any) -> dict[str, Any]:
        """Send a command and wait for its answer. Raises Refused, NoStation, TimeoutError."""
        return self.send(command, **arguments).result(ANSWER_S)

    def close(self, leave_s: float = LEAVE_S) -> None:
        """Leave the station, which goes on. If this client operates, its place is free then: the next may come at once."""
        self._channel.end_sending()
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join(leave_s)
            self._channel.hang_up()
            self._thread.join()
        self._channel.close()

    def _read(self) -> None:
        try:
            with contextlib.suppress(OSError):  # a broken connection
                while (line := self._channel.receive()) is not None:
                    self._take(line)
        finally:
            self.ended = True
            self._channel.close()
            for number in list(self._waiting):
                self._fail(number, "the station has ended")
            self._on_end()

    def _fail(self, number: int, reason: str) -> None:
        """Give up a command, unless it has been answered or given up in another thread."""
        if (waiting := self._waiting.pop(number, None)) is not None:
            waiting[0].set_exception(NoStation(reason))

    def _take(self, line: dict[str, Any]) -> None:
        if "event" in line:
            try:
                message = decode(line)
            except ValueError:  # of another version, as one whose type is unknown: Stop has to work all the same
                return
            if message is not None and not isinstance(message, Snapshot):
                self.snapshot = advance(self.snapshot, message)
                self._on_event(message)
        elif "received" in line:
            waiting = self._waiting.get(line["received"])
            if waiting is not None and waiting[1] is not None:
                waiting[1]()
        elif (waiting := self._waiting.pop(line.get("answer", 0), None)) is not None:
            future = waiting[0]
            if line.get("ok"):
                future.set_result(line)
            else:
                future.set_exception(Refused(str(line.get("error", "refused"))))


def _snapshot_of(first: dict[str, Any], port: int) -> Snapshot:
    """The snapshot of a station's first line. Raises NoStation, Refused."""
    if not first:
        raise NoStation(f"the station at port {port} has ended")
    if "error" in first:
        raise Refused(str(first["error"]))
    try:
        content = first.get("snapshot")
        snapshot = decode(content) if isinstance(content, dict) else None
    except ValueError as error:
        raise Refused(f"the station at port {port} is of another version: {error}") from None
    if not isinstance(snapshot, Snapshot):
        raise Refused(f"the station at port {port} is of another version: its first line has no snapshot")
    return snapshot
