"""Compiled functions, and their cache."""

import importlib
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from goniotwin.twin.optics.kernel import _set_cache_folder as set_cache_folder
from goniotwin.twin.optics.kernel import cache_folder, is_compiled, kernel, source_stamp

SOURCE = """
from typing import NamedTuple

from goniotwin.twin.optics.kernel import kernel


class {name}(NamedTuple):
    value: float


@kernel()
def scaled(argument, factor):
    return argument.value * factor


def result():
    return scaled({name}(2.0), {factor})
"""
MODULE = "kernel_of_a_test"


def import_anew(folder: Path, name: str, factor: float, changed_s: int) -> ModuleType:
    """Writes the module, as changed at some time, and imports it as another process would."""
    source = folder / f"{MODULE}.py"
    source.write_text(SOURCE.format(name=name, factor=factor), encoding="utf-8")
    os.utime(source, (changed_s, changed_s))
    return fresh_module(MODULE)


def fresh_module(name: str) -> ModuleType:
    """The module as another process would import it."""
    sys.modules.pop(name, None)
    importlib.invalidate_caches()
    source_stamp.cache_clear()
    return importlib.import_module(name)


CALLED = """
from goniotwin.twin.optics.kernel import kernel


@kernel()
def factor():
    return {factor}
"""
CALLER = """
from called_kernel import factor
from goniotwin.twin.optics.kernel import kernel


@kernel()
def result():
    return 2.0 * factor()
"""


def test_a_kernel_is_compiled_anew_where_one_that_it_calls_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    """As after an update that changes one file: numba compares that of the caller alone."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path / "cache"))
    called, caller = tmp_path / "called_kernel.py", tmp_path / "calling_kernel.py"
    caller.write_text(CALLER, encoding="utf-8")
    for factor, changed_s, misses in ((3.0, 1_000_000_000, 1), (5.0, 1_100_000_000, 1), (5.0, 1_100_000_000, 0)):
        called.write_text(CALLED.format(factor=factor), encoding="utf-8")
        os.utime(called, (changed_s, changed_s))
        fresh_module("called_kernel")
        module = fresh_module("calling_kernel")
        assert module.result() == 2.0 * factor
        assert sum(module.result.stats.cache_misses.values()) == misses
    for name in ("called_kernel", "calling_kernel"):
        sys.modules.pop(name)


CONSTANTS = """
from goniotwin.twin.optics.kernel import kernel


@kernel()
def added(number, count):
    return number + count


@kernel()
def result():
    count = 0
    while count < 3:
        count = added(count, 1)
    return added(count, 2)
"""


def test_a_kernel_is_compiled_once_for_all_constants(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path / "cache"))
    (tmp_path / "kernel_of_constants.py").write_text(CONSTANTS, encoding="utf-8")
    module = importlib.import_module("kernel_of_constants")
    assert module.result() == 5
    assert len(module.added.part.signatures) == 1
    sys.modules.pop("kernel_of_constants")


def test_it_is_known_whether_a_kernel_has_to_be_compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the files alone, of these sources; and by the type of the last argument."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path / "cache"))
    module = import_anew(tmp_path, "Value", 3.0, 1_000_000_000)
    assert not is_compiled(module.scaled)
    module.result()
    assert is_compiled(module.scaled)
    module = fresh_module(MODULE)
    assert is_compiled(module.scaled)
    assert is_compiled(module.scaled, "float64")
    assert not is_compiled(module.scaled, "none")
    assert not module.scaled.signatures
    assert not is_compiled(import_anew(tmp_path, "Value", 5.0, 1_100_000_000).scaled)
    sys.modules.pop(MODULE)


def test_what_one_kernel_alone_calls_has_no_machine_code_and_gives_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    """Its code is linked into the one that calls it. Called from Python it is a kernel like any other."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path / "cache"))
    (tmp_path / "called_kernel.py").write_text(CALLED.format(factor=3.0), encoding="utf-8")
    (tmp_path / "calling_kernel.py").write_text(CALLER, encoding="utf-8")
    called, calling = fresh_module("called_kernel"), fresh_module("calling_kernel")
    assert calling.result() == 6.0
    assert [each.name.partition("-")[0] for each in (tmp_path / "cache").rglob("*.nbi")] == ["calling_kernel.result"]
    assert called.factor() == 3.0
    assert len(list((tmp_path / "cache").rglob("*.nbi"))) == 2
    for name in ("called_kernel", "calling_kernel"):
        sys.modules.pop(name)


