"""`goniotwin compile`, the compilation ahead of a first use, and the line about it."""

import ast
import importlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from typer.exceptions import TyperException

from goniotwin import examples
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.cli import compilation
from goniotwin.app.cli.compilation import LOG, NOTE, state_compilation, state_no_more
from goniotwin.app.cli.main import app, compile_optics, run_command
from goniotwin.app.cli.work.compilation import PARTS, REHEARSAL, Part, compile_ahead, compiling_elsewhere, parts_of_rehearsal
from goniotwin.app.end_signals import EndSignalHandlers
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from goniotwin.twin.optics import kernel
from tests.conftest import REPOSITORY


def keep_code_in(monkeypatch: pytest.MonkeyPatch, folder: Path | None) -> None:
    """Have the optics keep their compiled code in a folder, or in none."""
    monkeypatch.setattr(kernel, "FOLDER", folder)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder for compiled code."""
    (tmp_path / "code").mkdir()
    keep_code_in(monkeypatch, tmp_path / "code")
    return tmp_path / "code"


class Compiler:
    """Parts that note which were compiled here, and which another process was to compile; it executes `code` in their place."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, code: str = "") -> None:
        self.here: list[str] = []
        self.there: list[str] = []
        usual = subprocess.Popen
        for name, part in PARTS.items():
            monkeypatch.setitem(PARTS, name, part._replace(call=partial(self.here.append, name)))

        def start(command: list[str], **how: Any) -> "subprocess.Popen[str]":
            names = command[3:]
            self.there += names
            marks = f"import pathlib; [pathlib.Path({str(kernel.FOLDER)!r}, n + '.done').touch() for n in {names!r}]"
            return usual([sys.executable, "-c", code or marks], **how)

        monkeypatch.setattr(subprocess, "Popen", start)

    @property
    def all(self) -> list[str]:
        return sorted(self.here + self.there)


@pytest.mark.usefixtures("folder")
def test_what_is_compiled_is_not_compiled_again(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    compiler = Compiler(monkeypatch)
    assert compile_ahead() == list(REHEARSAL)  # no more than a rehearsal needs
    assert compiler.all == sorted(REHEARSAL)
    assert compiler.here
    assert compiler.there
    compile_optics()
    assert compiler.all == sorted(PARTS)
    assert capsys.readouterr().out.startswith("compiled in ")
    compile_optics()
    assert compiler.all == sorted(PARTS)
    assert capsys.readouterr().out.startswith("nothing to do: all is compiled, in ")


@pytest.mark.usefixtures("folder")
def test_a_part_that_was_broken_off_is_compiled_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    def stop() -> None:
        raise KeyboardInterrupt

    Compiler(monkeypatch)
    with monkeypatch.context() as patch:
        patch.setitem(PARTS, "uncertainties", PARTS["uncertainties"]._replace(call=stop))
        with pytest.raises(KeyboardInterrupt):
            compile_ahead()
    assert "uncertainties" in compile_ahead()


@pytest.mark.usefixtures("folder")
def test_a_part_that_the_other_process_cannot_compile_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    compiler = Compiler(monkeypatch, code="raise ValueError('no compiler')")
    with pytest.raises(UserError, match="the optics cannot be compiled: ValueError: no compiler"):
        compile_ahead()
    assert compile_ahead() == compiler.there[:1]


@pytest.fixture
def notes() -> Iterator[None]:
    """The logger as it was before, at the end."""
    before = LOG.handlers[:], LOG.level, LOG.propagate, LOG.disabled
    LOG.disabled = False
    yield
    state_no_more()
    LOG.handlers[:], LOG.propagate, LOG.disabled = before[0], before[2], before[3]
    LOG.setLevel(before[1])


@pytest.mark.usefixtures("notes", "folder")
def test_it_is_stated_once_that_kernels_are_compiled_and_not_where_the_files_have_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "stated_kernel.py").write_text(
        "from goniotwin.twin.optics.kernel import kernel\n\n\n@kernel()\ndef double(x):\n    return x + x\n", encoding="utf-8"
    )
    for expected in ([f"goniotwin: {NOTE}"], []):
        state_compilation(0.01)
        sys.modules.pop("stated_kernel", None)
        double = importlib.import_module("stated_kernel").double
        assert (double(2.0), double(2)) == (4.0, 4)
        for looking in [each for each in threading.enumerate() if each.name == "compiled code"]:
            looking.join(60.0 if expected else 0.3)
        assert capsys.readouterr().err.splitlines() == expected


@pytest.mark.parametrize("kind", ["nbi", "nbc"])
@pytest.mark.parametrize("content", [b"some text\n", b"", bytes(64), bytes(range(256))])
def test_damaged_code_is_removed_and_that_is_stated(
    kind: str, content: bytes, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The index, or the code: text, nothing, zeros, anything."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "damaged_kernel.py").write_text(
        "from goniotwin.twin.optics.kernel import kernel\n\n\n@kernel()\ndef double(x):\n    return x + x\n", encoding="utf-8"
    )
    monkeypatch.setattr(sys, "argv", ["goniotwin", "compile"])
    monkeypatch.setitem(PARTS, "scenes", Part("double", lambda: importlib.import_module("damaged_kernel").double(2.0)))
    for name in set(PARTS) - {"scenes"}:
        (folder / f"{name}.done").touch()
    for status in (0, 1, 0):
        sys.modules.pop("damaged_kernel", None)
        assert run_command() == status
        for each in folder.glob(f"*/*.{kind}") if folder.exists() else ():
            each.write_bytes(content)
        (folder / "scenes.done").unlink(missing_ok=True)
        for name in set(PARTS) - {"scenes"} if status == 1 else ():
            folder.mkdir(exist_ok=True)
            (folder / f"{name}.done").touch()
        expected = f"goniotwin: {folder}: compiled code was damaged, and is removed; repeat the command\n" if status else ""
        assert capsys.readouterr().err.replace("\n", " ").split() == expected.split()


