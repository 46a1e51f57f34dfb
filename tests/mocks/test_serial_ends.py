"""Names of pseudo-terminals: their owner, and the conditions for their removal."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from goniotwin.mocks.serial_endpoints import ptys_exist
from goniotwin.mocks.serial_ends import PtyNames

pytestmark = pytest.mark.skipif(not ptys_exist(), reason="this system has no pseudo-terminals")


@pytest.fixture
def terminal() -> Iterator[str]:
    descriptors = os.openpty()
    yield os.ttyname(descriptors[1])
    for descriptor in descriptors:
        os.close(descriptor)


def test_a_folder_belongs_to_one_server(tmp_path: Path, terminal: str) -> None:
    first, second = PtyNames(), PtyNames()
    first.put(tmp_path / "axes", terminal)
    with pytest.raises(OSError, match="another server has its names there; end it"):
        second.put(tmp_path / "axes", terminal + "0")
    second.close()
    assert str((tmp_path / "axes").readlink()) == terminal
    first.close()
    assert not (tmp_path / "axes").is_symlink()
    second.put(tmp_path / "axes", terminal)
    second.close()


def test_names_left_by_a_killed_server_are_replaced(tmp_path: Path, terminal: str) -> None:
    (tmp_path / "axes").symlink_to(terminal + "0")
    names = PtyNames()
    names.put(tmp_path / "axes", terminal)
    assert str((tmp_path / "axes").readlink()) == terminal
    names.close()


def test_a_file_in_the_place_of_a_name_is_not_removed(tmp_path: Path, terminal: str) -> None:
    names = PtyNames()
    names.put(tmp_path / "axes", terminal)
    names.put(tmp_path / "mono", terminal)
    (tmp_path / "axes").unlink()
    (tmp_path / "axes").write_text("mine", encoding="utf-8")
    (tmp_path / "mono").unlink()
    (tmp_path / "mono").symlink_to("/dev/null")
    names.close()
    assert (tmp_path / "axes").read_text(encoding="utf-8") == "mine"
    assert (tmp_path / "mono").is_symlink()


def test_a_link_to_something_else_is_refused(tmp_path: Path, terminal: str) -> None:
    (tmp_path / "axes").symlink_to("/dev/ttyUSB0")
    names = PtyNames()
    with pytest.raises(OSError, match="is a link to /dev/ttyUSB0, which is not this server's"):
        names.put(tmp_path / "axes", terminal)
    names.close()
    assert (tmp_path / "axes").is_symlink()


@pytest.mark.parametrize("kind", ["link", "blank", "open to all"])
def test_a_folder_that_is_not_surely_of_this_user_is_refused(tmp_path: Path, terminal: str, kind: str) -> None:
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    folder = tmp_path / ("my ports" if kind == "blank" else "ports")
    if kind == "link":
        folder.symlink_to(foreign, target_is_directory=True)
    if kind == "open to all":
        folder.mkdir()
        folder.chmod(0o777)
    names = PtyNames()
    with pytest.raises(OSError, match=r"ports: .*; choose another"):
        names.put(folder / "axes", terminal)
    names.close()
    assert [*foreign.iterdir()] == []
