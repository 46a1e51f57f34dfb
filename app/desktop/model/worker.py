"""A worker: a process beside the window's, for what takes computing time. It starts with its first request. No Qt.

Requests and answers go through a pipe. Threads of the window's process feed and read it, so that nothing here ever waits.
`OneAtATime` is for work with one result, such as a study.
"""

import contextlib
import multiprocessing
import os
import queue
import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

from goniotwin.app.errors import UserError

Serve = Callable[["Connection[Any, Any]"], None]
"""The work: takes requests from a pipe and answers there, until the request None or the pipe's end (EOFError, OSError)."""
Deliver = Callable[[object], None]
Answer = TypeVar("Answer")
Failure = TypeVar("Failure")
ENDED = "the process that computes it was ended by another program, or memory was short; begin again"
NICE = 10
"""Lower priority of a worker: the station, which may run on the same computer, comes first."""


class NotWanted(Exception):
    """Raised within work that is not wanted any more: the worker ends without a result."""


@dataclass(frozen=True)
class WorkFailed:
    """Work without a result, and the reason in one line."""

    reason: str


@dataclass(frozen=True)
class WorkerEnded:
    """Delivered last, where a worker has ended that was not closed: another program may have ended it, or too little memory."""

    name: str


class Worker:
    """A worker in a process of its own, or with `process` off in a thread. `deliver` is called from a thread."""

    def __init__(self, name: str, serve: Serve, deliver: Deliver, *, process: bool = True) -> None:
        self._name = name
        self._serve = serve
        self._deliver = deliver
        self._in_process = process
        self._requests: queue.SimpleQueue[object] = queue.SimpleQueue()
        self._ours, self._theirs = multiprocessing.Pipe()
        self._lock = threading.Lock()
        self._process: Any = None
        self._closing = False
        self._threads = [
            threading.Thread(target=self._feed, name=f"{name}: requests"),
            threading.Thread(target=self._read, name=f"{name}: answers"),
        ]
        for each in self._threads:
            each.start()

    def put(self, request: object) -> None:
        """Pass a request on; return at once."""
        self._requests.put(request)

    def close(self) -> None:
        """End the worker, whatever it does. A second call does nothing."""
        with self._lock:
            if self._closing:
                return
            self._closing = True
            if self._process is not None:
                self._process.terminate()
        self._requests.put(None)
        for each in self._threads:
            each.join()
        if self._process is not None:
            self._process.join()
            self._process.close()
        self._ours.close()

    def _feed(self) -> None:
        work: threading.Thread | None = None
        first = self._requests.get()
        with self._lock:
            if self._closing or first is None:
                self._theirs.close()
                return
            if self._in_process:
                context = multiprocessing.get_context("spawn")
                self._process = context.Process(target=_work, args=(self._serve, self._theirs), name=self._name, daemon=True)
                self._process.start()
                self._theirs.close()
            else:
                work = threading.Thread(target=_work_here, args=(self._serve, self._theirs), name=self._name)
                work.start()
        with contextlib.suppress(OSError):  # the worker has ended
            self._ours.send(first)
            while (request := self._requests.get()) is not None:
                self._ours.send(request)
            self._ours.send(None)
        if work is not None:
            work.join()

    def _read(self) -> None:
        with contextlib.suppress(EOFError, OSError):
            while True:
                answer = self._ours.recv()
                if not self._closing:
                    self._deliver(answer)
        if not self._closing:
            self._deliver(WorkerEnded(self._name))


def _work(serve: Serve, connection: "Connection[Any, Any]") -> None:
    """Serve in a process of its own. A Ctrl-C is the window's business."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(NICE)
    _work_here(serve, connection)


def _work_here(serve: Serve, connection: "Connection[Any, Any]") -> None:
    with contextlib.suppress(NotWanted, EOFError, OSError), connection:
        serve(connection)


class OneAtATime(Generic[Answer]):
    """Work with one result, each piece in a worker of its own that may be ended at any time.

    `deliver` is called in a thread with the number of the piece and an answer. After one that is no `progress` there is no
    other; it is a `WorkFailed` with the reason of a worker that was ended from outside.
    """

    def __init__(
        self,
        name: str,
        serve: Serve,
        deliver: Callable[[tuple[int, Answer]], None],
        progress: type[object] | tuple[()] = (),
        *,
        process: bool = True,
    ) -> None:
        self._name, self._serve, self._deliver = name, serve, deliver
        self._progress, self._in_process = progress, process
        self._worker: Worker | None = None
        self.number = 0
        """The number of the piece that is computed; that of none once it is ended, so that a late answer has another."""

    def begin(self, request: object) -> None:
        """Begin a piece of work, after the `end` of the one before; at once."""
        self.number += 1
        number, done = self.number, False

        def deliver(delivered: object) -> None:
            nonlocal done
            answer: Any = WorkFailed(ENDED) if isinstance(delivered, WorkerEnded) else delivered
            if not done:  # a worker that has sent its result ends by itself
                self._deliver((number, answer))
            done = not isinstance(answer, self._progress)

        self._worker = Worker(self._name, self._serve, deliver, process=self._in_process)
        self._worker.put(request)

    def put(self, request: object) -> None:
        """Pass a request on to the work in progress."""
        if self._worker is not None:
            self._worker.put(request)

    def end(self) -> None:
        """End the worker: the work is done, or not wanted any more."""
        if self._worker is not None:
            self.number += 1
            worker, self._worker = self._worker, None
            worker.close()


def serve_once(compute: Callable[[Any], object], connection: "Connection[Any, Any]") -> None:
    """Answer the first request by what `compute` returns of it, or by WorkFailed."""
    request = connection.recv()
    connection.send(answer_of(lambda: compute(request), WorkFailed))


def answer_of(compute: Callable[[], Answer], failed: Callable[[str], Failure]) -> Answer | Failure:
    """What `compute` returns, or the reason why it has failed. Raises NotWanted where it does."""
    try:
        return compute()
    except NotWanted:
        raise
    except UserError as error:
        return failed(str(error))
    except MemoryError:
        return failed("there is too little memory for it")
    except Exception as error:  # noqa: BLE001  (of any library: reported, and the window goes on)
        return failed(f"{type(error).__name__}: {error}")
