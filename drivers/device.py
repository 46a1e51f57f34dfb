"""What every device is to the engine: an action is started and then polled until it is done.

No call blocks for longer than one exchange on its wire. `wait` polls any number of started actions.
"""

from collections.abc import Callable, Iterable
from operator import attrgetter
from typing import Protocol, runtime_checkable

from serial import Serial

from goniotwin.protocols.clock import Clock

LONGEST_SLEEP_S = 0.2
DUE = attrgetter("due")
PortOpener = Callable[[int, float], Serial]
"""Opens a serial port: baud rate, timeout in s."""


class Device(Protocol):
    """A device of the rig. `name` is that in errors, transcripts and lists; errors may also name one of its `parts`.

    A driver may have a `model` too, as on the device's plate (`PM100D`), empty before it is known: it is part of the headlines.
    """

    @property
    def name(self) -> str: ...

    @property
    def parts(self) -> tuple[str, ...]: ...

    def connect(self) -> str:
        """Open the wire, identify the device, write its settings; return its identity. Nothing moves. Raises DeviceError."""

    def reconnect(self) -> object:
        """Restore the connection and the settings after a fault. Nothing moves. Raises DeviceError."""

    def close(self) -> None:
        """Restore the settings that `connect` and later calls have changed, and close the wire. Nothing moves.

        A device that is not responding, or still moves, is left to the next connection.
        """


@runtime_checkable
class Identifiable(Protocol):
    """A device that can be identified without being connected. Drivers of other packages may not have it."""

    def identify(self) -> str:
        """Open the wire and return the identity of the device. Nothing is written and nothing moves. Raises DeviceError.

        Only what an earlier session has left changed, because it was killed, is restored: see `drivers.found`.
        """


class Pending(Protocol):
    """An action in progress. `due` is the time of the next poll, s."""

    due: float

    def poll(self) -> bool:
        """Ask the device, in one exchange at most; True when the action is done. Raises DeviceError if it failed."""


class Until:
    """A wait until a time, without any exchange."""

    def __init__(self, clock: Clock, t: float) -> None:
        self._clock = clock
        self.due = t

    def poll(self) -> bool:
        """True when the time has come."""
        return self._clock.now() >= self.due


class Poll:
    """An action that is done when `is_done` returns True: called first at `due`, then every `interval` s."""

    def __init__(self, clock: Clock, due: float, interval: float, is_done: Callable[[], bool]) -> None:
        self._clock = clock
        self._interval = interval
        self._is_done = is_done
        self.due = due

    def poll(self) -> bool:
        """Ask the device."""
        if self._is_done():
            return True
        self.due = self._clock.now() + self._interval
        return False


def wait(clock: Clock, started: Iterable[Pending], between: Callable[[], None] = lambda: None) -> None:
    """Block until all actions are done, polling each when it is due.

    `between` is called before each poll and at least every LONGEST_SLEEP_S. An exception from `between` or from an action
    ends the wait.
    """
    left = list(started)
    while left:
        between()
        first = min(left, key=DUE) if len(left) > 1 else left[0]
        now = clock.now()
        if first.due > now + LONGEST_SLEEP_S:
            clock.sleep_until(now + LONGEST_SLEEP_S)
        else:
            clock.sleep_until(first.due)
            if first.poll():
                left.remove(first)
