"""What commands with a sweep share: its runner, and the line after Ctrl-C."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

from goniotwin.app.cli.output import RunnerOptions, error_console
from goniotwin.app.cli.work.compilation import compile_ahead
from goniotwin.app.errors import UserError
from goniotwin.app.sweeps.runners import Runner, on_this_computer

MOST_PROCESSES = 1024


@contextlib.contextmanager
def runner_of(options: RunnerOptions, chunks: int) -> Iterator[Runner]:
    """The runner of the options. Raises UserError."""
    processes, dask = options
    if processes is not None and not 1 <= processes <= MOST_PROCESSES:
        raise UserError(f"--processes: {processes} is not possible; give 1 to {MOST_PROCESSES}")
    if dask is None:
        compile_ahead()  # or each of its processes would
        yield on_this_computer(processes, chunks)
        return
    # Loads one module more, which a sweep on this computer does without.
    from goniotwin.app.sweeps.dask_cluster import DaskCluster

    with DaskCluster(dask, processes) as cluster:
        yield cluster


@contextlib.contextmanager
def kept(folder: Path, name: str) -> Iterator[None]:
    """After a Ctrl-C one line states how to continue; `name` of the chunks, such as `rigs`."""
    try:
        yield
    except KeyboardInterrupt:
        error_console().print(f"to continue: the same command; finished {name} are in {folder}", markup=False)
        raise
