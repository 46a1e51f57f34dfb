"""pyusb's door: a backend whose bus has the twin's USB devices on it.

`usb.core.find(backend=TwinUsbBackend(rig))` finds them; pyusb's programs need not know. Source: pyusb 1.3's IBackend.
"""

import threading
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field

import usb.core
from usb.backend import IBackend

from twin.devices.usbtmc import (
    BULK_IN,
    BULK_OUT,
    MANUFACTURER,
    MAX_PACKET,
    PRODUCT,
    PRODUCT_ID,
    PROTOCOL,
    VENDOR_ID,
    Stall,
    UsbTmcDevice,
)
from twin.rig import VirtualRig

GET_DESCRIPTOR = (0x80, 6)
STRING_DESCRIPTOR = 3
ENGLISH = bytes((4, 3, 0x09, 0x04))
CLASS_IN = 0x20
HIGH_SPEED = 3


@dataclass
class Descriptor:
    """Any descriptor: the fields that pyusb reads, by their names in the USB specification."""

    fields: dict[str, object] = field(default_factory=dict)

    def __getattr__(self, name: str) -> object:
        try:
            return self.__dict__["fields"][name]
        except KeyError:
            raise AttributeError(name) from None


class TwinUsbBackend(IBackend):
    """The bus. One instance a rig, since pyusb compares devices by the objects that this gives it."""

    def __init__(self, rig: VirtualRig) -> None:
        super().__init__()
        self._clock = rig.clock
        self._devices = list(rig.usb.values())
        self._lock = threading.RLock()

    def enumerate_devices(self) -> Iterator[UsbTmcDevice]:
        return iter(self._devices)

    def get_parent(self, dev: UsbTmcDevice) -> None:
        del dev

    def get_device_descriptor(self, dev: UsbTmcDevice) -> Descriptor:
        return Descriptor(
            dict(
                bLength=18, bDescriptorType=1, bcdUSB=0x0200, bDeviceClass=0, bDeviceSubClass=0, bDeviceProtocol=0,
                bMaxPacketSize0=64, idVendor=VENDOR_ID, idProduct=PRODUCT_ID, bcdDevice=0x0100, iManufacturer=1, iProduct=2,
                iSerialNumber=3, bNumConfigurations=1, address=self._devices.index(dev) + 1, bus=1, port_number=1,
                port_numbers=(1,), speed=HIGH_SPEED,
            )
        )  # fmt: skip

    def get_configuration_descriptor(self, dev: UsbTmcDevice, config: int) -> Descriptor:
        del dev
        _only_first(config)
        return Descriptor(
            dict(
                bLength=9, bDescriptorType=2, wTotalLength=32, bNumInterfaces=1, bConfigurationValue=1, iConfiguration=0,
                bmAttributes=0xC0, bMaxPower=50, extra_descriptors=[],
            )
        )  # fmt: skip

    def get_interface_descriptor(self, dev: UsbTmcDevice, intf: int, alt: int, config: int) -> Descriptor:
        del dev
        _only_first(intf, alt, config)
        return Descriptor(
            dict(
                bLength=9, bDescriptorType=4, bInterfaceNumber=0, bAlternateSetting=0, bNumEndpoints=2,
                bInterfaceClass=0xFE, bInterfaceSubClass=3, bInterfaceProtocol=PROTOCOL, iInterface=0, extra_descriptors=[],
            )
        )  # fmt: skip

    def get_endpoint_descriptor(self, dev: UsbTmcDevice, ep: int, intf: int, alt: int, config: int) -> Descriptor:
        del dev
        _only_first(intf, alt, config)
        address = (BULK_OUT, BULK_IN)[ep]
        return Descriptor(
            dict(
                bLength=7, bDescriptorType=5, bEndpointAddress=address, bmAttributes=2, wMaxPacketSize=MAX_PACKET,
                bInterval=0, bRefresh=0, bSynchAddress=0, extra_descriptors=[],
            )
        )  # fmt: skip

    def open_device(self, dev: UsbTmcDevice) -> UsbTmcDevice:
        return dev

    def close_device(self, dev_handle: UsbTmcDevice) -> None:
        del dev_handle

    def set_configuration(self, dev_handle: UsbTmcDevice, config_value: int) -> None:
        del dev_handle, config_value

    def get_configuration(self, dev_handle: UsbTmcDevice) -> int:
        del dev_handle
        return 1

    def set_interface_altsetting(self, dev_handle: UsbTmcDevice, intf: int, altsetting: int) -> None:
        del dev_handle
        _only_first(intf, altsetting)

    def claim_interface(self, dev_handle: UsbTmcDevice, intf: int) -> None:
        del dev_handle
        _only_first(intf)

    def release_interface(self, dev_handle: UsbTmcDevice, intf: int) -> None:
        del dev_handle, intf

    def is_kernel_driver_active(self, dev_handle: UsbTmcDevice, intf: int) -> bool:
        del dev_handle, intf
        return False

    def clear_halt(self, dev_handle: UsbTmcDevice, ep: int) -> None:
        dev_handle.clear_halt(ep)

    def reset_device(self, dev_handle: UsbTmcDevice) -> None:
        dev_handle.reset()

    def bulk_write(self, dev_handle: UsbTmcDevice, ep: int, intf: int, data: "array[int]", timeout: int) -> int:
        del ep, intf, timeout
        with self._lock:
            try:
                dev_handle.bulk_out(data.tobytes(), self._clock.now() + 0.5 * dev_handle.latency_s)
            except Stall:
                raise _stalled() from None
            return len(data)

    def bulk_read(self, dev_handle: UsbTmcDevice, ep: int, intf: int, buff: "array[int]", timeout: int) -> int:
        del ep, intf
        deadline = self._clock.now() + timeout / 1000.0
        with self._lock:
            try:
                ready = dev_handle.bulk_in_ready()
            except Stall:
                raise _stalled() from None
            if ready is None or ready + 0.5 * dev_handle.latency_s > deadline:
                self._clock.sleep_until(deadline)
                raise usb.core.USBTimeoutError("Operation timed out", -7, 110)
            self._clock.sleep_until(ready + 0.5 * dev_handle.latency_s)
            data = dev_handle.bulk_in()
            if len(data) > len(buff):
                raise usb.core.USBError("Overflow", -8, 75)
            buff[: len(data)] = array("B", data)
            return len(data)

    def ctrl_transfer(
        self,
        dev_handle: UsbTmcDevice,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: "array[int]",
        timeout: int,
    ) -> int:
        del wIndex, timeout
        with self._lock:
            if (bmRequestType, bRequest) == GET_DESCRIPTOR and wValue >> 8 == STRING_DESCRIPTOR:
                answer = _string(dev_handle, wValue & 0xFF)
            elif bmRequestType & 0x60 == CLASS_IN and bmRequestType & 0x80:
                self._clock.sleep_until(self._clock.now() + dev_handle.latency_s)
                try:
                    answer = dev_handle.control_in(bRequest, wValue, self._clock.now())
                except Stall:
                    raise _stalled() from None
            else:
                raise _stalled()
            size = min(len(answer), len(data))
            data[:size] = array("B", answer[:size])
            return size


def _only_first(*numbers: int) -> None:
    """The device has one configuration with one interface: past it pyusb wants an IndexError."""
    if any(numbers):
        raise IndexError("past the last descriptor")


def _string(device: UsbTmcDevice, index: int) -> bytes:
    texts = {1: MANUFACTURER, 2: PRODUCT, 3: device.serial_number}
    if index == 0:
        return ENGLISH
    if index not in texts:
        raise _stalled()
    body = texts[index].encode("utf-16-le")
    return bytes((len(body) + 2, 3)) + body


def _stalled() -> usb.core.USBError:
    return usb.core.USBError("Pipe error", -9, 32)
