"""Ports of this computer at which the program listens: no other program shares one."""

import os
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from goniotwin.app.rig import read_rig
from goniotwin.app.station.server import StationServer
from goniotwin.app.station.station import Station
from goniotwin.mocks.served import ServedRig
from goniotwin.protocols import loopback
from tests.conftest import RIG

pytestmark = [pytest.mark.endpoint, pytest.mark.skipif(sys.platform != "linux", reason="open sockets are listed in /proc")]


def listening() -> Iterator[socket.socket]:
    """The sockets of this process that listen."""
    for entry in Path("/proc/self/fd").iterdir():
        if entry.is_symlink() and str(entry.readlink()).startswith("socket:"):
            with socket.socket(fileno=os.dup(int(entry.name))) as found:
                if found.family == socket.AF_INET and found.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN):
                    yield found


@pytest.mark.parametrize("option", [loopback.OWN_PORT, socket.SO_KEEPALIVE], ids=["real", "as on Windows"])
def test_every_port_is_the_programs_own(option: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """On Windows by an option in place of SO_REUSEADDR; any other one stands for it here, where the system shares no port."""
    monkeypatch.setattr(loopback, "OWN_PORT", option)
    before = {each.getsockname() for each in listening()}
    model = read_rig(RIG).model()
    assert model is not None
    station, served = StationServer(Station()), ServedRig(model, 1.0, tmp_path / "ptys")
    station.start()
    served.start()
    try:
        found = [each for each in options_of_listening() if each[0] not in before]
        ports = {station.port, *(each.port for each in served.endpoints if each.port is not None)}
        assert {(loopback.LOOPBACK, port) for port in ports} == {name for name, _ in found}
        assert len(ports) == 10  # the station, axes, monochromator, five modules, the monitor, the control port
        assert {each for _, options in found for each in options} == {option}
        for port in ports:
            for others in ((), (socket.SO_REUSEADDR,), (socket.SO_REUSEADDR, socket.SO_REUSEPORT)):
                for address in (loopback.LOOPBACK, ""):
                    with pytest.raises(OSError, match="Address already in use"):
                        listen(address, port, others)
    finally:
        served.stop()
        station.stop()


def options_of_listening() -> Iterator[tuple[tuple[str, int], list[int]]]:
    """The addresses of sockets that listen, each with the options that it has of those that tests use."""
    for each in listening():
        known = (socket.SO_REUSEADDR, socket.SO_REUSEPORT, socket.SO_KEEPALIVE)
        yield each.getsockname(), [option for option in known if each.getsockopt(socket.SOL_SOCKET, option)]


def listen(address: str, port: int, options: tuple[int, ...]) -> None:
    """Listen as another program would."""
    with socket.socket() as other:
        for option in options:
            other.setsockopt(socket.SOL_SOCKET, option, 1)
        other.bind((address, port))
        other.listen()
