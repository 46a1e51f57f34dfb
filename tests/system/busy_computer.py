"""A computer that other programs keep busy, and runs on a served rig beside them."""

import contextlib
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from goniotwin.app.campaign.journal.writing import Journal
from tests.system.command_process import CommandProcess
from tests.system.conftest import until

BUSY = """
import os, sys, threading
threading.Thread(target=lambda: os._exit(len(sys.stdin.read())), daemon=True).start()
while True:
    pass
"""
"""Uses all the time that it gets, until its input ends, as it does when the tests are killed."""


@contextlib.contextmanager
def busy_processes(count: int) -> Iterator[None]:
    """Programs that each use all the time of a processor that they get."""
    with contextlib.ExitStack() as stack:
        for _ in range(count):
            process = stack.enter_context(subprocess.Popen([sys.executable, "-S", "-c", BUSY], stdin=subprocess.PIPE))
            stack.callback(process.kill)
        yield


@dataclass(frozen=True)
class ServedRun:
    """A run on a served rig: its exit status, the faults in its journal, and its standard error."""

    status: int
    faults: tuple[str, ...]
    errors: str

    @property
    def stopped_axes(self) -> list[str]:
        """The faults by which an axis came to rest before its target."""
        return [each for each in self.faults if "heartbeat" in each]


def served_runs(
    folder: Path,
    rig: Path,
    schedule: Path,
    speed: float,
    runs: int,
    busy: int,
    report: Callable[[int, ServedRun], None] = lambda _number, _run: None,
) -> list[ServedRun]:
    """Runs of a schedule, one after the other, each in a process of its own, on one served rig beside busy programs."""
    served = folder / "served.toml"
    server = CommandProcess(folder, "serve", "--rig", rig, "--speed", speed, "--ptys", folder / "ptys", "--write-rig", served)
    until(lambda: not server.alive or '"control"' in server.output)
    found: list[ServedRun] = []
    try:
        with busy_processes(busy):
            for number in range(runs):
                journal = folder / f"{number}.journal"
                run = CommandProcess(folder, "run", schedule, "--rig", served, "--out", journal)
                status = run.wait()
                faults: tuple[str, ...] = ()
                if journal.exists():
                    with Journal.open(journal) as kept:
                        faults = tuple(text for _, kind, text in kept.events() if kind == "fault")
                found.append(ServedRun(status, faults, run.errors))
                report(number, found[-1])
    finally:
        server.kill()
    return found
