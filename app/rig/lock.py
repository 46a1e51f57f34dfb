"""One controlling program per rig: a lock on each device address; the system releases it when its process ends."""

import contextlib
import getpass
import hashlib
import os
import socket
import sys
import tempfile
from pathlib import Path
from typing import IO

from goniotwin.app.errors import UserError
from goniotwin.app.rig.addresses import canonical_address
from goniotwin.protocols.clock import RealClock, calendar_stamp

FOLDER = "goniotwin-locks"
LONGEST_NOTE = 400
PROBE_S = 0.05
"""How long `holder_of` of another program can hold a lock."""


class RigInUse(UserError):
    """An address is locked by another program; `holder` is the text of its note."""

    def __init__(self, address: str, holder: str) -> None:
        super().__init__(f"{address}: is in use by {holder}; wait for it, or end it")
        self.holder = holder


class RigLock:
    """Locks on device addresses, held until `release` or until the process ends, also if it is killed."""

    def __init__(self, addresses: list[str], purpose: str, folder: Path | None = None) -> None:
        """Lock all addresses or none. Raises RigInUse with the holder of an address and the start of its lock."""
        self._folder = folder if folder is not None else Path(tempfile.gettempdir()) / FOLDER
        self._files: list[IO[str]] = []
        note = f"process {os.getpid()} of {_user()} on {socket.gethostname()}, since {calendar_stamp()}: {purpose}"
        try:
            for canonical, address in sorted({canonical_address(address): address for address in addresses}.items()):
                self._lock(canonical, address, note)
        except UserError:
            self.release()
            raise

    def release(self) -> None:
        """Release all locks. A second call has no effect."""
        for file in self._files:
            file.close()
        self._files = []

    def _lock(self, canonical: str, address: str, note: str) -> None:
        path = self._folder / f"{hashlib.sha256(canonical.encode()).hexdigest()[:20]}.lock"
        try:
            self._folder.mkdir(mode=0o777, parents=True, exist_ok=True)
            with contextlib.suppress(OSError):
                self._folder.chmod(0o1777)  # other users of this computer use the same rig
            file = _open(path)
        except OSError as error:
            raise UserError(f"{path}: the lock of {address} cannot be made: {error.strerror}; check that folder") from None
        if not _try_lock(file) and not _try_lock_again(file):
            file.seek(0)
            holder = file.read(LONGEST_NOTE).strip() or "another program"
            file.close()
            raise RigInUse(address, holder)
        self._files.append(file)
        with contextlib.suppress(OSError):  # a full disk has no space for the note; the lock is held without it
            os.ftruncate(file.fileno(), 0)
            os.lseek(file.fileno(), 0, os.SEEK_SET)
            os.write(file.fileno(), f"{note}\n".encode())


def _open(path: Path) -> IO[str]:
    """Open a lock file, which is made for all users: the next one with this rig, or with this inode, may be another.

    A file that another user has made without write permission can still be locked; it keeps its note. Raises OSError.
    """
    try:
        return os.fdopen(os.open(path, os.O_RDWR), "r+", encoding="utf-8")
    except FileNotFoundError:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        if hasattr(os, "fchmod"):
            with contextlib.suppress(OSError):  # another user was faster, and has done it
                os.fchmod(handle, 0o666)  # the process' umask may have taken the permissions of others
        return os.fdopen(handle, "r+", encoding="utf-8")
    except PermissionError:
        return os.fdopen(os.open(path, os.O_RDONLY), "r", encoding="utf-8")


def holder_of(address: str) -> str | None:
    """The note of the program that holds the lock of an address, None if it is free. Raises UserError if that is unknown."""
    try:
        RigLock([address], "checking the lock").release()
    except RigInUse as error:
        return error.holder
    return None


def _try_lock_again(file: IO[str]) -> bool:
    """Try again after `PROBE_S`: a program that only checks the lock holds it for a moment."""
    clock = RealClock()
    clock.sleep_until(clock.now() + PROBE_S)
    return _try_lock(file)


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "an unknown user"


if sys.platform == "win32":
    import msvcrt

    def _try_lock(file: IO[str]) -> bool:
        """Lock the file; False if another program has it. The locked byte is far behind the note, which stays readable."""
        try:
            file.seek(1 << 20)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True

else:
    import fcntl

    def _try_lock(file: IO[str]) -> bool:
        """Lock the file; False if another program has it."""
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return False
        return True
