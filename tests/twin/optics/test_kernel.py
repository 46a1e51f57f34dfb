"""Compiled functions, and the folder of their code."""

import ast
import os
import pickle
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from goniotwin.twin.optics.kernel import SOURCES, VERSIONS_KEPT, find_folder, kernel
from tests.conftest import REPOSITORY

CALLED = """
from goniotwin.twin.optics.kernel import kernel


@kernel()
def factor():
    return {factor}
"""
CALLING = """
from goniotwin.twin.optics.called import factor
{decorator}


@kernel()
def result():
    return 1.0 * factor()
"""
OURS = "from goniotwin.twin.optics.kernel import kernel"
PLAIN = "import numba\nkernel = lambda: numba.njit(cache=True)"
RESULT = """
from goniotwin.twin.optics import kernel
from goniotwin.twin.optics.calling import result

print(result(), sum(result.stats.cache_hits.values()), kernel.FOLDER)
"""
Installer = Callable[..., Path]


@pytest.fixture
def install(tmp_path: Path) -> Installer:
    """Installs a copy of the optics with two kernels more, of which one calls the other in another file."""

    def install_version(factor: float, name: str = "installed", decorator: str = OURS) -> Path:
        package = tmp_path / name / "goniotwin"
        if not package.exists():
            shutil.copytree(REPOSITORY / "package", package, ignore=shutil.ignore_patterns("__pycache__"))
            shutil.copytree(REPOSITORY / "twin", package / "twin", ignore=shutil.ignore_patterns("__pycache__"))
        optics = package / "twin" / "optics"
        (optics / "called.py").write_text(CALLED.format(factor=factor), encoding="utf-8")
        (optics / "calling.py").write_text(CALLING.format(decorator=decorator), encoding="utf-8")
        return package.parent

    return install_version


