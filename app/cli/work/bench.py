"""The station of a command: the one that has the rig already, or one of the command alone; and what `move` and `read` do.

`home` and `here` use the station that has the rig (`attached_bench`); without it they need one controller only (`referencing`).
"""

import contextlib
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from goniotwin.app.campaign.campaign import clock_for
from goniotwin.app.campaign.running.events import EventLogged, SafetyOrder
from goniotwin.app.cli.output import answer, print_order, print_warning
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, read_rig
from goniotwin.app.station.client import StationClient
from goniotwin.app.station.connection_file import attach
from goniotwin.app.station.hosting import connection_path
from goniotwin.app.station.messages import ActivityChanged, BenchReading, Message, Snapshot, encode
from goniotwin.app.station.station import Station
from goniotwin.drivers.errors import FaultText

WAIT_S = 0.2
SILENT = "its station is not responding; wait, or end its process (the main switch stops the motors)"


def move_axis(rig: Path, axis: str, angle: float) -> None:
    """Move an axis and print its position. Raises UserError, BenchFault."""
    with _bench(rig) as bench:
        error = bench.do("move", axis=axis, target_deg=angle)
        if error:
            raise BenchFault(error)
        position = bench.snapshot.positions.get(axis)
    print(f"{axis}: moved to {angle:g} deg" + ("" if position is None else f", at {position:.3f} deg"))


def read_devices(rig: Path, readings: int, gain: float | None, dark: bool, as_json: bool) -> None:
    """Read photodiodes and monitor, and print the values. Raises UserError, BenchFault."""
    with _bench(rig) as bench:
        error = bench.do("gain", v_per_a=gain) if gain is not None else ""
        error = error or bench.do("read", readings=readings, dark=dark)
        found = next((each for each in reversed(bench.events) if isinstance(each, BenchReading) and not each.live), None)
        if error or found is None:
            raise BenchFault(error or "no reading was taken")
    lines = [
        f"{k:3d}  {counts:10.1f}  " + ("saturated" if volts is None else f"{volts:9.5f} V")
        for k, (counts, volts) in enumerate(zip(found.counts, found.volts, strict=True))
    ]
    monitor = "no value" if found.monitor_a is None else f"{found.monitor_a:.6g} A"
    shutter = "shutter closed" if found.dark else "shutter open or unknown"
    head = f"gain {found.gain_v_per_a:g} V/A, {found.readings} readings, monitor {monitor}, {shutter}"
    answer(as_json, {k: v for k, v in encode(found).items() if k != "type"}, lambda: print("\n".join([head, *lines])))


class BenchFault(UserError):
    """A fault of a device during a command."""

    status = 1


class LocalBench:
    """A station of this command alone, in this thread; a virtual rig is on the virtual clock."""

    def __init__(self, station: Station) -> None:
        self.events: list[Message] = []
        self._station = station
        station.board.subscribe(lambda _number, message: self.events.append(message))

    @property
    def snapshot(self) -> Snapshot:
        """The state of the station."""
        return self._station.snapshot

    def do(self, command: str, **arguments: Any) -> str:
        """Have a command carried out to its end; return its fault, or an empty text. Ctrl-C stops all axes."""
        begun = len(self.events)
        getattr(self._station, command)(**arguments)
        try:
            self._station.work()
        except KeyboardInterrupt:
            self._station.stop()
            raise
        return next(iter(_ends(self.events[begun:])), "")


class RemoteBench:
    """A client of the station that has the rig; it waits for the end of what it has asked for."""

    def __init__(self) -> None:
        self.events: list[Message] = []
        self._changed = threading.Condition()
        self._ended = False
        self.client: StationClient

    @property
    def snapshot(self) -> Snapshot:
        """The state of the station."""
        return self.client.snapshot

    def wait_for_rig(self) -> None:
        """Wait until the station has connected its devices. Raises BenchFault where it has none any more."""
        with self._changed:
            while self.snapshot.rig is None and not self._ended:
                if self.snapshot.closed:
                    raise BenchFault(f"the station has no rig: {self.snapshot.closed}")
                self._changed.wait(WAIT_S)

    def note(self, message: Message) -> None:
        """Take an event."""
        with self._changed:
            self.events.append(message)
            self._changed.notify_all()

    def end(self) -> None:
        """The station has ended."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def finish(self, command: str, **arguments: Any) -> None:
        """Have a command carried out to its end. Raises BenchFault."""
        if error := self.do(command, **arguments):
            raise BenchFault(error)

    def do(self, command: str, **arguments: Any) -> str:
        """Have a command carried out to its end; return its fault, or an empty text. Ctrl-C stops all axes."""
        begun = len(self.events)
        try:
            self.client.do(command, **arguments)
            with self._changed:
                while not (ends := _ends(self.events[begun:])):
                    if self._ended:
                        raise BenchFault("the station has ended")
                    self._changed.wait(WAIT_S)  # in pieces: on Windows a wait without a limit hears no signal
        except TimeoutError:
            raise BenchFault(SILENT) from None
        except KeyboardInterrupt:
            self.client.do("stop")
            raise
        return ends[0]


def _ends(events: list[Message]) -> list[str]:
    """The faults, or empty texts, with which activities have ended."""
    return [
        str(FaultText(each.error, each.detail)) for each in events if isinstance(each, ActivityChanged) and not each.activity
    ]


@contextlib.contextmanager
def _bench(rig: Path) -> Iterator[LocalBench | RemoteBench]:
    """The station that has a rig; without one, a station of this command alone. Raises UserError."""
    description = read_rig(rig)
    with attached_bench(description) as remote:
        if remote is not None:
            yield remote
            return
    with _station(description) as station:
        yield LocalBench(station)


@contextlib.contextmanager
def attached_bench(rig: RigDescription) -> Iterator[RemoteBench | None]:
    """The station that has a rig, with its devices connected; None where there is none. Raises UserError."""
    remote = RemoteBench()
    try:
        client = attach(connection_path(rig), "goniotwin command", remote.note, remote.end)
    except TimeoutError:
        raise UserError(f"{rig.name}: {SILENT}") from None
    if client is None:
        yield None
        return
    remote.client = client
    client.start()
    try:
        remote.wait_for_rig()
        for order in remote.snapshot.orders:
            print_order(order.text)
        held = remote.snapshot.rig
        if held is not None and held.digest != rig.digest:
            raise UserError(
                f"{rig.name}: its devices are in use by a station of another rig file, or it has changed since: {held.path}; "
                "disconnect that station first"
            )
        yield remote
    finally:
        client.close()


@contextlib.contextmanager
def _station(rig: RigDescription) -> Iterator[Station]:
    station = Station(clock=clock_for(rig.file))
    station.board.subscribe(lambda _number, message: print_shutter(message))
    station.open(rig)
    try:
        station.connect_all()
        opened = station.snapshot.rig
        for name in opened.not_responding if opened is not None else []:
            assert opened is not None
            print_warning(opened.devices[name].text)
        yield station
    finally:
        station.close_rig()


def print_shutter(message: Message) -> None:
    """Print what a session does about a shutter that another one has left open, and each safety order."""
    if isinstance(message, SafetyOrder):
        print_order(message.text)
    elif isinstance(message, EventLogged) and message.kind == "guardian":
        print_warning(message.what)
