"""The runner on the workers of a Dask cluster: of a scheduler on any computer, or of a local one on the loopback interface.

Dask is an extra; without it the import raises MissingPackage. A worker computes one chunk at a time, with all of its cores: a
chunk need not be safe among threads.
"""

import contextlib
import logging
import os
import queue
import signal
import threading
from collections.abc import Generator, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError
from dataclasses import replace
from itertools import islice
from typing import Any, Self

from goniotwin.app.errors import MissingPackage, UserError, one_line
from goniotwin.app.sweeps.environment import Environment, check_alike, environment
from goniotwin.app.sweeps.runners import AHEAD, HERE
from goniotwin.app.sweeps.specification import Computed, Specification, Work, compute

try:
    from distributed import Client, KilledWorker, LocalCluster
    from distributed.client import FutureCancelledError
    from distributed.comm.addressing import get_address_host_port
    from distributed.comm.core import CommClosedError
except ImportError:
    raise MissingPackage("--dask: dask is not installed; run pip install 'goniotwin[dask]'") from None

LOCAL = "local"
LOOPBACK = "127.0.0.1"
LOOK_S = 5.0
"""How often the number of workers is looked at where no chunk is done."""
CONNECT_S = 10.0
"""Longest time until the scheduler answers, and until the first worker is there."""
ONE_AT_A_TIME = threading.Lock()
"""Held by the chunk that a worker computes."""


class DaskCluster:
    """The workers of the scheduler at an address, or, for `local`, workers of this computer's own; a context.

    A chunk whose worker is lost goes to another one, and workers may come while chunks are computed.
    """

    def __init__(self, address: str, processes: int | None = None) -> None:
        """`processes`: number of `local` workers, by default that of the cores. Raises UserError."""
        if processes is not None and address != LOCAL:
            raise UserError("--processes: is the number of workers of --dask local; leave it out, or start so many workers")
        self._log = logging.getLogger("distributed")
        self._address = address
        self._count = processes or os.cpu_count() or 1
        self._opened = contextlib.ExitStack()
        self._client: Client | None = None

    def __enter__(self) -> Self:
        """Connect. Raises UserError where there is no scheduler at the address, or no worker."""
        before = self._log.level
        self._log.setLevel(logging.CRITICAL)  # lost workers are no errors of the user's
        self._opened.callback(self._log.setLevel, before)
        try:
            with self._errors():
                self._client = self._connected()
        except BaseException:
            self._opened.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    @property
    def title(self) -> str:
        """The number of workers at this moment."""
        count = self._workers()
        return f"{count} worker{'' if count == 1 else 's'}" if count else "waiting for a worker"

    def environments(self) -> Mapping[str, Environment]:
        """Each worker's. Raises UserError for one that has no goniotwin, and for workers that differ."""
        with self._errors():
            found: dict[str, Environment] = self._known().run(environment, on_error="return")
        lost = {name for name, each in found.items() if isinstance(each, OSError)}
        alike = {f"worker {name}": each for name, each in sorted(found.items()) if name not in lost}
        for name, each in alike.items():
            if not isinstance(each, Environment):
                raise UserError(f"{name}: {each}; install the same version of goniotwin on all workers")
        remedy = "install the same versions on all workers, on computers of the same kind"
        check_alike(alike, remedy)
        # This one computes nothing, but it has written the specification and reads the arrays.
        for each in alike.values():
            check_alike({HERE: replace(each, goniotwin=environment().goniotwin), **alike}, remedy)
        return alike

    def run(self, work: Work, specification: Specification, chunks: Iterable[int]) -> Generator[Computed | None]:
        """The chunks as they are done; None where nothing was done for some time.

        Raises UserError where the scheduler is lost, and for a chunk that ends one worker after the other.
        """
        client, waiting = self._known(), iter(chunks)
        done: queue.SimpleQueue[Any] = queue.SimpleQueue()
        running: dict[str, Any] = {}

        def submit() -> None:
            for chunk in islice(waiting, max(0, AHEAD * max(1, self._workers()) - len(running))):
                # Of this run alone: the chunks of an interrupted one may still be being cancelled.
                key = f"goniotwin-{specification.work}-{client.id}-{chunk}"
                running[key] = client.submit(_compute, work, specification, chunk, key=key, pure=False)
                running[key].add_done_callback(done.put)

        try:
            while True:
                with self._errors():
                    submit()
                if not running:
                    return
                computed = None
                with contextlib.suppress(queue.Empty):
                    computed = self._computed(running.pop(done.get(timeout=LOOK_S).key))
                yield computed
        finally:
            with contextlib.suppress(Exception):  # of a scheduler that is lost
                client.cancel(list(running.values()), force=True)

    def _computed(self, future: Any) -> Computed:
        """The result of a future that is done. Raises UserError, and what the program has raised on a worker."""
        with self._errors():
            fault = future.exception() if future.status == "error" else None
            if fault is None:
                computed: Computed = future.result()
                return computed
        if isinstance(fault, KilledWorker):
            wrong = "a chunk has ended one worker after the other, for want of memory perhaps"
            raise UserError(f"--dask {self._address}: {wrong}; the same command continues")
        if isinstance(fault, ImportError):
            remedy = "install the same version of goniotwin on all workers"
            raise UserError(f"--dask {self._address}: a worker cannot load {fault.name}; {remedy}")
        raise fault

    def _connected(self) -> Client:
        address: Any = self._address
        if self._address == LOCAL:
            cluster = LocalCluster(
                n_workers=self._count,
                threads_per_worker=1,
                host=LOOPBACK,
                dashboard_address=f"{LOOPBACK}:0",
                silence_logs=logging.CRITICAL,
            )
            address = self._opened.enter_context(cluster)
        else:  # a client of an address that is none waits for it, and ends with a traceback
            get_address_host_port(self._address, strict=True)
        client = self._opened.enter_context(Client(address, timeout=CONNECT_S, set_as_default=False))
        if self._address == LOCAL:
            client.run(_ignore_interrupts)
        with contextlib.suppress(TimeoutError):
            client.wait_for_workers(1, timeout=CONNECT_S)
        if not client.scheduler_info(n_workers=-1)["workers"]:
            raise UserError(f"--dask {self._address}: has no worker; start one with: dask worker {self._address}")
        return client

    def _known(self) -> Client:
        assert self._client is not None, "the cluster is not opened"
        return self._client

    def _workers(self) -> int:
        with self._errors():
            return len(self._known().scheduler_info(n_workers=-1)["workers"])

    @contextlib.contextmanager
    def _errors(self) -> Iterator[None]:
        """Errors of the connection as UserError."""
        try:
            yield
        except (CancelledError, FutureCancelledError, CommClosedError, OSError, ValueError) as error:
            reason = one_line(str(error)).strip() or "the connection is lost"
            remedy = f"check the address, such as tcp://HOST:8786, or give {LOCAL}; finished chunks are kept"
            raise UserError(f"--dask {self._address}: {reason}; {remedy}") from None


def _ignore_interrupts() -> None:
    """A Ctrl-C of the terminal is the command's business: it ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _compute(work: Work, specification: Specification, chunk: int) -> Computed:
    """Compute a chunk on a worker."""
    with ONE_AT_A_TIME:
        return compute(work, specification, chunk)
