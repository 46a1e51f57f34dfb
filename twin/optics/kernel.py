"""Decorator of every compiled function: numba's `njit`, with the options that all have, and one folder for compiled code.

numba keeps compiled code in files, and uses it again as long as the file of a kernel is the same. It does not see that a kernel
has changed that this one calls from another file, and would go on with the old code. So the folder's name has a digest of all
sources with kernels that others call, of numba and of the processor: another version has another folder, and finds its own
again. It is in the user's cache folder; where that cannot be written to (a service, a container), among the temporary files;
without even that each program compiles for itself. With `NUMBA_CACHE_DIR` it is there.

A module with kernels loads numba, which takes longer than most commands: it is imported where light is computed.
"""

import contextlib
import hashlib
import logging
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import llvmlite
import llvmlite.binding
import numba

from goniotwin.own_files import cache_folder, make_own_folder

LOG = logging.getLogger("goniotwin.compilation")
"""Has one record, of level INFO, when the first kernel is about to be defined: for programs that state that they compile."""
SOURCES = ("optics", "plant")
"""Folders of the twin with kernels that those of other files call."""
VERSIONS_KEPT = 16
"""Folders of compiled code: a version that was not used for long is dropped, and compiled again if it is used after all."""
Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(*, error_model: str = "numpy", **options: Any) -> Callable[[Function], Function]:
    """Compile a function at its first call for these types, or load its code. Division by zero gives inf or nan.

    `options` are those of `numba.njit`.
    """

    def compiled(function: Function) -> Function:
        with _numbas_folder(FOLDER):
            result: Any = numba.njit(cache=FOLDER is not None, error_model=error_model, **options)(function)
        return result  # type: ignore[no-any-return]

    return compiled


@contextlib.contextmanager
def _numbas_folder(folder: Path | None) -> Iterator[None]:
    """Have numba keep in `folder` what is decorated here, and what is decorated elsewhere where it was kept before.

    numba looks up the setting when a function is decorated, and not again.
    """
    before = numba.config.CACHE_DIR
    if folder is not None:
        numba.config.CACHE_DIR = str(folder)
    try:
        yield
    finally:
        numba.config.CACHE_DIR = before


def thread_count() -> int:
    """Number of threads on which kernels may run at the same time: numba's, so that one setting is for all."""
    return int(numba.get_num_threads())


def code_digest(twin: Path) -> str:
    """Digest of what compiled code depends on: the sources in the folder `twin`, this numba and this processor."""
    binding, config = llvmlite.binding, numba.config
    features = binding.get_host_cpu_features().flatten()
    about = numba.__version__, llvmlite.__version__, binding.get_host_cpu_name(), features, config.CPU_NAME, config.CPU_FEATURES
    digest = hashlib.sha256(repr(about).encode())
    for path in sorted(each for part in SOURCES for each in (twin / part).rglob("*.py")):
        digest.update(f"{path.relative_to(twin).as_posix()}\0".encode() + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def find_folder(name: str, chosen: str = "") -> Path | None:
    """The folder `name` for compiled code, made if need be; None where there is none. `chosen` is numba's own setting.

    Compiled code is loaded from there and executed: no other user may have had access to it.
    """
    if chosen:
        return _own_folder(Path(chosen).absolute() / name)
    user = str(os.getuid()) if hasattr(os, "getuid") else os.environ.get("USERNAME", "user")
    for place in (cache_folder(), Path(tempfile.gettempdir()) / f"goniotwin-{user}"):
        if place.is_absolute() and (folder := _own_folder(place / name)):  # without a home it is not
            return folder
    return None


def _own_folder(folder: Path) -> Path | None:
    """The folder, if it is this user's alone and can be written to."""
    try:
        is_new = not folder.is_dir()
        folder.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        make_own_folder(folder)
        if os.name != "nt" and folder.stat().st_mode & 0o022:
            return None
        with tempfile.TemporaryFile(dir=folder):
            os.utime(folder)  # it is in use
    except OSError:
        return None
    if is_new:
        versions = folder.parent.glob(f"{folder.name.partition('-')[0]}-*")
        for each in sorted(versions, key=lambda each: each.stat().st_mtime)[:-VERSIONS_KEPT]:
            shutil.rmtree(each, ignore_errors=True)
    return folder


FOLDER = find_folder(f"code-{code_digest(Path(__file__).parents[1])}", numba.config.CACHE_DIR)
"""Folder of this version's compiled code; None where none can be kept."""
LOG.info("kernels are defined; compiled code is kept in %s", FOLDER)
