"""`goniotwin` in processes that may be killed at any moment, and what each has told until then.

They are forked off a server that has the libraries loaded, so that a hundred of them take no minutes to start. What a
process tells goes into files, which outlive it: standard output, standard error, and a line for each row of which the
command has told that it is on the disk.
"""

import hashlib
import multiprocessing
import os
import signal
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from goniotwin.app.campaign.journal.record import RowData
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.running.events import Event, RowCommitted
from goniotwin.protocols.clock import RealClock

FORKED = [pytest.mark.skipif(sys.platform == "win32", reason="this system forks no processes")]
LONGEST_S = 300.0


@dataclass(frozen=True)
class Fate:
    """How a process is to end before its time, where nobody kills it from outside: all of them by SIGKILL, of its own doing.

    `rows` is after how many rows that it has told, `steps` at which step of SQLite's virtual machine. `most_bytes` is how
    far a file of it may grow, which is how a full disk looks where nobody may make one.
    """

    rows: int | None = None
    steps: int | None = None
    most_bytes: int | None = None


class Killable:
    """`goniotwin ARGUMENTS` at work."""

    def __init__(self, folder: Path, *arguments: object, fate: Fate | None = None) -> None:
        number = len(list(folder.glob("*.told")))
        self._files = [folder / f"{number}.{kind}" for kind in ("told", "out", "err")]
        for file in self._files:
            file.touch()
        names = [str(file) for file in self._files]
        self._process = _forks().Process(target=_command, args=(names, [str(each) for each in arguments], fate or Fate()))
        self._process.start()
        self._clock = RealClock()

    def killed_at(self, seconds: float) -> None:
        """Kills it that long after its start, if it still lives."""
        self._clock.sleep_until(seconds)
        self.killed()

    def killed(self) -> None:
        """Kills it."""
        self._process.kill()
        self.ended()

    def has_told(self, rows: int) -> None:
        """Waits until it has told so many rows."""
        while len(self.told) < rows:
            assert self._process.is_alive(), self.errors
            self._clock.sleep_until(self._clock.now() + 0.01)

    @property
    def pid(self) -> int:
        """Its number."""
        return int(self._process.pid)

    def ended(self) -> int:
        """Its status when it has ended; that of a killed one is negative."""
        self._process.join(LONGEST_S)
        status: int | None = self._process.exitcode
        assert status is not None
        self._process.close()
        return status

    @property
    def told(self) -> dict[int, str]:
        """The rows that it has told to be on the disk, by their numbers: the digest of what they came to."""
        lines = self._files[0].read_text(encoding="utf-8").splitlines()
        return {int(number): digest for number, digest in (line.split() for line in lines)}

    @property
    def output(self) -> str:
        """Its standard output."""
        return self._files[1].read_text(encoding="utf-8")

    @property
    def errors(self) -> str:
        """Its standard error."""
        return self._files[2].read_text(encoding="utf-8")

    @property
    def complaints(self) -> list[str]:
        """The lines of its standard error that it begins with its name, as it does when something is wrong."""
        return [line for line in self.errors.splitlines() if line.startswith("goniotwin: ")]


def digest_of(data: RowData) -> str:
    """Of everything that a row came to."""
    readings = [
        (*map(float, (each.gain_v_per_a, each.first_s, each.period_s, each.monitor_a)), each.counts.tobytes())
        for each in data.readings
    ]
    whole = (float(data.started_s), float(data.ended_s), data.positions, readings, data.flags)
    return hashlib.sha256(repr(whole).encode()).hexdigest()


def check_told(path: Path, told: dict[int, str]) -> None:
    """A journal has each row that was told to be in it, as it was told, and none twice."""
    if not path.exists():
        assert not told
        return
    with Journal.open(path) as journal:
        there = [(each.row.number, digest_of(each.data)) for each in journal.rows()]
    assert len(dict(there)) == len(there)
    assert told.items() <= dict(there).items()


def _forks() -> Any:
    forks = multiprocessing.get_context("forkserver")
    modules = ["cli", "campaign.campaign", "campaign.reducing.export", "campaign.journal.summary"]
    forks.set_forkserver_preload([*(f"goniotwin.app.{name}" for name in modules), __name__])
    return forks


def _command(files: list[str], arguments: list[str], fate: Fate) -> None:
    """In the new process."""
    from goniotwin.app.cli.main import main
    from goniotwin.app.cli.output import RowProgress

    told, out, err = (os.open(file, os.O_WRONLY | os.O_APPEND) for file in files)
    os.dup2(out, 1)
    os.dup2(err, 2)
    shown = RowProgress.__call__

    def tell(progress: RowProgress, event: Event) -> None:
        if isinstance(event, RowCommitted):
            os.write(told, f"{event.row.number} {digest_of(event.data)}\n".encode())
            if event.done == fate.rows:
                _die()
        shown(progress, event)

    RowProgress.__call__ = tell  # type: ignore[method-assign,assignment]
    if fate.steps is not None:
        _die_at_step(fate.steps)
    if fate.most_bytes is not None:
        _let_no_file_grow(fate.most_bytes)
    sys.argv = ["goniotwin", *arguments]
    main()


def _die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def _die_at_step(steps: int) -> None:
    import sqlite3

    left = steps
    connect = sqlite3.connect

    def count() -> int:
        nonlocal left
        left -= 1
        if left == 0:
            _die()
        return 0

    def connected(*arguments: Any, **options: Any) -> sqlite3.Connection:
        connection: sqlite3.Connection = connect(*arguments, **options)
        connection.set_progress_handler(count, 1)
        return connection

    sqlite3.connect = connected  # type: ignore[assignment]


def _let_no_file_grow(most_bytes: int) -> None:
    import resource

    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # the writing fails instead
    resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, resource.RLIM_INFINITY))
