"""The import package `goniotwin`: five folders under one name, in the tree and in the wheel."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path
from typing import Any

import pytest

import goniotwin
from tests.conftest import BARE_NAMES, REPOSITORY

pytestmark = pytest.mark.xdist_group("package")

SETUPTOOLS: dict[str, Any] = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]


def folders() -> set[str]:
    """The packages of the tree: a name for each folder with Python files."""
    found = {path.parent.relative_to(REPOSITORY) for name in BARE_NAMES for path in (REPOSITORY / name).rglob("*.py")}
    return {"goniotwin", *(f"goniotwin.{'.'.join(folder.parts)}" for folder in found)}


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel built from a copy of the sources alone: a build folder that was left would put deleted files into it."""
    copy = tmp_path_factory.mktemp("sources")
    for name in [*BARE_NAMES, "package"]:
        shutil.copytree(REPOSITORY / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(REPOSITORY / name, copy / name)
    out = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    done = subprocess.run([*build, "--wheel-dir", str(out), str(copy)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return next(out.glob("*.whl"))


@pytest.fixture(scope="session")
def unpacked(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site-packages")
    with zipfile.ZipFile(wheel) as packed:
        packed.extractall(folder)
    return folder


def test_the_list_of_packages_is_that_of_the_folders() -> None:
    assert set(SETUPTOOLS["packages"]) == folders()


def test_the_wheel_has_one_import_package_with_all_sources_and_examples(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as packed:
        names = {name for name in packed.namelist() if ".dist-info/" not in name}
    assert {name.partition("/")[0] for name in names} == {"goniotwin"}
    sources = {path.relative_to(REPOSITORY) for name in BARE_NAMES for path in (REPOSITORY / name).rglob("*.py")}
    wanted = {f"goniotwin/{path.as_posix()}" for path in sources}
    wanted |= {f"goniotwin/{path.name}" for path in (REPOSITORY / "package").iterdir() if path.is_file()}
    wanted |= {f"goniotwin/{path.relative_to(REPOSITORY).as_posix()}" for path in (REPOSITORY / "examples").glob("*/*.toml")}
    wanted |= {f"goniotwin/{path.relative_to(REPOSITORY).as_posix()}" for path in (REPOSITORY / "app").rglob("*.j2")}
    assert names == wanted


@pytest.mark.long
def test_the_wheel_runs_in_a_folder_with_files_of_the_same_names(unpacked: Path, tmp_path: Path) -> None:
    for name in BARE_NAMES:
        (tmp_path / f"{name}.py").write_text("raise RuntimeError('the wrong file')\n", encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(unpacked)}

    def run(*arguments: str) -> str:
        command = [sys.executable, "-m", "goniotwin", *arguments]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    assert run("--version") == f"goniotwin {goniotwin.__version__}\n"
    assert "examples" in run("--help")
    run("examples", "copied")
    originals = sorted((REPOSITORY / "examples").glob("*/*.toml"))
    copies = sorted((tmp_path / "copied").glob("*/*.toml"))
    assert [path.read_bytes() for path in copies] == [path.read_bytes() for path in originals]
    # Not `check`: in a new folder numba compiles the kernels of the light for it, for seconds.
    assert "TMCM-6214" in run("devices", "--rig", "copied/rigs/virtual.toml")
    assert "SCHEDULE" in run("check", "--help")


def test_the_import_and_the_version_load_nothing_heavy() -> None:
    heavy = "{name for name in sys.modules if name.partition('.')[0] in ('numba', 'numpy', 'pydantic', 'typer', 'PySide6')}"
    for lines in (
        "import sys, goniotwin",
        "import sys; sys.argv = ['goniotwin', '--version']; from goniotwin.__main__ import main; main()",
    ):
        command = [sys.executable, "-c", f"{lines}; print(sorted({heavy}))"]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        assert done.stdout.splitlines()[-1] == "[]"


def test_the_public_names_are_there_and_no_others() -> None:
    assert {"load", "open"} <= {*dir(goniotwin)}
    assert goniotwin.open is goniotwin.load
    names: dict[str, object] = {}
    exec("from goniotwin import *", names)
    assert sorted([*names.keys() - {"__builtins__"}, "open"]) == dir(goniotwin)  # Python's own is not hidden
    assert all(names[name] is getattr(goniotwin, name) for name in names.keys() - {"__builtins__"})
    with pytest.raises(AttributeError, match="nothing_of_it"):
        goniotwin.nothing_of_it  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.long
def test_each_public_name_has_a_type_in_an_installed_wheel(unpacked: Path, tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text("\n".join(["import goniotwin as g", *(f"reveal_type(g.{name})" for name in dir(goniotwin)), "g.none"]))
    command = [sys.executable, "-m", "mypy", "--strict", "--follow-imports", "silent", "--ignore-missing-imports", str(script)]
    environment = {**os.environ, "MYPYPATH": str(unpacked)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    types = dict(re.findall(r'script.py:(\d+): note: Revealed type is "(.*)"', done.stdout))
    assert [int(line) for line in types] == list(range(2, 2 + len(dir(goniotwin)))), done.stdout
    assert "Any" not in types.values()
    errors = [line for line in done.stdout.splitlines() if " error: " in line]
    assert len(errors) == 1, errors
    assert 'Module has no attribute "none"' in errors[0]
