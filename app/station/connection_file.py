"""How a client finds a station: a file for each rig in the user's state folder, readable by this user alone.

It has port and token, as the connection files of Jupyter's kernels have. The station holds a lock beside the file as long as it
lives, and the file is its own, for it removes that of an earlier one first: a file whose lock is free is stale, and nothing
connects to its port, which another program may have by now. Light: it loads no driver.
"""

import contextlib
import json
import socket
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from goniotwin.app.rig.lock import holder_of
from goniotwin.app.station.client import NoStation, Refused, StationClient
from goniotwin.app.station.messages import Message
from goniotwin.own_files import read_regular, replace_text, state_folder
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
        found = TypeAdapter(Connection).validate_json(read_regular(path, LONGEST_FILE), strict=True)
    except (OSError, ValidationError):
        return None
    return found if found.protocol == PROTOCOL else None


def _read_or_remove(path: Path) -> Connection | None:
    """The same; a file that is none of any version is removed. They are renamed into place, so none is seen half written."""
    if (connection := read_connection(path)) is None:
        with contextlib.suppress(OSError):
            version = (parse_object(read_regular(path, LONGEST_FILE)) or {}).get("protocol", PROTOCOL)
            if isinstance(version, bool) or not isinstance(version, int) or version == PROTOCOL:
                path.unlink()
    return connection


def lock_of(path: Path) -> Path:
    """The lock that the station of a connection file holds."""
    return path.with_suffix(".lock")


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

    Raises TimeoutError where the station is silent, and Refused as `StationClient` does, and where another program answers at
    the port: a station that lives keeps its file.
    """
    connection = _read_or_remove(path)
    if connection is None or connection.host != socket.gethostname():
        return None
    try:
        if holder_of(lock_of(path)) is not None:
            return StationClient(connection.port, connection.token, name, on_event, on_end)
    except (NoStation, TimeoutError) as error:
        holder = holder_of(lock_of(path))  # it may have ended, or another one have begun, meanwhile
        if holder is not None and read_connection(path) == connection:
            if isinstance(error, TimeoutError):
                raise
            raise Refused(f"{connection.rig}: {error}; the rig is in use by {holder}: wait for it, or end it") from None
    if read_connection(path) == connection:  # a new station may have taken its place
        path.unlink(missing_ok=True)
    return None


def connection_folder() -> Path:
    """The folder of the connection files."""
    return state_folder() / FOLDER


def write_connection(path: Path, content: Connection) -> None:
    """Write a connection file whole. Raises OSError."""
    replace_text(path, json.dumps(asdict(content)) + "\n")
