"""Signals that end the program: SIGINT, SIGTERM, SIGHUP. The first one stops it in order; later ones do not break off the stop.

A stop takes time: stop commands for every axis, the last entries of the journal, ports and names released. A second Ctrl-C
must not break this off with an axis in motion. So later signals are ignored during a stop. Only if the stop takes longer than
LONGEST_STOP_S does a later signal end the process.
"""

import atexit
import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType

LONGEST_STOP_S = 10.0
"""Much longer than a stop with every device silent and a journal on a slow disk."""
STOPPING_MESSAGE = b"\ngoniotwin: stopping\n"
END_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


class EndSignalHandlers:
    """Signal handlers. The first signal calls `act`; `received` is True from then on.

    `of_program`: the process is this program, which ends after the signal, and no host that has called a command of it.
    """

    def __init__(self, act: Callable[[], None], *, of_program: bool) -> None:
        self.received = False
        self.of_program = of_program
        self._act = act
        self._overdue = threading.Event()

    def install(self) -> None:
        """Set the handlers; a signal that is ignored stays ignored (nohup), except SIGINT."""
        for number in END_SIGNALS:
            if number == signal.SIGINT or signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, self.handle_first)

    def handle_first(self, number: int, frame: FrameType | None) -> None:
        """Handle the first signal."""
        del number, frame
        self.received = True
        for each in END_SIGNALS:
            signal.signal(each, self._handle_later)
        timer = threading.Timer(LONGEST_STOP_S, self._overdue.set)
        timer.daemon = True
        timer.start()
        if self.of_program:
            atexit.register(ignore_end_signals)
            _leave_closed_terminal()
        with contextlib.suppress(OSError):  # a full disk: the stop comes first
            os.write(2, STOPPING_MESSAGE)
        self._act()

    def _handle_later(self, number: int, frame: FrameType | None) -> None:
        """Ignore a later signal; after LONGEST_STOP_S it ends the process."""
        del frame
        if self._overdue.is_set():
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)


def interrupt_on_end_signal() -> None:
    """Install the program's handlers: the first signal raises KeyboardInterrupt in the main thread, later ones are ignored."""
    EndSignalHandlers(_raise_interrupt, of_program=True).install()


@contextlib.contextmanager
def call_on_end_signal(act: Callable[[], None]) -> Iterator[EndSignalHandlers]:
    """Install handlers for the time of the context: the first signal calls `act` in the main thread, between two statements.

    Later signals are ignored. For an event loop, in which a KeyboardInterrupt is lost. `act` must be quick and not raise.
    On exit the previous handlers are restored; but where they are the program's (`interrupt_on_end_signal`) and a signal came,
    it is about to end, and later signals stay ignored.
    """
    previous = {number: signal.getsignal(number) for number in END_SIGNALS}
    owners = [getattr(handler, "__self__", None) for handler in previous.values()]
    of_program = any(isinstance(owner, EndSignalHandlers) and owner.of_program for owner in owners)
    handlers = EndSignalHandlers(act, of_program=of_program)
    handlers.install()
    try:
        yield handlers
    finally:
        if not (handlers.received and of_program):
            for number, handler in previous.items():
                signal.signal(number, handler)


def end_signal_received() -> bool:
    """Whether a signal has come that ends the program."""
    owner = getattr(signal.getsignal(signal.SIGINT), "__self__", None)
    return isinstance(owner, EndSignalHandlers) and owner.received


def _leave_closed_terminal() -> None:
    """Let output and errors go nowhere if the terminal is closed: no message may break off the stop, or change its status."""
    for number in (1, 2):
        try:
            os.write(number, b"")
        except OSError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            if nowhere != number:
                os.dup2(nowhere, number)
                os.close(nowhere)


def ignore_end_signals() -> None:
    """Ignore signals from here to the end of the process: Python restores the system's handlers before it has ended, and a
    signal would then change the exit status.
    """
    for number in END_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


def _raise_interrupt() -> None:
    raise KeyboardInterrupt
