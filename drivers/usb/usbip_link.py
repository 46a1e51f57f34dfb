"""One imported USB/IP device: transfers over its TCP connection, one at a time, each with its timeout.

What has not ended in time is taken back before the next begins, so that a late answer cannot be taken for another's:
every transfer has a number of its own.

Errors are pyusb's, with libusb's codes: a timeout is USBTimeoutError(-7, ETIMEDOUT), a stall USBError(-9, EPIPE), a packet
too large USBError(-8, EOVERFLOW), and a device that is gone, its server with it or not, USBError(-4, ENODEV).
"""

import contextlib
import errno
import socket
import threading
from collections.abc import Callable
from typing import TypeVar

import usb.core

from goniotwin.protocols import usbip

CONNECT_S = 2.0
ANSWER_S = 2.0
"""How long the server may take for what no device is asked for."""
CHUNK = 65_536
# On the wire the numbers are Linux's, whatever system this is.
STALLED, TOO_LARGE, BUSY = -32, -75, -16
GONE = {-19, -104, -108}
T = TypeVar("T")


def listed_devices(host: str, port: int) -> list[usbip.ExportedDevice]:
    """What a server exports. Raises USBError where none answers."""
    with _connected(host, port) as connection:
        connection.sendall(usbip.ListRequest().encode())
        return _answer(connection, bytearray(), usbip.take_list)


class UsbIpLink:
    """A device that is this program's until `close`."""

    def __init__(self, host: str, port: int, bus_id: str) -> None:
        """Imports the device. Raises USBError where it is not there, or somebody else has it."""
        self._lock = threading.Lock()
        self._buffer = bytearray()
        self._number = 0
        self._socket = _connected(host, port)
        try:
            self._socket.sendall(usbip.ImportRequest(bus_id).encode())
            found = _answer(self._socket, self._buffer, usbip.take_import)
        except BaseException:
            self._socket.close()
            raise
        if found.device is None:
            self._socket.close()
            raise usb.core.USBError("Resource busy", -6, errno.EBUSY)
        self._device = found.device.number

    def control(self, setup: bytes, data: bytes, timeout_ms: int) -> bytes:
        """A request to endpoint 0: its eight bytes, what goes with them; what comes back. Raises USBError."""
        length = int.from_bytes(setup[6:8], "little")
        return self._transfer(0, data, length, timeout_ms, setup, to_host=bool(setup[0] & 0x80)).data

    def write(self, endpoint: int, data: bytes, timeout_ms: int) -> int:
        """To a bulk or interrupt endpoint; how many bytes went. Raises USBError."""
        return self._transfer(endpoint & 0x0F, data, len(data), timeout_ms).length

    def read(self, endpoint: int, length: int, timeout_ms: int) -> bytes:
        """From a bulk or interrupt endpoint. Raises USBError."""
        return self._transfer(endpoint & 0x0F, b"", length, timeout_ms, to_host=True).data

    def close(self) -> None:
        """Gives the device back."""
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
                self._socket.sendall(submit.encode())
                result = self._result(reading, timeout_ms / 1000.0 if timeout_ms else None)
                while result is not None and result.number != number:
                    result = self._result(reading, timeout_ms / 1000.0 if timeout_ms else None)
                if result is None:
                    result = self._taken_back(number, reading)
            except (OSError, usbip.UsbIpError) as error:
                if isinstance(error, usb.core.USBError):
                    raise
                self._socket.close()
                raise gone() from error
        assert isinstance(result, usbip.Submitted)
        _raise_for(result.status)
        return result

    def _result(self, reading: set[int], seconds: float | None) -> usbip.Submitted | usbip.Unlinked | None:
        """The next that arrives; None where nothing does for so long. Raises OSError, UsbIpError."""
        self._socket.settimeout(seconds)
        while (result := usbip.take_result(self._buffer, reading)) is None:
            try:
                data = self._socket.recv(CHUNK)
            except TimeoutError:
                return None
            if not data:
                raise ConnectionResetError
            self._buffer += data
        return result

    def _taken_back(self, number: int, reading: set[int]) -> usbip.Submitted:
        """Ends a transfer that has not ended. It may have meanwhile; then it counts. Raises USBTimeoutError."""
        self._number += 1
        self._socket.sendall(usbip.Unlink(self._number, self._device, number).encode())
        ended: usbip.Submitted | None = None
        while True:
            result = self._result(reading, ANSWER_S)
            if result is None:
                raise ConnectionResetError
            if isinstance(result, usbip.Submitted) and result.number == number:
                ended = result
            if isinstance(result, usbip.Unlinked) and result.number == self._number:
                break
        if ended is None:
            raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
        return ended


def gone() -> usb.core.USBError:
    """What libusb says of a device that is not there any more."""
    return usb.core.USBError("No such device (it may have been disconnected)", -4, errno.ENODEV)


def _raise_for(status: int) -> None:
    if status == STALLED:
        raise usb.core.USBError("Pipe error", -9, errno.EPIPE)
    if status == TOO_LARGE:
        raise usb.core.USBError("Overflow", -8, errno.EOVERFLOW)
    if status in GONE:
        raise gone()
    if status:
        raise usb.core.USBError(f"Input/output error: USB/IP status {status}", -1, errno.EIO)


def _connected(host: str, port: int) -> socket.socket:
    try:
        connection = socket.create_connection((host, port), timeout=CONNECT_S)
    except OSError as error:
        raise usb.core.USBError(f"no USB/IP server at {host}:{port}: {error.strerror or error}", -4, errno.ENODEV) from None
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


def _answer(connection: socket.socket, buffer: bytearray, take: Callable[[bytearray], T | None]) -> T:
    connection.settimeout(ANSWER_S)
    try:
        while (answer := take(buffer)) is None:
            data = connection.recv(CHUNK)
            if not data:
                raise ConnectionResetError("it hung up")
            buffer += data
    except (OSError, usbip.UsbIpError) as error:
        with contextlib.suppress(OSError):
            connection.close()
        raise usb.core.USBError(f"the USB/IP server does not answer: {error}", -4, errno.ENODEV) from None
    return answer
