"""One controlling program per rig."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from goniotwin.app.errors import UserError
from goniotwin.app.rig.lock import RigInUse, RigLock
from goniotwin.protocols.clock import RealClock

HOLD = """
import sys
from pathlib import Path
from goniotwin.app.rig.lock import RigLock
from goniotwin.protocols.clock import RealClock
lock = RigLock(["/dev/axes"], "measuring paint", Path(sys.argv[1]))
print("held", flush=True)
sys.stdin.read()
"""


def test_a_second_program_is_refused_with_the_holder_until_the_lock_is_released(tmp_path: Path) -> None:
    first = RigLock(["/dev/axes", "adam:502"], "measuring paint", tmp_path)
    with pytest.raises(UserError, match=rf"adam:502: is in use by process {os.getpid()} of .*: measuring paint"):
        RigLock(["adam:502"], "something else", tmp_path)
    RigLock(["/dev/other"], "another rig", tmp_path).release()
    first.release()
    RigLock(["/dev/axes"], "something else", tmp_path).release()


def test_if_one_address_is_in_use_no_other_is_locked(tmp_path: Path) -> None:
    first = RigLock(["b"], "one", tmp_path)
    with pytest.raises(UserError, match="b: is in use"):
        RigLock(["a", "b"], "two", tmp_path)
    RigLock(["a"], "three", tmp_path).release()
    first.release()


def test_the_lock_ends_with_its_process(tmp_path: Path) -> None:
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert holder.stdin is not None
    assert holder.stdout is not None
    assert holder.stdout.readline() == "held\n"
    with pytest.raises(UserError, match=rf"process {holder.pid} "):
        RigLock(["/dev/axes"], "mine", tmp_path)
    holder.kill()
    holder.wait()
    holder.stdin.close()
    holder.stdout.close()
    RigLock(["/dev/axes"], "mine", tmp_path).release()


def test_a_check_of_the_lock_does_not_keep_another_program_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    probe = RigLock(["COM4"], "checking the lock", tmp_path)
    monkeypatch.setattr(RealClock, "sleep_until", lambda *_: probe.release())
    RigLock(["COM4"], "first", tmp_path).release()


@pytest.mark.skipif(os.name == "nt", reason="Windows has no permissions by user, group and others")
def test_a_lock_file_is_for_all_users_and_one_without_write_permission_can_be_locked(tmp_path: Path) -> None:
    before = os.umask(0o077)
    try:
        RigLock(["/dev/ttyUSB0"], "first", tmp_path).release()
    finally:
        os.umask(before)
    (file,) = tmp_path.glob("*.lock")
    assert file.stat().st_mode & 0o777 == 0o666
    file.chmod(0o444)
    held = RigLock(["/dev/ttyUSB0"], "second", tmp_path)
    with pytest.raises(RigInUse):
        RigLock(["/dev/ttyUSB0"], "third", tmp_path)
    held.release()
