"""`goniotwin` in a process that may be killed at any moment, and the rows that it reported as committed until then.

The processes are forked from a server that has loaded the libraries, so that a hundred of them start quickly. Their output
goes to files, which remain after a kill: standard output, standard error, and a line for each row that the command reported
as committed.
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

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.row import RowData
from goniotwin.app.campaign.running.events import Event, RowCommitted
from goniotwin.protocols.clock import RealClock

FORKED = [pytest.mark.skipif(sys.platform == "win32", reason="this system does not fork processes")]
TIMEOUT_S = 300.0


@dataclass(frozen=True)
class Limits:
    """Limits of a process. At `rows` or `steps` it kills itself with SIGKILL.

    `rows` is the number of rows reported as committed; `steps` the number of steps of SQLite's virtual machine. `file_bytes`
    is the largest size of a file: it acts as a full disk.
    """

    rows: int | None = None
    steps: int | None = None
    file_bytes: int | None = None


class CommandProcess:
    """`goniotwin ARGUMENTS` in a process of its own."""

    def __init__(self, folder: Path, *arguments: object, limits: Limits | None = None) -> None:
        number = len(list(folder.glob("*.rows")))
        self._files = [folder / f"{number}.{kind}" for kind in ("rows", "out", "err")]
        for file in self._files:
            file.touch()
        names = [str(file) for file in self._files]
        self._process = _context().Process(target=_command, args=(names, [str(each) for each in arguments], limits or Limits()))
        self._process.start()
        self._clock = RealClock()

    def kill_at(self, seconds: float) -> None:
        """Kill the process this long after its start, if it is still alive."""
        self._clock.sleep_until(seconds)
        self.kill()

    def kill(self) -> None:
        """Kill the process and wait for its end."""
        self._process.kill()
        self.wait()

    def wait_for_rows(self, rows: int) -> None:
        """Wait until the process has reported this many rows as committed."""
        while len(self.committed) < rows:
            assert self._process.is_alive(), self.errors
            self._clock.sleep_until(self._clock.now() + 0.01)

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return bool(self._process.is_alive())

    @property
    def pid(self) -> int:
        """The process number."""
        return int(self._process.pid)

    def wait(self) -> int:
        """Wait for the end of the process; return its exit status, negative for a killed process."""
        self._process.join(TIMEOUT_S)
        status: int | None = self._process.exitcode
        assert status is not None
        self._process.close()
        return status

    @property
    def committed(self) -> dict[int, str]:
        """Numbers of the rows that the process reported as committed, with the digests of their data."""
        lines = self._files[0].read_text(encoding="utf-8").splitlines()
        return {int(number): digest for number, digest in (line.split() for line in lines)}

    @property
    def output(self) -> str:
        """Standard output."""
        return self._files[1].read_text(encoding="utf-8")

    @property
    def output_lines(self) -> list[str]:
        """The whole lines of standard output so far."""
        return self.output.rpartition("\n")[0].splitlines()

    @property
    def errors(self) -> str:
        """Standard error."""
        return self._files[2].read_text(encoding="utf-8")

    @property
    def error_lines(self) -> list[str]:
        """Error messages: the lines of standard error that begin with the program's name."""
        return [line for line in self.errors.splitlines() if line.startswith("goniotwin: ")]


def row_digest(data: RowData) -> str:
    """Digest of all data of a row."""
    readings = [
        (*map(float, (each.gain_v_per_a, each.first_s, each.period_s, each.monitor_a)), each.counts.tobytes())
        for each in data.readings
    ]
    whole = (float(data.started_s), float(data.ended_s), data.positions, readings, data.flags)
    return hashlib.sha256(repr(whole).encode()).hexdigest()


def check_committed(path: Path, committed: dict[int, str]) -> None:
    """Check that a journal has each row that was reported as committed, with the same data, and no row twice."""
    if not path.exists():
        assert not committed
        return
    with Journal.open(path) as journal:
        rows = [(each.row.number, row_digest(each.data)) for each in journal.rows()]
    assert len(dict(rows)) == len(rows)
    assert committed.items() <= dict(rows).items()


def _context() -> Any:
    context = multiprocessing.get_context("forkserver")
    modules = ["cli", "campaign.campaign", "data.conversion", "campaign.journal.summary"]
    context.set_forkserver_preload([*(f"goniotwin.app.{name}" for name in modules), "tests.system.preloaded", __name__])
    return context


def _command(files: list[str], arguments: list[str], limits: Limits) -> None:
    """Run the command, in the new process."""
    from goniotwin.app.cli.main import main
    from goniotwin.app.cli.work.row_progress import RowProgress

    rows, out, err = (os.open(file, os.O_WRONLY | os.O_APPEND) for file in files)
    os.dup2(out, 1)
    os.dup2(err, 2)
    show = RowProgress.__call__

    def report(progress: RowProgress, event: Event) -> None:
        if isinstance(event, RowCommitted):
            os.write(rows, f"{event.row.number} {row_digest(event.data)}\n".encode())
            if event.done == limits.rows:
                _kill_self()
        show(progress, event)

    RowProgress.__call__ = report  # type: ignore[method-assign,assignment]
    if limits.steps is not None:
        _kill_self_at_step(limits.steps)
    if limits.file_bytes is not None:
        _limit_file_size(limits.file_bytes)
    sys.argv = ["goniotwin", *arguments]
    main()


def _kill_self() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def _kill_self_at_step(steps: int) -> None:
    import sqlite3

    left = steps
    connect = sqlite3.connect

    def count() -> int:
        nonlocal left
        left -= 1
        if left == 0:
            _kill_self()
        return 0

    def connect_and_count(*arguments: Any, **options: Any) -> sqlite3.Connection:
        connection: sqlite3.Connection = connect(*arguments, **options)
        connection.set_progress_handler(count, 1)
        return connection

    sqlite3.connect = connect_and_count  # type: ignore[assignment]


def _limit_file_size(file_bytes: int) -> None:
    import resource

    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)  # so that a write fails instead
    resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes, resource.RLIM_INFINITY))
