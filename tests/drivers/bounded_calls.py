"""Checks of every call of a driver on a failing wire: it ends in bounded time, and its error names the device."""

import contextlib
from collections.abc import Iterator

from goniotwin.drivers import DeviceError, Pending, wait
from goniotwin.protocols.clock import Clock


class BoundedCalls:
    """Calls of one driver: `most_s` is the longest duration of a call, `device` the start of the device name in its errors.

    `errors` are the errors so far, `good` is the number of attempts without error.
    """

    def __init__(self, clock: Clock, device: str, most_s: float) -> None:
        self._clock = clock
        self._device = device
        self._most_s = most_s
        self.errors: list[DeviceError] = []
        self.good = 0

    @contextlib.contextmanager
    def attempt(self) -> Iterator[None]:
        """A block of calls, each in `call` or `wait`, and assertions on their values; a DeviceError ends the block."""
        before = len(self.errors)
        try:
            yield
            self.good += 1
        except DeviceError as error:
            self.errors.append(error)
        for each in self.errors[before:]:
            assert each.device.startswith(self._device)
            assert str(each).startswith(f"{each.device}: {each.doing}: {each.happened}")
            assert each.doing
            assert each.happened

    @contextlib.contextmanager
    def call(self) -> Iterator[None]:
        """One call."""
        started = self._clock.now()
        try:
            yield
        finally:
            assert self._clock.now() - started < self._most_s

    def wait(self, pending: Pending) -> None:
        """Wait for an action; each poll is a call."""
        wait(self._clock, [_BoundedPolls(pending, self)])


class _BoundedPolls:
    def __init__(self, pending: Pending, calls: BoundedCalls) -> None:
        self._pending, self._calls = pending, calls
        self.due = pending.due

    def poll(self) -> bool:
        with self._calls.call():
            done = self._pending.poll()
        self.due = self._pending.due
        return done
