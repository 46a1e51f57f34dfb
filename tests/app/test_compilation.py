"""`goniotwin compile`, and the compilation ahead of a first use."""

import ast
import importlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from typer.exceptions import TyperException

from goniotwin import examples
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.cli import compilation
from goniotwin.app.cli.compilation import (
    LOG,
    NEEDS,
    PARTS,
    REHEARSAL,
    Part,
    compile_ahead,
    compile_optics,
    parts_of_rehearsal,
    state_compilation,
)
from goniotwin.app.cli.main import command
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from tests.conftest import REPOSITORY

NO_PART = {
    "twin.optics.fast.ray_bundle.fill_view": "called as Python, for some questions about shadows without numba",
    "twin.optics.fast.ray_bundle.is_blocked": "the same",
    "twin.optics.fast.ray_bundle.map_to_disc": "the same",
}
"""Kernels that functions call and no part has, and why."""


def is_kernel(definition: ast.AST) -> bool:
    """Whether a function has the decorator of kernels."""
    decorators = definition.decorator_list if isinstance(definition, ast.FunctionDef) else []
    return any(isinstance(each, ast.Call) and ast.unparse(each.func) == "kernel" for each in decorators)


def named(tree: ast.AST) -> Iterator[str]:
    """The names that code outside kernels reads."""
    waiting = [tree]
    while waiting:
        each = waiting.pop()
        if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Load):
            yield each.id
        elif not is_kernel(each):
            waiting += ast.iter_child_nodes(each)


def sources() -> dict[str, str]:
    """The text of the modules of twin and app, by the module's name in `goniotwin`."""
    paths = [path for name in ("twin", "app") for path in (REPOSITORY / name).rglob("*.py")]
    return {".".join(each.relative_to(REPOSITORY).with_suffix("").parts): each.read_text(encoding="utf-8") for each in paths}


def entry_points() -> set[str]:
    """The kernels that functions which are no kernels call."""
    texts = sources()
    trees = {module: ast.parse(text) for module, text in texts.items() if "@kernel(" in text}
    kernels = {
        f"{module}.{getattr(each, 'name', '')}" for module, tree in trees.items() for each in tree.body if is_kernel(each)
    }
    imports = re.compile("|".join(rf"from goniotwin\.{re.escape(module)} import" for module in trees))
    found = set()
    for module, text in texts.items():
        names = {name.rpartition(".")[2]: name for name in kernels if name.rpartition(".")[0] == module}
        if not names and not imports.search(text):
            continue
        tree = trees.get(module) or ast.parse(text)
        for each in ast.walk(tree):
            if isinstance(each, ast.ImportFrom) and (each.module or "").startswith("goniotwin."):
                origin = str(each.module).removeprefix("goniotwin.")
                names |= {n.asname or n.name: f"{origin}.{n.name}" for n in each.names if f"{origin}.{n.name}" in kernels}
        if names:
            found |= {names[each] for each in named(tree) if each in names}
    return found


def test_every_kernel_that_a_function_calls_is_in_a_part() -> None:
    """Else the first command that calls it compiles it, although `goniotwin compile` has stated that all is compiled."""
    listed = {each.partition(" ")[0] for part in PARTS.values() for each in part.kernels}
    found = entry_points()
    assert len(found) > 30
    assert sorted(found - listed) == sorted(NO_PART)
    assert listed <= found


