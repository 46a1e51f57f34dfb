"""How kernels are compiled: what numba does several times for the same code is done once.

numba optimises a function by itself, makes machine code of it and an entrance from Python, although only other kernels call it;
then each of these has it once more. Here a kernel that another one calls is a *part*: its code is written down and linked into
the entry point, which alone is optimised and made machine code of. That is less than half of the work; what is executed is the
same. numba also looks up what `a * b` of two floats is anew for each product, through all that may be multiplied (lists,
strings, sets), and colours the text of an error for each that does not fit: the signatures are kept, and the text stays plain.

Nothing here changes what a kernel computes. If a future numba has no such places, kernels are compiled the usual way (`LEAN`).
"""

import gc
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from numba import types
from numba.core import errors
from numba.core.codegen import JITCodeLibrary
from numba.core.registry import cpu_target
from numba.core.targetconfig import ConfigStack
from numba.core.types.functions import BaseFunction


class _Plain:
    """numba's texts without colours."""

    @staticmethod
    def _text(message: str) -> str:
        return message

    code = errmsg = filename = indicate = highlight = reset = _text


class _Depth(threading.local):
    """How deep this thread is in parts of a kernel, and in kernels."""

    parts = 0
    kernels = 0


_DEPTH = _Depth()
_ERRORS: Any = errors


class _PartLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Code of a part, to be linked into an entry point: neither optimised nor made machine code of."""

    def _optimize_final_module(self) -> None:
        """Left to the entry point."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, _name: str) -> int:
        """0: there is no machine code."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> Any:
        """Itself, for what numba does with machine code."""
        return self

    def set_env(self, *_: Any) -> None:
        """Nothing: the environment belongs to the machine code."""


def _link_parts() -> bool:
    """Have libraries that are made while a part is compiled be those of parts; whether this numba allows it."""
    codegen = cpu_target.target_context.codegen()
    needed = ("_optimize_functions", "_optimize_final_module", "_finalize_final_module", "_finalize_dynamic_globals")
    if not all(hasattr(JITCodeLibrary, each) for each in needed) or not hasattr(codegen, "create_library"):
        return False
    usual = codegen.create_library

    def create_library(name: str, **options: Any) -> Any:
        return _PartLibrary(codegen, name, **options) if _DEPTH.parts else usual(name, **options)

    codegen.create_library = create_library
    return True


LEAN = _link_parts()


@contextmanager
def compiling_part() -> Iterator[None]:
    """While a kernel that another kernel calls is compiled in this thread."""
    _DEPTH.parts += 1
    try:
        yield
    finally:
        _DEPTH.parts -= 1


@contextmanager
def compiling_kernel() -> Iterator[None]:
    """While a kernel with all its parts is compiled in this thread.

    The compiler makes millions of objects, and searching them for garbage is a tenth of its time: there is little to find.
    """
    enabled = gc.isenabled()
    _DEPTH.kernels += 1
    colours, _ERRORS._termcolor_inst = _ERRORS._termcolor_inst, _Plain()
    gc.disable()
    try:
        yield
    finally:
        _ERRORS._termcolor_inst = colours
        _DEPTH.kernels -= 1
        if enabled:
            gc.enable()


PLAIN = (types.Integer, types.Float, types.Boolean, types.BaseTuple, types.Array)


def _keep_resolved() -> None:
    """Keep the signatures that numba finds for operators and functions of numbers, while kernels are compiled."""
    functions: Any = BaseFunction
    usual: Callable[..., Any] = functions.get_call_type

    def get_call_type(self: Any, context: Any, args: tuple[Any, ...], kws: dict[str, Any]) -> Any:
        if not _DEPTH.kernels or kws or not all(isinstance(each, PLAIN) for each in args):
            return usual(self, context, args, kws)
        flags = ConfigStack.top_or_none()
        kept = self.__dict__.setdefault("_goniotwin_resolved", {})
        key = args, flags and (flags.error_model, frozenset(flags.fastmath.flags))
        found = kept.get(key)
        if found is None:
            found = kept[key] = usual(self, context, args, kws)
        return found

    functions.get_call_type = get_call_type


_keep_resolved()
