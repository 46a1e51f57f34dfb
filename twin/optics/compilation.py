"""How kernels are compiled: what numba does several times for the same code is done once.

numba optimises a function by itself, makes machine code of it and an entrance from Python, although only other kernels call it;
then each of these has it once more. Here a kernel that another one calls is a *part*: its code is written down and linked into
the entry point, which alone is optimised and made machine code of. That is less than half of the work; what is executed is the
same. So are numba's own functions that a kernel calls. numba also looks up what `a * b` of two floats is anew for each product,
through all that may be multiplied (lists, strings, sets), and colours the text of an error for each that does not fit: the
signatures are kept, and the text stays plain.

Nothing here changes what a kernel computes. With any numba but the one that this was written for (`KNOWN`) kernels are compiled
the usual way.
"""

import gc
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import numba
from numba import types
from numba.core import compiler_machinery, dispatcher, errors, ir, typeinfer
from numba.core.codegen import JITCodeLibrary
from numba.core.registry import cpu_target
from numba.core.targetconfig import ConfigStack
from numba.core.types import functions
from numba.core.types.functions import BaseFunction
from numba.core.typing import typeof

KNOWN = "0.68."
"""The numba whose inner parts this module knows."""


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
_COLOURED: tuple[Any, ...] = (compiler_machinery, functions, ir, typeinfer, typeof)
"""Modules with texts of errors that are made, and colours for them, although no error is raised."""


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


LEAN = numba.__version__.startswith(KNOWN) and _link_parts()
"""Whether parts are linked; without it kernels are compiled as numba does it, in twice the time, with the same results."""


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
    coloured = [(module, module._termcolor) for module in _COLOURED if hasattr(module, "_termcolor")]
    for module, _ in coloured:
        module._termcolor = _Plain()
    gc.disable()
    try:
        yield
    finally:
        _ERRORS._termcolor_inst = colours
        for module, before in coloured:
            module._termcolor = before
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


def _link_numbas_own() -> None:
    """Have numba's own functions, which a kernel calls, be parts too."""
    kernels: Any = dispatcher._DispatcherBase
    usual: Callable[..., Any] = kernels.get_call_template

    def get_call_template(self: Any, args: Any, kws: Any) -> Any:
        if not _DEPTH.kernels:
            return usual(self, args, kws)
        with compiling_part():
            return usual(self, args, kws)

    kernels.get_call_template = get_call_template


NOTHING, VARIABLE, INSTRUCTION, SEQUENCE, TABLE = range(5)


def _list_variables_at_once() -> None:
    """Have numba list the variables of its instructions with a look at each value's type: it asks a million times."""
    kinds: dict[type, int] = {}

    def kind_of(value: object) -> int:
        order = ((ir.Var, VARIABLE), (ir.Inst, INSTRUCTION), ((list, tuple), SEQUENCE), (dict, TABLE))
        kind = kinds[type(value)] = next((kind for classes, kind in order if isinstance(value, classes)), NOTHING)
        return kind

    def collect(values: Iterable[Any], found: list[Any]) -> list[Any]:
        for value in values:
            kind = kinds.get(type(value))
            if kind is None:
                kind = kind_of(value)
            if kind == NOTHING:
                continue
            if kind == VARIABLE:
                found.append(value)
            elif kind == INSTRUCTION:
                found.extend(value.list_vars())
            else:
                collect(value if kind == SEQUENCE else value.values(), found)
        return found

    instructions: tuple[Any, Any, Any] = ir.Inst, ir.Stmt, ir.Expr
    instructions[0]._rec_list_vars = lambda _, value: collect((value,), [])
    instructions[1].list_vars = lambda self: collect(self.__dict__.values(), [])
    instructions[2].list_vars = lambda self: collect(self._kws.values(), [])


if LEAN:
    _keep_resolved()
    _link_numbas_own()
    _list_variables_at_once()
