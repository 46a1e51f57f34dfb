"""Calls of the command `goniotwin` from tests: in this process, or in a process of its own."""

import contextlib
import io
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any

import numba
import pytest

from goniotwin.app.cli.main import main
from goniotwin.app.end_signals import END_SIGNALS

Call = Callable[..., subprocess.CompletedProcess[str]]


def goniotwin(*arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run the command in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "goniotwin", *map(str, arguments)],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
        timeout=300,
        check=False,
    )


def invoke(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run the command in this process: a hundred times faster; for help, refusals and short work."""
    given = [str(each) for each in arguments]
    handlers = {number: signal.getsignal(number) for number in END_SIGNALS}
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(io.StringIO()) as out,
        contextlib.redirect_stderr(io.StringIO()) as err,
    ):
        patch.setattr(sys, "argv", ["goniotwin", *given])
        patch.setattr(sys, "excepthook", sys.excepthook)
        patch.setattr(threading, "excepthook", threading.excepthook)
        try:
            with pytest.raises(SystemExit) as ended:
                main()
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
    assert isinstance(ended.value.code, int)
    return subprocess.CompletedProcess(given, ended.value.code, out.getvalue(), err.getvalue())


def in_one_thread(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run the command in this process, with one thread for what takes several."""
    threads = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        return invoke(*arguments)
    finally:
        numba.set_num_threads(threads)


def process_in_one_thread(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run the command in a process of its own that has one thread for what takes several."""
    return goniotwin(*arguments, NUMBA_NUM_THREADS="1")


def process_in_two_threads(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run the command in a process of its own that has two threads for what takes several."""
    return goniotwin(*arguments, NUMBA_NUM_THREADS="2")


CALLS = [pytest.param(invoke, id="in process"), pytest.param(goniotwin, id="own process", marks=pytest.mark.long)]
"""Ways to call the command, with the same results: in this process always, in a process of its own in `make test-long`."""


def json_result(done: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    """The one JSON object on standard output of a call that succeeded."""
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found
