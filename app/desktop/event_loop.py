"""Python in Qt's event loop: signals that end the program, and the garbage collector in the window's thread.

A KeyboardInterrupt that is raised in a slot is lost. So a signal handler only puts a Qt signal into the event queue. Python
runs a handler between two of its own statements, and an event loop that waits runs none. So the system writes the number of
the signal to a socket that the loop watches (signal.set_wakeup_fd): the loop enters Python, and the handler runs.

The garbage collector runs in the thread that happens to allocate. In any other than the window's it would destroy widgets that
are part of a reference cycle, and Qt would crash. (pyqtgraph's `GarbageCollector` does the same, but cannot be stopped.)
"""

import contextlib
import gc
import signal
import socket
from collections.abc import Iterator

from PySide6.QtCore import QObject, QSocketNotifier, QTimer, Signal, Slot

from goniotwin.app.end_signals import EndSignalHandlers, call_on_end_signal

RECEIVE_BYTES = 4096
COLLECT_MS = 500


class EndSignalNotifier(QObject):
    """Emits `received` at the first signal that ends the program; connect it with a queued connection."""

    received = Signal()

    def __init__(self, reader: socket.socket) -> None:
        super().__init__()
        self._reader = reader
        self._notifier = QSocketNotifier(reader.fileno(), QSocketNotifier.Type.Read, self)
        self._notifier.activated.connect(self._read)

    def disable(self) -> None:
        """Stop watching the socket."""
        self._notifier.setEnabled(False)

    @Slot()
    def _read(self) -> None:
        """Empty the socket. The numbers are not needed: the handlers run because Python runs."""
        with contextlib.suppress(BlockingIOError):
            self._reader.recv(RECEIVE_BYTES)


@contextlib.contextmanager
def end_signal_notifier() -> Iterator[tuple[EndSignalNotifier, EndSignalHandlers]]:
    """An `EndSignalNotifier` and its handlers, for the time of the context: the main thread's event loop."""
    reader, writer = socket.socketpair()
    with reader, writer:
        reader.setblocking(False)
        writer.setblocking(False)  # required by set_wakeup_fd
        notifier = EndSignalNotifier(reader)
        previous = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
        try:
            with call_on_end_signal(notifier.received.emit) as handlers:
                yield notifier, handlers
        finally:
            signal.set_wakeup_fd(previous)
            notifier.disable()


class GarbageCollector(QObject):
    """Between `start` and `stop` garbage is collected by a timer of this object's thread, and in no other thread."""

    _running = 0

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self._timer = QTimer(self, interval=COLLECT_MS)
        self._timer.timeout.connect(self._collect)

    def start(self) -> None:
        """Start; call it before there is another thread."""
        GarbageCollector._running += 1
        gc.disable()
        self._timer.start()

    def stop(self) -> None:
        """Stop; call it when there is no other thread any more."""
        self._timer.stop()
        GarbageCollector._running -= 1
        if not GarbageCollector._running:  # the last of several windows
            gc.enable()

    @Slot()
    def _collect(self) -> None:
        """Collect the generations that the interpreter itself would collect."""
        full = [count > limit for count, limit in zip(gc.get_count(), gc.get_threshold(), strict=True)]
        if full[0]:
            gc.collect(2 if full[1] and full[2] else 1 if full[1] else 0)
