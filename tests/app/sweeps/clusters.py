"""A Dask cluster for tests: a scheduler and its workers on the loopback interface, at free ports, each a process of its own."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.conftest import REPOSITORY
from tests.system.conftest import until


class Cluster:
    """The processes of a cluster; its files are in a folder."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / "scheduler.json"
        self._folder = folder
        self.processes: list[subprocess.Popen[bytes]] = []
        self.scheduler = self._start("scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(self._file))
        until(lambda: self._file.exists() or self.scheduler.poll() is not None)

    @property
    def address(self) -> str:
        return str(json.loads(self._file.read_text(encoding="utf-8"))["address"])

    def add_worker(self, program: str = "", **environment: str) -> subprocess.Popen[bytes]:
        """Start a worker, or a program with the options of one, with further variables of the environment."""
        options = ["--scheduler-file", str(self._file), "--no-nanny", "--no-dashboard", "--nthreads", "1", "--worker-port", "0"]
        return self._start(program or "worker", *options, "--local-directory", str(self._folder), **environment)

    def _start(self, program: str, *options: str, **environment: str) -> subprocess.Popen[bytes]:
        module = ["-c", program] if " " in program else ["-m", f"distributed.cli.dask_{program}"]
        process = subprocess.Popen(
            [sys.executable, *module, "--host", "127.0.0.1", *options],
            env={**os.environ, "PYTHONPATH": os.pathsep.join([str(REPOSITORY), *sys.path]), **environment},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self.processes.append(process)
        return process


@contextmanager
def started_cluster(folder: Path) -> Iterator[Cluster]:
    """A scheduler without workers; all processes are ended at the end."""
    folder.mkdir()
    cluster = Cluster(folder)
    try:
        yield cluster
    finally:
        for process in cluster.processes[::-1]:
            process.kill()
            process.wait()
