"""The threads of numpy's linear algebra."""

from contextlib import AbstractContextManager
from functools import cache

import numpy as np
from threadpoolctl import ThreadpoolController


@cache
def libraries() -> ThreadpoolController:
    """The libraries of this process that have threads of their own."""
    np.linalg.inv(np.eye(2))  # loads that of numpy
    return ThreadpoolController()


def one_thread_in_linear_algebra() -> AbstractContextManager[object]:
    """A context in which linear algebra has one thread: the order of its sums depends on their number.

    Of many small products more threads wait for each other longer than they multiply, on a busy computer by far.
    """
    found: AbstractContextManager[object] = libraries().limit(limits=1, user_api="blas")
    return found
