"""What every driver owes on a wire that fails, checked at each of its calls: an end in bounded time, an error that names it."""

import contextlib
from collections.abc import Iterator

from goniotwin.drivers import DeviceError, Pending, wait
from goniotwin.protocols.clock import Clock


class Calls:
    """Calls of one driver: `most_s` is what one may take, `device` what its errors begin with.

    `errors` are those there were, `good` is how many attempts had none.
    """

    def __init__(self, clock: Clock, device: str, most_s: float) -> None:
        self._clock = clock
        self._device = device
        self._most_s = most_s
        self.errors: list[DeviceError] = []
        self.good = 0

    @contextlib.contextmanager
    def attempt(self) -> Iterator[None]:
        """Some calls, each in `call` or `wait`, and what is asserted of their values; a DeviceError ends them."""
        before = len(self.errors)
        try:
            yield
            self.good += 1
        except DeviceError as error:
            self.errors.append(error)
        for told in self.errors[before:]:
            assert told.device.startswith(self._device)
            assert str(told).startswith(f"{told.device}: {told.doing}: {told.happened}")
            assert told.doing
            assert told.happened

    @contextlib.contextmanager
    def call(self) -> Iterator[None]:
        """One call."""
        begun = self._clock.now()
        try:
            yield
        finally:
            assert self._clock.now() - begun < self._most_s

    def wait(self, pending: Pending) -> None:
        """Until something under way is done; each poll is a call."""
        wait(self._clock, [_Polled(pending, self)])


class _Polled:
    def __init__(self, pending: Pending, calls: Calls) -> None:
        self._pending, self._calls = pending, calls
        self.due = pending.due

    def poll(self) -> bool:
        with self._calls.call():
            done = self._pending.poll()
        self.due = self._pending.due
        return done
