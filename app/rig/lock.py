"""One controlling program per rig and per journal: locks that the system lifts when their process ends, however it ends.

A rig has two guards. Among the programs of one user it is a lock file for each device, in the user's state folder. Among
users it is the device itself: a serial port is opened exclusively, the interface of a USB instrument is claimed, and for a TCP
address a name of the system is taken, which every user sees: see `SystemName`. A journal has a lock file beside it, and, while
it is written, two guards of the file itself, whatever its name: a lock file in the state folder and a name of the system.

A lock file is empty and stays so, and no link is followed to it. The note of its holder, and since when, is a file beside it,
replaced by renaming. So no byte changes of a file that another user has put there.
"""

import contextlib
import getpass
import hashlib
import os
import re
import socket
import struct
import sys
from pathlib import Path

from filelock import FileLock, Timeout

from goniotwin.app.errors import UserError, printable, unusable
from goniotwin.app.guardian.held import Taken, take_name
from goniotwin.app.guardian.record import GUARDIAN
from goniotwin.app.rig.addresses import device_names
from goniotwin.own_files import make_own_folder, read_regular, replace_text, state_folder
from goniotwin.protocols.clock import calendar_stamp

LONGEST_NOTE = 400
PROBE_S = 0.05
"""How long another program can hold a lock only to check it."""
UNKNOWN = "another program"
GUARDIAN_S = 20.0
"""How long a program waits for the guardian of one that died, which makes the rig safe."""


class RigInUse(UserError):
    """An address or a journal is locked by another program; `holder` is the text of its note."""

    def __init__(self, address: str, holder: str) -> None:
        super().__init__(f"{address}: is in use by {holder}; wait for it, or end it")
        self.holder = holder


class LockFile:
    """A lock file, locked until `release` or until the process ends, also if it is killed."""

    def __init__(self, path: Path, what: str, purpose: str, mode: int, patience_s: float = PROBE_S) -> None:
        """Lock the file; `what` it stands for is in the errors. Raises RigInUse with the holder's note, OSError."""
        self.path = path
        self._note = _note_of(path)
        self._lock = FileLock(path, patience_s, mode, thread_local=False, fallback_to_soft=False, poll_interval=0.01)
        try:
            try:
                self._lock.acquire()
            except Timeout:
                if GUARDIAN not in _read_note(self._note):
                    raise
                self._lock.acquire(GUARDIAN_S)
        except Timeout:
            raise RigInUse(what, _read_note(self._note)) from None
        self._held = path.stat()
        _write_note(
            self._note, f"process {os.getpid()} of {_user()} on {socket.gethostname()}, since {calendar_stamp()}: {purpose}"
        )

    def release(self, *, remove: bool = False) -> None:
        """Release the lock; `remove` the file too. A second call has no effect.

        Another file in its place, after a person has removed this one, is that of another program: it stays.
        """
        if self._lock.is_locked:
            for file in (self._note, self.path) if remove else (self._note,):
                with contextlib.suppress(OSError):  # Windows removes no open file: an empty one stays
                    if os.path.samestat(self._held, self.path.stat()):
                        file.unlink()  # of two programs that wait for a removed file, FileLock gives neither the lock
            self._lock.release()


def holder_of(path: Path) -> str | None:
    """The note of the program that holds a lock file, None if it is free. Leaves no file that was not there."""
    try:
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
    except OSError:
        return None
    try:
        with FileLock(path, PROBE_S, 0o666, thread_local=False, fallback_to_soft=False, poll_interval=0.01):
            with contextlib.suppress(OSError):
                if not os.path.samestat(os.fstat(handle), path.stat()):
                    path.unlink()  # its holder has removed it since, and the lock has made another one
            return None
    except Timeout:
        return _read_note(_note_of(path))
    except OSError:  # a read-only medium, which no program can write to
        return None
    finally:
        os.close(handle)


