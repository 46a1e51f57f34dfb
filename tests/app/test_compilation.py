"""`goniotwin compile`, and the compilation ahead of a first use."""

import json
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from goniotwin import examples
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.cli import compilation
from goniotwin.app.cli.compilation import PARTS, REHEARSAL, Part, compile_ahead, compile_optics, parts_of_rehearsal
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig


class Compiler:
    """Parts that note in which process they were compiled; the other process executes `code`."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *done: str, code: str = "") -> None:
        self.here: list[str] = []
        self.there: list[str] = []
        self._code = code
        parts = {
            name: Part(each.title, partial(self.here.append, name), partial(done.__contains__, name), each.seconds)
            for name, each in PARTS.items()
        }
        monkeypatch.setattr(compilation, "PARTS", parts)
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
    assert len(compiler.here) == len(compiler.there) == 1


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
