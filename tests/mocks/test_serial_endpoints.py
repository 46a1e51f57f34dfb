"""Twin devices on pseudo-terminals and TCP, and client programs written by others."""

import socket
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import serial
from pytrinamic.connections import ConnectionManager
from pytrinamic.modules import TMCM6214

from mocks.serial_endpoints import SerialEndpoints, ptys_exist
from protocols.clock import RealClock
from protocols.tmcl import Axis, Command, Reply, Request
from tests.conftest import RigOpener
from twin import VirtualRig

ASK = Request(1, Command.GAP, Axis.ACTUAL_POSITION, 4).encode()


@dataclass
class Served:
    endpoints: SerialEndpoints
    port: int
    mono_port: int
    pty: Path | None
    rig: VirtualRig


@pytest.fixture
def served(opened: RigOpener, tmp_path: Path) -> Iterator[Served]:
    clock = RealClock(speed=20.0)
    rig = opened(clock=clock).virtual
    assert rig is not None
    endpoints = SerialEndpoints(clock, rig.lock)
    port = endpoints.add_tcp("axes", rig.serial["axes"])
    mono_port = endpoints.add_tcp("mono", rig.serial["mono"])
    pty = endpoints.add_pty("axes", rig.serial["axes"], tmp_path / "axes") if ptys_exist() else None
    endpoints.start()
    yield Served(endpoints, port, mono_port, pty, rig)
    endpoints.stop()


def _drive(module: TMCM6214) -> None:
    axis = module.motors[4]
    module.set_axis_parameter(axis.AP.MaxVelocity, 4, 400_000)
    assert module.get_axis_parameter(axis.AP.MaxVelocity, 4) == 400_000
    axis.move_to(20_000)
    while not axis.get_position_reached():
        pass
    assert axis.actual_position == 20_000


def test_pytrinamic_drives_the_twin_over_tcp(served: Served) -> None:
    manager = ConnectionManager(f"--interface socket_serial_tmcl --port 127.0.0.1:{served.port}")
    with manager.connect() as connection:
        assert connection.get_version_string() == "6214V117"
        _drive(TMCM6214(connection))


@pytest.mark.skipif(not ptys_exist(), reason="this system has no pseudo-terminals")
def test_pytrinamic_drives_the_twin_over_a_pty(served: Served) -> None:
    manager = ConnectionManager(f"--interface serial_tmcl --port {served.pty} --data-rate 115200")
    with manager.connect() as connection:
        _drive(TMCM6214(connection))


def test_a_move_over_one_end_is_seen_at_the_other(served: Served) -> None:
    first = serial.serial_for_url(f"socket://127.0.0.1:{served.port}", timeout=5.0)
    first.write(Request(1, Command.MVP, 0, 4, 5000).encode())
    assert len(first.read(9)) == 9
    first.close()
    clock = served.rig.clock
    clock.sleep_until(clock.now() + 2.0)
    assert served.rig.plant.angle_deg("sigma", clock.now()) == pytest.approx(5000 / 5120, abs=1e-6)


def test_a_killed_client_leaves_it_well(served: Served) -> None:
    for _ in range(20):
        client = socket.create_connection(("127.0.0.1", served.port))
        client.send(ASK[:5])  # half a frame, and gone
        client.close()
    served.rig.clock.sleep_until(served.rig.clock.now() + 2.0)  # longer than a partial frame lives
    port = serial.serial_for_url(f"socket://127.0.0.1:{served.port}", timeout=5.0)
    port.write(ASK)
    assert Reply.decode(port.read(9)).command == Command.GAP
    port.close()


def test_a_client_that_does_not_read_holds_up_nobody(served: Served) -> None:
    lazy = socket.create_connection(("127.0.0.1", served.port))
    for _ in range(2000):
        lazy.send(ASK * 50)
    port = serial.serial_for_url(f"socket://127.0.0.1:{served.mono_port}", timeout=10.0)
    port.write(b"WAVE?\n")
    assert port.read_until(b"\n") == b"WAVE?\r\n"
    port.close()
    lazy.close()


@pytest.mark.skipif(not ptys_exist(), reason="this system has no pseudo-terminals")
def test_whoever_opens_a_pty_is_not_told_what_was_said_to_others_before(served: Served) -> None:
    other = serial.serial_for_url(f"socket://127.0.0.1:{served.port}", timeout=5.0)
    for _ in range(1000):  # 9 kB, more than the system keeps for a reader
        other.write(ASK)
        other.read(9)
    other.close()
    port = serial.Serial(str(served.pty), 115200, timeout=5.0)
    port.write(Request(1, Command.GGP, 1, 2).encode())
    assert Reply.decode(port.read(9)).command == Command.GGP
    assert port.in_waiting == 0
    port.close()


def test_after_the_end_ports_and_names_are_free(opened: RigOpener, tmp_path: Path) -> None:
    clock = RealClock()
    rig = opened(clock=clock).virtual
    assert rig is not None
    endpoints = SerialEndpoints(clock, rig.lock)
    port = endpoints.add_tcp("axes", rig.serial["axes"])
    endpoints.start()
    endpoints.stop()
    with socket.create_server(("127.0.0.1", port)):
        pass
    again = SerialEndpoints(clock, rig.lock)
    if ptys_exist():
        link = again.add_pty("axes", rig.serial["axes"], tmp_path / "axes")
        assert link.is_symlink()
        again.stop()
        assert not link.is_symlink()
