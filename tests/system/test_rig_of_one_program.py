"""A rig belongs to one program, whatever user runs the other and however a port is spelled; ports are of known kinds."""

import contextlib
import multiprocessing
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import pytest

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.rig import open_rig, read_rig
from goniotwin.app.rig.last_rig import remember_rig
from goniotwin.protocols.clock import RealClock
from tests.conftest import RIG, Writer
from tests.system.another_user import ANOTHER_USER, Ports, open_folder, ports, rig_on
from tests.system.command import invoke

__all__ = ["open_folder", "ports"]  # fixtures

TCP = ["socket://127.0.0.1:{}", "socket://localhost:{}", "rfc2217://[::1]:{}", "SOCKET://LOCALHOST:{}/", "socket://0.0.0.0:{}"]


USERS = [(None, None), (None, ANOTHER_USER), (ANOTHER_USER, None)]
"""User of the first and of the second program; None is the one of the tests."""


@contextlib.contextmanager
def process(work: Callable[..., None], *arguments: Any) -> Iterator[Connection]:
    """A process that does some work, and the pipe to it."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["goniotwin.app.cli.main", "goniotwin.app.cli.work.device_search", __name__])
    ours, theirs = context.Pipe()
    started = context.Process(target=work, args=(theirs, *arguments))
    started.start()
    theirs.close()
    try:
        yield ours
    finally:
        started.kill()
        started.join()
        started.close()
        ours.close()


def become(user: int | None, folder: Path) -> None:
    """Go on as another user, which may not be able to load anything any more, with temporary files of this process' own."""
    if user is not None:
        from goniotwin.app.rig.addresses import device_names
        from goniotwin.app.rig.lock import RigLock

        assert device_names("localhost:1")
        RigLock(["/dev/null"], "loading", folder / "loading").release()
        assert invoke("devices", "--rig", RIG).returncode == 0
        assert invoke("devices", "--rig", folder / "no such file").returncode == 2
    own = folder / str(os.getpid())
    own.mkdir()
    state = folder / f"state-{user}"
    state.mkdir(exist_ok=True)
    os.environ.update(TMPDIR=str(own), XDG_STATE_HOME=str(state))
    tempfile.tempdir = None
    if user is not None:
        for each in (own, state):
            os.chown(each, user, user)
        os.setgroups([])
        os.setgid(user)
        os.setuid(user)


def hold(pipe: Connection, rig: Path, port: str, user: int | None) -> None:
    """The first program: it has opened its rig, and its serial port, until the test has ended."""
    from goniotwin.app.rig import read_rig
    from goniotwin.app.rig.wires import open_serial

    become(user, rig.parent)
    with open_rig(read_rig(rig), RealClock()):
        line = open_serial(port, 115200, 1.0) if port.startswith("/") else None
        pipe.send("held")
        pipe.recv()
        if line is not None:
            line.close()


def connect(pipe: Connection, rig: Path, user: int | None) -> None:
    """The second program."""
    become(user, rig.parent)
    done = invoke("devices", "--rig", rig)
    pipe.send((done.returncode, done.stderr))


def check_refused(status: int, errors: str, ports: Ports) -> None:
    """Check that a program was refused in one line, before it opened anything."""
    assert status == 2, errors
    assert "is in use by process" in errors
    assert "Traceback" not in errors
    assert ports.untouched()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere a TCP address has no guard among folders of state")
def test_no_spelling_of_a_port_gets_a_second_program_onto_a_rig(
    open_folder: Path, ports: Ports, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Neither in its own temporary folder, nor with its own folder of locks."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    own = ports.own.getsockname()[1]
    with process(hold, rig_on(open_folder, ports.serial, ports.tcp), ports.serial, None) as holder:
        assert holder.recv() == "held"
        for port in (ports.serial, ports.link, *(each.format(ports.tcp) for each in TCP)):
            for state in (open_folder / "state-None", tmp_path):
                monkeypatch.setenv("XDG_STATE_HOME", str(state))
                done = invoke("devices", "--rig", rig_on(open_folder, port, own))
                check_refused(done.returncode, done.stderr, ports)


@pytest.mark.long
@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only the system's administrator can be two users")
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere a TCP address has no guard among users")
@pytest.mark.parametrize("users", USERS, ids=["one user", "another second", "another first"])
def test_two_processes_of_any_users_do_not_get_onto_one_rig(open_folder: Path, ports: Ports, users: tuple[Any, Any]) -> None:
    first_user, second_user = users
    own = ports.own.getsockname()[1]
    tcp = [each.format(ports.tcp) for each in TCP]
    pairs = [*zip(tcp, tcp[1:] + tcp[:1], strict=True), (ports.serial, ports.link), (ports.link, ports.serial)]
    for first, second in pairs:
        with process(hold, rig_on(open_folder, first, ports.tcp), first, first_user) as holder:
            assert holder.recv() == "held"
            with process(connect, rig_on(open_folder, second, own), second_user) as pipe:
                status, errors = pipe.recv()
                check_refused(status, errors, ports)


@pytest.mark.parametrize("port", ["spy:///dev/null?file={file}", "spy://socket://127.0.0.1:9?file={file}&all", "alt://{file}"])
def test_a_port_of_another_kind_is_refused_before_anything_is_opened(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, port: str
) -> None:
    precious = tmp_path / "precious.txt"
    precious.write_text("precious")
    address = port.format(file=precious)
    for change in (
        ('port = "twin://virtual/axes"', f'port = "{address}"'),
        ('port = "twin://virtual/mono"', f'port = "{address}"'),
        ('"twin://virtual/adc-1"', f'"rtu:{address}"'),
    ):
        rig = write_rig(change)
        for arguments in (("devices", "--rig", rig), ("run", write_schedule(), "--rig", rig, "--out", tmp_path / "a.journal")):
            done = invoke(*arguments)
            assert (done.returncode, done.stdout) == (2, "")
            (line,) = done.stderr.splitlines()
            assert "is not an address of a known kind" in line
    assert precious.read_text() == "precious"


def test_a_resume_on_another_rig_than_the_last_asks_first(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("WIN_PD_OVERRIDE_LOCAL_APPDATA", str(tmp_path / "state"))
    rig = write_rig(("twin://virtual/mono", str(tmp_path / "no-device")))
    path = tmp_path / "a.journal"
    Journal.create(path, make_plan(read_schedule(write_schedule()), read_rig(rig)), {}).close()
    before = path.read_bytes()
    (line,) = invoke("run", "--resume", path).stderr.splitlines()  # standard input is no terminal
    assert invoke("run", "--resume", path).returncode == 2
    assert "is not the one that this computer used last" in line
    assert "--accept-rig" in line
    assert str(tmp_path / "no-device") in line
    assert path.read_bytes() == before
    for accepted in (("--accept-rig",), ("--rig", rig)):
        done = invoke("run", "--resume", path, *accepted)
        assert done.returncode == 2
        assert "no-device" in done.stderr
        assert "--accept-rig" not in done.stderr
    remember_rig(read_rig(rig).file)
    assert "--accept-rig" not in invoke("run", "--resume", path).stderr
    remember_rig(read_rig(write_rig(("twin://virtual/mono", "/dev/another"))).file)
    assert "--accept-rig" in invoke("run", "--resume", path).stderr
