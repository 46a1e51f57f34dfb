"""Kernels before their first call: numba is loaded, and a kernel made of a function, only when one is needed.

Most commands compute no light. Loading numba takes them longer than all they do.
"""

import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
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

    `make` takes a context within which numba has to compile the kernel. The kernels that a function calls are globals of its
    module.
    """

    def __init__(
        self, function: Callable[..., Any], make: Callable[[Callable[[], AbstractContextManager[None]]], Any]
    ) -> None:  # fmt: skip
        update_wrapper(self, function)
        self.py_func = function
        self._make = make
        self._kernel: Any = None

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        """Call the kernel, or within `interpreted()` the function. Once called, the kernel has its name in its module."""
        if getattr(_MODE, "interpreted", False):
            return self.py_func(*arguments, **keywords)
        kernel = self._kernel or self.kernel
        assert isinstance(self.py_func, FunctionType)
        if self.py_func.__globals__.get(self.py_func.__name__) is self:
            self.py_func.__globals__[self.py_func.__name__] = kernel
        return kernel(*arguments, **keywords)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.kernel, name)

    @property
    def kernel(self) -> Any:
        """The kernel."""
        with _LOCK:
            if self._kernel is None:
                self._kernel = self._make(self._make_called)
        return self._kernel

    @contextmanager
    def _make_called(self) -> Iterator[None]:
        """Have the kernels that the function calls under their names, where numba finds them in the function's module.

        Afterwards what was there is back: for Python they stay deferred, and within `interpreted()` functions.
        """
        assert isinstance(self.py_func, FunctionType)
        names = self.py_func.__globals__
        with _LOCK:
            deferred = _deferred(self.py_func.__code__, names)
            names.update({name: each.kernel for name, each in deferred.items()})
        try:
            yield
        finally:
            with _LOCK:
                names.update({name: each for name, each in deferred.items() if names.get(name) is each.kernel})


def _deferred(code: CodeType, names: dict[str, Any]) -> dict[str, DeferredKernel]:
    """The deferred kernels that a function's code names, by their names in the module of the function."""
    found = {name: names[name] for name in code.co_names if isinstance(names.get(name), DeferredKernel)}
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            found |= _deferred(constant, names)
    return found
