"""The line of a command that compiles the optics, and what it does with compiled code that is damaged."""

import contextlib
import logging
import shutil
import sys
import threading
import traceback
from pathlib import Path

from goniotwin.app.cli.output import print_note
from goniotwin.app.end_signals import end_signal_received

KERNEL = "goniotwin.twin.optics.kernel"
"""The module that knows where the code is kept: loaded with the first kernel."""
LOG = logging.getLogger("goniotwin.compilation")
NOTE = "compiling parts of the optics that were not needed before: up to a minute, once with this version"
FIRST_LOOK_S, LAST_LOOK_S = 0.2, 60.0
NUMBAS_CACHE = ("numba", "core", "caching.py")
NOT_KEPT = "compiling the optics, for this command alone: code can be kept nowhere; set NUMBA_CACHE_DIR to a folder of yours"


class CompilationNotes(logging.Handler):
    """States that kernels are compiled, once there is a new file of compiled code. Looks for one from the first kernel on."""

    def __init__(self, first_look_s: float) -> None:
        super().__init__(logging.INFO)
        self._first_look_s = first_look_s
        self._ended = threading.Event()
        self._watch: threading.Thread | None = None

    def emit(self, _record: logging.LogRecord) -> None:
        """Begin to look: kernels are about to be defined, by the record of `twin.optics.kernel` (logging calls this)."""
        folder = sys.modules[KERNEL].FOLDER
        if folder is None:
            print_note(NOT_KEPT)
            self._ended.set()
        elif self._watch is None:
            self._watch = threading.Thread(target=self._look, args=(folder, _files(folder)), name="compiled code", daemon=True)
            self._watch.start()

    def _look(self, folder: Path, known: int) -> None:
        pause_s = self._first_look_s
        while not self._ended.wait(pause_s):
            if _files(folder) > known:
                print_note(NOTE)
                return
            pause_s = min(1.1 * pause_s, LAST_LOOK_S)  # a campaign may take a day, and compiles at its start

    def close(self) -> None:
        """State nothing more."""
        LOG.removeHandler(self)
        self._ended.set()
        if self._watch is not None:
            self._watch.join()
        super().close()


def _files(folder: Path) -> int:
    """Number of kernels whose code is in a folder; 0 where it cannot be read."""
    with contextlib.suppress(OSError):
        return sum(1 for _ in folder.glob("*/*.nbi"))
    return 0


def state_compilation(first_look_s: float = FIRST_LOOK_S) -> None:
    """Have a command state that it compiles, where it does; the first look is after `first_look_s`, the others ever later."""
    state_no_more()
    LOG.addHandler(CompilationNotes(first_look_s))
    LOG.setLevel(logging.INFO)
    LOG.propagate = False
    if KERNEL in sys.modules:
        LOG.info("kernels are defined")


def state_no_more() -> None:
    """Leave the compiler's log as it was before `state_compilation`, at the end of a command."""
    for each in [each for each in LOG.handlers if isinstance(each, CompilationNotes)]:
        each.close()
    LOG.setLevel(logging.NOTSET)
    LOG.propagate = True


def is_of_kept_code(error: BaseException) -> bool:
    """Whether an error is of numba's reading or writing of compiled code."""
    return any(Path(each.filename).parts[-3:] == NUMBAS_CACHE for each in traceback.extract_tb(error.__traceback__))


def drop_damaged_code(error: BaseException) -> str:
    """Drop compiled code that numba cannot read, as after a power failure; the message. Empty for another error.

    A program that is being ended breaks off what numba writes: then nothing is damaged.
    """
    kernel = sys.modules.get(KERNEL)
    folder = kernel.FOLDER if kernel is not None and is_of_kept_code(error) and not end_signal_received() else None
    if folder is None:
        return ""
    shutil.rmtree(folder, ignore_errors=True)
    return f"{folder}: compiled code was damaged, and is removed; repeat the command"
