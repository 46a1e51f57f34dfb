"""Parts of serial endpoints: lines, their open ends, and the names of pseudo-terminals."""

import contextlib
import os
import socket
import sys
from dataclasses import dataclass, field
from pathlib import Path

from goniotwin.own_files import make_own_folder
from goniotwin.twin.devices.line import SerialDevice

if sys.platform != "win32":  # POSIX alone, as pseudo-terminals are
    import fcntl
    import termios

HEARD_AT_ONCE = 260
"""The longest request on any wire: of a flood a device hears no more before the others have their turn."""
OWED_AT_MOST = 4096
"""A device that has so many bytes still to send hears nothing more: its memory is full."""
UNSENT_LIMIT = 65_536
"""What a client that does not read may leave unread; then the oldest is lost, as on a line without handshake."""


@dataclass
class Line:
    """A device and its clients. Whatever the device sends goes to every open end."""

    name: str
    device: SerialDevice
    ends: list["OpenEnd"] = field(default_factory=list)
    links: list[Path] = field(default_factory=list)
    plugged: bool = True
    pty_asked: bool = False
    """Whether a pseudo-terminal's client, whose going cannot be seen, may wait for something."""


@dataclass
class OpenEnd:
    """One open end of a line: a file descriptor, the bytes that could not be written yet."""

    line: Line
    descriptor: int
    connection: socket.socket | None = None
    slave: int | None = None
    unsent: bytearray = field(default_factory=bytearray)

    def write(self, data: bytes) -> None:
        """Write without blocking; keep the rest. Raises OSError where the other side is closed.

        A pseudo-terminal keeps no rest: what its client does not read is lost, as at a serial port, and a client that opens it
        after a time of silence does not get earlier replies.
        """
        self.unsent += data
        if len(self.unsent) > UNSENT_LIMIT:
            del self.unsent[: len(self.unsent) - UNSENT_LIMIT]
        while self.unsent:
            try:
                sent = os.write(self.descriptor, self.unsent) if self.connection is None else self.connection.send(self.unsent)
            except BlockingIOError:
                if self.connection is None:
                    self.unsent.clear()
                return
            del self.unsent[:sent]

    def read(self) -> bytes:
        """Read the available bytes. Raises OSError where the other side is closed; an empty read of a socket means the same."""
        if self.connection is None:
            return os.read(self.descriptor, HEARD_AT_ONCE)
        data = self.connection.recv(HEARD_AT_ONCE)
        if not data:
            raise ConnectionResetError
        return data


def owed(device: SerialDevice) -> int:
    """Number of bytes that a device still has to send."""
    return sum(len(data) for _, data in device.outbox)


class PtyNames:
    """The links of one server.

    They are symbolic links in a folder that is one server's alone for as long as it serves. The folder belongs to this user,
    so that no other user can put another end there, and has no blank in its name, at which many a program would end a port's
    name. It is claimed by a lock on the folder itself, which the system lifts when its holder ends, however it ends. So a link
    to a pseudo-terminal in a folder that was just claimed is left over from an ended server, and may be replaced. Nothing else
    is: neither a file, nor a folder, nor a link to something else. What is removed is what was put.
    """

    def __init__(self) -> None:
        self._claimed: dict[Path, int] = {}
        self._put: dict[Path, str] = {}

    def put(self, link: Path, terminal: str) -> None:
        """`link` names the pseudo-terminal from now on. Raises OSError where the name belongs to another program."""
        self._claim(link.parent)
        if link.is_symlink():
            target = str(link.readlink())
            if _series(target) != _series(terminal):
                raise OSError(f"{link}: is a link to {target}, which is not this server's; remove it or choose another folder")
            link.unlink()
        elif link.exists():
            raise OSError(f"{link}: is there, and is not this server's; remove it or choose another folder")
        link.symlink_to(terminal)
        self._put[link] = terminal

    def take(self, link: Path) -> None:
        """Remove the link if it is still the one that `put` made."""
        terminal = self._put.pop(link, None)
        with contextlib.suppress(OSError):
            if terminal is not None and str(link.readlink()) == terminal:
                link.unlink()

    def close(self) -> None:
        """Remove all links and release the folders."""
        for link in list(self._put):
            self.take(link)
        for descriptor in self._claimed.values():
            os.close(descriptor)
        self._claimed.clear()

    def _claim(self, folder: Path) -> None:
        if folder in self._claimed:
            return
        if any(letter.isspace() for letter in str(folder)):
            raise OSError(f"{folder}: has a blank in its name; choose another folder")
        make_own_folder(folder)
        descriptor = None
        try:
            descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if descriptor is not None:
                os.close(descriptor)
            if isinstance(error, BlockingIOError):
                raise OSError(f"{folder}: another server has its names there; end it or choose another folder") from None
            raise OSError(f"{folder}: cannot be used: {error.strerror}; choose another folder") from None
        self._claimed[folder] = descriptor


def baudrate(slave: int) -> int | None:
    """Baud rate that the client has set on its side of a pseudo-terminal; None where it cannot be read."""
    speed = termios.tcgetattr(slave)[5]
    names = {getattr(termios, f"B{rate}"): rate for rate in (9600, 19200, 38400, 57600, 115200) if hasattr(termios, f"B{rate}")}
    return names.get(speed)


def _series(terminal: str) -> str:
    """A terminal's name without its number."""
    return terminal.rstrip("0123456789")
