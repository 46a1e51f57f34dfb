"""pyusb's door: a backend whose bus has the twin's USB devices on it.

`usb.core.find(backend=TwinUsbBackend(rig))` finds them; pyusb's programs need not know. `unplug` and `replug` are its back
door. Source: pyusb 1.3's IBackend and the errors of its libusb backend: a timeout is USBTimeoutError(-7, 110), a stall
USBError(-9, 32), a packet too large USBError(-8, 75), a device that is gone USBError(-4, 19).
"""

from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import usb.core
from usb.backend import IBackend

from protocols.clock import VirtualClock
from protocols.usbtmc import INTERFACE_CLASS
from twin.devices.usb_standard import ENDPOINTS, INTERRUPT_IN, INTERVAL_MS, MAX_POWER_2_MA, packet_bytes
from twin.devices.usbtmc import PROTOCOL, Overflow, Stall, UsbTmcDevice
from twin.rig import VirtualRig

FULL_SPEED = 2
POLL_S = 0.002


@dataclass
class Descriptor:
    """Any descriptor: the fields that pyusb reads, by their names in the USB specification."""

    fields: dict[str, object] = field(default_factory=dict)

    def __getattr__(self, name: str) -> object:
        try:
            return self.__dict__["fields"][name]
        except KeyError:
            raise AttributeError(name) from None


class Handle:
    """A device that somebody has opened; dead for good once its cable has been out."""

    def __init__(self, device: UsbTmcDevice) -> None:
        self._device = device
        self._plugs = device.plugs

    @property
    def device(self) -> UsbTmcDevice:
        """Raises USBError where it is gone."""
        if not self._device.plugged or self._device.plugs != self._plugs:
            raise gone()
        return self._device


