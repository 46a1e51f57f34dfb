"""The monitor over USB/IP: python-usbtmc unmodified, our driver, and clients that speak the bytes themselves."""

import socket
import struct
import threading
from collections.abc import Iterator

import pytest
import usb.core
import usb.util
import usbtmc

from goniotwin.app.rig import read_rig
from goniotwin.app.rig.addresses import usbip_address
from goniotwin.drivers import Monitor, MonitorSettings, wait
from goniotwin.drivers.errors import DeviceError
from goniotwin.drivers.usb.usbip import UsbIpBackend, find_usbip
from goniotwin.mocks.usb_endpoints import UsbEndpoints
from goniotwin.protocols import usbip
from goniotwin.protocols.clock import RealClock
from goniotwin.twin import VirtualRig
from tests.conftest import Writer

pytestmark = pytest.mark.endpoint
HOST = "127.0.0.1"


@pytest.fixture
def rig(write_rig: Writer) -> VirtualRig:
    model = read_rig(write_rig(("noise = true", "noise = false"))).model()
    assert model is not None
    return VirtualRig.build(model, RealClock())


@pytest.fixture
def served(rig: VirtualRig) -> Iterator[UsbEndpoints]:
    endpoints = UsbEndpoints(rig)
    endpoints.start()
    yield endpoints
    endpoints.stop()


def instrument(served: UsbEndpoints) -> usbtmc.Instrument:
    found = usbtmc.Instrument(find_usbip(HOST, served.port, "1-1"))
    found.timeout = 2.0
    return found


def test_python_usbtmc_works_unmodified(served: UsbEndpoints) -> None:
    monitor = instrument(served)
    assert monitor.ask("*IDN?") == "Thorlabs,PM100D,TWIN0001,2.8.0"
    assert float(monitor.ask("SENS:CORR:WAV?")) > 0
    assert monitor.read_stb() & 0x10 == 0
    monitor.clear()
    monitor.timeout = 0.1
    with pytest.raises(usb.core.USBTimeoutError):
        monitor.read()
    monitor.timeout = 2.0
    assert monitor.ask("*IDN?").startswith("Thorlabs")
    monitor.close()


def test_the_driver_measures_over_usbip_and_reports_a_lost_connection(served: UsbEndpoints) -> None:
    monitor = Monitor(lambda: find_usbip(HOST, served.port, "1-1"), MonitorSettings(), RealClock())
    monitor.connect()
    mean = monitor.start_mean(0.05)
    wait(RealClock(), [mean])
    served.unplug("monitor")
    with pytest.raises(DeviceError, match="monitor"):
        wait(RealClock(), [monitor.start_mean(0.05)])
    served.replug("monitor")
    monitor.connect()
    assert "TWIN0001" in monitor.connect()
    monitor.close()


def test_a_program_can_open_a_device_several_times_as_with_libusb(served: UsbEndpoints) -> None:
    """Programs list the devices with their serial numbers, which opens them, and then open one."""
    backend = UsbIpBackend(HOST, served.port)
    listed, used = (usb.core.find(backend=backend) for _ in range(2))
    assert listed == used
    assert (listed.serial_number, used.serial_number) == ("TWIN0001", "TWIN0001")
    usb.util.dispose_resources(listed)
    assert used.ctrl_transfer(0xA1, 64, 0, 0, 1).tobytes() == b"\x01"  # USBTMC 1.0, table 15: INDICATOR_PULSE
    usb.util.dispose_resources(used)
    assert instrument(served).ask("*IDN?")


def test_a_second_client_is_refused(served: UsbEndpoints) -> None:
    first = instrument(served)
    assert first.ask("*IDN?")
    with pytest.raises(usb.core.USBError, match="busy"):
        find_usbip(HOST, served.port, "1-1")
    first.close()
    assert instrument(served).ask("*IDN?")


def test_what_is_not_there_is_not_found(served: UsbEndpoints) -> None:
    assert find_usbip(HOST, served.port, "9-9") is None
    served.unplug("monitor")
    assert usb.core.find(backend=UsbIpBackend(HOST, served.port)) is None
    port = served.port
    served.stop()
    with pytest.raises(usb.core.USBError, match="no USB/IP server"):
        find_usbip(HOST, port, "1-1")


