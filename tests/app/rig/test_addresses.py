"""Addresses in a rig file: canonical forms, and the parsing of Modbus addresses."""

import os
import socket
import stat
from pathlib import Path

import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from goniotwin.app.errors import UserError
from goniotwin.app.rig import open_rig, read_rig
from goniotwin.app.rig.addresses import check_address, device_names, resolve_port, rtu_address
from goniotwin.app.rig.lock import RigLock
from goniotwin.app.rig.modbus_units import ModbusUnits
from goniotwin.app.rig.served_file import endpoint_address
from goniotwin.app.rig.wires import Wires, open_serial
from goniotwin.drivers.found import FoundSettings
from goniotwin.mocks.served import Endpoint, Wire
from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin.doors import NoSuchTwin
from goniotwin.twin.doors.registry import find
from tests.conftest import Writer


def test_an_rtu_address_has_port_unit_and_baud_rate() -> None:
    assert rtu_address("rtu:/dev/ttyUSB1?unit=3") == ("/dev/ttyUSB1", 3, 9600)
    assert rtu_address("rtu:COM4?unit=2&baudrate=115200") == ("COM4", 2, 115200)
    assert rtu_address("rtu:socket://moxa:4001?unit=9") == ("socket://moxa:4001", 9, 9600)
    assert rtu_address("rtu:COM4") == ("COM4", 1, 9600)


@pytest.mark.parametrize(
    "address",
    [
        "rtu:",
        "rtu:?unit=3",
        "rtu:COM4?unit=0",
        "rtu:COM4?unit=248",
        "rtu:COM4?unit=x",
        "rtu:COM4?unit=",
        "rtu:COM4?unit",
        "rtu:COM4?unit=1&unit=2",
        "rtu:COM4?baudrate=9601",
        "rtu:COM4?parity=E",
        "rtu:COM4?unit=1,baudrate=9600",
        "rtu:twin://virtual/adcs?unit=1",
        "",
        ":502",
        "adam-0:",
        "adam-0:0",
        "adam-0:65536",
        "adam-0:http",
        "adam-0:502?unit=256",
        "adam-0:502?unit=-1",
        "adam-0:502?baudrate=9600",
        "adam-0?unit=",
        "adam-0:502?3",
    ],
)
def test_an_invalid_address_is_refused_with_its_text(address: str) -> None:
    with pytest.raises(UserError) as error:
        ModbusUnits(None).unit(address)
    assert repr(address) in str(error.value)
    assert "rig file" in str(error.value)


@pytest.mark.parametrize(("address", "unit"), [("adam-0", 1), ("adam-0?unit=0", 0), ("[::1]:502?unit=255", 255)])
def test_a_module_over_tcp_may_respond_to_another_unit(address: str, unit: int) -> None:
    check_address(address)
    assert ModbusUnits(None).unit(address).unit == unit


@pytest.mark.parametrize(("unit", "address"), [(1, "127.0.0.1:5020"), (0, "127.0.0.1:5020?unit=0")])
def test_a_served_module_is_found_by_its_unit(unit: int, address: str) -> None:
    assert endpoint_address(Endpoint("adc-0", "adam-6017", Wire.MODBUS_TCP, host="127.0.0.1", port=5020, unit=unit)) == address


