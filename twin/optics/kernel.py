"""Decorator of every compiled function: numba's `njit`, with a cache that all programs of a computer share.

Compiled code is stored in files beside the sources. If that folder is not writable (an installation of another user), it is
stored in the user's own cache folder. A user without a home (a service, a container) gets a folder among the temporary files.
Without even that, each program compiles for itself. numba's own `NUMBA_CACHE_DIR` takes precedence.
"""

import contextlib
import hashlib
import logging
import os
import stat
import tempfile
from collections.abc import Callable
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

from goniotwin.twin.optics.deferred_kernel import DeferredKernel

LOG = logging.getLogger("goniotwin.compilation")
"""Has a record of each kernel before it is compiled, for programs that state it: its name, and the type of its last argument.

A program that listens sets the level INFO. Code that comes from the files has no record.
"""
Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(*, error_model: str = "numpy", **options: Any) -> Callable[[Function], Function]:
    """Compile a function at its first call, for which numba is loaded. Division by zero gives inf or nan.

    `options` are those of `numba.njit`. Within `interpreted()` the function is called as Python.
    """

    def deferred(function: Function) -> Function:
        settings = {"error_model": error_model, **options}
        result: Any = DeferredKernel(function, lambda make_called: _dispatcher(function, settings, make_called))
        return result  # type: ignore[no-any-return]

    return deferred


def _dispatcher(
    function: Any, options: dict[str, Any], make_called: Callable[[], contextlib.AbstractContextManager[None]]
) -> Any:  # fmt: skip
    """numba's dispatcher of a function; the function itself where numba's compiler is off.

    Within `make_called` there are the kernels that the function calls. Code from the cache does not need them.
    """
    from numba import njit
    from numba.core import config

    from goniotwin.twin.optics.compilation import LEAN

    if config.DISABLE_JIT:
        return function
    cached = _set_cache_folder()
    # Nothing calls a kernel from C, and numba's entrance for that is a twentieth of the time to compile.
    settings: dict[str, Any] = {"cache": cached, "no_cfunc_wrapper": True, **options}
    dispatcher: Any = njit(**settings)(function)
    part = njit(**{**settings, "cache": False, "no_cpython_wrapper": True})(function) if LEAN else dispatcher
    _call_from_kernels(dispatcher, part)
    for each in {id(dispatcher): dispatcher, id(part): part}.values():
        _compile_within(each, make_called)
    if cached:
        dispatcher._cache._cache_file._source_stamp = source_stamp(Path(function.__code__.co_filename).parent)
        _load_alone(dispatcher._cache)
    _discard_unreadable(dispatcher._cache)
    return dispatcher


@cache
def _load_compiler() -> None:
    """Load numba's compiler without scipy's linear algebra, which no kernel calls and which is a third of the time.

    numba loads it only to know whether it is there. A function that needs it loads it when it is compiled, as ever.
    """
    from numba.np import linalg

    load = getattr(linalg, "ensure_blas", None)
    if load is None:  # another numba
        return
    linalg.ensure_blas = _find_scipy
    try:
        from numba.np import arraymath

        arraymath.ensure_blas = load
    finally:
        linalg.ensure_blas = load


def _find_scipy() -> None:
    if find_spec("scipy") is None:
        raise ImportError("scipy is not installed")


def _compile_within(dispatcher: Any, context: Callable[[], contextlib.AbstractContextManager[None]]) -> None:
    """Compile the function within `context`; its code in the cache is loaded without it, and without the compiler."""
    compiler: Any = dispatcher._compiler
    compile_function: Any = compiler.compile

    def compile_in_context(*arguments: Any) -> Any:
        _load_compiler()
        with context():
            return compile_function(*arguments)

    compiler.compile = compile_in_context


def thread_count() -> int:
    """Number of threads on which kernels may run at the same time: numba's, so that one setting is for all."""
    import numba

    return int(numba.get_num_threads())


def _call_from_kernels(dispatcher: Any, part: Any) -> None:
    """Have other kernels call `part`, compiled once for all values of an argument.

    numba takes a constant in a call from another kernel as a type of its own: `f(x, 0)` and `f(x, 1)` would be two functions,
    and a variable that starts as a constant would have the function compiled for that constant first, to no use.
    """
    from numba import types

    from goniotwin.twin.optics.compilation import compiling_kernel, compiling_part

    template: Any = part.get_call_template
    compile_kernel: Any = dispatcher.compile
    plain: Any = types.unliteral

    def get_call_template(arguments: tuple[Any, ...], keywords: dict[str, Any]) -> Any:
        with compiling_part():
            return template(tuple(map(plain, arguments)), {name: plain(each) for name, each in keywords.items()})

    def compile_with_parts(signature: Any) -> Any:
        if LOG.isEnabledFor(logging.INFO) and signature not in dispatcher.overloads and not _is_kept(dispatcher, signature):
            name = f"{dispatcher.py_func.__module__}.{dispatcher.py_func.__qualname__}".removeprefix("goniotwin.")
            LOG.info("%s %s", name, signature[-1] if signature else "")
        with compiling_kernel():
            return compile_kernel(signature)

    dispatcher.get_call_template = get_call_template
    dispatcher.get_overload, dispatcher.part = part.get_overload, part
    dispatcher.compile = compile_with_parts


