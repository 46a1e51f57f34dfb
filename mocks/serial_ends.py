"""Parts of serial endpoints: lines and their open ends."""

import os
import socket
from dataclasses import dataclass, field
from pathlib import Path

from goniotwin.twin.devices.line import SerialDevice

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
