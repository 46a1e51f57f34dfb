"""Whose turn it is on a wire: one exchange at a time, and a stop before all others."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Turnstile:
    """Turns for any number of threads, in the order in which they come; and a count of stops.

    Within its turn a thread may take another: an event of the virtual clock, in the middle of a wait. `asked` stops have
    been called for, `done` of them have had their turn.
    """

    def __init__(self) -> None:
        self._gate = threading.Lock()
        self._line = threading.Lock()
        self._counting = threading.Lock()
        self._owner: int | None = None
        self.asked = 0
        self.done = 0

    @contextmanager
    def turn(self) -> Iterator[None]:
        """The wire is mine. Who waits for it holds the gate, so that nobody who comes later overtakes it."""
        me = threading.get_ident()
        if self._owner == me:
            yield
            return
        with self._gate:
            self._line.acquire()
        self._owner = me
        try:
            yield
        finally:
            self._owner = None
            self._line.release()

    @contextmanager
    def stop(self) -> Iterator[None]:
        """The turn of a stop: from the moment at which it is asked for, whoever has the wire can see that it waits."""
        with self._counting:
            self.asked += 1
        with self.turn():
            with self._counting:
                self.done += 1
            yield

    @property
    def stop_waits(self) -> bool:
        """Whether a stop has been asked for that has not had its turn."""
        return self.asked > self.done
