"""USB devices of another computer, or of another program, over USB/IP: a backend for pyusb.

`usb.core.find(backend=UsbIpBackend("127.0.0.1", 3240))` finds what the server exports. A device is imported while it is
open and, for a moment, to read its descriptors; nobody else can have it meanwhile.
"""

import errno
import struct
from array import array
from types import SimpleNamespace
from typing import Any

import usb.core
from usb.backend import IBackend

from goniotwin.drivers.usb.usbip_link import UsbIpLink, listed_devices
from goniotwin.protocols import usbip
from goniotwin.protocols.usb_descriptors import (
    CONFIGURATION,
    CONFIGURATION_BYTES,
    DEVICE,
    DEVICE_BYTES,
    Configuration,
    DescriptorError,
    decode_configuration,
    decode_device,
)

TIMEOUT_MS = 1000
GET_DESCRIPTOR, GET_CONFIGURATION, SET_CONFIGURATION, SET_INTERFACE = 6, 8, 9, 11
CLEAR_FEATURE, SET_FEATURE = 1, 3
PORT, PORT_RESET = 0x23, 4
"""To the hub's port that the device is on: a request of the hub class, which USB/IP carries like any other."""


class UsbIpDevice:
    """A device on a server's list; its descriptors are read once."""

    def __init__(self, host: str, port: int, exported: usbip.ExportedDevice) -> None:
        self.host, self.port, self.exported = host, port, exported
        self._described: tuple[bytes, list[Configuration]] | None = None

    def open(self) -> UsbIpLink:
        """Raises USBError where it is not there, or somebody else has it."""
        return UsbIpLink(self.host, self.port, self.exported.bus_id)

    def described(self) -> tuple[bytes, list[Configuration]]:
        """Its device descriptor, and its configurations. Raises USBError."""
        if self._described is None:
            link = self.open()
            try:
                device = _descriptor(link, DEVICE, 0, DEVICE_BYTES)
                whole = [_configuration(link, k) for k in range(self.exported.configurations)]
            except DescriptorError as error:
                raise usb.core.USBError(f"{self.exported.bus_id}: {error}", -1, errno.EIO) from None
            finally:
                link.close()
            self._described = device, whole
        return self._described


class UsbIpBackend(IBackend):
    """The devices of one server."""

    def __init__(self, host: str, port: int = usbip.PORT, bus_id: str | None = None) -> None:
        """With a `bus_id` there is this device only."""
        super().__init__()
        self._host, self._port, self._bus_id = host, port, bus_id

    def enumerate_devices(self) -> list[UsbIpDevice]:
        found = listed_devices(self._host, self._port)
        return [UsbIpDevice(self._host, self._port, each) for each in found if self._bus_id in (None, each.bus_id)]

    def get_parent(self, dev: UsbIpDevice) -> None:
        del dev

    def get_device_descriptor(self, dev: UsbIpDevice) -> SimpleNamespace:
        exported = dev.exported
        return decode_device(
            dev.described()[0], address=exported.address, bus=exported.bus, port_number=exported.address,
            port_numbers=(exported.address,), speed=exported.speed,
        )  # fmt: skip

    def get_configuration_descriptor(self, dev: UsbIpDevice, config: int) -> SimpleNamespace:
        return dev.described()[1][config].fields

    def get_interface_descriptor(self, dev: UsbIpDevice, intf: int, alt: int, config: int) -> SimpleNamespace:
        return dev.described()[1][config].setting(intf, alt).fields

    def get_endpoint_descriptor(self, dev: UsbIpDevice, ep: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        return dev.described()[1][config].setting(intf, alt).endpoints[ep]

    def open_device(self, dev: UsbIpDevice) -> UsbIpLink:
        return dev.open()

    def close_device(self, dev_handle: UsbIpLink) -> None:
        dev_handle.close()

    def set_configuration(self, dev_handle: UsbIpLink, config_value: int) -> None:
        dev_handle.control(_setup(0x00, SET_CONFIGURATION, config_value), b"", TIMEOUT_MS)

    def get_configuration(self, dev_handle: UsbIpLink) -> int:
        return dev_handle.control(_setup(0x80, GET_CONFIGURATION, length=1), b"", TIMEOUT_MS)[0]

    def set_interface_altsetting(self, dev_handle: UsbIpLink, intf: int, altsetting: int) -> None:
        dev_handle.control(_setup(0x01, SET_INTERFACE, altsetting, intf), b"", TIMEOUT_MS)

    def claim_interface(self, dev_handle: UsbIpLink, intf: int) -> None:
        """The whole device has been imported."""

    def release_interface(self, dev_handle: UsbIpLink, intf: int) -> None:
        """The whole device stays imported until it is closed."""

    def is_kernel_driver_active(self, dev_handle: UsbIpLink, intf: int) -> bool:
        del dev_handle, intf
        return False

    def clear_halt(self, dev_handle: UsbIpLink, ep: int) -> None:
        dev_handle.control(_setup(0x02, CLEAR_FEATURE, 0, ep), b"", TIMEOUT_MS)

    def reset_device(self, dev_handle: UsbIpLink) -> None:
        dev_handle.control(_setup(PORT, SET_FEATURE, PORT_RESET, 1), b"", TIMEOUT_MS)

    def bulk_write(self, dev_handle: UsbIpLink, ep: int, intf: int, data: "array[int]", timeout: int) -> int:
        del intf
        return dev_handle.write(ep, data.tobytes(), timeout)

    def bulk_read(self, dev_handle: UsbIpLink, ep: int, intf: int, buff: "array[int]", timeout: int) -> int:
        del intf
        return _fill(buff, dev_handle.read(ep, len(buff) * buff.itemsize, timeout))

    def intr_write(self, dev_handle: UsbIpLink, ep: int, intf: int, data: "array[int]", timeout: int) -> int:
        return self.bulk_write(dev_handle, ep, intf, data, timeout)

    def intr_read(self, dev_handle: UsbIpLink, ep: int, intf: int, buff: "array[int]", timeout: int) -> int:
        return self.bulk_read(dev_handle, ep, intf, buff, timeout)

    def ctrl_transfer(
        self,
        dev_handle: UsbIpLink,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: "array[int]",
        timeout: int,
    ) -> int:
        length = len(data) * data.itemsize
        setup = _setup(bmRequestType, bRequest, wValue, wIndex, length)
        if bmRequestType & 0x80:
            return _fill(data, dev_handle.control(setup, b"", timeout))
        dev_handle.control(setup, data.tobytes(), timeout)
        return length


def find_usbip(host: str, port: int, bus_id: str) -> Any:
    """The pyusb device that a server exports as `bus_id`, None where it does not. Raises USBError."""
    return usb.core.find(backend=UsbIpBackend(host, port, bus_id))


def _setup(kind: int, request: int, value: int = 0, index: int = 0, length: int = 0) -> bytes:
    return struct.pack("<BBHHH", kind, request, value, index, length)


def _descriptor(link: UsbIpLink, kind: int, index: int, length: int) -> bytes:
    return link.control(_setup(0x80, GET_DESCRIPTOR, kind << 8 | index, length=length), b"", TIMEOUT_MS)


def _configuration(link: UsbIpLink, index: int) -> Configuration:
    head = decode_configuration(_descriptor(link, CONFIGURATION, index, CONFIGURATION_BYTES))
    return decode_configuration(_descriptor(link, CONFIGURATION, index, head.fields.wTotalLength))


def _fill(buffer: "array[int]", data: bytes) -> int:
    view = memoryview(buffer).cast("B")
    view[: len(data)] = data[: len(view)]
    return len(data)