def test_without_numbas_compiler_a_kernel_is_the_function(monkeypatch: pytest.MonkeyPatch) -> None:
    """As with NUMBA_DISABLE_JIT=1, for a debugger."""
    monkeypatch.setattr("numba.core.config.DISABLE_JIT", True)
    assert kernel()(import_anew).kernel is import_anew  # type: ignore[attr-defined]


FACTORIAL = """
from called_kernel import factor
from goniotwin.twin.optics.kernel import kernel


@kernel()
def factorial(number):
    return factor() if number == 0 else number * factorial(number - 1)
"""
DEFERRED = """
import sys

from factorial_kernel import factorial

from goniotwin.twin.optics.deferred_kernel import interpreted

with interpreted():
    assert factorial(3) == 6.0
assert "numba" not in sys.modules
assert factorial(3) == 6.0
assert len(factorial.signatures) == 1
"""


def test_numba_is_loaded_at_the_first_call_that_is_not_interpreted(tmp_path: Path) -> None:
    """In a process of its own. A kernel that calls itself, and one of another module."""
    (tmp_path / "called_kernel.py").write_text(CALLED.format(factor=1.0), encoding="utf-8")
    (tmp_path / "factorial_kernel.py").write_text(FACTORIAL, encoding="utf-8")
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path[1:]]),
        "NUMBA_CACHE_DIR": str(tmp_path),
    }
    subprocess.run([sys.executable, "-c", DEFERRED], env=environment, check=True)


def test_a_cache_that_names_a_renamed_class_is_compiled_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As after an update of the program: the index of the old function exists, and its types do not."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path / "cache"))
    assert import_anew(tmp_path, "Before", 3.0, 1_000_000_000).result() == 6.0
    assert list((tmp_path / "cache").rglob("*.nbi"))
    module = import_anew(tmp_path, "After", 5.0, 1_100_000_000)
    assert module.result() == 10.0
    assert sum(module.scaled.stats.cache_misses.values()) == 1
    again = import_anew(tmp_path, "After", 5.0, 1_100_000_000)
    assert again.result() == 10.0
    assert sum(again.scaled.stats.cache_hits.values()) == 1
    sys.modules.pop(MODULE)


@pytest.mark.parametrize("kind", ["nbi", "nbc"])
@pytest.mark.parametrize("content", [b"some text\n", b"", bytes(64), bytes(range(256))])
def test_a_damaged_cache_is_compiled_anew(kind: str, content: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The index, or the code: text, nothing, zeros, anything."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path / "cache"))
    (tmp_path / "called_kernel.py").write_text(CALLED.format(factor=3.0), encoding="utf-8")
    assert fresh_module("called_kernel").factor() == 3.0
    (damaged,) = (tmp_path / "cache").rglob(f"*.{kind}")
    damaged.write_bytes(content)
    is_compiled(fresh_module("called_kernel").factor)
    for misses in (1, 0):
        module = fresh_module("called_kernel")
        assert module.factor() == 3.0
        assert sum(module.factor.stats.cache_misses.values()) == misses
    sys.modules.pop("called_kernel")


def test_a_folder_of_numba_that_cannot_be_written_keeps_no_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not another folder instead, as numba would have it: `goniotwin compile` names the one that is set."""
    (tmp_path / "file").touch()
    for place, kept in ((tmp_path / "file" / "cache", None), (tmp_path / "cache", tmp_path / "cache")):
        monkeypatch.setattr("numba.core.config.CACHE_DIR", str(place))
        set_cache_folder.cache_clear()
        assert cache_folder() == kept
    set_cache_folder.cache_clear()
