"""The station's end of the channel: its clients, one of which operates, and the translation of lines into commands.

A client sends `{"do": COMMAND, "id": NUMBER, ...}` with the arguments of the command, and gets `{"answer": NUMBER, "ok": true}`
or `{"answer": NUMBER, "error": REASON}`. A command that begins something may have `stops`, the number of stops that its client
knew; it is refused after another. A stop is carried out by the thread that reads its line, at once; it gets
`{"received": NUMBER}` before, and its answer when the axes have confirmed. What lasts is reported by events,
`{"event": NUMBER, "type": ..., ...}`, which follow the snapshot that answers the client's proof.
"""

import json
import threading
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError, validate_call

from goniotwin.app.errors import one_line
from goniotwin.app.station.messages import NEWEST_ONLY, Message, encode
from goniotwin.app.station.permissions import COMMANDS, EVERYBODYS, OF_BENCH, STOPPED, CommandRefused, allowed, watching
from goniotwin.app.station.station import Station
from goniotwin.protocols.channel import HELLO_S, LONGEST_LINE, Channel, ChannelServer, new_token
from goniotwin.protocols.clock import RealClock

DROPPED = "it did not read what was sent"
MOST_DROPPED = 100
Line = dict[str, Any] | tuple[int, Message]
"""An object to send, or an event with its number."""
METHODS = {"continue": "resume_journal"}
"""Commands whose methods have another name."""


class Outbox:
    """Lines that wait for one client, `most` of them, and the thread that sends them. `dropped` is called for one more."""

    def __init__(self, channel: Channel, most: int, dropped: Callable[[], None]) -> None:
        self._channel = channel
        self._most, self._dropped = most, dropped
        self._lines: deque[tuple[str, Line]] = deque()
        self._ready = threading.Condition()
        self._open = True
        self._thread = threading.Thread(target=self._work, name="outbox", daemon=True)
        self._thread.start()

    def put(self, line: Line, newest_of: str = "") -> None:
        """Send a line soon; it takes the place of one that waits with the same `newest_of`. Returns at once.

        An event is made a line in the thread of the outbox: the engine's thread publishes it and has other work.
        """
        with self._ready:
            if not self._open:
                return
            if newest_of:
                for at, (other, _) in enumerate(self._lines):
                    if other == newest_of:
                        del self._lines[at]
                        break
            self._lines.append((newest_of, line))
            full = len(self._lines) > self._most
            if full:
                self._open = False
            self._ready.notify()
        if full:
            self._dropped()
            self._channel.hang_up()

    def close(self) -> None:
        """Send what waits, as far as the client reads it, and end the thread."""
        with self._ready:
            self._open = False
            self._ready.notify()

    def join(self, timeout_s: float) -> None:
        """Wait for the end of the thread."""
        self._thread.join(timeout_s)

    def _work(self) -> None:
        while True:
            with self._ready:
                while self._open and not self._lines:
                    self._ready.wait()
                if not self._lines:
                    return
                _, line = self._lines.popleft()
            try:
                self._channel.send(_line(line))
            except OSError:
                with self._ready:
                    self._open = False
                    self._lines.clear()


@dataclass(frozen=True)
class ClientLimits:
    """What a station grants to its clients."""

    hello_s: float = HELLO_S
    clients: int = 64
    """Each has two threads and a socket, and the run needs files."""
    waiting: int = 2000
    """Lines that wait for a client. At 100 rows a second, a window that paints for ten seconds is still there."""


