"""Requests to end, from a terminal or from the system: the first is obeyed in good order, and nothing breaks that order.

A stop takes its time: stop frames for every axis, the journal's last words, names and ports given back. Whoever presses Ctrl-C
twice wants it to end, not to be broken off in the middle with an axis on its way. So what comes after the first request is
not heard while things are put in order; only if that takes longer than it ever should does another one break it off.
"""

import contextlib
import os
import signal
import threading
from types import FrameType

LONGEST_S = 10.0
"""Of a stop with every device silent and a journal on a slow disk, by far."""
SAID = b"\ngoniotwin: stopping\n"
REQUESTS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


def heed_requests_to_end() -> None:
    """From now on the first of them raises KeyboardInterrupt in the main thread, and the others are not heard."""
    for number in REQUESTS:
        if number == signal.SIGINT or signal.getsignal(number) != signal.SIG_IGN:  # nohup stays nohup
            signal.signal(number, _first)


def _first(number: int, frame: FrameType | None) -> None:
    del number, frame
    for each in REQUESTS:
        signal.signal(each, _not_heard)
    patience = threading.Timer(LONGEST_S, lambda: _heard.set())
    patience.daemon = True
    patience.start()
    with contextlib.suppress(OSError):  # of a terminal that has been closed
        os.write(2, SAID)
    raise KeyboardInterrupt


_heard = threading.Event()


def _not_heard(number: int, frame: FrameType | None) -> None:
    del frame
    if _heard.is_set():
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)
