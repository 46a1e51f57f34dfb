"""The clock of a virtual rig in the window: real time, multiplied by a simulation speed that can change during a run."""

import threading

from goniotwin.protocols.clock import Action, Event, RealClock

POLL_S = 0.05
"""Real time between two checks of the speed during a sleep, so that a sleeping thread follows a change of speed."""


class ScaledClock:
    """Time for any number of threads, `speed` times as fast as real time. It is continuous and never runs back."""

    def __init__(self, speed: float = 1.0) -> None:
        self._wall = RealClock()
        self._lock = threading.Lock()
        self._speed = speed
        self._since = self._wall.now()
        self._then = 0.0
        self.set_speed(speed)

    @property
    def speed(self) -> float:
        """Seconds of this clock in one second of real time."""
        return self._speed

    def set_speed(self, speed: float) -> None:
        """Set the speed from now on. Raises ValueError for a speed that is not positive."""
        if not speed > 0:
            raise ValueError(f"speed must be positive, not {speed}")
        with self._lock:
            wall = self._wall.now()
            self._then += (wall - self._since) * self._speed
            self._since, self._speed = wall, speed

    def now(self) -> float:
        """The time, s."""
        with self._lock:
            return self._then + (self._wall.now() - self._since) * self._speed

    def sleep_until(self, t: float) -> None:
        """Block the calling thread until `t`."""
        while (left := t - self.now()) > 0:
            self._wall.sleep_until(self._wall.now() + min(left / self._speed, POLL_S))

    def at(self, t: float, action: Action) -> Event:
        """Call `action` at `t`, in a thread of its own."""
        event = Event(t, action)

        def poll() -> None:
            left = (t - self.now()) / self._speed
            if event.cancelled:
                return
            if left > 0:
                self._wall.at(self._wall.now() + min(left, POLL_S), poll)
            else:
                event.action()

        self._wall.at(self._wall.now(), poll)
        return event