def test_units_of_one_port_share_one_bus() -> None:
    units = ModbusUnits(None)
    one, two, other = (units.unit(each) for each in ("rtu:COM4?unit=1", "rtu:COM4?unit=2", "rtu:COM5?unit=1"))
    assert one.bus is two.bus
    assert one.bus.rtu
    assert other.bus is not one.bus
    assert not units.unit("adam-0:502").bus.rtu
    with pytest.raises(UserError, match="unit 2 of the same line"):
        units.unit("rtu:COM4?unit=2")
    with pytest.raises(UserError, match="one speed"):
        units.unit("rtu:COM4?unit=3&baudrate=19200")


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("rtu:/dev/ttyUSB1?unit=3&baudrate=9600", "/dev/ttyUSB1"),
        ("127.0.0.1", "127.0.0.1:502"),
        ("127.0.0.1?unit=255", "127.0.0.1:502"),
        ("127.0.0.1", "rtu:127.0.0.1"),
        ("localhost:4001", "socket://127.0.0.1:4001"),
        ("LOCALHOST:4001", "localhost:4001"),
        ("usbip:127.0.0.1/1-1", "usbip:localhost:3240/1-1"),
        ("COM4", "com4"),
        ("COM4", r"\\.\COM4"),
        ("localhost:4001", "[::1]:4001"),
        ("[::ffff:127.0.0.1]:4001", "0.0.0.0:4001"),
        ("SOCKET://localhost:4001/", "rfc2217://127.0.0.1:4001?ign_set_control"),
        ("1313:807A:P1", "1313:807a:P1"),
        ("/dev/../dev/ttyUSB0", "/dev/ttyUSB0"),
        ("socket://localhost:04001", "localhost:4001"),
        ("127.0.0.1:0502", "127.0.0.1"),
        ("usbip:localhost:03240/1-1", "usbip:localhost/1-1"),
    ],
)
def test_spellings_of_one_device_have_a_name_in_common(one: str, other: str) -> None:
    assert device_names(one) & device_names(other)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("127.0.0.1:502", "127.0.0.1:503"),
        ("usbip:127.0.0.1/1-1", "usbip:127.0.0.1/1-2"),
        ("1313:8078:P1", "1313:8078:P2"),
        ("no-such-host-anywhere.invalid:1", "another.invalid:1"),
        ("COM4", "COM5"),
        ("192.0.2.1:4001", "192.0.2.2:4001"),
        ("192.0.2.1:4001", "localhost:4001"),
    ],
)
def test_two_devices_have_no_name_in_common(one: str, other: str) -> None:
    assert not device_names(one) & device_names(other)


@pytest.mark.skipif(os.name == "nt", reason="Windows has no device nodes")
def test_two_nodes_of_one_port_have_a_name_in_common(tmp_path: Path) -> None:
    server, port = os.openpty()
    node = tmp_path / "port"
    try:
        os.mknod(node, 0o600 | stat.S_IFCHR, os.fstat(port).st_rdev)
    except PermissionError:
        pytest.skip("only the system's administrator makes device nodes")
    finally:
        names = device_names(os.ttyname(port))
        os.close(port)
        os.close(server)
    assert names & device_names(str(node))


def test_a_link_and_its_target_are_locked_together(tmp_path: Path) -> None:
    port, link = tmp_path / "ttyACM0", tmp_path / "by-id"
    port.touch()
    link.symlink_to(port)
    first = RigLock([str(port)], "the first", tmp_path / "locks")
    with pytest.raises(UserError, match="the first"):
        RigLock([f"rtu:{link}?unit=2"], "the second", tmp_path / "locks")
    first.release()


def test_a_rig_with_an_invalid_address_leaves_no_virtual_rig_behind(write_rig: Writer) -> None:
    rig = read_rig(write_rig(('usb = "twin://virtual/monitor"', 'usb = "nonsense"')))
    with pytest.raises(UserError, match="'nonsense'"):
        open_rig(rig, VirtualClock())
    with pytest.raises(NoSuchTwin, match="'virtual'"):
        find("twin://virtual/axes")


@pytest.mark.parametrize(
    "address",
    [
        "/dev/ttyUSB0",
        "/dev/serial/by-id/usb-FTDI_FT232R-if00-port0",
        "COM4",
        "com12",
        r"\\.\COM10",
        "socket://moxa-1.lab:4001",
        "socket://[::1]:4001",
        "rfc2217://moxa:4001?ign_set_control&timeout=3",
        "hwgrep://0403:6001",
        "hwgrep://.*FT232R.*",
        "twin://virtual/adc-0",
        "rtu:/dev/ttyUSB1?unit=3&baudrate=9600",
        "rtu:socket://moxa:4001?unit=9",
        "rtu:hwgrep://FT232R?unit=2",
        "usbip:127.0.0.1:3240/1-1",
        "usbip:localhost/1-1.4",
        "10.0.0.7",
        "adam-0:502",
        "[fe80::1%eth0]:502",
        "1313:8078:P0012345",
    ],
)
def test_an_address_of_a_known_kind_is_accepted(address: str) -> None:
    check_address(address)