def run(installed: Path, home: Path, code: str = RESULT, **environment: str) -> list[str]:
    """The words that a program prints, in a process of its own with another home."""
    homes = {name: str(home) for name in ("HOME", "XDG_CACHE_HOME", "LOCALAPPDATA", "WIN_PD_OVERRIDE_LOCAL_APPDATA")}
    done = subprocess.run(
        [sys.executable, "-B", "-c", code],
        env={**os.environ, **homes, "PYTHONPATH": str(installed), "NUMBA_CACHE_DIR": "", **environment},
        cwd=installed,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split()


def test_a_changed_kernel_in_another_file_gives_the_new_value(install: Installer, tmp_path: Path) -> None:
    """numba alone goes on with the old one, because the file of the caller is the same: 3 in place of 4."""
    for decorator, name, second in ((PLAIN, "plain", "3.0"), (OURS, "ours", "4.0")):
        values = [run(install(factor, name, decorator), tmp_path / "home")[0] for factor in (3.0, 4.0)]
        assert values == ["3.0", second], name


@pytest.mark.long
def test_two_versions_in_turn_each_find_their_own_code_again(install: Installer, tmp_path: Path) -> None:
    results = [run(install(factor, name), tmp_path / "home") for factor, name in 2 * [(3.0, "installed"), (4.0, "installed")]]
    assert [each[:2] for each in results] == [["3.0", "0"], ["4.0", "0"], ["3.0", "1"], ["4.0", "1"]]
    assert len({each[2] for each in results}) == 2


class Poison:
    """What leaves a file when it is unpickled."""

    def __init__(self, trace: Path) -> None:
        self._trace = trace

    def __reduce__(self) -> tuple[object, ...]:
        return Path.touch, (self._trace,)


@pytest.mark.skipif(sys.platform == "win32", reason="a user's folders are closed to others")
@pytest.mark.parametrize(
    ("whose", "trusted"),
    [
        ("own", True),
        pytest.param("open to all", False, marks=pytest.mark.long),
        pytest.param("open to the group", False, marks=pytest.mark.long),
        pytest.param("another user's", False, marks=pytest.mark.long),
    ],
)
def test_code_in_a_folder_that_others_may_write_to_is_not_loaded(
    whose: str, trusted: bool, install: Installer, tmp_path: Path
) -> None:
    """The own folder is trusted: what is put there is loaded, or this test could not fail."""
    if whose == "another user's" and os.geteuid() != 0:
        pytest.skip("only the superuser can give a folder away")
    installed, home, trace = install(3.0), tmp_path / "home", tmp_path / "trace"
    temporary = {"TMPDIR": str(tmp_path)}
    folder = Path(run(installed, home, **temporary)[2])
    for index in folder.rglob("*.nbi"):
        index.write_bytes(pickle.dumps(Poison(trace)))
    if whose == "another user's":
        os.chown(folder, 65534, 65534)
    elif whose != "own":
        folder.chmod(0o777 if whose == "open to all" else 0o770)
    try:
        value, _, place = run(installed, home, **temporary)
    except subprocess.CalledProcessError:
        assert trusted
    else:
        assert value == "3.0"
        assert (Path(place) == folder) is trusted
        assert stat.S_IMODE(Path(place).stat().st_mode) == 0o700
    assert trace.exists() is trusted


@pytest.mark.long
def test_without_a_home_that_can_be_written_to_the_code_is_in_a_private_folder_for_temporary_files(
    install: Installer, tmp_path: Path
) -> None:
    (tmp_path / "home").touch()
    temporary = {name: str(tmp_path) for name in ("TMPDIR", "TEMP", "TMP")}
    for hits in ("0", "1"):
        value, found, place = run(install(3.0), tmp_path / "home", **temporary)
        assert (value, found) == ("3.0", hits)
        assert Path(place).parents[1] == tmp_path
        if sys.platform != "win32":
            assert [stat.S_IMODE(each.stat().st_mode) for each in (Path(place), Path(place).parent)] == [0o700, 0o700]


@pytest.mark.long
def test_without_any_folder_each_program_compiles_for_itself(install: Installer, tmp_path: Path) -> None:
    (tmp_path / "home").touch()
    for _ in range(2):
        assert run(install(3.0), tmp_path / "home", NUMBA_CACHE_DIR=str(tmp_path / "home")) == ["3.0", "0", "None"]


@pytest.mark.long
def test_numbas_own_setting_has_the_folder(install: Installer, tmp_path: Path) -> None:
    place = run(install(3.0), tmp_path / "home", NUMBA_CACHE_DIR=str(tmp_path / "chosen"))[2]
    assert Path(place).parent == tmp_path / "chosen"


USERS = """
from pathlib import Path

import numba
from users import doubled

before = numba.config.CACHE_DIR
from goniotwin.twin.optics.calling import result
from later import tripled

assert numba.config.CACHE_DIR == before
assert (doubled(2.0), tripled(2.0), result()) == (4.0, 6.0, 3.0)
for each in Path("__pycache__").glob("*.nbi"):
    print(each.name.partition("-")[0])
"""


@pytest.mark.long
def test_a_users_own_code_is_kept_where_numba_keeps_it(install: Installer, tmp_path: Path) -> None:
    """Whether it is decorated before the optics are loaded or after."""
    installed = install(3.0)
    for name, function, factor in (("users", "doubled", 2.0), ("later", "tripled", 3.0)):
        (installed / f"{name}.py").write_text(
            f"import numba\n\n\n@numba.njit(cache=True)\ndef {function}(x):\n    return {factor} * x\n", encoding="utf-8"
        )
    assert sorted(run(installed, tmp_path / "home", USERS)) == ["later.tripled", "users.doubled"]


def test_versions_that_were_not_used_for_long_are_dropped(tmp_path: Path) -> None:
    for k in range(VERSIONS_KEPT):
        folder = find_folder(f"code-{k}", str(tmp_path))
        assert folder is not None
        os.utime(folder, (1e9 + k, 1e9 + k))
    assert find_folder("code-0", str(tmp_path))  # used again
    assert find_folder("code-new", str(tmp_path))
    kept = {"code-0", "code-new", *(f"code-{k}" for k in range(2, VERSIONS_KEPT))}
    assert {each.name for each in tmp_path.iterdir()} == kept


def test_without_numbas_compiler_a_kernel_is_the_function(monkeypatch: pytest.MonkeyPatch) -> None:
    """As with NUMBA_DISABLE_JIT=1, for a debugger."""
    monkeypatch.setattr("numba.config.DISABLE_JIT", True)
    assert kernel()(run) is run


DIGESTED = tuple(f"goniotwin.twin.{part}." for part in SOURCES)


def kernels_of(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    """The functions of a module with the decorator of kernels."""
    for each in tree.body:
        if isinstance(each, ast.FunctionDef) and any("kernel(" in ast.unparse(d) for d in each.decorator_list):
            yield each


def test_what_kernels_take_from_other_files_is_in_the_digest() -> None:
    """Kernels and constants, which are part of the compiled code."""
    count = 0
    for path in [each for part in ("app", "drivers", "mocks", "twin") for each in (REPOSITORY / part).rglob("*.py")]:
        text = path.read_text(encoding="utf-8")
        if "@kernel(" not in text:
            continue
        tree = ast.parse(text)
        origins = {
            name.asname or name.name: each.module
            for each in tree.body
            if isinstance(each, ast.ImportFrom) and str(each.module).startswith("goniotwin.")
            for name in each.names
        }
        for function in kernels_of(tree):
            used = {n.id for line in function.body for n in ast.walk(line) if isinstance(n, ast.Name)} & set(origins)
            count += len(used)
            for name in used:
                assert str(origins[name]).startswith(DIGESTED), (path, function.name, name)
    assert count > 200
