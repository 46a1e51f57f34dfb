"""The clock of a rig that people watch: real time at a pace that may be changed while it runs."""

import threading

from goniotwin.protocols.clock import Action, Event, RealClock

NOTICED_WITHIN_S = 0.05
"""A sleeper looks up so often, in a person's time, so that it follows a change of pace."""


class PacedClock:
    """Time for any number of threads, `speed` times as fast as a person's; it never goes back and never jumps."""

    def __init__(self, speed: float = 1.0) -> None:
        self._wall = RealClock()
        self._lock = threading.Lock()
        self._speed = speed
        self._since = self._wall.now()
        self._then = 0.0
        self.set_speed(speed)

    @property
    def speed(self) -> float:
        """Seconds of this clock a second."""
        return self._speed

    def set_speed(self, speed: float) -> None:
        """From now on. Raises ValueError for a speed at which time would not go on."""
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
        """Blocks the calling thread until `t`."""
        while (left := t - self.now()) > 0:
            self._wall.sleep_until(self._wall.now() + min(left / self._speed, NOTICED_WITHIN_S))

    def at(self, t: float, action: Action) -> Event:
        """Has `action` called at `t`, in a thread of its own."""
        event = Event(t, action)

        def look() -> None:
            left = (t - self.now()) / self._speed
            if event.cancelled:
                return
            if left > 0:
                self._wall.at(self._wall.now() + min(left, NOTICED_WITHIN_S), look)
            else:
                event.action()

        self._wall.at(self._wall.now(), look)
        return event
