"""Runners on this computer: this process, or several."""

import contextlib
import multiprocessing
import os
import signal
import tempfile
import threading
from collections.abc import Generator, Iterable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait as wait_for
from pathlib import Path
from types import FrameType
from typing import Protocol

import numba

from goniotwin.app.errors import UserError
from goniotwin.app.sweeps.environment import Environment, environment
from goniotwin.app.sweeps.specification import (
    Computed,
    Specification,
    Work,
    compute,
    read_specification,
    write_specification,
)

HERE = "this computer"
AHEAD = 2
"""Chunks that wait or run for each process or thread: none is ever without work."""
LONGEST_END_S = 10.0
"""After the death of its parent a process has this time to remove what its chunk has put on the disk."""


class EndedFromOutside(UserError):
    """A process was killed, or could not start."""


class Runner(Protocol):
    """Computes the chunks of a sweep, in any order."""

    @property
    def title(self) -> str:
        """What computes, in words: `2 processes`."""

    def environments(self) -> Mapping[str, Environment]:
        """What computes each chunk, by the names of the places. Raises UserError where there is none."""

    def run(self, work: Work, specification: Specification, chunks: Iterable[int]) -> Generator[Computed | None]:
        """The chunks as they are done, and None now and then while none is: `title` may have changed.

        After `close` of the generator nothing is computed any more. Raises UserError.
        """


class Here:
    """This process, one chunk after the other."""

    title = "this process"

    def environments(self) -> Mapping[str, Environment]:
        """This process."""
        return {HERE: environment()}

    def run(self, work: Work, specification: Specification, chunks: Iterable[int]) -> Generator[Computed]:
        """The chunks in their order."""
        for chunk in chunks:
            yield compute(work, specification, chunk)


class Processes:
    """Processes of this computer, each with its share of the cores."""

    def __init__(self, count: int, *, beside: int = 0) -> None:
        """`count`: how many at once. `beside`: other processes that compute at the same time."""
        self._count, self._beside = count, beside
        self.title = f"{count} processes"

    def environments(self) -> Mapping[str, Environment]:
        """This computer: the processes are of the same program."""
        return {HERE: environment()}

    def run(self, work: Work, specification: Specification, chunks: Iterable[int]) -> Generator[Computed | None]:
        """The chunks as they are done, after a None once the first are begun.

        At the end, and at a Ctrl-C, the processes are ended.

        Raises EndedFromOutside.
        """
        context = multiprocessing.get_context("spawn")  # a fork would copy the locks of other threads
        cores = max(1, numba.get_num_threads() // (self._count + self._beside))
        folder = tempfile.TemporaryDirectory(prefix="goniotwin-sweep-")
        path = write_specification(Path(folder.name) / "specification.json", specification)
        pool = ProcessPoolExecutor(self._count, mp_context=context, initializer=_begin, initargs=(work, path, cores))
        waiting, running, begun = iter(chunks), set[Future[Computed]](), False
        try:
            while True:
                for chunk in waiting:
                    running.add(pool.submit(_compute, chunk))
                    if len(running) >= AHEAD * self._count:
                        break
                if not running:
                    return
                if not begun:
                    begun = True
                    yield None
                done, running = wait(running, return_when=FIRST_COMPLETED)
                for each in done:
                    yield each.result()
        except BrokenProcessPool:
            remedy = "for want of memory perhaps; run the same command again, with fewer --processes"
            raise EndedFromOutside(f"a process of the {specification.work} was ended from outside, {remedy}") from None
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            if running:
                for process in multiprocessing.active_children():
                    process.terminate()  # an interrupt there: see `_Process`
            pool.shutdown(wait=True)
            folder.cleanup()


def on_this_computer(processes: int | None, chunks: int) -> Runner:
    """This process, or so many processes (by default as many as there are cores), but no more than chunks."""
    count = min(processes or os.cpu_count() or 1, chunks)
    return Processes(count) if count > 1 else Here()


class _Process:
    """What a process computes. An end signal stops the chunk that runs, in order, and all that would follow."""

    work: Work
    specification: Specification
    stopped = False
    busy = False
    orphaned = False

    @classmethod
    def stop(cls, _signal: int, _frame: FrameType | None) -> None:
        """Handle the end signal: no exception in the midst of the pool's own work."""
        cls.stopped = True
        if cls.busy:
            raise KeyboardInterrupt


def _begin(work: Work, path: Path, cores: int) -> None:
    """Prepare a process. A Ctrl-C is the parent's business; after its death the process ends.

    The specification comes in a file: it is too long for the pipe from which a process takes its arguments, and the parent
    would wait forever to write it to a process that has died.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _Process.stop)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    numba.set_num_threads(cores)
    _Process.work, _Process.specification = staticmethod(work), read_specification(path)


def _end_with(sentinel: int) -> None:
    """End after the parent: first what a chunk has put on the disk is removed."""
    wait_for([sentinel])
    _Process.orphaned = True
    if _Process.busy:
        with contextlib.suppress(OSError):
            os.kill(os.getpid(), signal.SIGTERM)
        threading.Event().wait(LONGEST_END_S)
    os._exit(1)


def _compute(chunk: int) -> Computed:
    _Process.busy = True
    try:
        if _Process.stopped:
            raise KeyboardInterrupt
        return compute(_Process.work, _Process.specification, chunk)
    finally:
        _Process.busy = False
        if _Process.orphaned:
            os._exit(1)
