"""Commands of the bench: `goniotwin station`, `move` and `read`. A rig that a station has is used through it.

`home` and `here` do so too (`attached_bench`); without a station they need one controller only, and are in `instrument`.
"""

import contextlib
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from goniotwin.app.cli.output import Json, RigOption, Speed, answer, print_order, print_warning
from goniotwin.app.errors import UserError

if TYPE_CHECKING:
    from goniotwin.app.rig import RigDescription
    from goniotwin.app.station.client import StationClient
    from goniotwin.app.station.messages import Message, Snapshot
    from goniotwin.app.station.station import Station

WAIT_S = 0.2
SILENT = "its station does not answer; wait, or end its process (the main switch stops the motors)"

app = typer.Typer()


@app.command()
def station(
    rig: RigOption,
    speed: Speed = 1.0,
    unattended: Annotated[
        float, typer.Option("--unattended", metavar="S", min=0.0, help="Real time without a client after which it ends.")
    ] = 60.0,
) -> None:
    """Hold a rig for windows and terminals.

    The window starts one by itself. A campaign goes on in the station when the window is closed or has crashed; the next
    window attaches to it. Ctrl-C and SIGTERM stop a campaign in order, close the shutter and give the rig back.

    Exit status: 0 after a disconnect or without clients, 130 after a signal.
    """
    # Loads 836 modules, numba and pymodbus among them: 1.1 s, which help does without.
    from goniotwin.app.station.process import run_station

    def log(line: str) -> None:
        print(line, flush=True)

    if run_station(rig, speed, log, unattended):
        raise typer.Exit(130)


@app.command(context_settings={"ignore_unknown_options": True})  # -10 is an angle
def move(
    rig: RigOption,
    axis: Annotated[str, typer.Argument(metavar="AXIS", help="gamma, sigma, beta or shift.", show_default=False)],
    angle: Annotated[float, typer.Argument(metavar="DEG", help="Target, deg.", show_default=False)],
) -> None:
    """Move an axis to an angle.

    Within the soft limits of the rig file. Ctrl-C stops all axes.

    Exit status: 0 when it has arrived, 1 after a fault.
    """
    with _bench(rig) as bench:
        error = bench.do("move", axis=axis, target_deg=angle)
        if error:
            raise BenchFault(error)
        position = bench.snapshot.positions.get(axis)
    print(f"{axis}: moved to {angle:g} deg" + ("" if position is None else f", at {position:.3f} deg"))


@app.command()
def read(
    rig: RigOption,
    readings: Annotated[int, typer.Option("--readings", metavar="N", min=1, max=1000, help="Readings to average.")] = 1,
    gain: Annotated[
        float | None, typer.Option("--gain", metavar="V/A", help="Gain of the amplifiers, V/A.", show_default=False)
    ] = None,
    dark: Annotated[bool, typer.Option("--dark", help="Close the shutter for it.")] = False,
    as_json: Json = False,
) -> None:
    """Read all photodiodes and the monitor once.

    Pose, wavelength and shutter stay as they are.

    Exit status: 0 with the values, 1 after a fault.
    """
    # Loads 156 modules, numpy and pydantic among them: 0.1 s, which help does without.
    from goniotwin.app.station.messages import BenchReading, encode

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

    def __init__(self, station: "Station") -> None:
        self.events: list[Message] = []
        self._station = station
        station.board.subscribe(lambda _number, message: self.events.append(message))

    @property
    def snapshot(self) -> "Snapshot":
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
    def snapshot(self) -> "Snapshot":
        """The state of the station."""
        return self.client.snapshot

    def wait_for_rig(self) -> None:
        """Wait until the station has connected its devices. Raises BenchFault where it has none any more."""
        with self._changed:
            while self.snapshot.rig is None and not self._ended:
                if self.snapshot.closed:
                    raise BenchFault(f"the station has no rig: {self.snapshot.closed}")
                self._changed.wait(WAIT_S)

    def note(self, message: "Message") -> None:
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


def _ends(events: "list[Message]") -> list[str]:
    """The faults, or empty texts, with which activities have ended."""
    # Loads 157 modules, numpy and pydantic among them: 0.1 s, which help does without.
    from goniotwin.app.station.messages import ActivityChanged
    from goniotwin.drivers.errors import FaultText

    return [
        str(FaultText(each.error, each.detail)) for each in events if isinstance(each, ActivityChanged) and not each.activity
    ]


@contextlib.contextmanager
def _bench(rig: Path) -> "Iterator[LocalBench | RemoteBench]":
    """The station that has a rig; without one, a station of this command alone. Raises UserError."""
    # Loads 281 modules, numpy and pydantic among them: 0.3 s, which help does without.
    from goniotwin.app.rig import read_rig

    description = read_rig(rig)
    with attached_bench(description) as remote:
        if remote is not None:
            yield remote
            return
    with _station(description) as station:
        yield LocalBench(station)


@contextlib.contextmanager
def attached_bench(rig: "RigDescription") -> "Iterator[RemoteBench | None]":
    """The station that has a rig, with its devices connected; None where there is none. Raises UserError."""
    # Loads 835 modules, numba and pymodbus among them: 1.1 s, which help does without.
    from goniotwin.app.station.connection_file import attach
    from goniotwin.app.station.hosting import connection_path

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
def _station(rig: "RigDescription") -> "Iterator[Station]":
    # Loads 829 modules, numba and pymodbus among them: 1.1 s, which help does without.
    from goniotwin.app.campaign.campaign import clock_for
    from goniotwin.app.station.station import Station

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


def print_shutter(message: "Message") -> None:
    """Print what a session does about a shutter that another one has left open, and each safety order."""
    # Loads 98 modules, numpy among them: 76 ms, which help does without.
    from goniotwin.app.campaign.running.events import EventLogged, SafetyOrder

    if isinstance(message, SafetyOrder):
        print_order(message.text)
    elif isinstance(message, EventLogged) and message.kind == "guardian":
        print_warning(message.what)
