"""One controller a rig: a lock on each address, which the system takes back when the process that holds it dies."""

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
A_LOOK_S = 0.05


class RigInUse(UserError):
    """Another program has it."""

    def __init__(self, address: str, holder: str) -> None:
        super().__init__(f"{address}: is in use by {holder}; wait for it, or end it")
        self.holder = holder


class RigLock:
    """Holds addresses until `release`, or until the process ends, however it ends."""

    def __init__(self, addresses: list[str], doing: str, folder: Path | None = None) -> None:
        """Takes all or none. Raises UserError that says who has one, and since when."""
        self._folder = folder if folder is not None else Path(tempfile.gettempdir()) / FOLDER
        self._files: list[IO[str]] = []
        note = f"process {os.getpid()} of {_user()} on {socket.gethostname()}, since {calendar_stamp()}: {doing}"
        try:
            for place, address in sorted({canonical_address(address): address for address in addresses}.items()):
                self._take(place, address, note)
        except UserError:
            self.release()
            raise

    def release(self) -> None:
        """Gives all back; nothing more where that is done already."""
        for file in self._files:
            file.close()
        self._files = []

    def _take(self, place: str, address: str, note: str) -> None:
        path = self._folder / f"{hashlib.sha256(place.encode()).hexdigest()[:20]}.lock"
        try:
            self._folder.mkdir(mode=0o777, parents=True, exist_ok=True)
            with contextlib.suppress(OSError):
                self._folder.chmod(0o1777)  # other users of this computer use the same rig
            file = os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT, 0o666), "r+", encoding="utf-8")
        except OSError as error:
            raise UserError(f"{path}: the lock of {address} cannot be made: {error.strerror}; check that folder") from None
        if not _locked(file) and not _locked_soon(file):
            file.seek(0)
            holder = file.read(LONGEST_NOTE).strip() or "another program"
            file.close()
            raise RigInUse(address, holder)
        self._files.append(file)
        with contextlib.suppress(OSError):  # a full disk has no room for the note, and it is held all the same
            os.ftruncate(file.fileno(), 0)
            os.lseek(file.fileno(), 0, os.SEEK_SET)
            os.write(file.fileno(), f"{note}\n".encode())


def holder_of(address: str) -> str | None:
    """Who has an address now; None where nobody has. Raises UserError where that cannot be told."""
    try:
        RigLock([address], "looking who has it").release()
    except RigInUse as held:
        return held.holder
    return None


def _locked_soon(file: IO[str]) -> bool:
    """Somebody who only looks who has it holds it for an instant."""
    clock = RealClock()
    clock.sleep_until(clock.now() + A_LOOK_S)
    return _locked(file)


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "somebody"


if sys.platform == "win32":
    import msvcrt

    def _locked(file: IO[str]) -> bool:
        """Whether the lock is ours now; it lies on a byte far behind the note, which others may read."""
        try:
            file.seek(1 << 20)
            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True

else:
    import fcntl

    def _locked(file: IO[str]) -> bool:
        """Whether the lock is ours now."""
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return False
        return True
