"""USB devices of another computer, or of another program, over USB/IP: a backend for pyusb.

`usb.core.find(backend=UsbIpBackend("127.0.0.1", 3240))` finds the devices that the server exports. A device is imported
while it is open and, briefly, to read its descriptors; no other program can use it meanwhile.

Transfers go over one TCP connection per device, one at a time, each with its number and its timeout. A transfer that has
not ended in time is unlinked before the next begins, so that a late reply is not taken for another's. Whatever a server
sends, no wait is longer than its timeout: after that only what is there already is looked at, once.

Errors are pyusb's, with libusb's codes: a timeout is USBTimeoutError(-7, ETIMEDOUT), a stall USBError(-9, EPIPE), a packet
that is too large USBError(-8, EOVERFLOW), and a device or server that is disconnected USBError(-4, ENODEV).
"""

import contextlib
import errno
import socket
import struct
import threading
from array import array
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, TypeVar

import usb.core
from usb.backend import IBackend

from goniotwin.protocols import usbip
from goniotwin.protocols.clock import Clock, RealClock
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

CONNECT_S = 2.0
ANSWER_S = 2.0
"""Longest reply time of the server itself, without a device."""
CHUNK = 65_536
SHORTEST_WAIT_S = 1e-3
CLOCK: Clock = RealClock()
# Status numbers on the wire are Linux's on every system.
STALLED, TOO_LARGE, BUSY = -32, -75, -16
DISCONNECTED = {-19, -104, -108}
TIMEOUT_MS = 1000
GET_DESCRIPTOR, GET_CONFIGURATION, SET_CONFIGURATION, SET_INTERFACE = 6, 8, 9, 11
CLEAR_FEATURE, SET_FEATURE = 1, 3
PORT, PORT_RESET = 0x23, 4
"""Hub class request to the port of the device; USB/IP carries it like any other."""
T = TypeVar("T")


def exported_devices(host: str, port: int) -> list[usbip.ExportedDevice]:
    """Devices that a server exports. Raises USBError if the server does not respond."""
    with _connect(host, port) as connection:
        connection.sendall(usbip.ListRequest().encode())
        return _receive(connection, bytearray(), usbip.take_list)


