"""Sizes of statistical tests: a part of the draws in `make test`, all of them in `make test-long`.

What a test asserts does not change with its size. Where it compares with a standard error, that is the one of the draws
there were; where it needs so many hits, it takes those directions, samples or rows that have as many.
"""

import contextlib
from collections.abc import Iterable, Iterator
from typing import Any

import pytest

from goniotwin.app.simulation import estimate


def parted(part: int) -> pytest.MarkDecorator:
    """Gives a test its `part`: it takes one draw of so many, and all of them in the long run."""
    long = pytest.param(1, id="all", marks=pytest.mark.long)
    return pytest.mark.parametrize("part", [pytest.param(part, id=f"1 of {part}"), long])


def some(cases: Iterable[Any], count: int = 1) -> list[Any]:
    """Cases of a parametrized test, tuples for several values: the first ones in the short run, all in the long one."""
    each = [case if isinstance(case, tuple) else (case,) for case in cases]
    return [pytest.param(*case, marks=[pytest.mark.long] if k >= count else []) for k, case in enumerate(each)]


@contextlib.contextmanager
def few_check_rays() -> Iterator[None]:
    """Simulations compare the fast estimator's seven rays with 256 instead of 4096.

    That comparison is nearly all of their time. It gives the standard errors, and leaves the values as they are.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(estimate, "CHECK_RAYS", 256)
        yield
