"""The place of a station: its lock and its connection file, from the start of its server to the end; and how it is found."""

import contextlib
import hashlib
import os
import socket
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import Event
from goniotwin.app.errors import UserError
from goniotwin.app.rig import OpenRig, RigDescription, read_rig
from goniotwin.app.rig.addresses import device_names
from goniotwin.app.rig.lock import PROBE_S, LockFile
from goniotwin.app.station.connection_file import (
    Connection,
    connection_folder,
    known_stations,
    lock_of,
    read_connection,
    write_connection,
)
from goniotwin.app.station.messages import Message, RigClosed, RunBegun
from goniotwin.app.station.orders import RunRecord
from goniotwin.app.station.runs import positions_every_s
from goniotwin.app.station.server import StationServer
from goniotwin.app.station.station import Station
from goniotwin.own_files import make_own_folder
from goniotwin.protocols.channel import PROTOCOL
from goniotwin.protocols.clock import Clock, calendar_stamp

LEAVING_S = 5.0
"""Longest time in which a run's program that has given back the devices ends."""


def connection_path(rig: RigDescription) -> Path:
    """The connection file of the station that has a rig: of its devices; of a virtual rig in the station, of its rig file."""
    if rig.file.in_process:
        places = [str(Path(rig.name).resolve())]
    else:
        places = sorted({name for address in rig.file.addresses for name in device_names(address)})
    return connection_folder() / f"{hashlib.sha256(repr(places).encode()).hexdigest()[:32]}.json"


def station_of(rig: Path) -> Path | None:
    """The connection file of the station that has the rig of a file; None if there is none. Raises UserError.

    It was started with that file, whatever that is now, or has its devices: a run that is resumed has the rig of the journal.
    """
    wanted = str(rig.absolute())
    found = next((path for path, each in known_stations().items() if each.rig == wanted), None)
    if found is None and (path := connection_path(read_rig(rig))).exists():
        return path
    return found


@contextlib.contextmanager
def serving(station: Station, rig: RigDescription) -> Iterator[StationServer]:
    """Serve a station, whose rig is open, to clients that find it by its file.

    The lock beside the file is held until the end: it shows clients that the station lives, and keeps a virtual rig of this
    process for this one. Other rigs are kept by the locks of their devices, so that a station which still has this one is
    ending. Raises RigInUse where another station has it, and UserError where its file cannot be written.
    """
    path = connection_path(rig)
    with contextlib.ExitStack() as stack:
        with _writing(path):
            make_own_folder(path.parent)
            patience_s = PROBE_S if rig.file.in_process else LEAVING_S
            lock = LockFile(lock_of(path), rig.name, f"station of {rig.file.name} ({rig.name})", 0o600, patience_s)
            stack.callback(lock.release, remove=True)
            path.unlink(missing_ok=True)  # of a station that has died: with this lock it would seem alive
        server = StationServer(station)
        about = Connection(
            PROTOCOL,
            os.getpid(),
            socket.gethostname(),
            server.port,
            server.token,
            str(Path(rig.name).absolute()),
            "",
            calendar_stamp(),
        )

        def write(_number: int, message: Message) -> None:
            nonlocal about
            if isinstance(message, RunBegun):
                about = replace(about, journal=str(message.journal))
                with contextlib.suppress(OSError):  # a full disk: the file leads to the station as before
                    write_connection(path, about)

        def remove() -> None:
            found = read_connection(path)
            if found is not None and found.pid == about.pid:
                path.unlink(missing_ok=True)

        stack.callback(remove)
        stack.callback(server.stop)
        server.start()
        with _writing(path):
            write_connection(path, about)
        station.board.subscribe(write)
        stack.callback(station.board.unsubscribe, write)
        yield server


@contextlib.contextmanager
def _writing(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise NotServed(f"{path}: the file of the station cannot be written: {error.strerror or error}") from None


class NotServed(UserError):
    """A station cannot be found by others: there is no place for its file."""


@contextlib.contextmanager
def hosted_run(speed: float, warn: Callable[[str], None] = lambda _: None) -> Iterator["HostedRun"]:
    """The host of one run of this program, which others can attach to from the opening of its rig to the end.

    `warn` gets the reason, in one line, where no client can.
    """
    with contextlib.ExitStack() as stack:
        yield HostedRun(speed, stack, warn)


class HostedRun:
    """The host of a run of this program (`campaign.RunHost`): rig and engine are the run's, and clients have its `station`."""

    def __init__(self, speed: float, stack: contextlib.ExitStack, warn: Callable[[str], None] = lambda _: None) -> None:
        self.station = Station(speed)
        self._stack = stack
        self._warn = warn
        self._server: StationServer | None = None

    @property
    def clients(self) -> list[str]:
        """The clients that are attached."""
        return self._server.clients if self._server is not None else []

    @property
    def positions_every_s(self) -> float:
        """Time between two reports of the positions, s."""
        return positions_every_s(self.station.clock)

    def clock_for(self, rig: RigDescription, start_s: float) -> Clock:
        """The clock on which the rig is opened."""
        return self.station.clock_for(rig, start_s)

    def adopt(self, opened: OpenRig, rig: RigDescription) -> None:
        """Hold the rig, and serve."""
        self.station.adopt(opened, rig)
        try:
            self._server = self._stack.enter_context(serving(self.station, rig))
        except NotServed as error:
            self._warn(f"no client can attach to this run: {error}")
        self._stack.callback(lambda: self.station.board.publish(RigClosed("the run's program has ended")))

    def report_connected(self) -> None:
        """All devices are connected, and the run is about to begin."""
        self.station.report_connected()

    def run_begun(self, engine: Engine, plan: Plan, journal: Journal, work: Sequence[Row]) -> None:
        """The engine is about to run."""
        self.station.runs.begin(engine, plan, journal, work, RunRecord(journal, self.station.clock))

    def listen(self, event: Event) -> None:
        """An event of the engine."""
        self.station.runs.listen(event)

    def wait_for_stops(self) -> None:
        """The engine has ended: return when no stop is in progress."""
        self.station.runs.wait_for_stops()
