"""Chapter 9 of the USB specification for a USBTMC-USB488 instrument: its descriptors, byte for byte."""

import struct

from goniotwin.protocols.usb_descriptors import CONFIGURATION, DEVICE, ENDPOINT, INTERFACE, STRING
from goniotwin.protocols.usbtmc import INTERFACE_CLASS, PROTOCOL_USB488

BULK_OUT, BULK_IN, INTERRUPT_IN = 0x02, 0x82, 0x83
ENDPOINTS = ((BULK_OUT, 2), (BULK_IN, 2), (INTERRUPT_IN, 3))
"""Addresses with their kinds: 2 bulk, 3 interrupt."""
MAX_PACKET = 64
INTERRUPT_BYTES = 2
INTERVAL_MS = 10
MAX_POWER_2_MA = 50
ENGLISH = bytes((4, STRING, 0x09, 0x04))
MANUFACTURER_STRING, PRODUCT_STRING, SERIAL_STRING = 1, 2, 3
HALT_FEATURE = 0


def packet_bytes(endpoint: int) -> int:
    """wMaxPacketSize."""
    return INTERRUPT_BYTES if endpoint == INTERRUPT_IN else MAX_PACKET


def device_descriptor(vendor_id: int, product_id: int) -> bytes:
    """Eighteen bytes."""
    return struct.pack(
        "<BBHBBBBHHHBBBB",
        18,
        DEVICE,
        0x0200,
        0,
        0,
        0,
        64,
        vendor_id,
        product_id,
        0x0100,
        MANUFACTURER_STRING,
        PRODUCT_STRING,
        SERIAL_STRING,
        1,
    )


def configuration_descriptor() -> bytes:
    """The configuration with its interface and endpoints."""
    interface = struct.pack("<BBBBBBBBB", 9, INTERFACE, 0, 0, len(ENDPOINTS), *INTERFACE_CLASS, PROTOCOL_USB488, 0)
    endpoints = b"".join(
        struct.pack("<BBBBHB", 7, ENDPOINT, address, kind, packet_bytes(address), INTERVAL_MS if kind == 3 else 0)
        for address, kind in ENDPOINTS
    )
    total = 9 + len(interface) + len(endpoints)
    return struct.pack("<BBHBBBBB", 9, CONFIGURATION, total, 1, 1, 0, 0xC0, MAX_POWER_2_MA) + interface + endpoints


def string_descriptor(index: int, texts: dict[int, str]) -> bytes | None:
    """Index 0 lists the languages; None for an unknown index."""
    if index == 0:
        return ENGLISH
    if index not in texts:
        return None
    body = texts[index].encode("utf-16-le")
    return bytes((len(body) + 2, STRING)) + body