@cache
def source_stamp(folder: Path) -> str:
    """Digest of the sources from which the code of a kernel in this folder comes: those of the folder, and all of the optics.

    numba compares the file of a kernel alone, and would go on with code that has an earlier version of a kernel that it calls.
    """
    sources = {*folder.glob("*.py"), *Path(__file__).parent.rglob("*.py")}
    about = sorted((each.parent.name, each.name, each.stat().st_mtime_ns, each.stat().st_size) for each in sources)
    return hashlib.sha256(repr(about).encode()).hexdigest()


def _load_alone(cache: Any) -> None:
    """Load compiled code without what only the compiler needs: numba's own functions, a tenth of a second.

    numba loads them with the first kernel. The compiler does so itself.
    """
    from numba.core.runtime import rtsys

    from goniotwin.twin.optics.compilation import LEAN

    guarded, load = (getattr(cache, name, None) for name in ("_guard_against_spurious_io_errors", "_load_overload"))
    if not LEAN or guarded is None or load is None:
        return

    def load_overload(signature: Any, context: Any) -> Any:
        rtsys.initialize(context)  # memory of arrays, which the code links to
        found: list[Any] = []
        with guarded():
            found.append(load(signature, context))
        return found[0] if found else None

    cache.load_overload = load_overload


def _discard_unreadable(cache: Any) -> None:
    """Recompile the function if its cache names a class of an earlier version of the program, or is damaged.

    numba unpickles an index of the cache, with the types in it, before it compares the index with the source file.
    """
    load = cache.load_overload

    def load_overload(*arguments: Any) -> Any:
        try:
            return load(*arguments)
        except Exception:  # noqa: BLE001  (unpickling a file of an earlier version, or a damaged one, may raise anything)
            try:
                cache.flush()
            except OSError:  # a read-only folder
                cache.disable()
            return None

    cache.load_overload = load_overload


def find_cache(sources: Path, home: Path | None, temporary: Path) -> Path | None:
    """Folder for compiled code; None where there is none.

    `sources` is a folder of kernels, `home` the user's (None without one), `temporary` the one for temporary files.
    """
    beside = sources / "__pycache__"
    if _writable(beside):
        return beside
    if home is not None and _writable(home / ".cache" / "goniotwin"):
        return home / ".cache" / "goniotwin"
    own = temporary / f"goniotwin-{_user()}"
    # Compiled code is loaded from there and run: other users must not have access to it.
    return own if _writable(own, mode=0o700) and _private(own) else None


def is_compiled(function: Callable[..., Any], last: str = "") -> bool:
    """Whether the files have code of a kernel for this computer, these sources and this numba; or it need not be compiled.

    With `last` code whose last argument has that type, by numba's name of it.
    """
    from numba.core import config

    dispatcher: Any = function
    if config.DISABLE_JIT:
        return True
    found = [*dispatcher.signatures]
    if _set_cache_folder():
        with contextlib.suppress(Exception):  # as in `_discard_unreadable`
            computer = dispatcher.targetctx.codegen().magic_tuple()
            found += [key[0] for key in dispatcher._cache._cache_file._load_index() if key[1] == computer]
    return any(not last or str(each[-1]) == last for each in found)


def _is_kept(dispatcher: Any, signature: Any) -> bool:
    """Whether the files have code of a kernel for a signature."""
    with contextlib.suppress(Exception):  # as in `_discard_unreadable`
        key = dispatcher._cache._index_key(signature, dispatcher.targetctx.codegen())
        return key in dispatcher._cache._cache_file._load_index()
    return False


def cache_folder() -> Path | None:
    """Folder of compiled code, or that of the optics if each folder of sources has its own; None where none is kept."""
    from numba.core import config

    if not _set_cache_folder():
        return None
    return Path(config.CACHE_DIR) if config.CACHE_DIR else Path(__file__).parent / "__pycache__"


def _writable(folder: Path, mode: int = 0o777) -> bool:
    try:
        folder.mkdir(mode=mode, parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _private(folder: Path) -> bool:
    about = folder.lstat()
    return os.name == "nt" or (stat.S_ISDIR(about.st_mode) and about.st_uid == os.getuid() and not about.st_mode & 0o077)


def _user() -> str:
    return os.environ.get("USERNAME", "user") if os.name == "nt" else str(os.getuid())


def _home() -> Path | None:
    try:
        return Path.home()
    except RuntimeError:
        return None


@cache
def _set_cache_folder() -> bool:
    """Set the folder of numba's cache before the first kernel is made; False where compiled code cannot be stored."""
    from numba.core import config

    if config.CACHE_DIR:
        return _writable(Path(config.CACHE_DIR))  # as numba does, which otherwise takes another folder
    sources = Path(__file__).parent
    folder = find_cache(sources, _home(), Path(tempfile.gettempdir()))
    if folder is not None and folder.parent != sources:  # beside the sources is numba's own first choice
        config.CACHE_DIR = str(folder)
    return folder is not None