class UsbIpLink:
    """An imported device; it belongs to this program until every user has called `close`."""

    def __init__(
        self, host: str, port: int, bus_id: str, connection: socket.socket | None = None, clock: Clock = CLOCK
    ) -> None:
        """Import the device, over a `connection` that is open already, if it is given.

        Raises USBError if the device is not connected, or in use by another program.
        """
        self._clock = clock
        self._lock = threading.Lock()
        self._users, self._users_lock = 1, threading.Lock()
        self._buffer = bytearray()
        self._number = 0
        self._socket = connection or _connect(host, port)
        try:
            self._socket.sendall(usbip.ImportRequest(bus_id).encode())
            imported = _receive(self._socket, self._buffer, usbip.take_import, self._clock)
        except BaseException:
            self._socket.close()
            raise
        if imported.device is None:
            self._socket.close()
            raise usb.core.USBError("Resource busy", -6, errno.EBUSY)
        self._device = imported.device.number

    def control(self, setup: bytes, data: bytes, timeout_ms: int) -> bytes:
        """Send a request to endpoint 0, its eight bytes and data; return the reply. Raises USBError."""
        length = int.from_bytes(setup[6:8], "little")
        return self._transfer(0, data, length, timeout_ms, setup, to_host=bool(setup[0] & 0x80)).data

    def write(self, endpoint: int, data: bytes, timeout_ms: int) -> int:
        """Write to a bulk or interrupt endpoint; return the number of bytes written. Raises USBError."""
        return self._transfer(endpoint & 0x0F, data, len(data), timeout_ms).length

    def read(self, endpoint: int, length: int, timeout_ms: int) -> bytes:
        """Read from a bulk or interrupt endpoint. Raises USBError."""
        return self._transfer(endpoint & 0x0F, b"", length, timeout_ms, to_host=True).data

    def share(self) -> bool:
        """Add a user, which calls `close` as well; False for a link that is closed."""
        with self._users_lock:
            if self._socket.fileno() < 0:
                return False
            self._users += 1
            return True

    def close(self) -> None:
        """Release the device, if this is the last user."""
        with self._users_lock:
            self._users -= 1
            if self._users <= 0:
                self._socket.close()

    def _transfer(
        self, endpoint: int, data: bytes, length: int, timeout_ms: int, setup: bytes = usbip.NO_SETUP, *, to_host: bool = False
    ) -> usbip.Submitted:
        with self._lock:
            self._number += 1
            number = self._number
            submit = usbip.Submit(number, self._device, endpoint, to_host, length, b"" if to_host else data, setup)
            reading = {number} if to_host else set()
            try:
                self._send(submit.encode())
                result = next((each for each in self._results(reading, timeout_ms / 1000.0) if each.number == number), None)
                if result is None:
                    result = self._unlink(number, reading)
            except (OSError, usbip.UsbIpError) as error:
                if isinstance(error, usb.core.USBError):
                    raise
                self._socket.close()
                raise disconnected() from error
        assert isinstance(result, usbip.Submitted)
        _raise_for(result.status)
        return result

    def _send(self, data: bytes) -> None:
        self._socket.settimeout(ANSWER_S)
        self._socket.sendall(data)

    def _results(self, reading: set[int], seconds: float) -> Iterator[usbip.Submitted | usbip.Unlinked]:
        """Results as they come, until the timeout; 0 is none. Raises OSError, UsbIpError."""
        for _ in _received(self._socket, self._buffer, seconds, self._clock):
            while (result := usbip.take_result(self._buffer, reading)) is not None:
                yield result

    def _unlink(self, number: int, reading: set[int]) -> usbip.Submitted:
        """Unlink a transfer. If it has ended meanwhile, its result counts. Raises USBTimeoutError."""
        self._number += 1
        self._send(usbip.Unlink(self._number, self._device, number).encode())
        ended: usbip.Submitted | None = None
        for result in self._results(reading, ANSWER_S):
            if isinstance(result, usbip.Submitted) and result.number == number:
                ended = result
            if isinstance(result, usbip.Unlinked) and result.number == self._number:
                if ended is None:
                    raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
                return ended
        raise ConnectionResetError


class UsbIpDevice:
    """A device that a server exports; its descriptors are read once."""

    def __init__(self, host: str, port: int, exported: usbip.ExportedDevice) -> None:
        self.host, self.port, self.exported = host, port, exported
        self._lock = threading.Lock()
        self._link: UsbIpLink | None = None
        self._descriptors: tuple[bytes, list[Configuration]] | None = None

    def open(self) -> UsbIpLink:
        """Import the device. Raises USBError if it is not connected, or in use by another program.

        As with libusb, this program can open it several times.
        """
        with self._lock:
            if self._link is None or not self._link.share():
                self._link = UsbIpLink(self.host, self.port, self.exported.bus_id)
            return self._link

    def descriptors(self) -> tuple[bytes, list[Configuration]]:
        """Device descriptor and configurations. Raises USBError."""
        if self._descriptors is None:
            link = self.open()
            try:
                device = _descriptor(link, DEVICE, 0, DEVICE_BYTES)
                configurations = [_configuration(link, k) for k in range(self.exported.configurations)]
            except DescriptorError as error:
                raise usb.core.USBError(f"{self.exported.bus_id}: {error}", -1, errno.EIO) from None
            finally:
                link.close()
            self._descriptors = device, configurations
        return self._descriptors


