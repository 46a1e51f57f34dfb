"""Twin devices on pseudo-terminals and TCP, and client programs written by others."""

import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import serial
from pytrinamic.connections import ConnectionManager
from pytrinamic.modules import TMCM6214

from goniotwin.mocks.serial_endpoints import SerialEndpoints, ptys_exist
from goniotwin.mocks.serial_ends import OWED_AT_MOST, owed
from goniotwin.mocks.served import ServedRig
from goniotwin.protocols.clock import RealClock
from goniotwin.protocols.tmcl import Command, CommandFrame, ReplyFrame
from goniotwin.protocols.tmcl_parameters import AxisParameter
from goniotwin.twin import VirtualRig
from goniotwin.twin.devices.cornerstone_statements import IDENTITY
from tests.conftest import RigOpener

pytestmark = pytest.mark.endpoint
WALL = RealClock()
ASK = CommandFrame(1, Command.GAP, AxisParameter.ACTUAL_POSITION, 4).encode()


@dataclass
class Served:
    endpoints: SerialEndpoints
    port: int
    mono_port: int
    pty: Path | None
    mono_pty: Path | None
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
    mono_pty = endpoints.add_pty("mono", rig.serial["mono"], tmp_path / "mono") if ptys_exist() else None
    endpoints.start()
    yield Served(endpoints, port, mono_port, pty, mono_pty, rig)
    endpoints.stop()


def _until(happened: Callable[[], bool]) -> None:
    end = WALL.now() + 5.0
    while not happened():
        assert WALL.now() < end
        WALL.sleep_until(WALL.now() + 0.005)


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
    first.write(CommandFrame(1, Command.MVP, 0, 4, 5000).encode())
    assert len(first.read(9)) == 9
    first.close()
    clock = served.rig.clock
    clock.sleep_until(clock.now() + 2.0)
    assert served.rig.plant.angle_deg("sigma", clock.now()) == pytest.approx(5000 / 5120, abs=1e-6)


def test_a_killed_client_does_not_disturb_the_server(served: Served) -> None:
    for _ in range(20):
        client = socket.create_connection(("127.0.0.1", served.port))
        client.send(ASK[:5])  # half a frame, and gone
        client.close()
    served.rig.clock.sleep_until(served.rig.clock.now() + 2.0)  # longer than a partial frame lives
    port = serial.serial_for_url(f"socket://127.0.0.1:{served.port}", timeout=5.0)
    port.write(ASK)
    assert ReplyFrame.decode(port.read(9)).command == Command.GAP
    port.close()


def test_a_client_that_does_not_read_does_not_block_other_clients(served: Served) -> None:
    lazy = socket.create_connection(("127.0.0.1", served.port))
    for _ in range(2000):
        lazy.send(ASK * 50)
    port = serial.serial_for_url(f"socket://127.0.0.1:{served.mono_port}", timeout=10.0)
    port.write(b"WAVE?\n")
    assert port.read_until(b"\n") == b"WAVE?\n"
    port.close()
    lazy.close()


@pytest.mark.skipif(not ptys_exist(), reason="this system has no pseudo-terminals")
def test_a_new_client_of_a_pty_gets_no_earlier_answers(served: Served) -> None:
    other = serial.serial_for_url(f"socket://127.0.0.1:{served.port}", timeout=5.0)
    for _ in range(1000):  # 9 kB, more than the system keeps for a reader
        other.write(ASK)
        other.read(9)
    other.close()
    port = serial.Serial(str(served.pty), 115200, timeout=5.0)
    port.write(CommandFrame(1, Command.GGP, 1, 2).encode())
    assert ReplyFrame.decode(port.read(9)).command == Command.GGP
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


def test_a_client_that_floods_gets_a_bounded_number_of_answers(served: Served) -> None:
    device = served.rig.serial["mono"]
    client = socket.create_connection(("127.0.0.1", served.mono_port))
    client.sendall(b"GOWAVE 900\n" + b"INFO?\n" * 3000)  # it moves first, and answers afterwards
    most, end = 0, WALL.now() + 0.5
    while WALL.now() < end:
        with served.rig.lock:
            most = max(most, owed(device))
        WALL.sleep_until(WALL.now() + 0.005)
    assert 0 < most < 2 * OWED_AT_MOST
    client.close()


def test_answers_for_a_disconnected_client_do_not_reach_the_next(served: Served) -> None:
    client = socket.create_connection(("127.0.0.1", served.mono_port))
    client.sendall(b"GOWAVE 900\n" + b"INFO?\n" * 20)
    _until(lambda: bool(served.rig.serial["mono"].outbox))
    client.close()
    following = serial.serial_for_url(f"socket://127.0.0.1:{served.mono_port}", timeout=5.0)
    following.write(b"WAVE?\n")
    assert following.read_until(b"\n") == b"WAVE?\n"
    following.close()


@pytest.mark.skipif(not ptys_exist(), reason="this system has no pseudo-terminals")
def test_a_disconnection_does_not_affect_a_client_that_waits_at_the_pty(served: Served) -> None:
    port = serial.Serial(str(served.mono_pty), served.rig.serial["mono"].baudrate, timeout=5.0)
    port.write(b"GOWAVE 900\nINFO?\n")
    _until(lambda: bool(served.rig.serial["mono"].outbox))
    socket.create_connection(("127.0.0.1", served.mono_port)).close()
    assert port.read_until(IDENTITY.encode()).endswith(IDENTITY.encode())
    port.close()


def test_a_frame_may_come_in_pieces_however_fast_the_rig_lives(opened: RigOpener, tmp_path: Path) -> None:
    rig = opened().virtual
    assert rig is not None
    server = ServedRig(rig.plant.model, 100.0, tmp_path / "ptys")
    server.start()
    try:
        port = next(each.port for each in server.endpoints if each.device == "axes" and each.port is not None)
        with socket.create_connection(("127.0.0.1", port), timeout=5.0) as client:
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            for _ in range(10):
                for at in range(0, len(ASK), 3):
                    client.sendall(ASK[at : at + 3])
                    WALL.sleep_until(WALL.now() + 0.002)
                assert len(client.recv(9, socket.MSG_WAITALL)) == 9
    finally:
        server.stop()
