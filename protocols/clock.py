"""Time, injected: everything that reads the time or waits for it takes a `Clock`.

`RealClock` is monotonic time, `ScaledClock` the same at a speed that may change, `VirtualClock` jumps.
No other module imports `time` (a lint rule sees to it).
"""

import ctypes
import heapq
import itertools
import sys
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Protocol

Action = Callable[[], object]
POLL_S = 0.05
"""Real time between two checks of the speed during a sleep, so that a sleeping thread follows a change of speed."""


def calendar_stamp() -> str:
    """The calendar's time now, UTC, ISO 8601 to the second: for people and files, never for intervals."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def local_stamp(stamp: str) -> str:
    """A calendar's stamp (ISO 8601) in this computer's time zone, with its offset from UTC; any other text as it is."""
    try:
        local = datetime.fromisoformat(stamp).astimezone().isoformat(" ", "seconds")
    except (ValueError, OverflowError, OSError):
        return stamp
    return f"{local[:19]} UTC{local[19:]}"


def calendar_s() -> float:
    """The calendar's time, s. It may be set, and goes on while the computer sleeps."""
    return time.time()


def awake_s() -> float:
    """The time in which this computer was awake, s since an arbitrary start."""
    if sys.platform == "win32":  # monotonic time goes on there while the computer sleeps
        ticks = ctypes.c_ulonglong()
        ctypes.windll.kernel32.QueryUnbiasedInterruptTime(ctypes.byref(ticks))
        return ticks.value * 1e-7
    return time.monotonic()


class Clock(Protocol):
    """Seconds since an arbitrary start; never goes back."""

    def now(self) -> float:
        """The time, s."""

    def sleep_until(self, t: float) -> None:
        """Return once `now() >= t`; at once where that is so already."""

    def at(self, t: float, action: Action) -> "Event":
        """Have `action` called when the time is `t` (at once if that is past)."""


class Event:
    """Something that is to happen at a time; it can be cancelled until it happens."""

    __slots__ = ("action", "cancelled", "t")

    def __init__(self, t: float, action: Action) -> None:
        self.t = t
        self.action = action
        self.cancelled = False

    def cancel(self) -> None:
        """Nothing happens then, unless it has happened already."""
        self.cancelled = True


class VirtualClock:
    """A clock that jumps to a given time, for one thread.

    What should happen in the middle of a jump (a stop, a fault) is an event at a time. An action may itself sleep:
    the clock is then later than the sleeper asked for, as it would be on a real machine.
    """

    def __init__(self, start: float = 0.0) -> None:
        self._now = float(start)
        self._events: list[tuple[float, int, Event]] = []
        self._order = itertools.count()
        self._owner: int | None = None

    def now(self) -> float:
        """The time, s."""
        return self._now

    @property
    def elsewhere(self) -> bool:
        """Whether the clock belongs to another thread than this one."""
        return self._owner not in (None, threading.get_ident())

    def sleep_until(self, t: float) -> None:
        """Jump to `t`, and do on the way what is due by then, in the order of the times."""
        me = threading.get_ident()
        if self._owner != me:
            if self._owner is not None:
                raise RuntimeError("a VirtualClock belongs to the thread that first slept on it; use a RealClock here")
            self._owner = me
        while self._events and self._events[0][0] <= t:
            due, _, event = heapq.heappop(self._events)
            if event.cancelled:
                continue
            self._now = max(self._now, due)
            event.action()
        if t > self._now:
            self._now = t

    def at(self, t: float, action: Action) -> Event:
        """Have `action` called on the way past `t`; if `t` is past, at the next sleep."""
        event = Event(t, action)
        heapq.heappush(self._events, (t, next(self._order), event))
        return event

    def next_event(self) -> float:
        """When the next event is due, s; infinity where there is none."""
        while self._events and self._events[0][2].cancelled:
            heapq.heappop(self._events)
        return self._events[0][0] if self._events else float("inf")


class RealClock:
    """Monotonic time from `start` on, `speed` times as fast; for any number of threads."""

    def __init__(self, speed: float = 1.0, start: float = 0.0) -> None:
        if not speed > 0:
            raise ValueError(f"speed must be positive, not {speed}")
        self.speed = speed
        self._zero = time.monotonic() - start / speed

    def now(self) -> float:
        """The time, s."""
        return (time.monotonic() - self._zero) * self.speed

    def sleep_until(self, t: float) -> None:
        """Block the calling thread until `t`."""
        while (left := (t - self.now()) / self.speed) > 0:
            time.sleep(left)

    def at(self, t: float, action: Action) -> Event:
        """Have `action` called at `t`, in a thread of its own."""
        event = Event(t, action)

        def fire() -> None:
            if not event.cancelled:
                event.action()

        timer = threading.Timer(max(0.0, (t - self.now()) / self.speed), fire)
        timer.daemon = True
        timer.start()
        return event


LEAST_SPEED, GREATEST_SPEED = 0.1, 1000.0
"""Simulation speeds that can be chosen."""


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

    def advance_to(self, t: float) -> None:
        """Jump to `t`, unless it is past: a virtual rig goes on at the time of its journal."""
        with self._lock:
            wall = self._wall.now()
            self._then = max(self._then + (wall - self._since) * self._speed, t)
            self._since = wall

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