@pytest.mark.parametrize(
    "address",
    [
        "spy:///dev/ttyUSB0?file=precious.txt",
        "SPY://COM4?file=x",
        "spy://socket://moxa:4001?file=x",
        "rtu:spy:///dev/ttyUSB0?file=x",
        "alt:///dev/ttyUSB0?class=PosixPollSerial",
        "loop://",
        "cp2110://",
        "/dev/x://y",
        "rfc2217://moxa:4001?logging=debug",
        "file:///etc/passwd",
        "http://moxa/",
        r"\\server\share\x",
        "ttyUSB0/../x",
        "hwgrep://(a+)+$",
        "hwgrep://.*.*.*.*x",
        "hwgrep://a&skip_busy",
        "socket://moxa:4001?logging=debug",
        "/dev/tty\nUSB0",
        "",
        "/" + "x" * 1000,
    ],
)
def test_an_address_of_another_kind_is_refused_by_the_file(write_rig: Writer, address: str) -> None:
    with pytest.raises(ValueError, match="not an address of a known kind"):
        check_address(address)
    quoted = address.replace("\\", "\\\\").replace("\n", "\\n")
    for key, change in (
        ("axes.port", ('port = "twin://virtual/axes"', f'port = "{quoted}"')),
        ("photodiodes.units.1", ('"twin://virtual/adc-1"', f'"{quoted}"')),
        ("monitor.usb", ('usb = "twin://virtual/monitor"', f'usb = "{quoted}"')),
    ):
        with pytest.raises(UserError, match=rf"rig\.toml: {key}: .*is not an address of a known kind; give") as refused:
            read_rig(write_rig(change))
        assert "\n" not in str(refused.value)


def test_a_serial_device_has_no_other_address(write_rig: Writer) -> None:
    with pytest.raises(UserError, match=r"'10\.0\.0\.7:502' is not a serial port"):
        open_rig(read_rig(write_rig(("twin://virtual/mono", "10.0.0.7:502"))), VirtualClock())


def test_a_port_is_found_by_its_description_before_it_is_locked(monkeypatch: pytest.MonkeyPatch) -> None:
    ports = [ListPortInfo(f"/dev/ttyUSB{k}", skip_link_detection=True) for k in range(2)]
    ports[0].description, ports[1].description = "FT232R of the axes", "FT232R of the lamp"
    monkeypatch.setattr(list_ports, "comports", lambda *_: ports)
    assert resolve_port("hwgrep://of the axes") == "/dev/ttyUSB0"
    assert resolve_port("rtu:hwgrep://r.*lamp?unit=2") == "rtu:/dev/ttyUSB1?unit=2"
    assert (
        device_names("HWGREP://of the axes") == device_names("rtu:hwgrep://of the axes?unit=3") == device_names("/dev/ttyUSB0")
    )
    for address, reason in (
        ("hwgrep://FT232R", "several"),
        ("hwgrep://USB&skip_busy", "not a serial port"),
        ("hwgrep://FT4232", "no serial port"),
        ("hwgrep://*", "pattern"),
    ):
        with pytest.raises(UserError, match=reason):
            resolve_port(address)


@pytest.mark.parametrize(
    ("addresses", "other"),
    [
        (("127.0.0.1:502", "127.0.0.1", "localhost?unit=1"), "127.0.0.1?unit=2"),
        (("rtu:/dev/null", "rtu:/dev/null?unit=1&baudrate=9600", "rtu:/dev/null?baudrate=9600&unit=1"), "rtu:/dev/null?unit=2"),
    ],
)
def test_the_note_of_a_module_is_the_same_however_its_address_is_written(addresses: tuple[str, ...], other: str) -> None:
    """After a kill another rig file finds it."""

    def settings(address: str) -> FoundSettings:
        found = Wires(VirtualClock(), None, None).modbus(address, "module").found
        found.take_up("module")
        return found

    for address in addresses:
        settings(address).note({"range": ("7", "8")})
        assert [bool(settings(each).changes) for each in (*addresses, other)] == [True] * len(addresses) + [False]
        settings(address).clear()
        assert not any(settings(each).changes for each in addresses)


@pytest.mark.endpoint
def test_frames_to_a_network_port_are_sent_at_once() -> None:
    """Otherwise the second frame of a stop waits for the acknowledgement of the first, for 40 ms and more."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = open_serial(f"socket://127.0.0.1:{server.getsockname()[1]}", 115200, 0.02)
        with socket.fromfd(port.fileno(), socket.AF_INET, socket.SOCK_STREAM) as connection:
            assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) != 0
        port.close()
