"""Stations in processes, and clients of theirs in the tests' own."""

import contextlib
import os
import signal
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path

from goniotwin.app.station.client import StationClient
from goniotwin.app.station.connection_file import attach, known_stations
from goniotwin.app.station.messages import Message, Snapshot
from tests.system.command_process import CommandProcess
from tests.system.conftest import until

LONGEST_S = 60.0


class Attached:
    """A client, with its events."""

    def __init__(self, path: Path, name: str = "test") -> None:
        self.events: list[Message] = []
        self.ended = threading.Event()
        self._changed = threading.Condition()
        client = attach(path, name, self._note, self.ended.set)
        assert client is not None
        self.client: StationClient = client
        client.start()

    def _note(self, message: Message) -> None:
        with self._changed:
            self.events.append(message)
            self._changed.notify_all()

    @property
    def snapshot(self) -> Snapshot:
        return self.client.snapshot

    def wait_for(self, condition: Callable[[], bool]) -> None:
        """Wait for a condition on the snapshot or the events."""
        with self._changed:
            assert self._changed.wait_for(condition, LONGEST_S), self.snapshot


def station_process(folder: Path, rig: Path, *options: object) -> tuple[CommandProcess, Path]:
    """`goniotwin station` in a process, and its connection file."""
    process = CommandProcess(folder, "station", "--rig", rig, *options)
    return process, connection_of(process)


def connection_of(process: CommandProcess) -> Path:
    """The connection file of a station, when it is there."""
    until(lambda: not process.alive or process.pid in {each.pid for each in known_stations().values()})
    assert process.alive, process.errors
    return next(path for path, each in known_stations().items() if each.pid == process.pid)


def runs(pid: int) -> bool:
    """Whether a process is there."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    try:
        return "Z" not in Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2][:3]
    except OSError:
        return True


def kill_stations() -> None:
    """Kill all stations of this computer, and remove what a killed one leaves."""
    for path, station in known_stations().items():
        with contextlib.suppress(ProcessLookupError):  # it has ended, and left its file
            os.kill(station.pid, signal.SIGKILL)
        until(partial(has_ended, path))


def has_ended(path: Path) -> bool:
    """Whether the station of a connection file has ended; a file that is left is removed."""
    return attach(path, "cleaner") is None
