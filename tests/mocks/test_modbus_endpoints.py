"""Converter modules on real endpoints: pymodbus clients, the product's drivers, and clients that disconnect without notice."""

import os
import select
import socket
import struct
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.exceptions import ModbusException, ModbusIOException

from goniotwin.app.rig import OpenRig
from goniotwin.app.rig.modbus_units import ModbusUnits
from goniotwin.drivers import PhotodiodeArray, PhotodiodeSettings, wait
from goniotwin.mocks.modbus_endpoints import ModbusEndpoints
from goniotwin.protocols import adam
from goniotwin.protocols.clock import RealClock
from tests.conftest import RigOpener
from tests.drivers.photodiode_bench import QUIET, SERIAL

pytestmark = pytest.mark.endpoint
SETTINGS = {"upper_deg": tuple(float(k) for k in range(36)), "lower_deg": (), "gains_v_per_a": (1e6, 1e8, 1e10, 1e11)}
PUMPED = 4096


class NullModem:
    """Two joined pseudo-terminals: bytes written to one are read from the other."""

    def __init__(self) -> None:
        import tty

        self._masters, self._slaves = zip(*(os.openpty() for _ in range(2)), strict=True)
        for slave in self._slaves:
            tty.setraw(slave)
        self.device, self.computer = (os.ttyname(slave) for slave in self._slaves)
        self._ending = False
        self._thread = threading.Thread(target=self._pump, daemon=True)
        self._thread.start()

    def _pump(self) -> None:
        while not self._ending:
            for master in select.select(self._masters, [], [], 0.05)[0]:
                os.write(self._masters[1 - self._masters.index(master)], os.read(master, PUMPED))

    def close(self) -> None:
        self._ending = True
        self._thread.join()
        for descriptor in (*self._masters, *self._slaves):
            os.close(descriptor)


def open_descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


@pytest.fixture
def rig(opened: RigOpener) -> OpenRig:
    return opened(QUIET, ("drift_per_hour = 0.02", "drift_per_hour = 0.0"), clock=RealClock(speed=10.0))


@pytest.fixture
def tcp(rig: OpenRig) -> Iterator[ModbusEndpoints]:
    assert rig.virtual is not None
    endpoints = ModbusEndpoints(rig.virtual)
    for name in rig.virtual.modbus:
        endpoints.add_tcp(name)
    with endpoints:
        yield endpoints


@pytest.fixture
def line(opened: RigOpener) -> Iterator[tuple[OpenRig, NullModem, ModbusEndpoints]]:
    rig = opened(QUIET, *SERIAL, clock=RealClock())
    assert rig.virtual is not None
    modem = NullModem()
    endpoints = ModbusEndpoints(rig.virtual)
    endpoints.add_rtu(modem.device)
    with endpoints:
        yield rig, modem, endpoints
    modem.close()


def test_an_unmodified_tcp_client(tcp: ModbusEndpoints, caplog: pytest.LogCaptureFixture) -> None:
    with ModbusTcpClient("127.0.0.1", port=tcp.ports["adc-1"], timeout=0.3, retries=0) as client:
        assert client.read_holding_registers(adam.MODULE_NAME, count=2).registers == [0x6017, 0]
        assert client.read_input_registers(adam.MODULE_NAME, count=2).registers == [0x6017, 0]
        assert client.read_holding_registers(9, count=1).exception_code == 2
        assert client.write_register(adam.RANGE_CODE, 7).exception_code == 3
        assert client.report_device_id().exception_code == 1
        assert not client.write_registers(adam.RANGE_CODE, [0x0140] * 8).isError()
        assert client.read_holding_registers(adam.RANGE_CODE, count=8).registers == [0x0140] * 8
        assert not client.write_coils(adam.DIGITAL_OUTPUT, [True, False]).isError()
        assert client.read_coils(adam.DIGITAL_OUTPUT, count=2).bits[:2] == [True, False]
        for unit in (0, 1, 255):
            assert client.read_holding_registers(0, count=1, device_id=unit).dev_id == unit
        with pytest.raises(ModbusIOException):
            client.read_holding_registers(0, count=1, device_id=7)
        assert not client.read_holding_registers(0, count=8).isError()
    assert "Traceback" not in caplog.text


