"""What commands with a sweep share: the options of its runner, and the line after Ctrl-C."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from goniotwin.app.cli.compilation import compile_ahead
from goniotwin.app.cli.output import error_console
from goniotwin.app.errors import UserError

if TYPE_CHECKING:  # the runners load numpy, which a command's help does not need
    from goniotwin.app.sweeps.runners import Runner

MOST_PROCESSES = 1024
Processes = Annotated[
    int | None,
    typer.Option("--processes", metavar="P", help="How many at once; default all cores.", show_default=False),
]
Dask = Annotated[
    str | None,
    typer.Option(
        "--dask",
        metavar="ADDRESS",
        help="Compute on the workers of this Dask scheduler (tcp://HOST:8786), or `local`: workers on this computer.",
        show_default=False,
    ),
]


@contextlib.contextmanager
def runner_of(processes: int | None, dask: str | None, chunks: int) -> "Iterator[Runner]":
    """The runner of the options --processes and --dask. Raises UserError."""
    if processes is not None and not 1 <= processes <= MOST_PROCESSES:
        raise UserError(f"--processes: {processes} is not possible; give 1 to {MOST_PROCESSES}")
    if dask is None:
        # Loads 397 modules, numba and numpy among them: 0.3 s, which help does without.
        from goniotwin.app.sweeps.runners import on_this_computer

        compile_ahead()  # or each of its processes would
        yield on_this_computer(processes, chunks)
        return
    # Loads 398 modules, numba and numpy among them: 0.2 s, which help does without.
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