class RigLock:
    """Locks on device addresses, held until `release` or until the process ends, also if it is killed."""

    def __init__(self, addresses: list[str], purpose: str, folder: Path | None = None, patience_s: float = PROBE_S) -> None:
        """Lock all addresses or none; nothing is opened. `folder` is that of the lock files.

        `patience_s` is how long the check of another program may take that looks whether the rig is locked.

        Raises RigInUse with the holder of an address and the start of its lock.
        """
        self._folder = folder if folder is not None else _lock_folder()
        self._files: list[LockFile] = []
        self._names: list[SystemName] = []
        try:
            devices = sorted({name: address for address in addresses for name in device_names(address)}.items())
            for name, address in devices:
                self._lock(name, address, purpose, patience_s)
            for name, address in devices:
                self._check_relatives(name, address)
        except UserError:
            self.release()
            raise

    @property
    def files(self) -> list[str]:
        """The paths of the lock files."""
        return [str(each.path) for each in self._files]

    @property
    def names(self) -> list[str]:
        """The names of the system."""
        return [each.name for each in self._names]

    def release(self) -> None:
        """Release all locks. A second call has no effect."""
        for name in self._names:
            name.release()
        for file in self._files:
            file.release()
        self._names, self._files = [], []

    def _lock(self, name: str, address: str, purpose: str, patience_s: float) -> None:
        path = self._path(name)
        try:
            make_own_folder(self._folder)
            self._files.append(LockFile(path, address, purpose, 0o600, patience_s))
            if name.startswith("tcp:"):
                self._names.append(SystemName(name, address))
            elif (process := _process_on_port(name)) is not None:
                raise RigInUse(address, process)
        except OSError as error:
            reason = f"{error.strerror}; check that folder" if error.strerror else str(error)
            raise UserError(f"{path}: the lock of {address} cannot be made: {reason}") from None

    def _check_relatives(self, name: str, address: str) -> None:
        """`usb:1313:8078` may be the instrument `usb:1313:8078:P1`, which has another lock: raise RigInUse if that is held.

        Its own lock is taken before. So of two programs at once at least one sees the other.
        """
        product = re.fullmatch(r"(usb:[0-9a-f]{4}:[0-9a-f]{4})(:.*)?", name)
        if product is None:
            return
        plain = self._path(product[1])
        relatives = (
            [plain] if product[2] else [each for each in self._folder.glob(f"{_stem(product[1])}-*.lock") if each != plain]
        )
        for each in relatives:
            if (holder := holder_of(each)) is not None:
                raise RigInUse(address, holder)

    def _path(self, name: str) -> Path:
        return self._folder / f"{file_stem(name)}.lock"


def lock_served_rig(server: str, purpose: str) -> LockFile:
    """The lock that shows that the process which serves a rig lives; `server` is its key in the rig file. Raises OSError."""
    path = _served_lock(server)
    make_own_folder(path.parent)
    return LockFile(path, purpose, purpose, 0o600)


def check_server(server: str | None, rig: str) -> None:
    """Raise UserError if the process that served a rig has ended: its ports may be another program's by now.

    Nothing is checked without the key of a process: such a rig file was not written by `goniotwin serve`.
    """
    if server is not None and holder_of(_served_lock(server)) is None:
        raise UserError(f"{rig}: the goniotwin serve that served this rig has ended; serve it again, and use the new rig file")


def _served_lock(server: str) -> Path:
    return _lock_folder() / f"{file_stem(f'served:{server}')}.lock"


FileIdentity = tuple[int, int]
"""Device and number of a file: what it keeps when it is renamed."""


class JournalLock:
    """The locks of one journal, held until `release` or until the process ends, also if it is killed.

    The journal itself is never opened: SQLite's own locks on it end when any other opening of it in this process is closed.
    """

    def __init__(self, path: Path, purpose: str) -> None:
        self._path = path
        self._purpose = purpose
        self._files = [LockFile(_journal_lock(path), str(path), purpose, 0o666)]
        self._name: SystemName | None = None
        self.identity: FileIdentity | None = None
        """The file that is locked too; None before `hold_file`."""

    def hold_file(self, file: Path) -> None:
        """Lock the journal's file too, which may be renamed from now on. Raises RigInUse with the holder, OSError.

        There is no such guard where it cannot be made: a user without a writable home can measure too, and not every system
        has such names.
        """
        self.identity = identity_of(file)
        with contextlib.suppress(OSError):
            lock = _identity_lock(self.identity)
            make_own_folder(lock.parent)
            self._files.append(LockFile(lock, str(self._path), f"{self._purpose}, as {os.path.realpath(self._path)}", 0o600))
        with contextlib.suppress(OSError):
            self._name = SystemName("journal:{}:{}".format(*self.identity), str(self._path))

    def release(self, *, remove: bool = False) -> None:
        """Release the locks; `remove` their files too. A second call has no effect."""
        if self._name is not None:
            self._name.release()
        for file in self._files[::-1]:
            file.release(remove=remove)


