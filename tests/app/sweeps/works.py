"""Sweeps for tests: functions of a module, as processes and workers need them."""

import os
import signal
from pathlib import Path

import numpy as np

from goniotwin.app.errors import UserError
from goniotwin.app.sweeps.specification import Arrays, Specification


def specification(size: int = 3, seed: int = 7, **content: object) -> Specification:
    """A sweep of random numbers; see `numbers` for the content."""
    return Specification.of("numbers", 1, size, seed, content)


def numbers(specification: Specification, chunk: int) -> Arrays:
    """Uniform numbers (size, 4), those of an item keyed by its number.

    Of the content: chunk `fails` has no result; chunk `kills` kills its process where the file `once` is not there yet, and
    leaves that file; chunk `interrupts` is Ctrl-C, as long as that file is not there.
    """
    data = specification.data
    if chunk == data.get("fails"):
        raise UserError("the arc is in the beam")
    if chunk in (data.get("kills"), data.get("interrupts")) and not (once := Path(data["once"])).exists():
        once.touch()
        if chunk == data.get("interrupts"):
            raise KeyboardInterrupt
        os.kill(os.getpid(), signal.SIGKILL)
    keys = [np.array([specification.seed, item], np.uint64) for item in specification.items(chunk)]
    return {"values": np.stack([np.random.Generator(np.random.Philox(key=key)).random(4) for key in keys])}