def test_the_program_listens_to_the_compiler_whatever_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    stated: list[int] = []
    monkeypatch.setattr(compilation, "state_compilation", lambda: stated.append(1))
    for name in ("info", "simulate"):
        with pytest.raises(TyperException):
            app([name, "--no-such-option"], standalone_mode=False)
    assert stated == [1, 1]


@pytest.mark.parametrize(("rewrite", "every"), [("", False), ("open_beam = true\n", True), ("signature = true\n", True)])
def test_without_a_sample_the_light_of_a_clear_sheet_is_compiled_too(rewrite: str, every: bool, tmp_path: Path) -> None:
    model = read_rig(examples.RIG).model()
    path = tmp_path / "some.toml"
    path.write_text(rewrite + examples.SCHEDULE.read_text(encoding="utf-8"), encoding="utf-8")
    assert parts_of_rehearsal(read_schedule(path).file, model) == (*REHEARSAL, *["every-scene"] * every)


def test_without_a_folder_for_compiled_code_a_command_goes_on_and_compile_states_it(monkeypatch: pytest.MonkeyPatch) -> None:
    compiler = Compiler(monkeypatch)
    keep_code_in(monkeypatch, None)
    assert compile_ahead() == []
    with pytest.raises(UserError, match="set NUMBA_CACHE_DIR"):
        compile_optics()
    assert not compiler.all


FIRST_USE = """
from numba.core import event
from goniotwin import examples
from goniotwin.app.cli.work.demo import run_demo
from pathlib import Path
from rich.console import Console

with event.install_recorder("numba:compile") as compiled:
    run_demo(examples.FIRST_RIG, examples.FIRST_SCHEDULE, Path("demo"), None, Console(stderr=True))
names = [each.data["dispatcher"].py_func.__qualname__ for _, each in compiled.buffer if each.is_start]
assert not names, names
"""
NO_PART = {"blocks.trace_geometry", "sampling.density", "sampling.density_all"}
"""Kernels for tests and benchmarks alone."""
NOT_BY_NAME = "inline='always'"
"""In the decorator of a kernel that numba copies into those that call it: it has no code of its own."""


def kernels() -> Iterator[str]:
    """The kernels that have code of their own, by the names of file and function."""
    for path in [each for part in ("app", "twin") for each in (REPOSITORY / part).rglob("*.py")]:
        for each in ast.parse(path.read_text(encoding="utf-8")).body:
            decorators = [ast.unparse(d) for d in each.decorator_list] if isinstance(each, ast.FunctionDef) else []
            if any(d.startswith("kernel(") and NOT_BY_NAME not in d for d in decorators):
                yield f"{path.stem}.{each.name}"  # type: ignore[attr-defined]


@pytest.mark.long
def test_after_compile_there_is_nothing_to_compile(tmp_path: Path) -> None:
    """In an empty folder every kernel of the sources gets code, or is in no part; then nothing is left to do."""
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
    assert set(kernels()) - {each.name.partition("-")[0] for each in tmp_path.rglob("*.nbi")} == NO_PART
    subprocess.run([sys.executable, "-c", FIRST_USE], env=environment, cwd=tmp_path, check=True, capture_output=True)


@pytest.mark.long
def test_damage_that_another_process_meets_is_removed_and_that_is_stated(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder.parent))
    with compiling_elsewhere(["sequences"]):
        pass
    code = list(folder.parent.glob("code-*/*/path_kernels*.nbi"))
    assert code
    for each in code:
        each.write_bytes(each.read_bytes()[:20])
    with (
        pytest.raises(UserError, match="compiled code was damaged, and is removed; repeat"),
        compiling_elsewhere(["sequences"]),
    ):
        pass
    assert not any(each.exists() for each in code)


@pytest.mark.parametrize("ended", [False, True])
def test_what_a_signal_breaks_off_is_no_damage(ended: bool, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    handlers = EndSignalHandlers(lambda: None, of_program=False)
    handlers.received = ended
    monkeypatch.setattr(compilation, "is_of_kept_code", lambda _: True)
    before = signal.signal(signal.SIGINT, handlers.handle_first)
    try:
        assert bool(compilation.drop_damaged_code(EOFError())) != ended
    finally:
        signal.signal(signal.SIGINT, before)
    assert folder.exists() == ended


def test_a_command_without_a_folder_states_that_it_compiles(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    keep_code_in(monkeypatch, None)
    monkeypatch.setattr(LOG, "disabled", False)
    state_compilation()
    try:
        assert "compiling the optics, for this command alone" in " ".join(capsys.readouterr().err.split())
    finally:
        state_no_more()
