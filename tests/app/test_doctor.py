"""The examination of this computer: what is broken is named with its remedy, and nothing is changed."""

import getpass
import json
import os
import shutil
import socket
import sys
from collections import namedtuple
from pathlib import Path

import pytest

from goniotwin.app.cli.work import doctor
from goniotwin.app.cli.work.doctor import QT_LIBRARIES, Finding, examine, exit_status
from goniotwin.app.errors import UserError
from tests.conftest import REPOSITORY, Writer
from tests.system.command import goniotwin, invoke

UNPRIVILEGED = pytest.mark.skipif(sys.platform == "win32" or os.geteuid() == 0, reason="rights do not bind this user")


@pytest.fixture(autouse=True)
def _sound_libraries(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Libraries load, there is no USB bus, and folders are the test's: it is about one fault at a time."""
    monkeypatch.setattr(doctor, "import_fault", lambda _: "")
    monkeypatch.setattr(doctor, "USB_DEVICES", tmp_path / "no-bus")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def finding(topic: str, rig: Path | None = None) -> Finding:
    """The one line on a topic."""
    (found,) = [each for each in examine(rig) if each.topic == topic]
    return found


def test_a_library_that_does_not_load_is_named_and_the_rest_is_examined(tmp_path: Path) -> None:
    """A folder before all others has a Qt and a numba that are broken; the command itself needs neither."""
    for name in ("PySide6", "numba"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(f"raise ImportError('libEGL of {name} is missing')\n", encoding="utf-8")
    paths = os.pathsep.join(filter(None, (str(tmp_path), os.environ.get("PYTHONPATH"))))
    done = goniotwin("doctor", "--json", PYTHONPATH=paths)
    found = {each["topic"]: each for each in json.loads(done.stdout)["findings"]}
    assert (done.returncode, done.stderr) == (1, "")
    assert (found["numba"]["level"], found["PySide6-Essentials"]["level"]) == ("problem", "note")
    assert "libEGL of PySide6 is missing" in found["PySide6-Essentials"]["text"]
    assert "libegl1" in found["PySide6-Essentials"]["remedy"]
    assert {"numpy", "state", "logs"} <= set(found)


def test_an_examination_writes_nothing(tmp_path: Path) -> None:
    examine()
    assert not (tmp_path / "state").exists()
    assert not (tmp_path / "cache").exists()


def test_a_state_folder_that_cannot_be_made_prevents_measuring(tmp_path: Path) -> None:
    (tmp_path / "state").write_text("a file\n", encoding="utf-8")
    assert finding("state").level == "problem"
    assert exit_status(examine()) == 1
    done = invoke("doctor")
    assert (done.returncode, done.stderr) == (1, "")


@UNPRIVILEGED
def test_a_home_that_cannot_be_written_to_is_named(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        assert (finding("state").level, finding("cache").level) == ("problem", "note")
    finally:
        tmp_path.chmod(0o700)


@pytest.mark.parametrize(("free", "level"), [(5_000_000, "problem"), (500_000_000, "note"), (50_000_000_000, "ok")])
def test_a_full_disk_prevents_measuring(free: int, level: str, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(10**11, 10**11 - free, free))
    assert finding("state").level == level


@pytest.mark.skipif(sys.platform == "win32", reason="ports have no rights of a group")
def test_a_port_that_this_user_may_not_open_is_a_problem_with_its_group(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, write_rig: Writer
) -> None:
    port = tmp_path / "port"
    port.touch()
    monkeypatch.setattr(Path, "group", lambda _: "lab")
    rig = write_rig(("twin://virtual/mono", str(port)))
    assert [each.level for each in examine(rig) if str(port) in each.text] == ["ok"]
    monkeypatch.setattr(os, "access", lambda path, _: Path(path) != port)
    (found,) = [each for each in examine(rig) if str(port) in each.text]
    assert (found.level, found.remedy) == ("problem", "sudo usermod -aG lab $USER, then log in again")
    monkeypatch.setattr(Path, "group", lambda _: "root")
    (found,) = [each for each in examine(rig) if str(port) in each.text]
    assert (found.level, "usermod" in found.remedy, "dialout" in found.remedy) == ("problem", False, True)
    port.unlink()
    (found,) = [each for each in examine(rig) if str(port) in each.text]
    assert (found.level, "does not exist" in found.text) == ("problem", True)


def test_a_group_without_a_name_is_dialout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_name(_: Path) -> str:
        raise KeyError("gid")

    monkeypatch.setattr(Path, "group", no_name)
    assert doctor.group_of(tmp_path) == "dialout"


def test_a_monitor_without_rights_has_the_rule_for_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bus as the kernel shows it: a hub, an instrument of another make, and the monitor as device 7 of bus 250."""
    texts = {"usb1": ("1d6b", "0002"), "1-1": ("0957", "1755"), "1-2": ("1313", "8078")}
    for name, (vendor, product) in texts.items():
        (tmp_path / "bus" / name).mkdir(parents=True)
        for key, text in (("idVendor", vendor), ("idProduct", product), ("busnum", "250"), ("devnum", "7")):
            (tmp_path / "bus" / name / key).write_text(f"{text}\n", encoding="ascii")
    monkeypatch.setattr(doctor, "USB_DEVICES", tmp_path / "bus")
    found = finding("monitor")
    assert (found.level, found.text) == ("problem", "/dev/bus/usb/250/007: this user may not open it")
    assert 'ATTR{idVendor}=="1313", ATTR{idProduct}=="8078"' in found.remedy


def test_the_text_has_neither_home_nor_user_nor_host(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "alice-home"
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("USERPROFILE", str(home))
    monkeypatch.setenv("XDG_STATE_HOME", str(home / "state"))
    monkeypatch.setattr(socket, "gethostname", lambda: "lab-pc-3")
    monkeypatch.setattr(getpass, "getuser", lambda: "alice")
    assert doctor.anonymous(f"{home}/x of alice on lab-pc-3, not malice") == "~/x of USER on HOST, not malice"
    done = invoke("doctor")
    assert str(home) not in done.stdout
    assert f"~{os.sep}state" in done.stdout


def test_a_broken_part_of_the_examination_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def breaks() -> list[Finding]:
        raise RuntimeError("no list of ports")

    breaks.__name__ = "serial_ports"
    monkeypatch.setattr(doctor, "serial_ports", breaks)
    assert finding("serial ports").text == "not examined: RuntimeError: no list of ports"


def test_page_and_workflow_install_the_system_libraries_that_it_names() -> None:
    names = QT_LIBRARIES.partition("install -y ")[2]
    assert names
    for place in ("docs/install.md", ".github/workflows/test.yml"):
        assert names in (REPOSITORY / place).read_text(encoding="utf-8"), place


def test_a_rig_file_that_cannot_be_read_is_refused_before_the_examination(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    examined: list[str] = []
    monkeypatch.setattr(doctor, "import_fault", examined.append)
    with pytest.raises(UserError, match=r"none\.toml: cannot be read"):
        examine(tmp_path / "none.toml")
    assert examined == []
