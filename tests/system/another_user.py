"""Ports and rig files that programs of several users want."""

import os
import shutil
import socket
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.conftest import RIG

ANOTHER_USER = 65_534


@dataclass(frozen=True)
class Ports:
    """A TCP port and a serial port that both programs want, and the TCP port of all other devices of the second one."""

    tcp: int
    serial: str
    link: str
    own: socket.socket

    def untouched(self) -> bool:
        """Whether no program has connected to the devices that only the second one has."""
        try:
            self.own.accept()
        except BlockingIOError:
            return True
        return False


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that every user can read: those of pytest are closed."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


@pytest.fixture
def ports(open_folder: Path) -> Iterator[Ports]:
    """The ports, for every user."""
    with socket.create_server(("127.0.0.1", 0)) as shared, socket.create_server(("127.0.0.1", 0)) as own:
        own.setblocking(False)
        server, port = os.openpty()
        os.fchmod(port, 0o666)
        link = open_folder / "by-id"
        link.symlink_to(os.ttyname(port))
        yield Ports(shared.getsockname()[1], os.ttyname(port), str(link), own)
        os.close(server)
        os.close(port)


def rig_on(folder: Path, port: str, others: int) -> Path:
    """The rig file of a rig that has its axes at a port, and everything else at a TCP port."""
    text = RIG.read_text(encoding="utf-8")
    text = text[: text.index("\n[simulated]")] + text[text.index("\n[axes]") : text.index("\n[twin]")]
    text = text.replace('"twin://virtual/axes"', f'"{port}"').replace(
        '"twin://virtual/monitor"', f'"usbip:localhost:{others}/1"'
    )
    text = text.replace('"twin://virtual/mono"', f'"socket://localhost:{others}"')
    for number in range(10):
        text = text.replace(f'"twin://virtual/adc-{number}"', f'"rtu:socket://localhost:{others}?unit={number + 1}"')
    assert "twin://" not in text
    path = folder / f"rig-{len(list(folder.iterdir()))}.toml"
    path.write_text(text, encoding="utf-8")
    return path
