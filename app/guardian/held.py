"""Locks and names that end with their process, as the system has them; light, for the guardian.

The rule which of them a rig has is in `app.rig.lock`. A lock of a file is the one that `filelock` takes (flock, on Windows a
locked byte), so that both exclude each other. A name is seen by all users of a computer: on Linux it is an abstract socket,
which ends at the border of a container with a network of its own; on Windows a mutex. On macOS there is no such name.
"""

import errno
import os
import socket
import sys
from typing import Protocol


class Held(Protocol):
    """What is held until `close`, or until the process ends."""

    def close(self) -> None:
        """Release it."""


class Taken(OSError):
    """Another process holds it."""


class HeldFile:
    """The lock of a file that exists. Raises Taken, OSError."""

    def __init__(self, path: str) -> None:
        self._handle = os.open(path, os.O_RDWR | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
        try:
            _lock(self._handle)
        except OSError as error:
            os.close(self._handle)
            if error.errno in (errno.EACCES, errno.EAGAIN, errno.EDEADLK):
                raise Taken(path) from None
            raise

    def close(self) -> None:
        """Release the lock."""
        os.close(self._handle)


if sys.platform == "win32":
    import ctypes
    import msvcrt

    ACCESS_DENIED, ALREADY_EXISTS = 5, 183

    def _lock(handle: int) -> None:
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)

    class _Mutex:
        def __init__(self, handle: int) -> None:
            self._handle = handle

        def close(self) -> None:
            ctypes.windll.kernel32.CloseHandle(ctypes.c_void_p(self._handle))

    def take_name(name: str) -> Held | None:
        """Take a name. Raises Taken, OSError."""
        kernel = ctypes.WinDLL("kernel32", use_last_error=True)
        kernel.CreateMutexW.restype = ctypes.c_void_p
        handle = kernel.CreateMutexW(None, False, f"Global\\{name}")
        error = ctypes.get_last_error()
        if handle and error != ALREADY_EXISTS:
            return _Mutex(handle)
        if handle:
            kernel.CloseHandle(ctypes.c_void_p(handle))
        if error in (ACCESS_DENIED, ALREADY_EXISTS):  # that of another user cannot be opened
            raise Taken(name)
        raise ctypes.WinError(error)

else:
    import fcntl

    def _lock(handle: int) -> None:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def take_name(name: str) -> Held | None:
        """Take a name; None where the system has none. Raises Taken, OSError."""
        if not sys.platform.startswith("linux"):
            return None
        held = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            held.bind(f"\0{name}")
            held.listen()  # so that the next one learns which process this is
        except OSError as error:
            held.close()
            if error.errno != errno.EADDRINUSE:
                raise
            raise Taken(name) from None
        return held
