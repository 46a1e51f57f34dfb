"""Lock of a serial line: one exchange at a time, in FIFO order, with a count of stop requests."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager


class StopLock:
    """FIFO lock of a line for any number of threads, and a count of stop requests.

    A thread that has the line may acquire it again: an event of the virtual clock, in the middle of a wait. `requested` is
    the number of stops requested, `acquired` the number of those that have got the line.
    """

    def __init__(self) -> None:
        self._gate = threading.Lock()
        self._line = threading.Lock()
        self._counting = threading.Lock()
        self._owner: int | None = None
        self.requested = 0
        self.acquired = 0

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Acquire the line in FIFO order; waiters queue on `_gate`."""
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
    def hold_for_stop(self) -> Iterator[None]:
        """Acquire the line for a stop. From the request on, the exchange in progress sees `stop_waiting`."""
        with self._counting:
            self.requested += 1
        with self.hold():
            with self._counting:
                self.acquired += 1
            yield

    @property
    def stop_waiting(self) -> bool:
        """True if a requested stop has not got the line yet."""
        return self.requested > self.acquired
