"""One controller a rig."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from goniotwin.app.errors import UserError
from goniotwin.app.rig.lock import RigLock
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


def test_the_second_is_told_who_has_it_until_the_first_lets_go(tmp_path: Path) -> None:
    first = RigLock(["/dev/axes", "adam:502"], "measuring paint", tmp_path)
    with pytest.raises(UserError, match=rf"adam:502: is in use by process {os.getpid()} of .*: measuring paint"):
        RigLock(["adam:502"], "something else", tmp_path)
    RigLock(["/dev/other"], "another rig", tmp_path).release()
    first.release()
    RigLock(["/dev/axes"], "something else", tmp_path).release()


def test_what_cannot_be_had_whole_is_not_held_in_part(tmp_path: Path) -> None:
    first = RigLock(["b"], "one", tmp_path)
    with pytest.raises(UserError, match="b: is in use"):
        RigLock(["a", "b"], "two", tmp_path)
    RigLock(["a"], "three", tmp_path).release()
    first.release()


def test_the_lock_dies_with_its_process(tmp_path: Path) -> None:
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


def test_who_only_looks_keeps_nobody_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    looker = RigLock(["COM4"], "looking who has it", tmp_path)
    monkeypatch.setattr(RealClock, "sleep_until", lambda *_: looker.release())
    RigLock(["COM4"], "first", tmp_path).release()