class UsbIpBackend(IBackend):
    """The devices of one server."""

    def __init__(self, host: str, port: int = usbip.PORT, bus_id: str | None = None) -> None:
        """With a `bus_id`, only this device."""
        super().__init__()
        self._host, self._port, self._bus_id = host, port, bus_id
        self._known: dict[usbip.ExportedDevice, UsbIpDevice] = {}

    def enumerate_devices(self) -> list[UsbIpDevice]:
        """The devices now; one that was known is the same object, since pyusb compares devices by it."""
        exported = [each for each in exported_devices(self._host, self._port) if self._bus_id in (None, each.bus_id)]
        return [self._known.setdefault(each, UsbIpDevice(self._host, self._port, each)) for each in exported]

    def get_parent(self, dev: UsbIpDevice) -> None:
        del dev

    def get_device_descriptor(self, dev: UsbIpDevice) -> SimpleNamespace:
        exported = dev.exported
        return decode_device(
            dev.descriptors()[0],
            address=exported.address,
            bus=exported.bus,
            port_number=exported.address,
            port_numbers=(exported.address,),
            speed=exported.speed,
        )

    def get_configuration_descriptor(self, dev: UsbIpDevice, config: int) -> SimpleNamespace:
        return dev.descriptors()[1][config].fields

    def get_interface_descriptor(self, dev: UsbIpDevice, intf: int, alt: int, config: int) -> SimpleNamespace:
        return dev.descriptors()[1][config].setting(intf, alt).fields

    def get_endpoint_descriptor(self, dev: UsbIpDevice, ep: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        return dev.descriptors()[1][config].setting(intf, alt).endpoints[ep]

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
        """Nothing to do: the whole device has been imported."""

    def release_interface(self, dev_handle: UsbIpLink, intf: int) -> None:
        """Nothing to do: the whole device stays imported until it is closed."""

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
    """The pyusb device that a server exports as `bus_id`, or None. Raises USBError."""
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


def disconnected() -> usb.core.USBError:
    """The error of libusb for a disconnected device."""
    return usb.core.USBError("No such device (it may have been disconnected)", -4, errno.ENODEV)


def _raise_for(status: int) -> None:
    if status == STALLED:
        raise usb.core.USBError("Pipe error", -9, errno.EPIPE)
    if status == TOO_LARGE:
        raise usb.core.USBError("Overflow", -8, errno.EOVERFLOW)
    if status in DISCONNECTED:
        raise disconnected()
    if status:
        raise usb.core.USBError(f"Input/output error: USB/IP status {status}", -1, errno.EIO)


def _connect(host: str, port: int) -> socket.socket:
    try:
        connection = socket.create_connection((host, port), timeout=CONNECT_S)
    except OSError as error:
        raise usb.core.USBError(f"no USB/IP server at {host}:{port}: {error.strerror or error}", -4, errno.ENODEV) from None
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


def _receive(connection: socket.socket, buffer: bytearray, take: Callable[[bytearray], T | None], clock: Clock = CLOCK) -> T:
    try:
        for _ in _received(connection, buffer, ANSWER_S, clock):
            if (reply := take(buffer)) is not None:
                return reply
        raise TimeoutError("timed out")
    except (OSError, usbip.UsbIpError) as error:
        with contextlib.suppress(OSError):
            connection.close()
        raise usb.core.USBError(f"the USB/IP server is not responding: {error}", -4, errno.ENODEV) from None


def _received(connection: socket.socket, buffer: bytearray, seconds: float, clock: Clock) -> Iterator[None]:
    """Append to `buffer` what comes: once before the first wait, then after each piece, until a timeout; 0 is none.

    Raises OSError.
    """
    yield
    deadline, over = clock.now() + seconds, False
    while not over:
        left = deadline - clock.now()
        over = seconds > 0.0 and left <= 0.0
        connection.settimeout(max(left, SHORTEST_WAIT_S) if seconds else None)
        try:
            data = connection.recv(CHUNK)
        except TimeoutError:
            return
        if not data:
            raise ConnectionResetError("the server closed the connection")
        buffer += data
        yield
