"""`goniotwin serve` never replaces or removes a file that is not its own link."""

from pathlib import Path

import pytest

from goniotwin.mocks.serial_endpoints import ptys_exist
from tests.conftest import RIG
from tests.system.command import CALLS, Call
from tests.system.conftest import ForkedServe, at

pytestmark = pytest.mark.skipif(not ptys_exist(), reason="this system has no pseudo-terminals")


def refusal(call: Call, *options: object) -> str:
    """The message of a refused `goniotwin serve`, in one line."""
    done = call("serve", "--rig", RIG, *options)
    assert (done.returncode, done.stdout) == (2, "")
    assert "Traceback" not in done.stderr
    return " ".join(done.stderr.split())


@pytest.mark.parametrize("call", CALLS)
def test_a_file_with_the_name_of_a_device_is_not_changed(tmp_path: Path, call: Call) -> None:
    (tmp_path / "mono").write_text("other", encoding="utf-8")
    assert "not this server's; remove it" in refusal(call, "--ptys", tmp_path)
    assert [each.name for each in tmp_path.iterdir()] == ["mono"]
    assert (tmp_path / "mono").read_text(encoding="utf-8") == "other"


@pytest.mark.parametrize("call", CALLS)
def test_a_folder_with_the_name_of_a_device_is_not_changed(tmp_path: Path, call: Call) -> None:
    (tmp_path / "axes").mkdir()
    assert "not this server's; remove it" in refusal(call, "--ptys", tmp_path)
    assert (tmp_path / "axes").is_dir()


@pytest.mark.parametrize("call", CALLS)
def test_a_file_in_place_of_the_folder_is_refused(tmp_path: Path, call: Call) -> None:
    (tmp_path / "file").write_text("other", encoding="utf-8")
    assert "is not a folder" in refusal(call, "--ptys", tmp_path / "file")
    assert "is not a folder" in refusal(call, "--ptys", tmp_path / "file" / "below")


@pytest.mark.parametrize("call", CALLS)
def test_a_second_server_does_not_change_the_names_of_the_first(forked_serve: ForkedServe, tmp_path: Path, call: Call) -> None:
    lines = forked_serve(RIG)
    path = Path(at(lines, "axes", "path")["path"])
    before = path.readlink()
    (tmp_path / "mine.toml").write_text("other", encoding="utf-8")
    assert "another server has its names there" in refusal(call, "--ptys", path.parent)
    assert "was not written by goniotwin serve" in refusal(call, "--ptys", path.parent, "--write-rig", tmp_path / "mine.toml")
    assert path.readlink() == before
    assert path.exists()


@pytest.mark.parametrize("call", CALLS)
def test_a_rig_file_that_cannot_be_written_is_refused_before_any_port_opens(tmp_path: Path, call: Call) -> None:
    names = tmp_path / "names"
    assert "cannot be written" in refusal(call, "--ptys", names, "--write-rig", tmp_path / "nowhere" / "rig.toml")
    assert "was not written by goniotwin serve" in refusal(call, "--ptys", names, "--write-rig", tmp_path)
    (tmp_path / "file").write_text("other", encoding="utf-8")
    assert "is not a folder" in refusal(call, "--ptys", tmp_path / "file", "--write-rig", tmp_path / "rig.toml")
    assert [each.name for each in tmp_path.iterdir()] == ["file"]


def test_the_rig_file_with_the_token_of_the_control_port_is_for_this_user_alone(
    forked_serve: ForkedServe, tmp_path: Path
) -> None:
    (tmp_path / "file").mkdir()
    rig = tmp_path / "file" / "served.toml"
    for ptys in ("first", "second"):  # the second replaces the file, which was made readable meanwhile
        lines = forked_serve(RIG, "--write-rig", rig, "--ptys", tmp_path / ptys)
        assert f'control_token = "{at(lines, "control", "port")["token"]}"' in rig.read_text(encoding="utf-8")
        assert rig.stat().st_mode & 0o777 == 0o600
        assert [each.name for each in rig.parent.iterdir()] == ["served.toml"]
        rig.chmod(0o644)
