"""A stop that anybody may say at any time: nothing is set in motion after it, and whoever works heeds it soon."""

import threading
from collections.abc import Callable
from typing import TypeVar

from goniotwin.drivers import DeviceError, Rig

T = TypeVar("T")


class Stopped(Exception):
    """Somebody has said stop."""


class StopRequest:
    """For one run on a rig. `said` is whether there has been a stop."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._motion = threading.RLock()
        self.said = False

    def say(self) -> list[DeviceError]:
        """The axes come to rest now, and nothing else moves; returns what could not be told to its axis. From any thread."""
        self.said = True
        failures = self._rig.stop()
        with self._motion:  # an axis that was being started meanwhile has been started by now, and is stopped here
            return self._rig.stop() or failures

    def heed(self) -> None:
        """Raises Stopped where there has been one."""
        if self.said:
            raise Stopped

    def start(self, motion: Callable[[], T]) -> T:
        """Begins something that moves, unless there has been a stop. Raises Stopped, DeviceError."""
        with self._motion:
            self.heed()
            return motion()
