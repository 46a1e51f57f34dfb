"""The state of a station and its listeners: each event changes the one and reaches the others, in one order."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from goniotwin.app.station.messages import Message, Snapshot, advance

Listener = Callable[[int, Message], None]
"""Gets an event with its number; must return at once."""
Publish = Callable[[Message], None]


class Board:
    """The snapshot of a station. From any thread."""

    def __init__(self, snapshot: Snapshot) -> None:
        self._lock = threading.RLock()
        self._listeners: list[Listener] = []
        self.snapshot = snapshot

    def publish(self, message: Message) -> None:
        """Take an event into the snapshot, and give it to all listeners."""
        with self._lock:
            self.snapshot = advance(self.snapshot, message)
            for listener in list(self._listeners):
                listener(self.snapshot.number, message)

    def subscribe(self, listener: Listener) -> Snapshot:
        """Give all events from now on to `listener`; return the snapshot that they follow."""
        with self._lock:
            self._listeners.append(listener)
            return self.snapshot

    def unsubscribe(self, listener: Listener) -> None:
        """Give no more events to `listener`."""
        with self._lock:
            if listener in self._listeners:
                self._listeners.remove(listener)

    @contextmanager
    def deciding(self) -> Iterator[Snapshot]:
        """The snapshot, which no other thread changes meanwhile: for a decision that is published before the end."""
        with self._lock:
            yield self.snapshot
