"""Addresses of converter modules."""

import pytest

from goniotwin.app.errors import UserError
from goniotwin.app.rig.addresses import ModbusUnits, rtu_address


def test_a_serial_address_says_port_unit_and_baud_rate() -> None:
    assert rtu_address("rtu:/dev/ttyUSB1?unit=3") == ("/dev/ttyUSB1", 3, 9600)
    assert rtu_address("rtu:COM4?unit=2&baudrate=115200") == ("COM4", 2, 115200)
    assert rtu_address("rtu:socket://moxa:4001?unit=9") == ("socket://moxa:4001", 9, 9600)
    assert rtu_address("rtu:COM4") == ("COM4", 1, 9600)


@pytest.mark.parametrize("address", [
    "rtu:", "rtu:?unit=3", "rtu:COM4?unit=0", "rtu:COM4?unit=248", "rtu:COM4?unit=x", "rtu:COM4?unit=", "rtu:COM4?unit",
    "rtu:COM4?unit=1&unit=2", "rtu:COM4?baudrate=9601", "rtu:COM4?parity=E", "rtu:COM4?unit=1,baudrate=9600",
    "rtu:twin://virtual/adcs?unit=1", "", ":502", "adam-0:", "adam-0:0", "adam-0:65536", "adam-0:http", "adam-0:502?unit=3",
])  # fmt: skip
def test_another_form_is_told_with_the_address(address: str) -> None:
    with pytest.raises(UserError) as error:
        ModbusUnits(None).unit(address)
    assert repr(address) in str(error.value)
    assert "rig file" in str(error.value)


def test_units_of_one_port_share_one_wire() -> None:
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