def lock_journal(path: Path, purpose: str) -> JournalLock:
    """Lock a journal, which need not exist yet, by a file beside it: among all users of its folder. Raises UserError."""
    try:
        folder = Path(os.path.realpath(path)).parent
        if not folder.is_dir():  # FileLock would make it
            raise UserError(f"{path}: there is no folder {folder}; create it first")
        return JournalLock(path, purpose)
    except OSError as error:
        raise unusable(path, "its lock file cannot be made", error, "check the folder") from None


def port_holder(address: str) -> str | None:
    """The program that has a device, None if it is free. Nothing is locked, and no file is made. Raises UserError."""
    for name in sorted(device_names(address)):
        if (holder := holder_of(_lock_folder() / f"{file_stem(name)}.lock") or _process_on_port(name)) is not None:
            return holder
    return None


def journal_holder(path: Path) -> str | None:
    """The note of the program that has a journal open for writing, by this name or another; None if there is none."""
    holder = holder_of(_journal_lock(path))
    if holder is None:
        with contextlib.suppress(OSError):
            holder = holder_of(_identity_lock(identity_of(path)))
    return holder


def identity_of(path: Path) -> FileIdentity:
    """What distinguishes a file from others, whatever its name; the file is not opened. Raises OSError."""
    status = path.stat()
    return status.st_dev, status.st_ino


def _lock_folder() -> Path:
    return state_folder() / "locks"


def _identity_lock(identity: FileIdentity) -> Path:
    return _lock_folder() / "journal-{}-{}.lock".format(*identity)


def _journal_lock(path: Path) -> Path:
    real = Path(os.path.realpath(path))
    return real.with_name(f"{real.name}.lock")


def file_stem(name: str) -> str:
    """The name of a file about a device, without its suffix."""
    return f"{_stem(name)}-{hashlib.sha256(name.encode()).hexdigest()[:20]}"


def _stem(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9.]+", "-", name)[:60].strip("-")


def _note_of(lock: Path) -> Path:
    return lock.with_suffix(".holder")


def _write_note(path: Path, note: str) -> None:
    """Replace a note; without one the lock holds as well, so that a full disk is no error."""
    with contextlib.suppress(OSError):
        replace_text(path, f"{printable(note)}\n", 0o644)  # a file name may have bytes that are no text


def _read_note(path: Path) -> str:
    """A note as one printable line, whatever the file is."""
    try:
        note = read_regular(path, LONGEST_NOTE)
    except OSError:
        return UNKNOWN
    return printable(note.decode(errors="replace").strip()) or UNKNOWN


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "an unknown user"


def _process_on_port(name: str) -> str | None:
    """The process that has a serial port open exclusively, None if none is seen: only Linux lists them.

    This refuses before anything is opened; the guard itself is the exclusive opening.
    """
    try:
        if not name.startswith("serial:/") or not sys.platform.startswith("linux"):
            return None
        status = Path(name.removeprefix("serial:")).stat()
        place = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
        locks = [line.split() for line in Path("/proc/locks").read_text(encoding="utf-8").splitlines()]
    except OSError:
        return None
    return next((f"process {each[4]}" for each in locks if each[1] == "FLOCK" and place in each), None)


class SystemName:
    """A name that one process of this computer holds, of whichever user: it ends with the process."""

    def __init__(self, name: str, address: str) -> None:
        """Take the name. Raises RigInUse, OSError."""
        self.name = "goniotwin-" + hashlib.sha256(name.encode()).hexdigest()[:32]
        try:
            self._held = take_name(self.name)
        except Taken:
            raise RigInUse(address, _holder_of_socket(self.name)) from None

    def release(self) -> None:
        """Give the name back. A second call has no effect."""
        held, self._held = self._held, None
        if held is not None:
            held.close()


def _holder_of_socket(name: str) -> str:
    """The process that holds a name, which is known on Linux only."""
    if not sys.platform.startswith("linux"):
        return UNKNOWN
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(f"\0{name}")
            process, user, _ = struct.unpack("3i", probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
        except OSError:
            return UNKNOWN
    return f"process {process} of the user with the number {user}"
