"""The import package `goniotwin`: five folders under one name, in the tree and in the wheel."""

import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import yaml
from markdown_it import MarkdownIt

import goniotwin
from tests.conftest import BARE_NAMES, REPOSITORY

pytestmark = pytest.mark.xdist_group("package")

SETUPTOOLS: dict[str, Any] = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]


def needs(module: str) -> pytest.MarkDecorator:
    """Skips a test without a module of the extra `release`, which `make test-long` installs."""
    return pytest.mark.skipif(find_spec(module) is None, reason=f"{module} is not installed")


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
    for name in ("pyproject.toml", "setup.py", "README.md", "LICENSE"):
        shutil.copy(REPOSITORY / name, copy / name)
    return built("wheel", copy, tmp_path_factory.mktemp("wheel"))


def built(kind: str, sources: Path, out: Path) -> Path:
    """The wheel or sdist of a folder of sources, by the build back end that pyproject.toml names."""
    lines = f"import sys, setuptools.build_meta as back_end; print(back_end.build_{kind}(sys.argv[1]))"
    done = subprocess.run([sys.executable, "-c", lines, str(out)], cwd=sources, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return out / done.stdout.splitlines()[-1]


@pytest.fixture(scope="session")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A source distribution of a copy of the tree, without what git ignores."""
    ignored = shutil.ignore_patterns(".git", ".venv", ".*_cache", ".hypothesis", "__pycache__", "*.egg-info", "*.nbi", "*.nbc")
    outputs = {"build", "demo", "dist", "proofs"}
    copy = tmp_path_factory.mktemp("tree")
    for path in REPOSITORY.iterdir():
        if path.name in outputs or path.name in ignored("", [path.name]):
            continue
        if path.is_dir():
            shutil.copytree(path, copy / path.name, ignore=ignored)
        else:
            shutil.copy(path, copy / path.name)
    return built("sdist", copy, tmp_path_factory.mktemp("sdist"))


def contents(wheel: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(wheel) as packed:
        return {name: packed.read(name) for name in packed.namelist()}


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
def test_the_source_distribution_has_all_that_a_clone_has_and_builds_the_same_wheel(
    sdist: Path, wheel: Path, tmp_path: Path
) -> None:
    with tarfile.open(sdist) as packed:
        packed.extractall(tmp_path, filter="data")
    root = tmp_path / sdist.name.removesuffix(".tar.gz")
    documents = ("CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "SECURITY.md", "README.md", "LICENSE")
    for name in (*documents, "Makefile", "constraints.txt", ".ci/run"):
        assert (root / name).read_bytes() == (REPOSITORY / name).read_bytes()
    for folder in ("tests", "docs", "examples", "benchmarks", ".github"):
        kept = [path.relative_to(REPOSITORY) for path in (REPOSITORY / folder).rglob("*") if path.is_file()]
        wanted = {path for path in kept if path.suffix not in {".pyc", ".nbi", ".nbc"}}
        assert {path.relative_to(root) for path in (root / folder).rglob("*") if path.is_file()} == wanted
    out = tmp_path / "wheel"
    out.mkdir()
    assert contents(built("wheel", root, out)) == contents(wheel)


def long_description(wheel: Path) -> str:
    metadata = next(text for name, text in contents(wheel).items() if name.endswith(".dist-info/METADATA"))
    return metadata.decode("utf-8").partition("\n\n")[2]


def test_the_long_description_is_the_readme_without_dead_links(wheel: Path) -> None:
    text = MarkdownIt().parse(long_description(wheel))
    spans = [span for block in text for span in [block, *(block.children or [])]]
    targets = [str(span.attrGet("href") or span.attrGet("src") or "") for span in spans]
    assert [target for target in targets if target and not target.startswith(("https://", "#"))] == []
    assert not any("src=" in span.content for span in spans if span.type.startswith("html"))
    headings = re.findall(r"^#+ .*$", (REPOSITORY / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    # The last one has the links to the pages.
    assert [*re.findall(r"^#+ .*$", long_description(wheel), re.MULTILINE), "## Read on"] == headings


@pytest.mark.long
@needs("twine")
def test_twine_finds_nothing_wrong(wheel: Path, sdist: Path) -> None:
    command = [sys.executable, "-m", "twine", "check", "--strict", str(wheel), str(sdist)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("PASSED") == 2


def test_the_citation_and_the_changelog_have_the_version() -> None:
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == goniotwin.__version__
    changes = (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"## {citation['version']} - {citation['date-released']}\n" in changes


@pytest.mark.parametrize("path", sorted((REPOSITORY / ".github").rglob("*.yml")), ids=lambda path: path.stem)
def test_the_files_of_the_host_of_the_sources_can_be_read(path: Path) -> None:
    assert isinstance(yaml.safe_load(path.read_text(encoding="utf-8")), dict)


def test_the_workflow_has_each_python_of_the_classifiers_on_three_systems() -> None:
    workflow = yaml.safe_load((REPOSITORY / ".github/workflows/test.yml").read_text(encoding="utf-8"))
    matrix = workflow["jobs"]["test"]["strategy"]["matrix"]
    classifiers = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]["classifiers"]
    stated = [each.rpartition(" ")[2] for each in classifiers if re.search(r":: 3\.\d+$", each)]
    assert matrix["python"] == stated
    assert {name.partition("-")[0] for name in matrix["system"]} == {"ubuntu", "macos", "windows"}
    lines = [step.get("run", "") for step in workflow["jobs"]["test"]["steps"]]
    targets = re.findall(r"^([a-z-]+):", (REPOSITORY / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    called = [line.split()[1] for line in lines if line.startswith("make ")]
    assert called == ["demo", "test"]
    assert set(called) <= set(targets)


@pytest.mark.long
@needs("pyright")
def test_an_editor_finds_each_import_of_a_clone() -> None:
    command = [sys.executable, "-m", "pyright", "--outputjson"]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    found = json.loads(done.stdout)
    assert found["summary"]["filesAnalyzed"] > len(folders())
    unresolved = [each["message"] for each in found["generalDiagnostics"] if each.get("rule") == "reportMissingImports"]
    assert unresolved == []


def test_the_links_for_editors_are_the_files_of_the_tree() -> None:
    links = REPOSITORY / ".venv/links/goniotwin"
    for name in BARE_NAMES:
        assert (links / name).samefile(REPOSITORY / name)
    for path in (REPOSITORY / "package").glob("*.py"):
        assert (links / path.name).samefile(path)


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
