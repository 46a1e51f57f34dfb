"""pyusb's door: a backend whose bus has the twin's USB devices on it.

`usb.core.find(backend=TwinUsbBackend(rig))` finds them; pyusb's programs need not know. `unplug` and `replug` are its back
door. Source: pyusb 1.3's IBackend and the errors of its libusb backend: a timeout is USBTimeoutError(-7, 110), a stall
USBError(-9, 32), a packet too large USBError(-8, 75), a device that is gone USBError(-4, 19).
"""

from array import array
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import usb.core
from usb.backend import IBackend

from goniotwin.protocols.clock import VirtualClock
from goniotwin.protocols.usb_descriptors import decode_configuration, decode_device
from goniotwin.protocols.usbip import FULL_SPEED
from goniotwin.twin.devices.usb_standard import INTERRUPT_IN, configuration_descriptor, device_descriptor
from goniotwin.twin.devices.usbtmc import UsbTmcDevice
from goniotwin.twin.devices.usbtmc_transfers import Overflow, Stall
from goniotwin.twin.rig import VirtualRig

POLL_S = 0.002


class Handle:
    """An open device; dead for good once its cable has been out."""

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
        self._configurations = [decode_configuration(configuration_descriptor())]

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

    def get_device_descriptor(self, dev: UsbTmcDevice) -> SimpleNamespace:
        address = list(self._rig.usb.values()).index(dev) + 1
        data = device_descriptor(dev.instrument.vendor_id, dev.instrument.product_id)
        return decode_device(data, address=address, bus=1, port_number=address, port_numbers=(address,), speed=FULL_SPEED)

    def get_configuration_descriptor(self, dev: UsbTmcDevice, config: int) -> SimpleNamespace:
        del dev
        return self._configurations[config].fields

    def get_interface_descriptor(self, dev: UsbTmcDevice, intf: int, alt: int, config: int) -> SimpleNamespace:
        del dev
        return self._configurations[config].setting(intf, alt).fields

    def get_endpoint_descriptor(self, dev: UsbTmcDevice, ep: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        del dev
        return self._configurations[config].setting(intf, alt).endpoints[ep]

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
        """Time at which another client may use the device."""
        if isinstance(self._clock, VirtualClock):
            return self._clock.next_event()
        return now + POLL_S * getattr(self._clock, "speed", 1.0)


def _only_first(*numbers: int) -> None:
    """The device has one configuration with one interface: past it pyusb wants an IndexError."""
    if any(numbers):
        raise IndexError("past the last descriptor")


def stalled() -> usb.core.USBError:
    """libusb's error for a stall."""
    return usb.core.USBError("Pipe error", -9, 32)


def gone() -> usb.core.USBError:
    """libusb's error for a device that has gone."""
    return usb.core.USBError("No such device (it may have been disconnected)", -4, 19)
