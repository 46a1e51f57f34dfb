"""Thread-safe stop request; checked before every motion and between polls."""

import threading
from collections.abc import Callable
from typing import TypeVar

from goniotwin.drivers import DeviceError, Rig

T = TypeVar("T")


class Stopped(Exception):
    """The run was stopped by a stop request."""


class StopRequest:
    """Stop request of one run on a rig. `requested` is whether the run was asked to stop."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._motion = threading.RLock()
        self.requested = False

    def stop(self) -> list[DeviceError]:
        """Stop all axes now and allow no further motion; return the errors of axes that did not confirm. From any thread."""
        self.requested = True
        failures = self._rig.stop()
        with self._motion:  # a motion that was being started in another thread has started by now, and is stopped here
            return self._rig.stop() or failures

    def check(self) -> None:
        """Raise Stopped if the run was asked to stop."""
        if self.requested:
            raise Stopped

    def start(self, motion: Callable[[], T]) -> T:
        """Start a motion unless the run was asked to stop. Raises Stopped, DeviceError."""
        with self._motion:
            self.check()
            return motion()
