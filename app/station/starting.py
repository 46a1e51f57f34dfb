"""The start of a station in a process of its own, detached from this one, which may end."""

import contextlib
import math
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from platformdirs import user_log_path

from goniotwin.app.detached import start_detached
from goniotwin.app.errors import UserError, one_line
from goniotwin.app.station.client import StationClient
from goniotwin.app.station.connection_file import attach, known_stations
from goniotwin.app.station.hosting import station_of
from goniotwin.app.station.messages import Message
from goniotwin.protocols.clock import RealClock, calendar_s

WAIT_S = 0.05
MOST_LOGS = 20
"""Log files of stations that are kept."""
COMING_S = 1.0
"""Longest time from the lock of a station to its connection file."""
START_S = 120.0
"""Longest time from the start of a station to its answer: the first start on a computer compiles the twin."""


def start_station(
    rig: Path,
    speed: float,
    name: str,
    on_event: Callable[[Message], None] = lambda _: None,
    on_end: Callable[[], None] = lambda: None,
    given_up: Callable[[], bool] = lambda: False,
    within_s: float = START_S,
) -> StationClient:
    """Start the station of a rig in a process of its own and attach to it. Blocks for some seconds.

    The process lives on when this one ends. Raises UserError with the reason where it does not come up, or `given_up` returns
    True before: then it comes up without a client, and ends soon.
    """
    log = user_log_path("goniotwin") / f"station-{calendar_s():.3f}.log"
    process = _start([sys.executable, "-m", "goniotwin", "station", "--rig", str(rig.absolute()), "--speed", f"{speed:g}"], log)
    clock, ended_at = RealClock(), math.inf
    while clock.now() < within_s:
        if given_up():
            raise UserError(f"{rig}: its station is not waited for")
        clock.sleep_until(clock.now() + WAIT_S)
        if process.poll() is not None:
            ended_at = min(ended_at, clock.now())
        path = next((path for path, each in known_stations().items() if each.pid == process.pid), None)
        if ended_at < math.inf:
            path = station_of(rig)  # another program has started one in the same moment
        if path is not None:
            with contextlib.suppress(TimeoutError):
                if (client := attach(path, name, on_event, on_end)) is not None:
                    _reap(process)
                    return client
        if clock.now() > ended_at + COMING_S:
            raise UserError(_last_line(log) or f"{rig}: its station has ended with status {process.returncode}; see {log}")
    process.terminate()
    _reap(process)
    raise UserError(f"{rig}: its station did not respond within {within_s:g} s and was ended; see {log}")


def _start(command: list[str], log: Path) -> "subprocess.Popen[bytes]":
    """Start a process that outlives this one: in a session of its own, its output in a file."""
    log.parent.mkdir(parents=True, exist_ok=True)
    for old in sorted(log.parent.glob("station-*.log"))[:-MOST_LOGS]:
        with contextlib.suppress(OSError):
            old.unlink()
    with log.open("wb") as output:
        try:
            return start_detached(command, output=output)
        except PermissionError:
            if sys.platform != "win32":
                raise
            raise UserError("Windows does not let a process be started here; start goniotwin station in a terminal") from None


def _reap(process: "subprocess.Popen[bytes]") -> None:
    """Leave no zombie of a process when it ends."""
    threading.Thread(target=process.wait, name="station's end", daemon=True).start()


def _last_line(log: Path) -> str:
    with contextlib.suppress(OSError):
        lines = [each for each in log.read_text(encoding="utf-8", errors="replace").splitlines() if each.strip()]
        if lines:
            return one_line(lines[-1].removeprefix("goniotwin: "))
    return ""
