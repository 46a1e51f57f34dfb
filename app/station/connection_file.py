"""How a client finds a station: a file for each rig in the user's state folder, readable by this user alone.

It has port and token, as the connection files of Jupyter's kernels have. Whether a rig is taken is decided by a lock beside
the file, and by those of its devices; a file is only an address, and one at which no station answers is stale. Light: it loads
no driver.
"""

import contextlib
import json
import os
import socket
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from goniotwin.app.station.client import NoStation, StationClient
from goniotwin.app.station.messages import Message
from goniotwin.own_files import replace_text, state_folder
from goniotwin.protocols.channel import PROTOCOL, parse_object

FOLDER = "stations"
LONGEST_FILE = 65_536


@dataclass(frozen=True)
class Connection:
    """The content of a connection file. `rig` is the absolute path of the rig file, `begun` the calendar time of the start."""

    protocol: int
    pid: int
    host: str
    port: int
    token: str
    rig: str
    journal: str
    begun: str


def read_connection(path: Path) -> Connection | None:
    """The content of a connection file; None where there is none, or it is none of this version."""
    try:
        found = TypeAdapter(Connection).validate_json(_content(path))
    except (OSError, ValidationError):
        return None
    return found if found.protocol == PROTOCOL else None


def _content(path: Path) -> bytes:
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
    try:
        return os.read(handle, LONGEST_FILE)
    finally:
        os.close(handle)


def _read_or_remove(path: Path) -> Connection | None:
    """The same; a file that is none of any version is removed. They are renamed into place, so none is seen half written."""
    if (connection := read_connection(path)) is None:
        with contextlib.suppress(OSError):
            version = (parse_object(_content(path)) or {}).get("protocol", PROTOCOL)
            if isinstance(version, bool) or not isinstance(version, int) or version == PROTOCOL:
                path.unlink()
    return connection


def _has_ended(pid: int) -> bool:
    """Whether there is no process of this number; not known on Windows."""
    if sys.platform == "win32":
        return False
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return True
    except PermissionError:
        pass
    return False


def known_stations() -> dict[Path, Connection]:
    """The connection files of stations on this computer, those of other hosts excluded; they may be stale.

    A file that is none of any version is removed.
    """
    paths = sorted(connection_folder().glob("*.json"))
    found = {path: connection for path in paths if (connection := _read_or_remove(path)) is not None}
    return {path: each for path, each in found.items() if each.host == socket.gethostname()}


def attach(
    path: Path,
    name: str,
    on_event: Callable[[Message], None] = lambda _: None,
    on_end: Callable[[], None] = lambda: None,
) -> StationClient | None:
    """Attach to the station of a connection file; None where there is none. A stale file is removed.

    Raises TimeoutError where something listens and is silent, and Refused as `StationClient` does: such a station keeps its
    file.
    """
    connection = _read_or_remove(path)
    if connection is None or connection.host != socket.gethostname():
        return None
    try:
        return StationClient(connection.port, connection.token, name, on_event, on_end)
    except (NoStation, TimeoutError) as error:
        if isinstance(error, TimeoutError) and not _has_ended(connection.pid):
            raise
        if read_connection(path) == connection:  # a new station may have taken its place
            path.unlink(missing_ok=True)
        return None


def connection_folder() -> Path:
    """The folder of the connection files."""
    return state_folder() / FOLDER


def write_connection(path: Path, content: Connection) -> None:
    """Write a connection file whole. Raises OSError."""
    replace_text(path, json.dumps(asdict(content)) + "\n")
