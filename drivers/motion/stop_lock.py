"""Lock of a serial line: one exchange at a time, in FIFO order, with a count of stop requests."""

import threading

from goniotwin.drivers.motion.stop import StopPhase, StopSteps, StopWait

ACQUIRE_S = 0.01
"""Longest real time that one step of a stop waits for the line."""


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

    def hold(self) -> "Hold":
        """A context in which the thread has the line."""
        return Hold(self)

    def acquire(self) -> bool:
        """Acquire the line in FIFO order; waiters queue on `_gate`. False if the thread has it already."""
        me = threading.get_ident()
        if self._owner == me:
            return False
        with self._gate:
            self._line.acquire()
        self._owner = me
        return True

    def release(self) -> None:
        """Release the line."""
        self._owner = None
        self._line.release()

    def begin_stop(self, steps: StopSteps) -> StopSteps:
        """Request a stop: from now on the exchange in progress sees `stop_waiting`. Its steps are carried out on the line."""
        with self._counting:
            self.requested += 1
        return self._stop(steps)

    def _stop(self, steps: StopSteps) -> StopSteps:
        nested = self._owner == threading.get_ident()
        if not nested:
            yield from self._wait_for_line()
        with self._counting:
            self.acquired += 1
        try:
            return (yield from steps)
        finally:
            if not nested:
                self.release()

    def _wait_for_line(self) -> StopWait:
        """Acquire the line in FIFO order, in steps of ACQUIRE_S."""
        for lock in (self._gate, self._line):
            while not lock.acquire(timeout=ACQUIRE_S):
                yield StopPhase.SENDING
        self._owner = threading.get_ident()
        self._gate.release()

    @property
    def stop_waiting(self) -> bool:
        """True if a requested stop has not got the line yet."""
        return self.requested > self.acquired


class Hold:
    """Context of `StopLock.hold`."""

    __slots__ = ("_acquired", "_lock")

    def __init__(self, lock: StopLock) -> None:
        self._lock = lock

    def __enter__(self) -> None:
        self._acquired = self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        if self._acquired:
            self._lock.release()