def exactly(connection: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        piece = connection.recv(size - len(data))
        assert piece, "hung up"
        data += piece
    return data


def imported(port: int) -> socket.socket:
    connection = socket.create_connection((HOST, port), timeout=5.0)
    connection.sendall(bytes.fromhex("0111 8003 00000000") + b"1-1".ljust(32, b"\0"))
    assert exactly(connection, 8 + 312)[:8].hex() == "0111000300000000"
    return connection


def submit(number: int, direction: int, endpoint: int, length: int, setup: bytes = bytes(8), data: bytes = b"") -> bytes:
    return struct.pack(">10I", 1, number, 0x10001, direction, endpoint, 0, length, 0, 0xFFFFFFFF, 0) + setup + data


def test_a_transfer_that_waits_is_taken_back_in_bytes(served: UsbEndpoints) -> None:
    with imported(served.port) as connection:
        connection.sendall(submit(1, 1, 2, 64))
        connection.sendall(struct.pack(">6I24x", 2, 2, 0x10001, 0, 0, 1))
        assert exactly(connection, 48) == struct.pack(">5Ii24x", 4, 2, 0, 0, 0, -104)
        connection.sendall(struct.pack(">6I24x", 2, 3, 0x10001, 0, 0, 1))  # it has ended already
        assert exactly(connection, 48) == struct.pack(">5Ii24x", 4, 3, 0, 0, 0, 0)
        descriptor = bytes.fromhex("80 06 00 01 00 00 12 00")
        connection.sendall(submit(4, 1, 0, 18, descriptor))
        answer = exactly(connection, 48 + 18)
        assert struct.unpack(">7I", answer[:28]) == (3, 4, 0, 0, 0, 0, 18)
        assert answer[48 + 8 : 48 + 12] == struct.pack("<HH", 0x1313, 0x8078)
        connection.sendall(submit(5, 1, 9, 64))  # an endpoint that there is not
        assert struct.unpack(">5Ii", exactly(connection, 48)[:24])[5] == -32


@pytest.mark.parametrize("data", [b"GET / HTTP/1.1\r\n\r\n", bytes(64), bytes.fromhex("0111 8003 00000000") + b"\xff" * 32])
def test_a_client_of_another_protocol_is_disconnected(served: UsbEndpoints, data: bytes) -> None:
    with socket.create_connection((HOST, served.port), timeout=5.0) as connection:
        connection.sendall(data)
        connection.shutdown(socket.SHUT_WR)
        rest = b"".join(iter(lambda: connection.recv(4096), b""))
        assert rest in (b"", bytes.fromhex("0111000300000001"))
    assert instrument(served).ask("*IDN?")


def test_clients_that_vanish_leave_it_well(served: UsbEndpoints) -> None:
    for _ in range(20):
        connection = imported(served.port)
        connection.sendall(submit(1, 1, 2, 64)[:-5])
        connection.close()
    for _ in range(200):  # until the last of them has been noticed
        try:
            assert instrument(served).ask("*IDN?")
        except usb.core.USBError:
            continue
        break
    else:
        pytest.fail("it stays taken")


def test_it_ends_and_its_port_is_free(rig: VirtualRig) -> None:
    before = threading.active_count()
    endpoints = UsbEndpoints(rig)
    endpoints.start()
    connection = imported(endpoints.port)
    endpoints.stop()
    assert connection.recv(1) == b""
    connection.close()
    with socket.create_server((HOST, endpoints.port)):
        pass
    while threading.active_count() > before:
        pass


@pytest.mark.parametrize(
    ("address", "place"),
    [
        ("usbip:localhost:3241/1-1", ("localhost", 3241, "1-1")),
        ("usbip:bench/2-1.4", ("bench", usbip.PORT, "2-1.4")),
        ("usbip:[::1]/1-1", ("::1", usbip.PORT, "1-1")),
    ],
)
def test_addresses(address: str, place: tuple[str, int, str]) -> None:
    assert usbip_address(address) == place


def test_many_clients_may_come_at_once(rig: VirtualRig) -> None:
    endpoints = UsbEndpoints(rig)
    waiting = [socket.create_connection((HOST, endpoints.port), timeout=0.5) for _ in range(40)]
    endpoints.start()
    for client in waiting:
        client.sendall(struct.pack(">HHI", 0x0111, 0x8005, 0))
        client.settimeout(5.0)
        assert client.recv(8)[:4] == struct.pack(">HH", 0x0111, 0x0005)
        client.close()
    endpoints.stop()
