"""What has been started and is not done yet: when to ask next, and asking."""

from collections.abc import Callable, Iterable
from operator import attrgetter
from typing import Protocol

from goniotwin.protocols.clock import Clock

LONGEST_SLEEP_S = 0.2
DUE = attrgetter("due")


class Pending(Protocol):
    """Something under way. `due` is the time at which it is worth asking, s."""

    due: float

    def poll(self) -> bool:
        """Asks, in one exchange at most; True when it is done. Raises DeviceError where it has failed."""


class Until:
    """Done when a time has come, and nothing else needs asking."""

    def __init__(self, clock: Clock, t: float) -> None:
        self._clock = clock
        self.due = t

    def poll(self) -> bool:
        """Whether the time has come."""
        return self._clock.now() >= self.due


class Poll:
    """Done when a question is answered with yes: asked first at `due`, then every `interval` s."""

    def __init__(self, clock: Clock, due: float, interval: float, question: Callable[[], bool]) -> None:
        self._clock = clock
        self._interval = interval
        self._question = question
        self.due = due

    def poll(self) -> bool:
        """Asks."""
        if self._question():
            return True
        self.due = self._clock.now() + self._interval
        return False


def wait(clock: Clock, started: Iterable[Pending], between: Callable[[], None] = lambda: None) -> None:
    """Blocks until all are done, asking each when it is due; calls `between` before each question, and now and then.

    What `between` raises ends the waiting, as does the failure of any of the started.
    """
    left = list(started)
    while left:
        between()
        first = min(left, key=DUE)
        now = clock.now()
        if first.due > now + LONGEST_SLEEP_S:
            clock.sleep_until(now + LONGEST_SLEEP_S)
        else:
            clock.sleep_until(first.due)
            if first.poll():
                left.remove(first)