def test_the_endpoint_and_the_door_give_the_same_answers(rig: OpenRig, tcp: ModbusEndpoints) -> None:
    assert rig.virtual is not None
    device = rig.virtual.modbus["adc-0"]
    with ModbusTcpClient("127.0.0.1", port=tcp.ports["adc-0"], retries=0) as client:
        for address, count in ((0, 9), (10, 9), (20, 9), (30, 18), (200, 8), (210, 4), (220, 1)):
            over_the_wire = client.read_holding_registers(address, count=count).registers
            assert over_the_wire == device.registers(address, count, rig.virtual.clock.now())


def test_pipelined_and_split_requests_are_all_answered(tcp: ModbusEndpoints) -> None:
    requests = b"".join(struct.pack(">HHHBBHH", k, 0, 6, 1, 3, adam.MODULE_NAME, 1) for k in range(1, 40))
    with socket.create_connection(("127.0.0.1", tcp.ports["adc-0"]), timeout=5.0) as connection:
        connection.sendall(requests[:7])
        connection.sendall(requests[7:])
        answers = b""
        while len(answers) < 39 * 11:
            answers += connection.recv(PUMPED)
    assert [int.from_bytes(answers[at : at + 2], "big") for at in range(0, len(answers), 11)] == list(range(1, 40))


def test_a_frame_that_states_too_many_bytes_does_not_take_the_next_one_with_it(tcp: ModbusEndpoints) -> None:
    with ModbusTcpClient("127.0.0.1", port=tcp.ports["adc-0"], timeout=2.0, retries=0) as client:
        assert client.socket is not None
        client.socket.sendall(struct.pack(">HHHB", 9, 0, 255, 1) + bytes(254))
        assert client.read_holding_registers(adam.MODULE_NAME, count=2).registers == [0x6017, 0]


def test_a_client_that_floods_and_does_not_read_does_not_block_other_clients(tcp: ModbusEndpoints) -> None:
    request = struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, 0, 8)
    with socket.create_connection(("127.0.0.1", tcp.ports["adc-0"])) as lazy:
        lazy.setblocking(False)
        sent = 0
        while select.select([], [lazy], [], 0.5)[1] and sent < 8_000_000:
            sent += lazy.send(request * 5000)
        assert sent < 8_000_000  # the server stops reading: flow control
        with socket.create_connection(("127.0.0.1", tcp.ports["adc-1"]), timeout=2.0) as other:
            other.sendall(request)
            assert other.recv(PUMPED)


def test_a_disconnected_client_gets_no_more_answers(tcp: ModbusEndpoints, caplog: pytest.LogCaptureFixture) -> None:
    with socket.create_connection(("127.0.0.1", tcp.ports["adc-0"])) as connection:
        connection.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, adam.MODULE_NAME, 1) * 3000)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    clock = RealClock()
    clock.sleep_until(clock.now() + 0.5)
    assert "socket.send() raised exception" not in caplog.text


def drive(rig: OpenRig, settings: PhotodiodeSettings, addresses: list[str], gain: int) -> np.ndarray:
    """Read dark counts over real wires with the product's driver; assert that they equal those of the same rig in process."""
    units = ModbusUnits(None)
    clock = rig.rig.clock
    array = PhotodiodeArray([units.unit(address) for address in addresses], settings, clock)
    try:
        assert array.connect().startswith("5 modules")
        found = []
        for each in (array, rig.rig.photodiodes):
            wait(clock, [each.start_gain(gain)])
            readings = each.start_readings(2)
            wait(clock, [readings])
            found.append(readings.counts.astype(int))
        # The amplifiers come to their new voltage for ever: what is left of it may round the other way.
        np.testing.assert_allclose(found[0], found[1], atol=1)
        return found[0]
    finally:
        array.close()


def test_our_driver_over_tcp_reads_what_it_reads_in_process(rig: OpenRig, tcp: ModbusEndpoints) -> None:
    addresses = [tcp.address[f"adc-{k}"] for k in range(5)]
    counts = drive(rig, PhotodiodeSettings(**SETTINGS, kind="adam-6017"), addresses, 3)  # type: ignore[arg-type]
    assert counts.min() > 33000  # 0.2 V at 1e11 V/A


