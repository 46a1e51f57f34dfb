"""Requests to end, from a terminal or from the system: the first is obeyed in good order, and nothing breaks that order.

A stop takes its time: stop frames for every axis, the journal's last words, names and ports given back. Whoever presses Ctrl-C
twice wants it to end, not to be broken off in the middle with an axis on its way. So what comes after the first request is
not heard while things are put in order; only if that takes longer than it ever should does another one break it off.
"""

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType

LONGEST_S = 10.0
"""Of a stop with every device silent and a journal on a slow disk, by far."""
SAID = b"\ngoniotwin: stopping\n"
REQUESTS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


class EndRequests:
    """Signal handlers: the first request calls `act`; `came` whether there was one."""

    def __init__(self, act: Callable[[], None]) -> None:
        self.came = False
        self._act = act
        self._overdue = threading.Event()

    def first(self, number: int, frame: FrameType | None) -> None:
        """Handle the first request."""
        del number, frame
        self.came = True
        for each in REQUESTS:
            signal.signal(each, self._further)
        patience = threading.Timer(LONGEST_S, self._overdue.set)
        patience.daemon = True
        patience.start()
        with contextlib.suppress(OSError):  # of a terminal that has been closed
            os.write(2, SAID)
        self._act()

    def _further(self, number: int, frame: FrameType | None) -> None:
        """Ignore a further request, unless the stop takes longer than LONGEST_S: then the signal ends the process."""
        del frame
        if self._overdue.is_set():
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)


def heed_requests_to_end() -> None:
    """From now on the first request raises KeyboardInterrupt in the main thread; further ones are ignored."""
    _install(EndRequests(_interrupt))


@contextlib.contextmanager
def requests_to_end_call(act: Callable[[], None]) -> Iterator[EndRequests]:
    """While it lasts, the first request calls `act` in the main thread, between two of its statements.

    Further ones are ignored. For an event loop, in which a KeyboardInterrupt would be lost. `act` is quick and does not raise.
    At the end the handlers are restored, unless a request came: then the program is about to end, and further requests stay
    ignored.
    """
    before = {number: signal.getsignal(number) for number in REQUESTS}
    requests = EndRequests(act)
    _install(requests)
    try:
        yield requests
    finally:
        if not requests.came:
            for number, handler in before.items():
                signal.signal(number, handler)


def _install(requests: EndRequests) -> None:
    for number in REQUESTS:
        if number == signal.SIGINT or signal.getsignal(number) != signal.SIG_IGN:  # nohup stays nohup
            signal.signal(number, requests.first)


def _interrupt() -> None:
    raise KeyboardInterrupt
