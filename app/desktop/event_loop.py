"""Requests to end (Ctrl-C, SIGTERM, SIGHUP) in Qt's event loop.

A KeyboardInterrupt that is raised in a slot is lost there. So the signal's handler only puts `requested` into the event queue.

Python runs a handler between two of its own statements, and an event loop that waits runs none. So the system writes the
signal's number to a socket that the loop watches (signal.set_wakeup_fd): the loop enters Python, and the handler runs.
"""

import contextlib
import signal
import socket
from collections.abc import Iterator

from PySide6.QtCore import QObject, QSocketNotifier, Signal, Slot

from goniotwin.app.end_signals import EndSignalHandlers, call_on_end_signal

MOST_BYTES = 4096


class Interrupt(QObject):
    """Emits `requested` once for the first request to end; it is to be connected with a queued connection."""

    requested = Signal()

    def __init__(self, reader: socket.socket) -> None:
        super().__init__()
        self._reader = reader
        self._notifier = QSocketNotifier(reader.fileno(), QSocketNotifier.Type.Read, self)
        self._notifier.activated.connect(self._empty)

    def end(self) -> None:
        """The socket is watched no longer."""
        self._notifier.setEnabled(False)

    @Slot()
    def _empty(self) -> None:
        """The numbers are not looked at: handlers run because Python runs."""
        with contextlib.suppress(BlockingIOError):
            self._reader.recv(MOST_BYTES)


@contextlib.contextmanager
def interrupts() -> Iterator[tuple[Interrupt, EndSignalHandlers]]:
    """While it lasts, requests to end go to an `Interrupt`. For the main thread, around its event loop."""
    reader, writer = socket.socketpair()
    with reader, writer:
        reader.setblocking(False)
        writer.setblocking(False)  # set_wakeup_fd asks for it
        interrupt = Interrupt(reader)
        before = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
        try:
            with call_on_end_signal(interrupt.requested.emit) as requests:
                yield interrupt, requests
        finally:
            signal.set_wakeup_fd(before)
            interrupt.end()
