"""Sleep of this computer during a run: it is prevented where the system has a way, and noticed where it comes all the same."""

import contextlib
import ctypes
import os
import select
import signal
import subprocess
import sys
from collections.abc import Callable

from goniotwin.protocols.clock import Clock, VirtualClock, awake_s, calendar_s

SLEPT_S = 10.0
"""Shortest sleep: by less the calendar may have been corrected."""
ANSWER_S = 5.0
"""Longest time in which the system grants that this computer stays awake."""
HOLD = "echo; exec cat"
"""Prints a line when the lock is held, and ends when its input ends, as it does when this program ends in whatever way."""
ES_CONTINUOUS, ES_SYSTEM_REQUIRED = 0x8000_0000, 0x1


class SleepWatch:
    """Notices that this computer slept: the calendar went on, the time in which it was awake did not. Both in s.

    A calendar that was set forward looks the same; what follows then is harmless.
    """

    def __init__(self, calendar: Callable[[], float] = calendar_s, awake: Callable[[], float] = awake_s) -> None:
        self._calendar, self._awake = calendar, awake
        self._ahead = calendar() - awake()

    def slept_s(self) -> float:
        """How long this computer slept since the last call, s; 0 if it did not."""
        before, self._ahead = self._ahead, self._calendar() - self._awake()
        slept = self._ahead - before
        return slept if slept >= SLEPT_S else 0.0


class NoSleepWatch(SleepWatch):
    """The watch of a virtual clock, which does not go on either while the computer sleeps."""

    def __init__(self) -> None:
        super().__init__(lambda: 0.0, lambda: 0.0)


def watch_for(clock: Clock) -> SleepWatch:
    """The watch of a run on a clock."""
    return NoSleepWatch() if isinstance(clock, VirtualClock) else SleepWatch()


class StayAwake:
    """Keeps this computer awake from `begin` to `end`, both in one thread, or to the end of this program."""

    def __init__(self, answer_s: float = ANSWER_S) -> None:
        """`answer_s` is how long the system's program may take to grant it."""
        self._answer_s = answer_s
        self._process: subprocess.Popen[bytes] | None = None

    def begin(self, purpose: str) -> str:
        """Keep this computer awake for `purpose`; return why it may sleep all the same, or an empty text."""
        if sys.platform == "win32":
            granted = ctypes.windll.kernel32.SetThreadExecutionState(ES_CONTINUOUS | ES_SYSTEM_REQUIRED)
            return "" if granted else "Windows does not grant it"
        if sys.platform == "darwin":
            command = ["caffeinate", "-i", "sh", "-c", HOLD]
        else:
            what = ["--what=sleep:idle", "--who=goniotwin", f"--why={purpose}", "--mode=block"]
            command = ["systemd-inhibit", *what, "sh", "-c", HOLD]
        return self._hold(command)

    def end(self) -> None:
        """Let this computer sleep again."""
        if sys.platform == "win32":
            ctypes.windll.kernel32.SetThreadExecutionState(ES_CONTINUOUS)
        process, self._process = self._process, None
        if process is not None:
            _end(process)

    def _hold(self, command: list[str]) -> str:
        try:
            process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True
            )
        except OSError as error:
            return f"{command[0]}: {error.strerror or error}"
        assert process.stdout is not None
        if select.select([process.stdout], [], [], self._answer_s)[0] and os.read(process.stdout.fileno(), 1):
            self._process = process
            return ""
        _end(process)
        return f"{command[0]} does not grant it"


def _end(process: "subprocess.Popen[bytes]") -> None:
    """End the input of a process, and so the process; or, if it does not end, all of its session, which has its output open."""
    try:
        process.communicate(timeout=ANSWER_S)
    except subprocess.TimeoutExpired:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
