"""Addresses in a rig file: canonical forms, and the parsing of Modbus addresses."""

from pathlib import Path

import pytest

from goniotwin.app.errors import UserError
from goniotwin.app.rig import open_rig, read_rig
from goniotwin.app.rig.addresses import ModbusUnits, canonical_address, rtu_address
from goniotwin.app.rig.lock import RigLock
from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin.doors import NoSuchTwin
from goniotwin.twin.doors.registry import find
from tests.conftest import Writer


def test_an_rtu_address_has_port_unit_and_baud_rate() -> None:
    assert rtu_address("rtu:/dev/ttyUSB1?unit=3") == ("/dev/ttyUSB1", 3, 9600)
    assert rtu_address("rtu:COM4?unit=2&baudrate=115200") == ("COM4", 2, 115200)
    assert rtu_address("rtu:socket://moxa:4001?unit=9") == ("socket://moxa:4001", 9, 9600)
    assert rtu_address("rtu:COM4") == ("COM4", 1, 9600)


@pytest.mark.parametrize("address", [
    "rtu:", "rtu:?unit=3", "rtu:COM4?unit=0", "rtu:COM4?unit=248", "rtu:COM4?unit=x", "rtu:COM4?unit=", "rtu:COM4?unit",
    "rtu:COM4?unit=1&unit=2", "rtu:COM4?baudrate=9601", "rtu:COM4?parity=E", "rtu:COM4?unit=1,baudrate=9600",
    "rtu:twin://virtual/adcs?unit=1", "", ":502", "adam-0:", "adam-0:0", "adam-0:65536", "adam-0:http", "adam-0:502?unit=3",
])  # fmt: skip
def test_an_invalid_address_is_refused_with_its_text(address: str) -> None:
    with pytest.raises(UserError) as error:
        ModbusUnits(None).unit(address)
    assert repr(address) in str(error.value)
    assert "rig file" in str(error.value)


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
        ("127.0.0.1", "rtu:127.0.0.1"),
        ("localhost:4001", "socket://127.0.0.1:4001"),
        ("LOCALHOST:4001", "localhost:4001"),
        ("usbip:127.0.0.1/1-1", "usbip:localhost:3240/1-1"),
        ("COM4", "com4"),
        ("1313:807A:P1", "1313:807a:P1"),
        ("/dev/../dev/ttyUSB0", "/dev/ttyUSB0"),
    ],
)
def test_spellings_of_one_device_have_one_canonical_address(one: str, other: str) -> None:
    assert canonical_address(one) == canonical_address(other)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("127.0.0.1:502", "127.0.0.1:503"),
        ("usbip:127.0.0.1/1-1", "usbip:127.0.0.1/1-2"),
        ("1313:8078:P1", "1313:8078:P2"),
        ("no-such-host-anywhere.invalid:1", "another.invalid:1"),
        ("COM4", "COM5"),
    ],
)
def test_two_devices_have_two_canonical_addresses(one: str, other: str) -> None:
    assert canonical_address(one) != canonical_address(other)


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