class Compiler:
    """Parts that note in which process they were compiled; the other process executes `code`."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *done: str, code: str = "") -> None:
        self.here: list[str] = []
        self.there: list[str] = []
        self._code = code
        parts = {name: replace(each, call=partial(self.here.append, name)) for name, each in PARTS.items()}
        monkeypatch.setattr(compilation, "PARTS", parts)
        monkeypatch.setattr(Part, "done", lambda part: next(name for name in parts if parts[name] is part) in done)
        monkeypatch.setattr(compilation, "_start", self._start)

    def _start(self, names: list[str]) -> "subprocess.Popen[str]":
        self.there += names
        return subprocess.Popen([sys.executable, "-c", self._code], stderr=subprocess.PIPE, text=True)


def test_two_processes_compile_what_is_missing_and_one_line_states_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    compiler = Compiler(monkeypatch, "illumination")
    assert sorted(compile_ahead(compilation.PARTS)) == sorted(set(PARTS) - {"illumination"})
    assert sorted(compiler.here + compiler.there) == sorted(set(PARTS) - {"illumination"})
    loads = [sum(PARTS[name].seconds for name in half) for half in (compiler.here, compiler.there)]
    assert max(loads) <= sum(loads) / 2.0 + max(PARTS[name].seconds for name in PARTS) / 2.0
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("goniotwin: compiling the optics, once: light on the detectors;")


def test_a_rehearsal_compiles_what_it_needs_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    compiler = Compiler(monkeypatch)
    assert sorted(compile_ahead()) == sorted(REHEARSAL)
    assert min(len(compiler.here), len(compiler.there)) == 1


@pytest.fixture
def notes() -> Iterator[None]:
    """The logger as it was before, at the end."""
    before = LOG.handlers[:], LOG.level, LOG.propagate, LOG.disabled
    LOG.disabled = False
    yield
    LOG.handlers[:], LOG.propagate, LOG.disabled = before[0], before[2], before[3]
    LOG.setLevel(before[1])


@pytest.mark.usefixtures("notes")
@pytest.mark.parametrize("name", [*NEEDS, "export", "check"])
def test_every_command_states_that_it_compiles_and_uses_both_cores(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    compiler = Compiler(monkeypatch, "uncertainties")
    state_compilation(name)
    for kernel in ("twin.plant.lamp.lamp_mean array(float64, 1d, C)", "twin.optics.fast.scenes.score_scenes none"):
        LOG.info(kernel)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("goniotwin: compiling the optics, once: samples, electronics")
    assert compiler.there == [each for each in NEEDS.get(name, ()) if each not in ("rig", "uncertainties")]


@pytest.mark.usefixtures("notes")
def test_a_kernel_is_stated_before_it_is_compiled_and_not_where_the_files_have_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    state_compilation("export")
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "stated_kernel.py").write_text(
        "from goniotwin.twin.optics.kernel import kernel\n\n\n@kernel()\ndef double(x):\n    return x + x\n", encoding="utf-8"
    )
    for expected in (["goniotwin: compiling the optics, once: stated_kernel.double float64; about 1 s"], []):
        state_compilation("export")
        sys.modules.pop("stated_kernel", None)
        assert importlib.import_module("stated_kernel").double(2.0) == 4.0
        assert capsys.readouterr().err.splitlines() == expected


def test_the_program_listens_to_the_compiler_whatever_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    stated: list[str] = []
    monkeypatch.setattr(compilation, "state_compilation", stated.append)
    for name in ("info", "simulate"):
        with pytest.raises(TyperException):
            command()([name, "--no-such-option"], standalone_mode=False)
    assert stated == ["info", "simulate"]


@pytest.mark.parametrize(("rewrite", "every"), [("", False), ("open_beam = true\n", True), ("signature = true\n", True)])
def test_without_a_sample_the_light_of_a_clear_sheet_is_compiled_too(rewrite: str, every: bool, tmp_path: Path) -> None:
    model = read_rig(examples.RIG).model()
    path = tmp_path / "some.toml"
    path.write_text(rewrite + examples.SCHEDULE.read_text(encoding="utf-8"), encoding="utf-8")
    assert parts_of_rehearsal(read_schedule(path).file, model) == (*REHEARSAL, *["every-scene"] * every)


def test_what_is_compiled_is_not_compiled_again(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    compiler = Compiler(monkeypatch, *PARTS)
    compile_optics()
    assert not compiler.here + compiler.there
    done = capsys.readouterr()
    assert done.out.startswith("nothing to do: all is compiled, in ")
    assert not done.err


def test_a_part_that_the_other_process_cannot_compile_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    Compiler(monkeypatch, code="raise ValueError('no compiler')")
    with pytest.raises(UserError, match="the optics cannot be compiled: ValueError: no compiler"):
        compile_ahead()


def test_without_a_folder_for_compiled_code_a_command_goes_on_and_compile_states_it(monkeypatch: pytest.MonkeyPatch) -> None:
    compiler = Compiler(monkeypatch)
    monkeypatch.setattr("goniotwin.twin.optics.kernel._set_cache_folder", lambda: False)
    assert compile_ahead() == []
    with pytest.raises(UserError, match="set NUMBA_CACHE_DIR"):
        compile_optics()
    assert not compiler.here + compiler.there


FIRST_USE = """
from numba.core import event
from goniotwin import examples
from goniotwin.app.cli.demo import run_demo
from pathlib import Path
from rich.console import Console

with event.install_recorder("numba:compile") as compiled:
    run_demo(examples.RIG, examples.SCHEDULE, Path("demo"), None, Console(stderr=True))
names = [each.data["dispatcher"].py_func.__qualname__ for _, each in compiled.buffer if each.is_start]
assert not names, names
"""


@pytest.mark.long
def test_after_compile_there_is_nothing_to_compile(tmp_path: Path) -> None:
    """In an empty folder; then the command has nothing to do, and no kernel of the demo is compiled."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    for expected in (sorted(PARTS), []):
        done = subprocess.run(
            [sys.executable, "-m", "goniotwin", "compile", "--json"],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        assert sorted(json.loads(done.stdout)["compiled"]) == expected
    subprocess.run([sys.executable, "-c", FIRST_USE], env=environment, cwd=tmp_path, check=True, capture_output=True)