class TwinUsbBackend(IBackend):
    """The bus. One instance a rig, since pyusb compares devices by the objects that this gives it."""

    def __init__(self, rig: VirtualRig) -> None:
        super().__init__()
        self._rig = rig
        self._clock = rig.clock
        self._lock = rig.lock

    def unplug(self, name: str) -> None:
        """Pulls a device's cable. Raises KeyError for one that the rig does not have."""
        with self._lock:
            self._rig.usb[name].unplug()

    def replug(self, name: str, *, reset: bool = False) -> None:
        """Puts the cable in again; with `reset` the instrument had no other power, and has forgotten its settings."""
        with self._lock:
            device = self._rig.usb[name]
            if reset:
                device.instrument.power_cycle(self._clock.now())
            device.replug()

    def enumerate_devices(self) -> Iterator[UsbTmcDevice]:
        return iter([device for device in self._rig.usb.values() if device.plugged])

    def get_parent(self, dev: UsbTmcDevice) -> None:
        del dev

    def get_device_descriptor(self, dev: UsbTmcDevice) -> Descriptor:
        instrument = dev.instrument
        return Descriptor(
            dict(
                bLength=18, bDescriptorType=1, bcdUSB=0x0200, bDeviceClass=0, bDeviceSubClass=0, bDeviceProtocol=0,
                bMaxPacketSize0=64, idVendor=instrument.vendor_id, idProduct=instrument.product_id, bcdDevice=0x0100,
                iManufacturer=1, iProduct=2, iSerialNumber=3, bNumConfigurations=1,
                address=list(self._rig.usb.values()).index(dev) + 1, bus=1, port_number=1, port_numbers=(1,), speed=FULL_SPEED,
            )
        )  # fmt: skip

    def get_configuration_descriptor(self, dev: UsbTmcDevice, config: int) -> Descriptor:
        del dev
        _only_first(config)
        return Descriptor(
            dict(
                bLength=9, bDescriptorType=2, wTotalLength=18 + 7 * len(ENDPOINTS), bNumInterfaces=1, bConfigurationValue=1,
                iConfiguration=0, bmAttributes=0xC0, bMaxPower=MAX_POWER_2_MA, extra_descriptors=[],
            )
        )  # fmt: skip

    def get_interface_descriptor(self, dev: UsbTmcDevice, intf: int, alt: int, config: int) -> Descriptor:
        del dev
        _only_first(intf, alt, config)
        device_class, subclass = INTERFACE_CLASS
        return Descriptor(
            dict(
                bLength=9, bDescriptorType=4, bInterfaceNumber=0, bAlternateSetting=0, bNumEndpoints=len(ENDPOINTS),
                bInterfaceClass=device_class, bInterfaceSubClass=subclass, bInterfaceProtocol=PROTOCOL, iInterface=0,
                extra_descriptors=[],
            )
        )  # fmt: skip

    def get_endpoint_descriptor(self, dev: UsbTmcDevice, ep: int, intf: int, alt: int, config: int) -> Descriptor:
        del dev
        _only_first(intf, alt, config)
        address, kind = ENDPOINTS[ep]
        return Descriptor(
            dict(
                bLength=7, bDescriptorType=5, bEndpointAddress=address, bmAttributes=kind, wMaxPacketSize=packet_bytes(address),
                bInterval=INTERVAL_MS if kind == 3 else 0, bRefresh=0, bSynchAddress=0, extra_descriptors=[],
            )
        )  # fmt: skip

    def open_device(self, dev: UsbTmcDevice) -> Handle:
        return Handle(dev)

    def close_device(self, dev_handle: Handle) -> None:
        del dev_handle

    def set_configuration(self, dev_handle: Handle, config_value: int) -> None:
        del config_value
        self._now(dev_handle.device.new_host)

    def get_configuration(self, dev_handle: Handle) -> int:
        assert dev_handle.device
        return 1

    def set_interface_altsetting(self, dev_handle: Handle, intf: int, altsetting: int) -> None:
        assert dev_handle.device
        _only_first(intf, altsetting)

    def claim_interface(self, dev_handle: Handle, intf: int) -> None:
        _only_first(intf)
        self._now(dev_handle.device.new_host)

    def release_interface(self, dev_handle: Handle, intf: int) -> None:
        assert dev_handle.device
        _only_first(intf)

    def is_kernel_driver_active(self, dev_handle: Handle, intf: int) -> bool:
        assert dev_handle.device
        _only_first(intf)
        return False

    def detach_kernel_driver(self, dev_handle: Handle, intf: int) -> None:
        del dev_handle, intf
        raise usb.core.USBError("Entity not found", -5, 2)

    def attach_kernel_driver(self, dev_handle: Handle, intf: int) -> None:
        del dev_handle, intf
        raise usb.core.USBError("Entity not found", -5, 2)

    def clear_halt(self, dev_handle: Handle, ep: int) -> None:
        device = dev_handle.device
        self._now(lambda: device.clear_halt(ep))

    def reset_device(self, dev_handle: Handle) -> None:
        self._now(dev_handle.device.reset)

    def bulk_write(self, dev_handle: Handle, ep: int, intf: int, data: "array[int]", timeout: int) -> int:
        del ep, intf, timeout
        device = dev_handle.device
        self._now(lambda: device.bulk_out(data.tobytes(), self._clock.now() + 0.5 * device.latency_s))
        return len(data)

    def bulk_read(self, dev_handle: Handle, ep: int, intf: int, buff: "array[int]", timeout: int) -> int:
        del ep, intf
        return self._read(
            dev_handle, buff, timeout, lambda device: device.bulk_in_ready(), lambda device: device.bulk_in(len(buff))
        )

    def intr_read(self, dev_handle: Handle, ep: int, intf: int, buff: "array[int]", timeout: int) -> int:
        del intf
        if ep != INTERRUPT_IN:
            raise usb.core.USBError("Entity not found", -5, 2)
        return self._read(
            dev_handle,
            buff,
            timeout,
            lambda device: device.interrupt_in_ready(),
            lambda device: device.interrupt_in(self._clock.now()),
        )

    def ctrl_transfer(
        self,
        dev_handle: Handle,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: "array[int]",
        timeout: int,
    ) -> int:
        del timeout
        device = dev_handle.device
        if bmRequestType & 0x60:
            self._clock.sleep_until(self._clock.now() + device.latency_s)
        answers: list[bytes] = []
        length = len(data)
        self._now(lambda: answers.append(device.control(bmRequestType, bRequest, wValue, wIndex, length, self._clock.now())))
        if not bmRequestType & 0x80:
            return length
        size = min(len(answers[0]), length)
        data[:size] = array("B", answers[0][:size])
        return size

    def _now(self, action: Callable[[], object]) -> None:
        """What a device does, alone; a stall becomes pyusb's."""
        with self._lock:
            try:
                action()
            except Stall:
                raise stalled() from None

    def _read(
        self,
        handle: Handle,
        buffer: "array[int]",
        timeout_ms: int,
        ready: Callable[[UsbTmcDevice], float | None],
        take: Callable[[UsbTmcDevice], bytes],
    ) -> int:
        """Waits for something to read, NAK after NAK, and takes it; a timeout of 0 is none. Others may go on meanwhile."""
        deadline = self._clock.now() + timeout_ms / 1000.0 if timeout_ms else float("inf")
        while True:
            now = self._clock.now()
            with self._lock:
                device = handle.device
                try:
                    when = ready(device)
                    arrives = float("inf") if when is None else max(when, now - 0.5 * device.latency_s) + 0.5 * device.latency_s
                    if arrives <= now:
                        data = take(device)
                        break
                except Stall:
                    raise stalled() from None
                except Overflow:
                    raise usb.core.USBError("Overflow", -8, 75) from None
            if now >= deadline:
                raise usb.core.USBTimeoutError("Operation timed out", -7, 110)
            self._clock.sleep_until(min(arrives, deadline, self._next_change(now)))
        buffer[: len(data)] = array("B", data)
        return len(data)

    def _next_change(self, now: float) -> float:
        """When somebody else may do something to the device."""
        if isinstance(self._clock, VirtualClock):
            return self._clock.next_event()
        return now + POLL_S * getattr(self._clock, "speed", 1.0)


def _only_first(*numbers: int) -> None:
    """The device has one configuration with one interface: past it pyusb wants an IndexError."""
    if any(numbers):
        raise IndexError("past the last descriptor")


def stalled() -> usb.core.USBError:
    """What libusb says of a stall."""
    return usb.core.USBError("Pipe error", -9, 32)


def gone() -> usb.core.USBError:
    """What libusb says of a device that is not there any more."""
    return usb.core.USBError("No such device (it may have been disconnected)", -4, 19)
