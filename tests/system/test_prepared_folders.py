"""Folders and files that another user has prepared: they are refused, and no file to which they lead is changed."""

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.conftest import RIG, SMALL, changed
from tests.system.another_user import ANOTHER_USER, open_folder, rig_on
from tests.system.command import invoke

posix = pytest.mark.skipif(sys.platform == "win32", reason="Windows closes a user's folders to others")

__all__ = ["open_folder"]  # a fixture


def owned_by_another(folder: Path, foreign: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("only the system's administrator can prepare the folder of another user")
    folder.mkdir(parents=True)
    os.chown(folder, ANOTHER_USER, ANOTHER_USER)


def linked(folder: Path, foreign: Path) -> None:
    folder.parent.mkdir(parents=True, exist_ok=True)
    folder.symlink_to(foreign, target_is_directory=True)


def writable_by_all(folder: Path, foreign: Path) -> None:
    folder.mkdir(parents=True)
    folder.chmod(0o777)


@contextlib.contextmanager
def unchanged(foreign: Path) -> Iterator[None]:
    """Check that no byte of a foreign folder changes, and no file comes."""
    before = {each: each.read_bytes() for each in foreign.iterdir()}
    yield
    assert {each: each.read_bytes() for each in foreign.iterdir()} == before


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """A folder with a file that is not to change."""
    folder = tmp_path / "foreign"
    folder.mkdir()
    (folder / "precious").write_text("precious", encoding="utf-8")
    return folder


@posix
@pytest.mark.parametrize("prepare", [owned_by_another, linked, writable_by_all])
def test_a_prepared_folder_of_locks_is_refused(
    prepare: Callable[[Path, Path], None], open_folder: Path, foreign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    prepare(tmp_path / "state" / "goniotwin" / "locks", foreign)
    with unchanged(foreign):
        done = invoke("devices", "--rig", rig_on(open_folder, "/dev/ttyACM7", 9))
    assert done.returncode == 2
    assert "the lock of /dev/ttyACM7 cannot be made" in done.stderr


@posix
@pytest.mark.parametrize("prepare", [owned_by_another, linked, writable_by_all])
def test_a_prepared_folder_of_pseudo_terminals_is_refused(
    prepare: Callable[[Path, Path], None], foreign: Path, tmp_path: Path
) -> None:
    prepare(tmp_path / "ports", foreign)
    with unchanged(foreign):
        done = invoke("serve", "--rig", RIG, "--ptys", tmp_path / "ports")
    assert (done.returncode, done.stdout) == (2, "")
    assert "cannot be served" in done.stderr


@posix
@pytest.mark.parametrize("name", ["a.journal.lock", "a.journal.holder", ".a.journal.goniotwin-new", "a.journal"])
def test_no_byte_changes_of_a_file_to_which_a_prepared_link_leads(name: str, foreign: Path, tmp_path: Path) -> None:
    schedule = tmp_path / "schedule.toml"
    schedule.write_text(changed(SMALL, (("readings = 2", "readings = 1"),)), encoding="utf-8")
    (tmp_path / name).symlink_to(foreign / "precious")
    with unchanged(foreign):
        done = invoke("run", schedule, "--rig", RIG, "--out", tmp_path / "a.journal")
    assert "Traceback" not in done.stderr
    assert done.returncode == (0 if name in ("a.journal.holder", ".a.journal.goniotwin-new") else 2), done.stderr
