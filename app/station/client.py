"""A client of a station: its snapshot, kept by the events, and the commands. Light: it loads no driver and no numerics."""

import contextlib
import itertools
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from goniotwin.app.errors import UserError
from goniotwin.app.station.messages import Message, Snapshot, advance, decode
from goniotwin.protocols.channel import PROTOCOL, Channel, connect

ANSWER_S = 10.0
"""Longest time in which a station answers the hello, or a command that is waited for."""


class Refused(UserError):
    """A command that the station has refused; the message is its reason."""


class NoStation(UserError):
    """There is no station at a port, or it has ended."""


class StationClient:
    """One attached client. `on_event` gets each event, `on_end` the end of the connection, in the thread that reads.

    `snapshot` is the state of the station as the events so far give it. `name` is this client's at the station; `dropped` is
    why an earlier connection of that name was ended by the station, or empty.
    """

    def __init__(
        self,
        port: int,
        token: str,
        name: str,
        on_event: Callable[[Message], None] = lambda _: None,
        on_end: Callable[[], None] = lambda: None,
    ) -> None:
        """Attach. Raises NoStation where nothing answers as a station with this token does, TimeoutError where it is silent."""
        try:
            self._channel: Channel = connect(port, token, ANSWER_S, client=name)
        except TimeoutError:
            raise
        except OSError as error:
            raise NoStation(f"no station answers at port {port}: {error.strerror or error}") from None
        try:
            first = self._channel.receive(ANSWER_S)
            content = first.get("snapshot") if first is not None and first.get("protocol") == PROTOCOL else None
            snapshot = decode(content) if isinstance(content, dict) else None
            if first is None or not isinstance(snapshot, Snapshot):
                raise NoStation(f"what answers at port {port} is no station with this token")
        except (NoStation, ValueError, OSError) as error:
            self._channel.close()
            if isinstance(error, NoStation | TimeoutError):
                raise
            raise NoStation(f"what answers at port {port} is no station of this version: {error}") from None
        self._channel.wait_without_limit()
        self.snapshot = snapshot
        self.name = str(first.get("client", name))
        self.dropped = str(first.get("dropped", ""))
        self.ended = False
        self._on_event, self._on_end = on_event, on_end
        self._numbers = itertools.count(1)
        self._sending = threading.Lock()
        self._waiting: dict[int, tuple[Future[dict[str, Any]], Callable[[], None] | None]] = {}
        self._thread = threading.Thread(target=self._read, name="station client", daemon=True)

    def start(self) -> None:
        """Read what the station sends, from now on."""
        self._thread.start()

    @property
    def operates(self) -> bool:
        """Whether this client operates the rig, or the place is free."""
        return self.snapshot.operator in ("", self.name)

    def send(self, command: str, *, received: Callable[[], None] | None = None, **arguments: Any) -> "Future[dict[str, Any]]":
        """Send a command; the future has its answer, or raises Refused, or NoStation where the connection ends.

        The line is written before anything else is done. `received` is called when a stop has reached the station.
        """
        number = next(self._numbers)
        future: Future[dict[str, Any]] = Future()
        self._waiting[number] = future, received
        try:
            with self._sending:
                self._channel.send({"do": command, "id": number, **arguments})
        except OSError as error:
            self._waiting.pop(number, None)
            future.set_exception(NoStation(f"{command}: the station does not answer: {error.strerror or error}"))
        if self.ended and self._waiting.pop(number, None) is not None:  # it ended in between
            future.set_exception(NoStation(f"{command}: the station has ended"))
        return future

    def do(self, command: str, **arguments: Any) -> dict[str, Any]:
        """Send a command and wait for its answer. Raises Refused, NoStation, TimeoutError."""
        return self.send(command, **arguments).result(ANSWER_S)

    def close(self) -> None:
        """Leave the station, which goes on."""
        self._channel.hang_up()
        if self._thread.is_alive() and threading.current_thread() is not self._thread:
            self._thread.join()
        self._channel.close()

    def _read(self) -> None:
        try:
            with contextlib.suppress(OSError, ValueError):
                while (line := self._channel.receive()) is not None:
                    self._take(line)
        finally:  # also after an error here: a client that reads no more must not look attached
            self.ended = True
            self._channel.close()
            for number in list(self._waiting):
                if (waiting := self._waiting.pop(number, None)) is not None:
                    waiting[0].set_exception(NoStation("the station has ended"))
            self._on_end()

    def _take(self, line: dict[str, Any]) -> None:
        if "event" in line:
            message = decode(line)
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
