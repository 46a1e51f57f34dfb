"""Kernels before their first call: numba is loaded, and a kernel made of a function, only when one is needed.

Most commands compute no light. Loading numba takes them longer than all they do.
"""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import update_wrapper
from types import CodeType, FunctionType
from typing import Any

_LOCK = threading.RLock()
_MODE = threading.local()


@contextmanager
def interpreted() -> Iterator[None]:
    """Call the kernels of this thread as Python functions: for some ten calls, which take less time than loading numba.

    A division by zero then raises ZeroDivisionError.
    """
    before = getattr(_MODE, "interpreted", False)
    _MODE.interpreted = True
    try:
        yield
    finally:
        _MODE.interpreted = before


class DeferredKernel:
    """A function, and the kernel that `make` gives of it: at the first call, or for an attribute of the kernel.

    `make` takes a function that has to be called before numba compiles the kernel. The kernels that a function calls are
    globals of its module.
    """

    def __init__(self, function: Callable[..., Any], make: Callable[[Callable[[], None]], Any]) -> None:
        update_wrapper(self, function)
        self.py_func = function
        self._make = make
        self._kernel: Any = None

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        """Call the kernel, or within `interpreted()` the function."""
        if getattr(_MODE, "interpreted", False):
            return self.py_func(*arguments, **keywords)
        return (self._kernel or self.kernel)(*arguments, **keywords)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.kernel, name)

    @property
    def kernel(self) -> Any:
        """The kernel. From then on it is under the function's name in its module."""
        with _LOCK:
            if self._kernel is None:
                assert isinstance(self.py_func, FunctionType)
                self._kernel = self._make(self._make_called)
                if self.py_func.__globals__.get(self.py_func.__name__) is self:
                    self.py_func.__globals__[self.py_func.__name__] = self._kernel
        return self._kernel

    def _make_called(self) -> None:
        """Make the kernels that the function calls: numba takes them by name from the function's module."""
        assert isinstance(self.py_func, FunctionType)
        with _LOCK:
            _resolve(self.py_func.__code__, self.py_func.__globals__)


def _resolve(code: CodeType, names: dict[str, Any]) -> None:
    """Replace the deferred kernels that a function's code names by their kernels, in the module of the function."""
    for name in code.co_names:
        if isinstance(named := names.get(name), DeferredKernel):
            names[name] = named.kernel
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            _resolve(constant, names)
