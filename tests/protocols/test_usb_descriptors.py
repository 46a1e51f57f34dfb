"""USB's descriptors, held against the bytes that a real instrument has, and against anything."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.protocols.usb_descriptors import DescriptorError, decode_configuration, decode_device, decode_string

# USB 2.0 table 9-8 filled in for a Thorlabs PM100D; a configuration with an interface of two alternate settings.
DEVICE = bytes.fromhex("12 01 0002 00 00 00 40 1313 7880 0001 01 02 03 01")
CONFIGURATION = bytes.fromhex(
    "09 02 2900 01 01 00 C0 32 09 04 00 00 00 FE 03 01 00 09 04 00 01 01 FE 03 01 00 07 05 82 02 4000 00"
)


def test_a_device_descriptor() -> None:
    found = decode_device(DEVICE, bus=1)
    assert (found.bcdUSB, found.idVendor, found.idProduct, found.iSerialNumber, found.bus) == (0x200, 0x1313, 0x8078, 3, 1)


def test_alternate_settings_and_what_lies_between_them() -> None:
    unknown = bytes.fromhex("03 21 00")  # of a class: passed over
    found = decode_configuration(CONFIGURATION[:18] + unknown + CONFIGURATION[18:])
    assert found.fields.wTotalLength == 0x29
    assert found.setting(0, 0).endpoints == []
    assert found.setting(0, 1).endpoints[0].bEndpointAddress == 0x82
    for interface, alternate in ((1, 0), (0, 2)):
        with pytest.raises(IndexError):
            found.setting(interface, alternate)


def test_a_string() -> None:
    assert decode_string(bytes((10, 3)) + "PM1µ".encode("utf-16-le")) == "PM1µ"


@given(st.binary(max_size=60), st.integers(0, len(CONFIGURATION)))
def test_nothing_escapes_but_its_own_error(data: bytes, kept: int) -> None:
    for decode in (decode_device, decode_configuration, decode_string):
        for candidate in (data, CONFIGURATION[:kept] + data, DEVICE[:kept] + data):
            try:
                decode(candidate)
            except DescriptorError:
                continue