class StationServer:
    """Serves a station to clients on this computer. `token` opens it, on `port`.

    `unattended_s` is the real time since the last client has left, 0 while there is one.
    """

    def __init__(self, station: Station, port: int = 0, limits: ClientLimits = ClientLimits()) -> None:
        self.token = new_token()
        self._station, self._limits = station, limits
        self._server = ChannelServer("station", self.token, self._serve, port, limits.hello_s)
        self._clients: dict[str, tuple[Channel, Outbox]] = {}
        self._dropped: OrderedDict[str, str] = OrderedDict()
        self._lock = threading.Lock()
        self._number = 0
        self._clock = RealClock()
        self._alone_since = self._clock.now()
        self._commands = {name: validate_call(getattr(station, METHODS.get(name, name))) for name in COMMANDS}

    @property
    def port(self) -> int:
        """Port number."""
        return self._server.port

    @property
    def clients(self) -> list[str]:
        """The clients that are attached."""
        with self._lock:
            return list(self._clients)

    @property
    def unattended_s(self) -> float:
        """Real time without a client, s."""
        with self._lock:
            return 0.0 if self._clients else self._clock.now() - self._alone_since

    def start(self) -> None:
        """Start serving."""
        self._server.start()

    def stop(self) -> None:
        """Send what waits, end all connections and release the port."""
        with self._lock:
            clients = list(self._clients.values())
        for _, outbox in clients:
            outbox.close()
        for channel, outbox in clients:
            outbox.join(0.5)
            channel.hang_up()
        self._server.stop()

    def _serve(self, channel: Channel) -> None:
        if len(self.clients) >= self._limits.clients:
            channel.send({"error": f"{self._limits.clients} clients are attached to the station; close one"})
            return
        client = ""
        outbox = Outbox(channel, self._limits.waiting, lambda: self._drop(client))

        def listen(number: int, message: Message) -> None:
            newest = type(message).__name__ if isinstance(message, NEWEST_ONLY) else ""
            outbox.put((number, message), newest)

        with self._station.board.deciding() as snapshot:
            self._station.board.subscribe(listen)
            with self._lock:
                client = self._name(channel.hello)
                self._clients[client] = channel, outbox
                left = self._dropped.pop(client, "")
            outbox.put({"client": client, "dropped": left, "t_s": self._station.now_s, "snapshot": encode(snapshot)})
        try:
            while (line := channel.receive()) is not None:
                self._obey(client, line, outbox)
        finally:
            self._station.board.unsubscribe(listen)
            outbox.close()
            with self._lock:
                del self._clients[client]
                if not self._clients:
                    self._alone_since = self._clock.now()
            with self._station.board.deciding() as snapshot:
                if snapshot.operator == client:
                    self._station.operate("")

    def _name(self, hello: dict[str, Any]) -> str:
        """The name of a client: that of its hello, if it is free, or with a number."""
        wanted = hello.get("client")
        name = wanted = one_line(wanted)[:80] if isinstance(wanted, str) and wanted else "client"
        while name in self._clients:
            self._number += 1
            name = f"{wanted} ({self._number})"
        return name

    def _drop(self, client: str) -> None:
        with self._lock:
            self._dropped[client] = DROPPED
            while len(self._dropped) > MOST_DROPPED:
                self._dropped.popitem(last=False)

    def _obey(self, client: str, line: dict[str, Any], outbox: Outbox) -> None:
        """Carry out a command; a stop before anything else."""
        number, name = line.pop("id", None), line.pop("do", None)
        if not isinstance(number, int | str):
            number = None
        if name == "stop":
            outbox.put({"received": number})
            failures = self._station.stop()
            outbox.put({"answer": number, "ok": True, "failures": failures})
            return
        try:
            self._command(client, name, line)
            outbox.put({"answer": number, "ok": True})
        except CommandRefused as error:
            outbox.put({"answer": number, "error": str(error)})
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(map(str, first["loc"]))
            outbox.put({"answer": number, "error": one_line(f"{name}: {place}: {first['msg']}")})
        except Exception as error:  # noqa: BLE001  (whatever a command raises, the client gets an answer)
            outbox.put({"answer": number, "error": one_line(f"{name}: {type(error).__name__}: {error}")})

    def _command(self, client: str, name: Any, arguments: dict[str, Any]) -> None:
        if not isinstance(name, str) or name not in self._commands:
            raise CommandRefused(f"there is no command {name!r}; give one of {', '.join(sorted(self._commands))}")
        for argument, value in arguments.items():
            if isinstance(value, str) and not _is_text(value):
                raise CommandRefused(f"{name}: {one_line(argument)}: has characters that no name has")
        if name == "operate":
            self._station.operate(client)
            return
        stops = arguments.pop("stops", None)
        with self._station.board.deciding() as snapshot:
            if reason := watching(snapshot, client, name):
                raise CommandRefused((allowed(snapshot)[name] if name in OF_BENCH else "") or reason)
            if name not in EVERYBODYS and not snapshot.operator:
                self._station.operate(client)
            if name in OF_BENCH:  # accepted or refused before the next stop is counted
                if stops not in (None, snapshot.stops):
                    raise CommandRefused(STOPPED)
                self._commands[name](**arguments)
                return
        self._commands[name](**arguments)


def _is_text(value: str) -> bool:
    return "\0" not in value and not any("\ud800" <= letter <= "\udfff" for letter in value)


def _line(line: Line) -> dict[str, Any]:
    """The object of a line; one that is too long for the channel, or is no text, is a note in its place."""
    try:
        content = line if isinstance(line, dict) else {"event": line[0], **encode(line[1])}
    except ValueError:
        content = {"event": line[0]} if isinstance(line, tuple) else {}
    else:
        if len(json.dumps(content)) <= LONGEST_LINE:
            return content
    known: dict[str, Any] = {key: content[key] for key in ("event", "answer") if key in content}
    return {**known, "type": "TooLong"}
