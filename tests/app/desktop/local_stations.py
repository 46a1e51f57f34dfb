"""Stations in the tests' own process, each behind its channel: what a test changes of the drivers changes theirs."""

import contextlib
import threading
from collections.abc import Callable
from pathlib import Path

from goniotwin.app.desktop.model.connection import OnEnd, OnEvent
from goniotwin.app.errors import UserError
from goniotwin.app.rig import OpenRig, read_rig
from goniotwin.app.station.client import NoStation, StationClient
from goniotwin.app.station.server import StationServer
from goniotwin.app.station.station import Station
from goniotwin.protocols.clock import ScaledClock
from goniotwin.twin import VirtualRig

FAST = 1000.0
"""Simulation speed while a rig is connected and given back."""


class Host:
    """A station with its server and its engine's thread."""

    def __init__(self, rig: Path, speed: float) -> None:
        self.rig = rig
        self.station = Station(speed)
        self.station.open(read_rig(rig))
        self.server = StationServer(self.station)
        self.server.start()
        self._engine = threading.Thread(target=self.station.serve, name="engine")
        clock = self.station.clock
        assert isinstance(clock, ScaledClock)
        clock.set_speed(FAST)
        self._clock = clock
        self.station.do(self.station.connect_all)
        self.station.do(lambda: clock.set_speed(speed))
        self._engine.start()
        self._watch = threading.Thread(target=self._end_when_disconnected, name="disconnect")
        self._watch.start()
        self.ended = threading.Event()

    def _end_when_disconnected(self) -> None:
        self.station.disconnected.wait()
        self._clock.set_speed(FAST)
        self.station.end()
        self._engine.join()
        self.server.stop()
        self.ended.set()

    def kill(self) -> None:
        """End the connections as the death of a process does; what the rig then does is not shown to anyone."""
        self.server.stop()
        self.end()

    def end(self) -> None:
        """Give the rig back."""
        self.station.disconnected.set()
        self._watch.join()


class LocalStations:
    """Finds and starts stations in this process."""

    look_s = 2.0

    def __init__(self) -> None:
        self.hosts: list[Host] = []
        self.coming_up = threading.Event()
        """Cleared, a station that is started does not answer yet."""
        self.coming_up.set()
        self._seen = 0

    def attach(self, rig: Path, name: str, on_event: OnEvent, on_end: OnEnd) -> StationClient | None:
        """Attach to a station that has the rig."""
        found = [each for each in self.hosts if each.rig == rig and not each.station.disconnected.is_set()]
        with contextlib.suppress(NoStation):
            return StationClient(found[-1].server.port, found[-1].server.token, name, on_event, on_end) if found else None
        return None

    def start(
        self, rig: Path, speed: float, name: str, on_event: OnEvent, on_end: OnEnd, given_up: Callable[[], bool]
    ) -> StationClient:
        """Start a station and attach to it. Raises UserError."""
        while not self.coming_up.wait(0.01):
            if given_up():
                raise UserError("given up")
        self.hosts.append(Host(rig, speed))
        return StationClient(self.hosts[-1].server.port, self.hosts[-1].server.token, name, on_event, on_end)

    def changed(self) -> bool:
        """Whether there may be other stations than at the last call that returned True."""
        before, self._seen = self._seen, len(self.hosts)
        return self._seen != before

    @property
    def station(self) -> Station:
        """The station that was started last."""
        return self.hosts[-1].station

    @property
    def opened(self) -> OpenRig:
        """The rig of the station that was started last."""
        opened = self.station.opened
        assert opened is not None
        return opened

    @property
    def virtual(self) -> VirtualRig:
        """Its virtual devices."""
        assert self.opened.virtual is not None
        return self.opened.virtual

    def end(self) -> None:
        """End all stations."""
        for each in self.hosts:
            each.end()