def test_our_driver_over_one_rtu_line_reads_what_it_reads_in_process(line: tuple[OpenRig, NullModem, ModbusEndpoints]) -> None:
    rig, modem, endpoints = line
    addresses = [endpoints.address[f"adc-{k}"].replace(modem.device, modem.computer) for k in range(5)]
    assert addresses[2] == f"rtu:{modem.computer}?unit=3&baudrate=9600"
    settings = PhotodiodeSettings(**{**SETTINGS, "gains_v_per_a": (1e11,)}, kind="adam-4117", exchange_s=0.04)  # type: ignore[arg-type]
    assert drive(rig, settings, addresses, 0).min() > 33000


def test_an_unmodified_rtu_client(line: tuple[OpenRig, NullModem, ModbusEndpoints], caplog: pytest.LogCaptureFixture) -> None:
    with ModbusSerialClient(line[1].computer, baudrate=9600, timeout=0.3, retries=0) as client:
        for unit in range(1, 6):
            assert client.read_holding_registers(adam.MODULE_NAME, count=2, device_id=unit).registers == [0x4117, 0]
        assert client.read_holding_registers(adam.AVERAGE, count=1, device_id=2).exception_code == 2
        assert client.write_register(adam.RANGE_CODE, 0x0143, device_id=2).exception_code == 3
        assert not client.write_register(adam.RANGE_CODE, 7, device_id=2).isError()
        with pytest.raises(ModbusIOException):
            client.read_holding_registers(0, count=1, device_id=9)
        assert not client.read_input_registers(0, count=8, device_id=5).isError()
    assert "Traceback" not in caplog.text


def test_a_killed_client_does_not_disturb_the_server(tcp: ModbusEndpoints) -> None:
    port = tcp.ports["adc-0"]
    before = open_descriptors()
    for _ in range(20):
        connection = socket.create_connection(("127.0.0.1", port))
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # reset, as a kill does it
        connection.sendall(b"\0\1\0\0\0\6\1\3")
        connection.close()
    with ModbusTcpClient("127.0.0.1", port=port, retries=0) as client:
        for _ in range(100):  # meanwhile the server sees that the others have gone
            assert not client.read_holding_registers(0, count=8).isError()
    assert open_descriptors() <= before + 1


def test_ports_threads_and_descriptors_are_released_at_the_end(opened: RigOpener) -> None:
    rig = opened(QUIET, clock=RealClock())
    assert rig.virtual is not None
    before, threads = open_descriptors(), threading.active_count()
    port = 0
    for _ in range(3):
        endpoints = ModbusEndpoints(rig.virtual)
        endpoints.add_tcp("adc-0", port)
        with endpoints, ModbusTcpClient("127.0.0.1", port=endpoints.ports["adc-0"], retries=0) as client:
            port = endpoints.ports["adc-0"]  # the same again in the next turn
            assert not client.read_holding_registers(0, count=8).isError()
        endpoints.stop()  # a second time does nothing
    assert (open_descriptors(), threading.active_count()) == (before, threads)


def test_a_port_in_use_is_reported(rig: OpenRig, tcp: ModbusEndpoints) -> None:
    assert rig.virtual is not None
    second = ModbusEndpoints(rig.virtual)
    second.add_tcp("adc-0", tcp.ports["adc-0"])
    with pytest.raises(OSError, match=f"127.0.0.1:{tcp.ports['adc-0']} cannot be opened"):
        second.start()
    with pytest.raises(KeyError, match="adc-9"):
        second.add_tcp("adc-9")


def test_a_device_works_again_after_it_is_plugged_in_again(tcp: ModbusEndpoints) -> None:
    for _ in range(2):
        with ModbusTcpClient("127.0.0.1", port=tcp.ports["adc-0"], timeout=0.5, retries=0) as client:
            assert not client.read_holding_registers(0, count=8).isError()
            tcp.unplug("adc-0")
            for _ in range(2):  # the connection that was open, and one made anew
                with pytest.raises(ModbusException):
                    client.read_holding_registers(0, count=8)
            tcp.replug("adc-0")
