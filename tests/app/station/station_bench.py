"""A station on the virtual clock, with its events, for tests."""

from collections.abc import Callable
from pathlib import Path

from goniotwin.app.rig import OpenRig, read_rig
from goniotwin.app.station.messages import ActivityChanged, DeviceStatus, Message, Snapshot
from goniotwin.app.station.questions import LOOK_S
from goniotwin.app.station.station import Station
from goniotwin.protocols.clock import Clock, VirtualClock
from goniotwin.twin import VirtualRig

ROWS = 10


class StationBench:
    """A station on the virtual clock, with its events."""

    def __init__(self, rig: Path, wall: Clock | None = None, look_s: float = LOOK_S) -> None:
        self.clock = VirtualClock()
        self.station = Station(clock=self.clock, wall=wall, look_s=look_s)
        self.events: list[Message] = []
        self.reactions: list[Callable[[Message], object]] = []
        self.station.board.subscribe(self._note)
        self.station.open(read_rig(rig))
        self.station.connect_all()

    def _note(self, _number: int, message: Message) -> None:
        self.events.append(message)
        for each in self.reactions:
            each(message)

    def of(self, kind: type[Message]) -> list[Message]:
        return [each for each in self.events if isinstance(each, kind)]

    def work(self) -> Snapshot:
        self.station.work()
        return self.station.snapshot

    @property
    def error(self) -> str:
        """The error of the last activity."""
        return [each.error for each in self.events if isinstance(each, ActivityChanged)][-1]

    @property
    def opened(self) -> OpenRig:
        opened = self.station.opened
        assert opened is not None
        return opened

    @property
    def virtual(self) -> VirtualRig:
        assert self.opened.virtual is not None
        return self.opened.virtual


class HurriedClock(VirtualClock):
    """Real time that is a second later whenever it is read: what is due from time to time is due each time."""

    def now(self) -> float:
        self.sleep_until(super().now() + 1.0)
        return super().now()


class Idle(StationBench):
    """A station without a command, on the virtual clock, and on another one in place of the real time between its polls."""

    def __init__(self, rig: Path) -> None:
        self.wall = VirtualClock()
        super().__init__(rig, self.wall, look_s=0.01)

    def wait(self, seconds: float, step_s: float = 0.1) -> None:
        """Let time pass, and what is due be done."""
        for _ in range(round(seconds / step_s)):
            self.wall.sleep_until(self.wall.now() + step_s)
            self.clock.sleep_until(self.clock.now() + step_s)
            self.station.tick()

    def status(self, device: str) -> DeviceStatus:
        rig = self.station.snapshot.rig
        assert rig is not None
        return rig.devices[device]
