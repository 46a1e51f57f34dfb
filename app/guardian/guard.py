"""The parent's side of the guardian: guards of a rig's devices, and the process that is handed their last wills.

The process is started with the first guard that is armed: a program that opens no shutter has none. What is armed is also a
file in the user's state folder: where the guardian dies with its parent, the next program finds it.
"""

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from goniotwin.app.detached import start_detached
from goniotwin.app.errors import printable
from goniotwin.app.guardian.record import BYTES, FAREWELL, Record, encode_all
from goniotwin.drivers.guard import LastWill
from goniotwin.own_files import make_own_folder, read_regular, replace_text, state_folder
from goniotwin.protocols.channel import parse_object
from goniotwin.protocols.clock import calendar_stamp

COMMAND = [sys.executable, "-P", "-m", "goniotwin.app.guardian"]
FOLDER = "wills"
LONGEST_RECORD = 100_000
FAREWELL_S = 5.0


class Guardian:
    """The process. `failure` is why there is none, empty without one. For any thread."""

    def __init__(self, command: Sequence[str] = COMMAND) -> None:
        self._command = list(command)
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.Lock()
        self.failure = ""

    @property
    def pid(self) -> int | None:
        """The number of the process; None before it is needed."""
        return None if self._process is None else self._process.pid

    def hand(self, records: list[Record]) -> None:
        """Hand over all records that are armed now; a process that has died is started again."""
        with self._lock:
            for _ in range(2):
                try:
                    self._write(encode_all(records))
                    self.failure = ""
                    return
                except OSError as error:
                    self.failure = f"the guardian cannot be started: {error}; after a crash close the shutter by hand"
                    self._end()

    def end(self) -> None:
        """Send the farewell: the process ends without a byte on a wire."""
        with self._lock:
            if self._process is not None:
                with contextlib.suppress(OSError):
                    self._write(FAREWELL)
                self._end()

    def _write(self, line: bytes) -> None:
        if self._process is None:
            self._process = start_detached(self._command, subprocess.PIPE)
        assert self._process.stdin is not None
        self._process.stdin.write(line)
        self._process.stdin.flush()

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is not None:
            with contextlib.suppress(OSError):
                assert process.stdin is not None
                process.stdin.close()
            try:
                process.wait(FAREWELL_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


class RigGuard:
    """The guards of one rig's devices, from the opening of the rig to its end.

    `rig` is its name, `journal` that of the run in progress, empty without one. `locks` and `names` are what the rig's lock
    holds, known when it is taken.
    """

    def __init__(self, rig: str) -> None:
        self.rig = rig
        self.journal = ""
        self.locks: tuple[str, ...] = ()
        self.names: tuple[str, ...] = ()
        self.guardian = Guardian()
        self._devices: list[DeviceGuard] = []

    def device(self, stem: str, address: str) -> "DeviceGuard":
        """The guard of a device at an address; `stem` is that of files about it."""
        guard = DeviceGuard(self, record_folder() / f"{stem}.json", address)
        self._devices.append(guard)
        return guard

    def begin(self, locks: list[str], names: list[str]) -> None:
        """The rig is locked: read what a program that died has left."""
        self.locks, self.names = tuple(locks), tuple(names)
        for each in self._devices:
            each.left = read_record(each.path)

    @property
    def left(self) -> Record | None:
        """What a program that died has left of the first device that has it so; None if all were left well."""
        return next((each.left for each in self._devices if each.left is not None), None)

    @property
    def armed(self) -> list[Record]:
        """The records that are armed."""
        return [each.record for each in self._devices if each.record is not None]

    @property
    def failure(self) -> str:
        """Why there is no guardian although one is needed; else empty."""
        return self.guardian.failure

    def settle(self) -> None:
        """What a program that died has left is seen to."""
        for each in self._devices:
            each.forget()

    def close(self) -> None:
        """Dismiss the guardian. What is still armed stays recorded, because nothing controls it from now on."""
        self.guardian.end()


class DeviceGuard:
    """The guard of one device (`drivers.guard.Guard`). `left` is the record of a program that died, until it is seen to."""

    def __init__(self, rig: RigGuard, path: Path, address: str) -> None:
        self._rig = rig
        self._address = address
        self.path = path
        self.left: Record | None = None
        self.record: Record | None = None

    def arm(self, will: LastWill) -> None:
        """Hand the will to the guardian, and record it. A full disk is no error."""
        if self.record is not None:
            return
        rig = self._rig
        wire: dict[str, Any] = {
            key: each.decode(BYTES) if isinstance(each, bytes) else each for key, each in asdict(will).items()
        }
        self.record = Record(
            **wire,
            address=self._address,
            rig=rig.rig,
            pid=os.getpid(),
            since=calendar_stamp(),
            path=str(self.path),
            journal=rig.journal,
            locks=rig.locks,
            names=rig.names,
        )
        rig.guardian.hand(rig.armed)
        with contextlib.suppress(OSError):
            make_own_folder(self.path.parent)
            replace_text(self.path, self.record.encode())

    def disarm(self) -> None:
        """The device was seen safe: nothing is handed or recorded any more."""
        if self.record is not None:
            self.record = None
            self._rig.guardian.hand(self._rig.armed)
            remove_record(self.path)
        self.forget()

    def forget(self) -> None:
        """What was left is seen to."""
        if self.left is not None:
            self.left = None
            if self.record is None:
                remove_record(self.path)


def record_folder() -> Path:
    """The folder of the records, in that of the user's state."""
    return state_folder() / FOLDER


def read_record(path: Path) -> Record | None:
    """The record of a file; None where there is none."""
    try:
        record = TypeAdapter(Record).validate_json(read_regular(path, LONGEST_RECORD))
    except (OSError, ValidationError):
        return None
    return replace(record, path=str(path))


def remove_record(path: Path) -> None:
    """Remove a record: the device is safe, or a person has acknowledged it."""
    with contextlib.suppress(OSError):
        path.unlink()


def read_events(path: Path) -> list[str]:
    """The texts of the events that a guardian has written beside a journal; none where there is no such file."""
    with contextlib.suppress(OSError):
        found = map(parse_object, read_regular(path, LONGEST_RECORD).splitlines())
        return [printable(each["text"]) for each in found if each is not None and isinstance(each.get("text"), str)]
    return []
