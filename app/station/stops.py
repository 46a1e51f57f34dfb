"""The stops of a station, from any thread: nothing begins while one is carried out."""

import contextlib
import threading
from collections.abc import Iterator

from goniotwin.app.station.permissions import CommandRefused


class Stops:
    """The stops that are being carried out. `requested` is set by each, and cleared when the next activity is accepted."""

    def __init__(self) -> None:
        self.requested = threading.Event()
        self.in_progress = 0
        self._changed = threading.Condition()

    @contextlib.contextmanager
    def carrying_out(self) -> Iterator[None]:
        """The time of one stop: it is counted and requested before the context, and counted until after it."""
        with self._changed:
            self.in_progress += 1
            self.requested.set()
        try:
            yield
        finally:
            with self._changed:
                self.in_progress -= 1
                self._changed.notify_all()

    @contextlib.contextmanager
    def none_in_progress(self) -> Iterator[None]:
        """A time in which no stop begins. Raises CommandRefused where one is in progress."""
        with self._changed:
            if self.in_progress:
                raise CommandRefused("the axes are being stopped; wait until they are at rest")
            yield

    def wait(self) -> None:
        """Wait for the end of the stops in progress."""
        with self._changed:
            self._changed.wait_for(lambda: not self.in_progress)
